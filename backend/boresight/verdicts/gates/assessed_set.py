"""A parameter set as the gates read it: a stored one, a calibration, a sensor's start, or what a file says.

Whether a set is sound is what the gates ask, so nothing in a document is refused here: parameters that are none of this sensor's
are a fault, a sigma that is no number is NaN, and a covariance that is not names and a matrix is None.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Calibration, Covariance, Values, parse_part
from boresight.calibration.parameter_file import parse_parameters, take_parameters
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.telemetry.sensors import Sensor

#: A document that is read before it is known whether it is a set.
Document = Mapping[str, Any]
State = tuple[FloatArray, FloatArray | None]
INCOMPLETE = "This set lacks the numbers for this gate: calibrate again."


@dataclass(frozen=True, kw_only=True)
class AssessedSet:
    """A parameter set, SI by name.

    `covariance`: of noise alone; `reliable_covariance`: the one to decide by, with misfit where the set has it; None where there is
    none or it is no matrix of numbers. `known_state`: the parameters in the camera model's order with their covariance, as
    `parse_parameters` reads them; None where they are none of the sensor's, and `fault` says why.
    """

    sensor: str | None
    camera_model: str | None
    status: str | None
    parameters: Values[float]
    sigma: Values[float | None]
    covariance: Covariance | None
    reliable_covariance: Covariance | None
    known_state: State | None
    fault: str = ""

    @property
    def state(self) -> State:
        """The parameters and their covariance over all of them; refuses parameters that are none of the sensor's."""
        if self.known_state is None:
            raise RefusedInputError(self.fault)
        return self.known_state


def assess_calibration(result: Calibration, sensor: Sensor) -> AssessedSet:
    """Take what a calibration found."""
    state, fault = _try(lambda: take_parameters(result, result.covariance, sensor, "The set"))
    return AssessedSet(
        sensor=result.sensor,
        camera_model=result.camera_model,
        status=result.status,
        parameters=result.parameters,
        sigma=result.sigma,
        covariance=result.covariance,
        reliable_covariance=result.reliable_covariance,
        known_state=state,
        fault=fault,
    )


def ground_set(sensor: Sensor) -> AssessedSet:
    """Take a sensor's start as a set: declared, its sigmas the typical spread from unit to unit."""
    names = CAMERA_MODELS[sensor.camera_model].parameter_names
    P = np.diag(np.square(sensor.typical_sigma))
    covariance = Covariance(names=list(names), matrix=P.tolist())
    return AssessedSet(
        sensor=sensor.name,
        camera_model=sensor.camera_model,
        status="ground calibration",
        parameters=Values(dict(zip(names, map(float, sensor.initial), strict=True))),
        sigma=Values(dict(zip(names, map(float, sensor.typical_sigma), strict=True))),
        covariance=covariance,
        reliable_covariance=covariance,
        known_state=(sensor.initial, P),
    )


def read_incumbent(document: Document, sensor: Sensor) -> AssessedSet:
    """Take parameters from a file as a set; without a covariance they are known as a ground calibration's are.

    Raises
    ------
    RefusedInputError
        When they are none of this sensor's.
    """
    x, P = parse_parameters(document, sensor, "The baseline")
    declared = ground_set(sensor)
    taken = replace(
        declared,
        parameters=Values(dict(zip(declared.parameters, map(float, x), strict=True))),
        known_state=(x, declared.state[1]),
    )
    if not (given := document.get("covariance")):
        return taken
    covariance = _read_covariance(given)
    return replace(taken, covariance=covariance, reliable_covariance=covariance, known_state=(x, P))


def parse_assessed_set(document: Document, sensor: Sensor, name: str = "The set") -> AssessedSet:
    """Read a set from its document, whatever stands in it; `name` is what faults call it."""
    state, fault = _try(lambda: parse_parameters(document, sensor, name))
    covariance, misfit = _read_covariance(document.get("covariance")), document.get("misfit")
    with_misfit = misfit.get("covariance") if isinstance(misfit, Mapping) else None
    return AssessedSet(
        sensor=_read_text(document.get("sensor")),
        camera_model=_read_text(document.get("camera_model")),
        status=_read_text(document.get("status")),
        parameters=_read_numbers(document.get("parameters")),
        sigma=_read_numbers(document.get("sigma")),
        covariance=covariance,
        reliable_covariance=covariance if misfit is None else _read_covariance(with_misfit),
        known_state=state,
        fault=fault,
    )


def _try(read: Callable[[], State]) -> tuple[State | None, str]:
    """Return what was read, or None with why."""
    try:
        return read(), ""
    except RefusedInputError as refusal:
        return None, str(refusal)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        return None, INCOMPLETE


def _read_text(value: Any) -> str | None:
    return None if value is None else str(value)


def _read_numbers(values: Any) -> Values[Any]:
    """Read numbers by name, None for those that are not known; NaN for what is no number."""
    if not isinstance(values, Mapping):
        return Values()
    return Values(
        {
            name: value if value is None else float(value) if isinstance(value, int | float) else math.nan
            for name, value in values.items()
        }
    )


def _read_covariance(document: Any) -> Covariance | None:
    try:
        return parse_part(Covariance, document, RefusedInputError)
    except RefusedInputError:
        return None
