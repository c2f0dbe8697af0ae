"""What the gates look at: a set, what it is compared with, the run behind it, and held-out frames seen under both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.parameter_file import parse_parameters
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.telemetry.sensors import Sensor

Document = Mapping[str, Any]


@dataclass(frozen=True)
class GateInputs:
    """Everything a verdict rests on."""

    sensor: Sensor
    candidate: Document
    incumbent: Document | None
    result: Document | None = None
    made_with: Document | None = None
    held_out: Document | None = None
    no_held_out: str = ""
    definition: Document | None = None

    @property
    def camera(self) -> CameraModel:
        """The sensor's camera model."""
        return CAMERA_MODELS[self.sensor.camera_model]

    @property
    def names(self) -> tuple[str, ...]:
        """Its parameters, in order."""
        return self.camera.parameter_names

    @cached_property
    def x(self) -> FloatArray:
        """(n_parameters,) the set's parameters, SI; refuses as `parse_parameters`."""
        return parse_parameters(self.candidate, self.sensor, "The set")[0]

    @cached_property
    def x_incumbent(self) -> FloatArray | None:
        """(n_parameters,) the incumbent's; None where there is no incumbent."""
        return None if self.incumbent is None else parse_parameters(self.incumbent, self.sensor, "The incumbent")[0]

    def covariance_of(self, document: Document) -> FloatArray:
        """Spread a set's covariance over all parameters, (n_parameters, n_parameters) SI, 0 for those it held fixed."""
        covariance = document["covariance"]
        places = [self.names.index(name) for name in covariance["names"]]
        P = np.zeros((len(self.names),) * 2)
        P[np.ix_(places, places)] = np.array(covariance["matrix"], np.float64).reshape(len(places), len(places))
        return P

    @property
    def pixel_rad(self) -> float:
        """What one pixel sees at the centre of the registered sensor."""
        return float(self.sensor.pixel_pitch_m / self.sensor.initial[self.names.index("f_m")])
