"""Star trackers, what held for one at a time, and its trend over the mission."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.cameras import DEFAULT_CAMERA
from boresight.console.parameter_sets.schemas import ParameterSet
from boresight.console.schemas import Document, Row, Shape, Values
from boresight.console.uplinks.schemas import OnBoard

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


class DriftTest(Shape):
    """A test at the false-alarm rate of the document."""

    statistic: float
    dof: int
    limit: float
    p: float
    rejects: bool


class Drift(Shape):
    """Whether the baseline still holds, and whether the parameters move with time."""

    verdict: str
    sentence: str
    false_alarm_rate: float
    run_id: int | None
    names: list[str]
    difference: Values | None
    sigma: Values | None
    baseline_holds: DriftTest | None
    slope: DriftTest | None
    calibrations_on_the_line: int
    slope_per_day: Values | None
    slope_sigma_per_day: Values | None
    change_per_c: Values | None


class TrendPoint(Shape):
    """A calibration at the time of its data."""

    run_id: int
    label: str
    method: str
    camera_model: str
    telemetry_set_id: int
    telemetry: str
    begins_utc: str
    at_utc: str
    ends_utc: str
    timed: bool = Field(description="Whether the times are those of the telemetry, not of the upload.")
    temperature_c: float | None
    parameters: Values
    sigma: Values
    stars: int
    rms_arc_rad: float | None
    counted: bool
    left_out: str | None
    said: str | None


class TrendBaseline(Shape):
    """A baseline's time."""

    parameter_set_id: int
    name: str
    from_utc: str
    to_utc: str | None
    measured: bool
    parameters: Values
    sigma: Values


class SetName(Shape):
    """A parameter set by number and name."""

    parameter_set_id: int
    name: str


class OnBoardMark(SetName):
    """A record on board."""

    at_utc: str
    state: str


class TrendAnnotation(Shape):
    """What a person says of a time of the mission."""

    at_utc: str
    text: str
    printed_name: str
    made_utc: str


class Advice(Shape):
    """Whether to recalibrate now."""

    answer: Literal["YES", "NOT YET", "MORE DATA NEEDED"]
    sentence: str
    code: str = Field(description="The kind of advice, for its section in the guide.", examples=["trend_drift"])
    reasons: list[str]


class Trend(Shape):
    """A sensor over the mission."""

    document_schema: Literal["boresight.trend/1"] = Field(alias="schema")
    sensor_id: int
    sensor: str
    camera_model: str
    parameter_names: list[str]
    baseline: SetName | None
    points: list[TrendPoint]
    others: list[TrendPoint] = Field(description="Calibrations under another camera model.")
    baselines: list[TrendBaseline]
    on_board: list[OnBoardMark]
    truth: Document | None
    annotations: list[TrendAnnotation]
    drift: Drift
    advice: Advice
