"""A sensor over the mission, `boresight.trend/1`, SI: the tree that the console fills, REST writes and the figure draws.

The shape that REST publishes is made of these classes, by their names and sentences.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal

from boresight.calibration.calibration import Values

SCHEMA: Final = "boresight.trend/1"
Answer = Literal["YES", "NOT YET", "MORE DATA NEEDED"]
#: Verdicts of the drift test that people read otherwise than programs do.
SHOWN_AS: Final = {"HOLDS": "AGREES"}


@dataclass(frozen=True, kw_only=True)
class TrendPoint:
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
    timed: bool = field(metadata={"description": "Whether the times are those of the telemetry, not of the upload."})
    temperature_c: float | None
    parameters: Values[float]
    sigma: Values[float]
    stars: int
    rms_arc_rad: float | None
    counted: bool
    left_out: str | None
    said: str | None


@dataclass(frozen=True, kw_only=True)
class TrendBaseline:
    """A baseline's time."""

    parameter_set_id: int
    name: str
    from_utc: str
    to_utc: str | None
    measured: bool
    parameters: Values[float]
    sigma: Values[float | None]


@dataclass(frozen=True, kw_only=True)
class SetName:
    """A parameter set by number and name."""

    parameter_set_id: int
    name: str


@dataclass(frozen=True, kw_only=True)
class OnBoardMark:
    """A record on board."""

    at_utc: str
    state: str
    parameter_set_id: int
    name: str


@dataclass(frozen=True, kw_only=True)
class TrendAnnotation:
    """What a person says of a time of the mission."""

    at_utc: str
    text: str
    printed_name: str
    made_utc: str


@dataclass(frozen=True, kw_only=True)
class DriftTest:
    """A test at the false-alarm rate of the document, or where two are made at half of it."""

    statistic: float
    dof: int
    limit: float
    p: float
    rejects: bool


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Whether the baseline still holds, and whether the parameters move with time."""

    verdict: str
    sentence: str
    false_alarm_rate: float
    run_id: int | None = None
    names: list[str] = field(default_factory=list)
    difference: Values[float] | None = None
    sigma: Values[float] | None = None
    baseline_holds: DriftTest | None = None
    slope: DriftTest | None = None
    calibrations_on_the_line: int = 0
    slope_per_day: Values[float] | None = None
    slope_sigma_per_day: Values[float] | None = None
    change_per_c: Values[float] | None = None


@dataclass(frozen=True, kw_only=True)
class Advice:
    """Whether to recalibrate now."""

    answer: Answer
    sentence: str
    code: str = field(
        metadata={"description": "The kind of advice, for its section in the guide.", "examples": ["trend_drift"]}
    )
    reasons: list[str] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Trend:
    """A sensor over the mission."""

    schema: Literal["boresight.trend/1"] = SCHEMA
    sensor_id: int
    sensor: str
    camera_model: str
    parameter_names: list[str]
    baseline: SetName | None
    points: list[TrendPoint]
    others: list[TrendPoint] = field(metadata={"description": "Calibrations under another camera model."})
    baselines: list[TrendBaseline]
    on_board: list[OnBoardMark]
    truth: Values[float] | None
    annotations: list[TrendAnnotation]
    drift: Drift
    advice: Advice
