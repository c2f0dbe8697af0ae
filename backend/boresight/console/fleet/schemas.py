"""Star trackers, what held for one at a time, and its trend over the mission."""

from __future__ import annotations

from pydantic import Field

from boresight.cameras import DEFAULT_CAMERA
from boresight.console.parameter_sets.schemas import ParameterSet
from boresight.console.schemas import Document, Row, Shape, make_shape
from boresight.console.uplinks.schemas import OnBoard
from boresight.verdicts import trend as documents

_PARAMETERS = DEFAULT_CAMERA.plain(0.016 / 2.2e-6, 971.5, 1295.5, 2.2e-6).round(9)
#: Parameters of the sensor file that is shown as an example: 16 mm before 1944 by 2592 pixels of 2.2 um.
EXAMPLE_INITIAL = dict(zip(DEFAULT_CAMERA.parameter_names, _PARAMETERS.tolist(), strict=True))
EXAMPLE_TYPICAL_SIGMA = dict(zip(DEFAULT_CAMERA.parameter_names, DEFAULT_CAMERA.default_typical_sigma, strict=True))
#: What it declares that no data can show.
EXAMPLE_READOUT = {"mode": "rolling", "line_time_s": 3.6e-5, "axis": "rows", "corrected": True}
EXAMPLE_DECLARED = {
    "satellite_velocity": "given",
    "directions": "apparent",
    "refraction": "none",
    "decentring": "centred",
    "centroids": "unbiased",
}


class Sensor(Row):
    """A star tracker."""

    versioned_by = ("version",)
    location = "/sensors/{row.id}"

    id: int
    name: str
    version: int = Field(description='Counts edits; the ETag is `"v<version>"`.')
    document: Document = Field(
        description="The sensor file; `readout`, `declared` and, on the ground, `site` are in it if they are declared.",
    )
    simulated: bool = Field(description="Whether its telemetry was simulated here.")
    truth: Document | None = Field(description="True parameters of a simulated sensor.")
    created_utc: str
    created_by: int | None


class SensorAt(Shape):
    """What held for a sensor at a time."""

    at: str
    baseline: ParameterSet | None
    onboard: list[OnBoard]


#: A sensor over the mission.
Trend = make_shape(documents.Trend, truth=Document | None)
