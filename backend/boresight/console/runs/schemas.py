"""Runs, their logs and their frames, presets, figures and comparisons, and what a run would be."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from boresight.calibration.evaluation.forecast import Forecast
from boresight.console.runs.tables import RecordedProgress, parse_progress
from boresight.console.schemas import Document, Numbers, Row, Shape

RunState = Literal["QUEUED", "RUNNING", "CANCELLING", "SUCCEEDED", "FAILED", "CANCELLED", "LOST"]


class RunProgress(Row):
    """How far a run is."""

    fraction: float | None = Field(None, description="0 to 1.")
    message: str | None = None
    elapsed_s: float | None = Field(None, description="Since its worker started.")
    at_utc: str | None = Field(None, description="When the worker last reported.")


def _read_progress(recorded: Any) -> RecordedProgress | None:
    """Read what a run's row holds, where a damaged one says that it is."""
    return None if recorded is None else parse_progress(recorded)


class Run(Row):
    """A calibration, or a choice of a camera; this is also the job resource to poll."""

    versioned_by = ("id", "state", "attempt")
    moves_beneath = True  # so does its progress
    location = "/runs/{row.id}"

    id: int
    sensor_id: int
    telemetry_set_id: int
    validation_set_id: int | None
    label: str
    method: str
    settings: Document
    state: RunState
    reason: str | None = Field(description="Why it failed, was lost or was cancelled.")
    attempt: int = Field(description="Grows each time a worker or server is lost.")
    progress: Annotated[RunProgress | None, BeforeValidator(_read_progress)]
    summary: Document | None = Field(description="The numbers of a finished run that lists show.")
    result_sha256: str | None
    joint_set_ids: list[int] = Field(description="Further sets, calibrated with the first as one.")
    prior_run_id: int | None = Field(description="The calibration that it starts from with its covariance.")
    prior_set_id: int | None = Field(description="The parameter set that this was named by.")
    choice_of: int | None = Field(description="The run for whose data it chooses a camera; null of a calibration.")
    launched_utc: str
    launched_by: int | None
    started_utc: str | None
    ended_utc: str | None


class LogLine(Row):
    """One line of a run's log."""

    id: int
    attempt: int
    at_utc: str
    kind: str = Field(description="`state`, `log` or `lost`.")
    message: str
    state: str | None = Field(description="The run's new state, where this line changed it.")
    cause: str | None = Field(description="Why the state changed, or why an attempt ended without a result.")
    level: Literal["info", "warning", "error"]
    numbers: dict[str, float] | None = Field(description="Numbers in the sentence: `fraction`, `elapsed_s`, `seconds`.")


class DryRun(BaseModel):
    """What a run would be, from `validate_only=true`."""

    model_config = ConfigDict(extra="allow")
    sensor: str
    telemetry_set: str
    joint_sets: list[str]
    prior: str | None = Field(description="What it would start from; null: the sensor's own parameters.")
    left_out: list[str] = Field(description="Sets that the prior already contains, so that their stars count once.")
    frames: int
    stars: int
    pairs: int
    free: list[str]
    predicted_s: float
    predicted_range_s: tuple[float, float] = Field(
        description="Four of five past runs of the method are within this range."
    )
    paced_by: int = Field(description="Past runs that the time is based on; 0: a guess.")
    forecast: Forecast | None
    warnings: list[str]


class NoResult(BaseModel):
    """What stands for the calibration of a run that has none."""

    document_schema: Literal["boresight.calibration/1"] = Field(alias="schema")
    status: Literal["running", "none"] = Field(description="`none` where the run ended without a result.")
    run_state: str


class FrameLine(Row):
    """A frame in a list."""

    id: int = Field(description="Its place in this list, from 1.")
    frame: int = Field(description="Its number in the telemetry.")
    detections: int
    chi2_per_dof: float | None = Field(description="Of the run's best fit; null where the result does not contain it.")
    deviation: float | None = Field(description="The same as a normal deviate: above 3 is bad.")


class StarUnder(Shape):
    """Where a parameter set puts a star, and what is left over; pairs are row, column."""

    row_px: float
    col_px: float
    d_px: list[float] = Field(description="Measured minus predicted.")
    sigma_px: list[float] = Field(description="Of the residual, from centroid noise.")
    d_arcsec: list[float]
    sigma_arcsec: list[float]
    apart_arcsec: float = Field(description="Angle between measured and predicted direction.")
    normalised: list[float] = Field(description="Residual over its sigma.")


class FrameStar(Shape):
    """A detection and what became of it."""

    row: int = Field(description="Its row in the frame, from 0.")
    row_px: float
    col_px: float
    sigma_px: float
    magnitude: float | None = Field(description="As the telemetry gives it.")
    star_id: int | None = Field(description="Hipparcos number it is matched with.")
    catalogue_magnitude: float | None = Field(description="Hp of the matched or named star.")
    given_star_id: int | None = Field(description="As the file names it.")
    old_star_id: int | None = Field(description="As matched under the old parameters.")
    fate: str = Field(description="`used`, `left out`, `rejected` or `unmatched`.")
    reason: str | None
    flags: list[str]
    old: StarUnder | None
    new: StarUnder | None


class FrameAttitude(Shape):
    """An exposure's attitude at one parameter set. Triad: x = increasing rows, z = boresight, right-handed."""

    quaternion: list[float] = Field(description="x y z w, Hamilton, ICRS to the detector triad.")
    ra_deg: float
    dec_deg: float
    roll_deg: float = Field(description="Position angle of increasing rows, from north through east.")
    covariance_rad2: list[list[float]] = Field(description="About x, y, z of the triad, from centroid noise.")
    sigma_arcsec: list[float]
    stars: int
    rms_px: float
    chi2: float
    dof: int
    worst_row: int | None = Field(description="Star with the largest normalised residual.")
    from_telemetry_arcsec: list[float] | None = Field(
        description="Rotation about x, y, z from the telemetry's quaternion to this one."
    )


class BothAttitudes(Shape):
    """Under the old and the new parameters; null where there is none."""

    old: FrameAttitude | None
    new: FrameAttitude | None


class UndetectedStar(Shape):
    """A catalogue star that lies on the detector and was not detected."""

    star_id: int
    magnitude: float
    row_px: float
    col_px: float


class FrameExposure(Shape):
    """One image of a frame."""

    exposure: int
    time_utc: str | None
    detections: int
    matched: int
    used: int = Field(description="Of them in the fit.")
    start: str = Field(description="Where matching began.")
    why_invalid: str | None = Field(description="Why matching rejects it.")
    why_no_attitude: str | None
    attitude: BothAttitudes
    stars: list[FrameStar]
    undetected: list[UndetectedStar]


class FrameImage(Shape):
    """The image that a frame was extracted from."""

    name: str
    sha256: str = Field(description="Of the image's bytes.")


class RunFrame(Shape):
    """One frame of a run under its old and new parameters, computed for this answer."""

    run: int
    sensor: str
    method: str
    place: int = Field(description="Among the frames of the set, from 1.")
    frames: int
    previous: int | None
    next: int | None
    rows: int
    columns: int
    partial: bool = Field(description="Whether the new parameters are those of a run that is still computing.")
    frame: int
    time_utc: str | None
    temperature_c: float | None
    image: FrameImage | None = Field(
        description="The image that the frame was extracted from; null for other telemetry."
    )
    match: str
    why_no_new: str | None
    why_nothing: str | None
    exposures: list[FrameExposure]


class Preset(Row):
    """Settings under a name."""

    versioned_by = ("id", "archived_utc")
    location = "/presets/{row.id}"

    key: str = Field(description="The value of `preset` in a launch.")
    id: int | None = Field(description="Id of a saved version; null for built-in ones.")
    name: str
    number: int | None = Field(description="Version.")
    sentence: str = Field(description="When to use it.")
    settings: Document
    created_utc: str | None
    created_by: int | None
    archived_utc: str | None


class FigureEntry(Shape):
    """A figure that a run has."""

    name: str
    title: str
    guide: str = Field(description="How to read it, and what a good one looks like.")
    href: str


class PlotlyFigure(Shape):
    """A figure for `Plotly.react`; `layout.meta.detail` says whether a closer look shows more."""

    data: list[dict[str, Any]]
    layout: dict[str, Any]


class SharedData(Shape):
    """What a run's data have in common with the reference's."""

    kind: Literal["same", "inside", "around", "partly", "disjoint"]
    share: float
    share_of_reference: float


class JointTest(Shape):
    """The test of all parameters together."""

    chi2: float | None
    dof: int
    p: float | None


class ComparedRun(Shape):
    """A run of a comparison."""

    id: int
    label: str
    state: str
    method: str
    shared_data: SharedData
    sentence: str
    joint: JointTest | None


class ComparedParameter(Shape):
    """A parameter, a number a run."""

    name: str
    values: Numbers
    sigmas: Numbers
    differences: Numbers
    sigmas_of_difference: Numbers
    separations: Numbers


class ComparedCorrelation(Shape):
    """A strong correlation, a number a run."""

    names: list[str]
    values: Numbers


class RadialContrast(Shape):
    """How far a run places stars along the radius from where the reference places them."""

    radius_px: Numbers
    difference_px: Numbers
    sigma_px: Numbers
    difference_arcsec: Numbers
    sigma_arcsec: Numbers
    data_radius_px: float | None


class Comparison(Shape):
    """Runs against a reference run."""

    document_schema: Literal["boresight.comparison/1"] = Field(alias="schema")
    camera_model: str
    reference: int
    assumption: str = Field(description="How the sigma of a difference takes shared data into account.")
    runs: list[ComparedRun]
    parameters: list[ComparedParameter]
    correlations: list[ComparedCorrelation]
    radial: list[RadialContrast | None]
