"""A sensor over the mission, `boresight.trend/1`, SI: the tree that the console fills, REST writes and the figure draws."""

from __future__ import annotations

from dataclasses import dataclass, field

from boresight.calibration.calibration import Values

SCHEMA = "boresight.trend/1"


@dataclass(frozen=True, kw_only=True)
class TrendPoint:
    """A calibration at the time of its data; `timed`: whether the times are those of the telemetry."""

    run_id: int
    label: str
    method: str
    camera_model: str
    telemetry_set_id: int
    telemetry: str
    begins_utc: str
    at_utc: str
    ends_utc: str
    timed: bool
    temperature_c: float | None
    parameters: Values[float]
    sigma: Values[float]
    stars: int
    rms_arc_rad: float | None
    counted: bool
    left_out: str | None
    said: str | None


@dataclass(frozen=True, kw_only=True)
class BaselinePeriod:
    """A set was the baseline from a time, until another."""

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
class Annotation:
    """What a person says of a time of the mission."""

    at_utc: str
    text: str
    printed_name: str
    made_utc: str


@dataclass(frozen=True, kw_only=True)
class DriftTest:
    """A chi-square test of the drift."""

    statistic: float
    dof: int
    limit: float
    p: float
    rejects: bool


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Whether the baseline still holds, and whether the parameters move with time, SI."""

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
    """Whether to recalibrate now, and the kind of advice that this is."""

    answer: str
    sentence: str
    code: str
    reasons: list[str] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Trend:
    """A sensor over the mission, `boresight.trend/1`; `others`: calibrations under another camera model."""

    schema: str = SCHEMA
    sensor_id: int
    sensor: str
    camera_model: str
    parameter_names: list[str]
    baseline: SetName | None
    points: list[TrendPoint]
    others: list[TrendPoint]
    baselines: list[BaselinePeriod]
    on_board: list[OnBoardMark]
    truth: Values[float] | None
    annotations: list[Annotation]
    drift: Drift
    advice: Advice
