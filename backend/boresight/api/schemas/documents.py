"""Documents that are computed when they are read: figures, trends, comparisons, conversions, what held at a time."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from boresight.api.schemas.parameter_sets import ParameterSet
from boresight.api.schemas.row import Document
from boresight.api.schemas.uplinks import OnBoard
from boresight.services.calibration_document import Calibration, Covariance

__all__ = [
    "Calibration",
    "Comparison",
    "Conversion",
    "FigureEntry",
    "Health",
    "PlotlyFigure",
    "Readiness",
    "SensorAt",
    "Trend",
]

Values = dict[str, float | None]
Numbers = list[float | None]


class _Shape(BaseModel):
    """A document of which every member is listed."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)


class SensorAt(_Shape):
    """What held for a sensor at a time."""

    at: str
    baseline: ParameterSet | None
    onboard: list[OnBoard]


class FigureEntry(_Shape):
    """A figure that a run has."""

    name: str
    title: str
    guide: str = Field(description="How to read it, and what a good one looks like.")
    href: str


class PlotlyFigure(BaseModel):
    """A figure for `Plotly.react`; `layout.meta.detail` says whether a closer look shows more."""

    model_config = ConfigDict(extra="forbid")
    data: list[dict[str, Any]]
    layout: dict[str, Any]


class DriftTest(_Shape):
    """A test at the false-alarm rate of the document."""

    statistic: float
    dof: int
    limit: float
    p: float
    rejects: bool


class Drift(_Shape):
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


class TrendPoint(_Shape):
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
    timed: bool = Field(description="Whether the times are the telemetry's own, and not the upload's.")
    temperature_c: float | None
    parameters: Values
    sigma: Values
    stars: int
    rms_arc_rad: float | None
    counted: bool
    left_out: str | None
    said: str | None


class TrendBaseline(_Shape):
    """A baseline's time."""

    parameter_set_id: int
    name: str
    from_utc: str
    to_utc: str | None
    measured: bool
    parameters: Values
    sigma: Values


class SetName(_Shape):
    """A parameter set by number and name."""

    parameter_set_id: int
    name: str


class OnBoardMark(SetName):
    """A record on board."""

    at_utc: str
    state: str


class Advice(_Shape):
    """Whether to recalibrate now."""

    answer: Literal["YES", "NOT YET", "MORE DATA NEEDED"]
    sentence: str
    reasons: list[str]


class Trend(_Shape):
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
    drift: Drift
    advice: Advice


class SharedData(_Shape):
    """What a run's data have in common with the reference's."""

    kind: Literal["same", "inside", "around", "partly", "disjoint"]
    share: float
    share_of_reference: float


class JointTest(_Shape):
    """The test of all parameters together."""

    chi2: float | None
    dof: int
    p: float | None


class ComparedRun(_Shape):
    """A run of a comparison."""

    id: int
    label: str
    state: str
    method: str
    shared_data: SharedData
    sentence: str
    joint: JointTest | None


class ComparedParameter(_Shape):
    """A parameter, a number a run."""

    name: str
    values: Numbers
    sigmas: Numbers
    differences: Numbers
    sigmas_of_difference: Numbers
    separations: Numbers


class ComparedCorrelation(_Shape):
    """A strong correlation, a number a run."""

    names: list[str]
    values: Numbers


class RadialDifference(_Shape):
    """How far a run places stars along the radius from where the reference places them."""

    radius_px: Numbers
    difference_px: Numbers
    sigma_px: Numbers
    difference_arcsec: Numbers
    sigma_arcsec: Numbers
    data_radius_px: float | None


class Comparison(_Shape):
    """Runs against a reference run."""

    document_schema: Literal["boresight.comparison/1"] = Field(alias="schema")
    camera_model: str
    reference: int
    assumption: str = Field(description="How the sigma of a difference is made from data that runs share.")
    runs: list[ComparedRun]
    parameters: list[ComparedParameter]
    correlations: list[ComparedCorrelation]
    radial: list[RadialDifference | None]


class Conversion(_Shape):
    """A parameter set in another camera model."""

    document_schema: Literal["boresight.parameters/1"] = Field(alias="schema")
    sensor: str
    camera_model: str
    parameters: Values
    units: dict[str, str]
    sigma: Values
    covariance: Covariance | None
    conversion: Document = Field(description="From what, and how far the two differ over the detector.")


class Health(_Shape):
    """That the process answers."""

    status: Literal["ok"]


class Check(BaseModel):
    """One part of the server."""

    model_config = ConfigDict(extra="allow")
    ready: bool
    detail: str | None = None


class Readiness(_Shape):
    """Whether store, files and workers are there."""

    status: Literal["ready", "not ready"]
    checks: dict[str, Check] | None = Field(None, description="For whoever is known.")
