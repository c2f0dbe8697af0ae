"""A calibration as a tree of frozen dataclasses, and its JSON, `boresight.calibration/1`: design and units of every member.

Numbers are SI in parameter order unless a name says otherwise; None stands where a number was not estimated or cannot be known,
never NaN. JSON is read and written at the border only: `parse_calibration` reads what any version of schema 1 wrote (a member that
it did not have yet is None or empty, one that is not known here is dropped), `Calibration.to_dict` writes the members in the order
in which they stand here. `compute_json_schema` is the published JSON Schema; it and the reading follow from the annotations, by
pydantic.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

from boresight.calibration.advice_kinds import join_codes
from boresight.calibration.options import StatedSettings
from boresight.disks import writing
from boresight.errors import RefusedInputError
from boresight.telemetry.quality import StarOff

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter
    from pydantic_core import SchemaValidator

    from boresight.cameras import CameraModel

SCHEMA: Final = "boresight.calibration/1"
EVALUATION_SCHEMA = "boresight.evaluation/1"

Status = Literal["converged", "max_iterations", "rank_deficient", "diverged", "too_few_stars", "running"]
#: The status of an estimate that may be used.
USABLE: Status = "converged"
T = TypeVar("T")
#: A number of `Values`, or one that may be unknown.
Number_co = TypeVar("Number_co", bound="float | None", covariant=True)
#: Numbers of a series; None is unknown.
Numbers = list[float | None]
#: Rows of numbers.
Matrix = list[Numbers]


class Values(Mapping[str, Number_co]):
    """Numbers by parameter name, in parameter order, read as `values.f_m` or `values["f_m"]`; None is unknown.

    To type checkers `Values[float]` are known numbers: only an estimate that diverged has none of a parameter.
    """

    __slots__ = ("_numbers",)

    def __init__(self, numbers: Mapping[str, Number_co] | None = None) -> None:
        self._numbers: dict[str, Number_co] = dict(numbers or {})

    def __setattr__(self, name: str, value: object) -> None:
        """Take the numbers once; what an estimate found is not changed."""
        if name not in Values.__slots__:
            raise AttributeError(f"{name} is read-only: copy it with dict() to change values")
        super().__setattr__(name, value)

    def __getitem__(self, name: str) -> Number_co:
        """Return a number by the parameter's name."""
        return self._numbers[name]

    def __getattr__(self, name: str) -> Number_co:
        """Return a number by the parameter's name, as an attribute."""
        if name in Values.__slots__:  # not set yet, while a copy is being made
            raise AttributeError(name)
        try:
            return self._numbers[name]
        except KeyError:
            raise AttributeError(f"there is no parameter {name!r} here: {', '.join(self._numbers)}") from None

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names, in parameter order."""
        return iter(self._numbers)

    def __len__(self) -> int:
        """Count the parameters."""
        return len(self._numbers)

    def __dir__(self) -> list[str]:
        """List the names too, so that a notebook completes them."""
        return [*super().__dir__(), *self._numbers]

    def __repr__(self) -> str:
        """Show the numbers as a dict shows them."""
        return f"Values({self._numbers!r})"

    def __reduce__(self) -> tuple[type[Values[Number_co]], tuple[dict[str, Number_co]]]:
        """Copy and pickle by the numbers."""
        return Values, (self._numbers,)

    def to_dict(self) -> dict[str, Number_co]:
        """Return the numbers as they stand in JSON."""
        return dict(self._numbers)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Read them from a JSON object of numbers and nulls, and write them so."""
        from pydantic_core import core_schema  # noqa: PLC0415 - only where JSON is read

        of_numbers = handler.generate_schema(dict[str, float | None])
        written = core_schema.plain_serializer_function_ser_schema(cls.to_dict, return_schema=of_numbers)
        return core_schema.no_info_after_validator_function(cls, of_numbers, serialization=written)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: GetJsonSchemaHandler) -> Any:
        """Describe them as a JSON object of numbers and nulls."""
        return handler(schema["schema"])


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Rows or exposures that take no part, with the reason as a phrase."""

    what: str
    count: int
    reason: str


@dataclass(frozen=True, kw_only=True)
class StarsOffDetector:
    """Matched stars that were left out because they lie off the detector: how many, how far at most, and the first twenty."""

    stars: int = 0
    farthest_px: float | None = None
    rows: list[StarOff] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class InputPass:
    """One telemetry set of a joint calibration.

    `first_frame`, `last_frame`: as the calibration numbers frames; its own numbers are those less `frame_offset`, and its own
    rows those of the calibration less `row_offset`. `temperature_c`: mean over its detections. `stars`, `pairs`, `chi2`: those in
    the fit, and the chi-square of this pass in it.
    """

    name: str
    sha256: str | None = None
    frames: int
    detections: int
    first_frame: int
    last_frame: int
    frame_offset: int = 0
    row_offset: int = 0
    start_utc: str | None = None
    end_utc: str | None = None
    temperature_c: float | None = None
    stars: int | None = None
    pairs: int | None = None
    chi2: float | None = None


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """What a calibration was made from: content addresses by role, versions of what computed, every setting, and its passes."""

    sha256s: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    settings: StatedSettings = field(default_factory=StatedSettings)
    passes: list[InputPass] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Covariance:
    """Covariance of the estimated parameters, SI, rows and columns in the order of `names`; `numpy.asarray` takes it."""

    names: list[str] = field(default_factory=list)
    matrix: Matrix = field(default_factory=list)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        """Return the matrix as (n_names, n_names), NaN where it is unknown."""
        import numpy as np  # noqa: PLC0415 - only where arrays are asked for

        if copy is False:
            raise ValueError("A covariance is stored as lists; converting it to an array makes a copy.")
        n = len(self.names)
        return np.array(self.matrix, dtype=np.float64).reshape(n, n).astype(dtype or np.float64, copy=False)


@dataclass(frozen=True, kw_only=True)
class Change:
    """A number under the sensor's own parameters and under the estimate."""

    initial: float | None = None
    final: float | None = None


@dataclass(frozen=True, kw_only=True)
class CountChange:
    """A count under the sensor's own parameters and under the estimate."""

    initial: int
    final: int


@dataclass(frozen=True, kw_only=True)
class ChiSquareTest:
    """The sum of squares of the whitened arcs; `lower` and `upper` hold it over `dof` in 95 of 100 sets."""

    value: float | None = None
    dof: int
    lower: float | None
    upper: float | None
    consistent: bool


@dataclass(frozen=True, kw_only=True)
class InnovationTest:
    """A filter's mean normalised innovation squared per degree of freedom, with its 95 % bounds; of a batch its chi-square."""

    mean: float | None
    dof: int
    lower: float | None
    upper: float | None
    consistent: bool


@dataclass(frozen=True, kw_only=True)
class WeakestDirection:
    """The combination of parameters that the data know least, by name, and what to do about it."""

    direction: Values[float | None]
    sentence: str


@dataclass(frozen=True, kw_only=True)
class Observability:
    """Singular values of the whitened design in typical sigmas, with their directions as rows, strongest first.

    `chi2_rise`: of a batch, how much chi-square rises one sigma along its weak directions, where the covariance says 1.
    """

    parameter_names: list[str]
    singular_values: Numbers
    condition_number: float | None
    right_singular_vectors: Matrix
    sigma_of_direction: Numbers
    weakest: WeakestDirection
    chi2_rise: float | None = None


@dataclass(frozen=True, kw_only=True)
class PriorAgreement:
    """Chi-square between a prior and the data alone, over the directions that these determine."""

    chi2: float
    dof: int
    p_value: float


@dataclass(frozen=True, kw_only=True)
class PriorUse:
    """What a calibration began with, and how much of it is left.

    `telemetry_sha256s`: every set that the prior holds, and its own prior. `covariance`: `with-misfit` or `noise`. `parameters`,
    `sigma`: SI, as taken in, inflated and aged by `drift_sigma` typical sigmas a square root of a day. `share`: of each variance
    that came from the prior; None under process noise or forgetting.
    """

    name: str
    sha256: str | None = None
    telemetry_sha256s: list[str] = field(default_factory=list)
    covariance: str
    inflation: float
    age_days: float | None = None
    drift_sigma: float = 0.0
    parameters: Values[float] = field(default_factory=Values)
    sigma: Values[float] = field(default_factory=Values)
    share: Values[float | None] = field(default_factory=Values)
    agreement: PriorAgreement | None = None
    sentence: str = ""


@dataclass(frozen=True, kw_only=True)
class PassState:
    """The camera in one pass of a joint calibration: the free parameters with their sigmas, SI, and the pass's chi-square."""

    name: str
    parameters: Values[float] = field(default_factory=Values)
    sigma: Values[float] = field(default_factory=Values)
    chi2: float


@dataclass(frozen=True, kw_only=True)
class VariationTest:
    """By how much chi-square falls where parameters may vary, and how likely chance alone makes it fall so far."""

    fall: float
    dof: int
    p_value: float


@dataclass(frozen=True, kw_only=True)
class WalkSigma:
    """Drift of a parameter from pass to pass, typical sigmas a square root of a day.

    `interval`: the ends of its 95 % interval where it was estimated, from zero where the data do not show that it moves; None
    where it was given.
    """

    sigma: float
    interval: Numbers | None = None


@dataclass(frozen=True, kw_only=True)
class ParameterStep:
    """A step of a parameter, SI, at an event, or somewhere between two passes: a 95 % interval where the data propose the date.

    `p_value`: of a step so large where there is none, counting all dates and parameters that were looked at.
    """

    parameter: str
    step: float
    sigma: float
    event_utc: str | None = None
    from_utc: str | None = None
    to_utc: str | None = None
    p_value: float
    sentence: str = ""


@dataclass(frozen=True, kw_only=True)
class ComparedChange:
    """A kind of change held against the passes: `none`, `drift`, `steps` or `walk`, beside the temperature where it is known.

    `deviance`: -2 log likelihood over the least of all. `bic`: with `parameters` counted; the lowest is the likeliest.
    """

    kind: str
    parameters: int
    deviance: float
    bic: float


@dataclass(frozen=True, kw_only=True)
class PassVariation:
    """What changes from pass to pass of a joint calibration.

    `vary`: the parameters of a pass; `vary_as`: `pass`, `walk` (by `walk`), `walk-and-temperature` (about a line of that
    `slope`), `temperature`, `drift` or `step` (`steps`).
    Polynomials in temperature or time have a `degree` by parameter, 0 where it does not change, and `coefficients` of the powers
    from 1 on, SI a degree Celsius or a day from the reference; `slope` is the first of them, and `tests` has the evidence of each
    parameter. `test`: of all together; None of a walk. `compared`: kinds of change, the likeliest first.
    """

    vary: list[str]
    vary_as: str
    walk: dict[str, WalkSigma] | None = None
    reference_temperature_c: float | None = None
    slope: Values[float] | None = None
    slope_sigma: Values[float] | None = None
    states: list[PassState] = field(default_factory=list)
    chi2: float
    test: VariationTest | None = None
    sentence: str = ""
    reference_utc: str | None = None
    degree: dict[str, int] | None = None
    coefficients: dict[str, Numbers] | None = None
    coefficient_sigma: dict[str, Numbers] | None = None
    tests: dict[str, VariationTest] | None = None
    steps: list[ParameterStep] | None = None
    rate: Values[float] | None = None
    rate_sigma: Values[float] | None = None
    compared: list[ComparedChange] | None = None


@dataclass(frozen=True, kw_only=True)
class Robust:
    """A robust loss beside least squares on the same arcs.

    `threshold`: in whitened sigmas of an arc (huber), or in measured sigmas of a star (stars). `downweighted`, `share`: arcs or
    stars beyond it, and how many of all; `expected_share`: under Gaussian noise.
    """

    threshold: float
    downweighted: int
    share: float
    expected_share: float
    parameters_without: Values[float]
    shift_in_sigma: Values[float | None]
    sentence: str


@dataclass(frozen=True, kw_only=True)
class IntervalChange:
    """95 % intervals of a score under the sensor's own parameters and under the estimate."""

    initial: Numbers
    final: Numbers


@dataclass(frozen=True, kw_only=True)
class EvaluationIntervals:
    """95 % intervals of the scores, from resampled blocks of frames."""

    availability: IntervalChange
    matched_star_ratio: Numbers
    rms_arc_rad: IntervalChange
    rms_ratio: Numbers = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class ReasonChange:
    """Frames without an attitude, counted by reason, under the sensor's own parameters and under the estimate."""

    initial: dict[str, int] = field(default_factory=dict)
    final: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Flight scores of a set under two states, `boresight.evaluation/1`; RMS is unweighted, on the pairs that both match."""

    schema: str = EVALUATION_SCHEMA
    frames: int
    availability: Change
    matched_stars: CountChange | None = None
    matched_star_ratio: float | None
    rms_arc_rad: Change
    rms_ratio: float | None = None
    common_pairs: int | None = None
    stars: int | None = None
    match: str | None = None
    flight_tolerance_rad: float | None = None
    intervals: EvaluationIntervals | None = None
    reasons: ReasonChange = field(default_factory=ReasonChange)


@dataclass(frozen=True, kw_only=True)
class RemovedStar:
    """A detection whose proposed star did not stand: its row as an editor counts, its numbers, and why.

    `probability`: that a detection of this star under the same noise would lie as far from its place, where a test decided.
    """

    frame: int
    exposure: int
    row: int
    star_id: int | None
    reason: str
    probability: float | None = None


@dataclass(frozen=True, kw_only=True)
class RemovedOf:
    """How many stars the telemetry proposed, and how many of them were removed; of very many the first alone are listed."""

    proposed: int
    removed: int


@dataclass(frozen=True, kw_only=True)
class TrustTest:
    """One test of the data against the model.

    `probability`: of a statistic so large when all is as the model says; `adjusted`: the same after Holm's correction for all tests
    made, by which it is `noticed`. `effect`: the size of what was found, in `unit`.
    """

    name: str
    probability: float
    adjusted: float
    noticed: bool
    effect: float | None = None
    unit: str = ""
    sentence: str = ""


@dataclass(frozen=True, kw_only=True)
class Cause:
    """What explains the tests that were noticed, with its share of likelihood among all causes, and what to do about it."""

    name: str
    likelihood: float
    sentence: str
    remedy: str
    tests: list[str] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class ModelMisfit:
    """How much wider than noise alone makes them the sigmas are for what the model does not hold.

    `covariance`: SI, of the estimate with it. `factor`: by parameter. `blocks`: of frames that disagree by more than noise, 0 where
    none do. `departures`: from the model that widen, and `suspected`: those among them that no test noticed. `level`: variance of
    the residuals over the stated one, 1 within its bounds. `selected`: claimed sigmas between a filter that selects its arcs and
    the fit of the whole set. `bends`: whether chi-square has other minima or bends.
    """

    covariance: Covariance
    factor: Values[float | None]
    blocks: int
    sentence: str
    departures: list[str] = field(default_factory=list)
    suspected: list[str] = field(default_factory=list)
    level: float = 1.0
    selected: float = 0.0
    bends: bool = False


@dataclass(frozen=True, kw_only=True)
class Minimum:
    """A place where chi-square, or a robust loss, is lowest among its neighbours.

    `parameters`: SI. `chi2_above_best`: how far it lies above the lowest, each under its own weights.
    """

    parameters: Values[float]
    chi2_above_best: float


@dataclass(frozen=True, kw_only=True)
class ProfileInterval:
    """Where a parameter, SI, may lie by profile likelihood: pieces, each with its ends; None is beyond what was searched."""

    name: str
    confidence: float
    pieces: list[Numbers]


@dataclass(frozen=True, kw_only=True)
class Minima:
    """What a search from many starts found, the best first, and the intervals of the parameters that are not symmetric.

    `spread`: mean square distance from the estimate of all states, each as likely as the data make it, SI; None where the sigmas
    tell as much. `taken_from`: what led to the minimum that was taken up, empty where the usual start had ended
    in it. `elsewhere`: whether a filter ended in another than the lowest.
    """

    starts: int
    found: list[Minimum] = field(default_factory=list)
    intervals: list[ProfileInterval] = field(default_factory=list)
    spread: Covariance | None = None
    taken_from: str = ""
    elsewhere: bool = False
    sentence: str = ""


@dataclass(frozen=True, kw_only=True)
class NoiseTerm:
    """One term of the noise model: its coefficients with sigmas, the probability that it is none, and whether it was applied."""

    name: str
    unit: str
    coefficients: dict[str, float]
    sigma: dict[str, float | None]
    probability: float
    needed: bool
    applied: bool
    sentence: str


@dataclass(frozen=True, kw_only=True)
class Noise:
    """How the centroid noise and bias of a set depend on magnitude, field angle, rate, pixel phase and colour."""

    terms: list[NoiseTerm] = field(default_factory=list)
    unavailable: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Assumption:
    """What the data cannot show: whether it was declared, what was taken to be so, and what an error in it would do.

    `left_in`: declared to be in the data, and not taken out of them.
    """

    name: str
    declared: bool
    value: str
    sentence: str
    left_in: bool = False


@dataclass(frozen=True, kw_only=True)
class JudgedOn:
    """The part of a set too large to be judged whole that scores, alignment and trust are of."""

    frames: int
    stars: int
    of_frames: int


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """One fit or one filter run.

    `cycle`: its number, from 1. `matched`: stars in the arcs it was made from. `rematched`: stars that its result matches
    afterwards. `changed`: detections whose star is another, or gone, or new, afterwards. `rms_arc_rad`: unweighted RMS of the
    arcs at its result.
    """

    cycle: int
    matched: int
    rematched: int
    changed: int
    rms_arc_rad: float | None


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """Median and 95th percentile of the distance within which a star was looked for, pixels."""

    median: float | None
    p95: float | None


@dataclass(frozen=True, kw_only=True)
class FlaggedStars:
    """Matched stars that the catalogue calls double or unreliable, and rows left out for it or as blended."""

    doubles: int = 0
    unreliable: int = 0
    left_out: int = 0
    blended: int = 0


@dataclass(frozen=True, kw_only=True)
class FlightScores:
    """What the flight code makes of the matches: its tolerance, and the scores of the evaluation."""

    tolerance_rad: float | None
    availability: Change
    matched_stars: CountChange | None


@dataclass(frozen=True, kw_only=True)
class Matching:
    """The matches that an estimate stands on, against those that the file gave, and how many have each reason or start."""

    given: int
    kept: int
    added: int
    removed: int
    renamed: int
    matched: int
    cycles: list[Cycle]
    rested: bool
    tolerance_px: Tolerance
    row_reasons: dict[str, int]
    removed_reasons: dict[str, int]
    exposure_reasons: dict[str, int]
    starts: dict[str, int]
    flagged: FlaggedStars | None = None
    flight: FlightScores | None = None


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """How loading the estimate turns the reported attitude, about the axes of the right-handed detector triad.

    `quaternion`: (4,) x y z w. `sigma_of_mean_arcsec` belongs to loading these very values, `sigma_arcsec` to another calibration
    as good as this one. `c_sd_update`: (3, 3) by which C_SD is multiplied from the right to keep the attitude.
    """

    quaternion: Numbers
    rotation_arcsec: Numbers
    sigma_arcsec: Numbers
    sigma_of_mean_arcsec: Numbers
    frames: int
    scatter_arcsec: float | None
    noise_arcsec: float | None
    consistent: bool
    sentence: str
    c_sd_update: Matrix


@dataclass(frozen=True, kw_only=True)
class ReferenceInformation:
    """What a reference keeps of the information in the centroids: geometric mean over the parameters, and the least."""

    reference: str
    share: float | None
    least_share: float | None
    least: str | None


@dataclass(frozen=True, kw_only=True)
class FrameObservability:
    """What single frames tell: the least singular value by curve (`model_1` ... `sigma_3`), and each reference's information."""

    frame: list[int]
    frames_used: int
    frames: int
    minimum_singular_value: dict[str, Numbers]
    information: list[ReferenceInformation]
    sentence: str


@dataclass(frozen=True, kw_only=True)
class ArcSigmaMap:
    """Error of an arc of `arc_deg` about places of the detector, from the parameters alone."""

    row_px: Numbers
    col_px: Numbers
    sigma_arcsec: Matrix
    arc_deg: float
    sentence: str


@dataclass(frozen=True, kw_only=True)
class HalvesTest:
    """Difference of two halves in units of its covariance, chi-square, with its 95 % bounds and probability."""

    value: float
    dof: int
    lower: float
    upper: float
    p: float
    consistent: bool


@dataclass(frozen=True, kw_only=True)
class HalvesMap:
    """Difference of two halves over the detector, and what their covariances let one expect."""

    row_px: Numbers
    col_px: Numbers
    difference_arcsec: Matrix
    expected_arcsec: Matrix


@dataclass(frozen=True, kw_only=True)
class TwoHalves:
    """Two halves of the set fitted apart, and how far they differ."""

    names: list[str]
    difference_in_sigma: Numbers
    chi2: HalvesTest
    map: HalvesMap
    sentence: str


@dataclass(frozen=True, kw_only=True)
class Efficiency:
    """Claimed sigmas over the Cramér-Rao bound of the centroids, by parameter and over all directions."""

    names: list[str]
    cramer_rao_sigma: Values[float | None]
    ratio: Values[float | None]
    overall_ratio: float
    frames_used: int
    sentence: str


@dataclass(frozen=True, kw_only=True)
class MoreData:
    """Predicted one-sigma against further frames of the same kind, with the relative uncertainty of that prediction."""

    frames: int
    further_frames: list[int]
    sigma: dict[str, Numbers]
    relative_uncertainty: Values[float | None] | None
    sentence: str


@dataclass(frozen=True, kw_only=True)
class DroppedParameter:
    """What holding one free parameter at its start would cost."""

    name: str
    chi2_increase: float
    rms_arc_rad: float | None
    shift_in_sigma_of_others: float | None
    most_shifted: str
    needed: bool
    frames_used: int
    settled: bool


@dataclass(frozen=True, kw_only=True)
class NisOverTime:
    """Normalised innovations, or a batch's chi-squares, per degree of freedom over the frames, with 95 % bounds."""

    frame: list[int]
    nis_per_dof: Numbers
    lower: Numbers
    upper: Numbers
    outside_share: float
    expected_share: float
    outside_bounds: Numbers
    runs_p: float
    points_in_all: int
    consistent: bool
    sentence: str


@dataclass(frozen=True, kw_only=True)
class LjungBox:
    """Ljung and Box's test of a series; `p` is corrected for how many were looked at."""

    value: float
    dof: int
    p: float


@dataclass(frozen=True, kw_only=True)
class Whiteness:
    """Autocorrelation of the least white score, that of parameter `name`, with the bound of white noise."""

    lags: list[int]
    autocorrelation: Numbers
    bound: float
    name: str
    ljung_box: LjungBox
    p_of_parameters: Values[float | None]
    white: bool
    sentence: str


@dataclass(frozen=True, kw_only=True)
class WorstFrames:
    """The frames that are explained worst, as normal deviates, the worst first."""

    frame: list[int]
    chi2_per_dof: Numbers
    dof: Numbers
    deviation: Numbers
    frames_in_all: int
    beyond: int
    expected_beyond: float
    sentence: str


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Centroids less the projected catalogue under each exposure's best attitude, pixels, evenly thinned."""

    row_px: Numbers
    col_px: Numbers
    d_row_px: Numbers
    d_col_px: Numbers
    star_id: list[int] | None
    frame: list[int]
    rms_px: float
    spread: float
    stars_in_all: int
    frames_used: int
    sentence: str


@dataclass(frozen=True, kw_only=True)
class FieldOfResiduals:
    """Means of the residuals in cells of the detector with one-sigma, rows of cells; None where a cell has too few stars."""

    count: list[list[int]]
    mean_row_px: Matrix
    mean_col_px: Matrix
    sigma_row_px: Matrix
    sigma_col_px: Matrix
    rms_px: Matrix
    rms_in_all_px: float
    chi2: float
    dof: int
    p: float


@dataclass(frozen=True, kw_only=True)
class ResidualField:
    """Residuals over the detector before and after; `even` where what is left has no pattern beyond noise."""

    row_edges_px: Numbers
    col_edges_px: Numbers
    frames_used: int
    even: bool
    sentence: str
    before: FieldOfResiduals | None
    after: FieldOfResiduals


@dataclass(frozen=True, kw_only=True)
class Histogram:
    """Counts of the bins, and of what lies beyond them."""

    counts: list[int]
    below: int
    above: int


@dataclass(frozen=True, kw_only=True)
class ResidualDistribution:
    """Residuals over their sigmas: histogram before and after, quantiles against the normal curve, and the verdict on the tails."""

    edges: Numbers
    before: Histogram
    after: Histogram
    normal: Numbers
    quantile: Numbers
    sigma_of_quantile: Numbers
    count: int
    mean: float
    sigma: float
    spread: float
    beyond_share: float
    expected_share: float
    p_tail: float
    normal_tails: bool
    sentence: str


@dataclass(frozen=True, kw_only=True)
class ResidualOutliers:
    """Single sightings beyond `limit` spreads along either axis, the worst first; `rows`, `columns`: of the detector."""

    frame: list[int]
    exposure: list[int]
    star_id: list[int] | None
    row_px: Numbers
    col_px: Numbers
    d_row_px: Numbers
    d_col_px: Numbers
    normalised: Numbers
    rows: int | None = None
    columns: int | None = None
    limit: float
    stars_in_all: int
    in_all: int
    expected: float
    sentence: str


@dataclass(frozen=True, kw_only=True)
class StarTrust:
    """A star over all its sightings: its displacement from the catalogue place, and what the catalogue says against it."""

    star_id: int
    sightings: int
    mean_residual_px: float
    rms_px: float
    z: float
    east_north_arcsec: Numbers
    sigma_arcsec: Numbers
    suspect: bool
    flags: list[str]


@dataclass(frozen=True, kw_only=True)
class ResidualDependence:
    """The radial residual in equally full bins of a quantity; `even` where it does not depend on it beyond noise."""

    edges: Numbers
    mean_px: Numbers
    sigma_of_mean_px: Numbers
    rms_px: Numbers
    count: list[int]
    unit: str
    p: float
    even: bool
    sentence: str


#: Unit of each quantity that the residual is held against.
RESIDUAL_UNITS = {
    "radius": "px", "magnitude": "mag", "temperature": "°C", "time": "h", "colour": "mag", "row": "px", "column": "px",
    "row_phase": "px", "column_phase": "px",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ResidualAgainst:
    """The residual against what may explain it: radial, or along the rows or columns against places and phases along them."""

    radius: ResidualDependence | None = None
    magnitude: ResidualDependence | None = None
    temperature: ResidualDependence | None = None
    time: ResidualDependence | None = None
    colour: ResidualDependence | None = None
    row: ResidualDependence | None = None
    column: ResidualDependence | None = None
    row_phase: ResidualDependence | None = None
    column_phase: ResidualDependence | None = None

    @property
    def by_cause(self) -> dict[str, ResidualDependence | None]:
        """The dependence on each, by its name."""
        return dict(vars(self))


@dataclass(frozen=True, kw_only=True)
class SplineCoefficients:
    """Coefficients of a spline of displacements, along row and column, pixels."""

    row_px: list[list[float]]
    col_px: list[list[float]]


@dataclass(frozen=True, kw_only=True)
class SplineTest:
    """Whether a spline holds more than noise: its value, its mean where the model is right, the chance of as much then."""

    statistic: float
    expected: float
    p: float
    false_alarm_rate: float


@dataclass(frozen=True, kw_only=True)
class LargestDisplacement:
    """The place of the largest displacement told: where, how much along either axis, its length and the sigma of that, pixels."""

    row_px: float
    col_px: float
    d_row_px: float
    d_col_px: float
    size_px: float
    sigma_px: float


@dataclass(frozen=True, kw_only=True)
class SplineExplanation:
    """What a camera model with all its parameters free would leave: `p` of the same test, and the parameters it frees besides."""

    camera_model: str
    p: float
    more: list[str]


@dataclass(frozen=True, kw_only=True)
class ResidualSpline:
    """What a camera model leaves over the detector, as a spline with its sigma; `structure` where that is more than noise.

    Knots and coefficients are the spline, of degree `degree`; `d_row_px` ... `sigma_col_px` are it at places `row_px`, `col_px`.
    """

    camera_model: str
    degree: int
    row_knots_px: list[float]
    col_knots_px: list[float]
    coefficients: SplineCoefficients
    row_px: list[float]
    col_px: list[float]
    d_row_px: list[list[float]]
    d_col_px: list[list[float]]
    sigma_row_px: list[list[float]]
    sigma_col_px: list[list[float]]
    strength_px: float
    effective_parameters: float
    noise: float
    test: SplineTest
    structure: bool
    largest: LargestDisplacement
    at_most_px: float
    explained_by: list[SplineExplanation]
    stars: int
    frames_used: int
    left_out: int
    sentence: str


@dataclass(frozen=True, kw_only=True)
class UnseenDeparture:
    """The largest displacement of a kind that its test misses once in ten times, and what it does to the parameter it moves most.

    `size_px`: of tangential distortion at the corner of the detector, of another kind the largest of the stars. `sigmas`: claimed
    ones of the parameter; None where nothing tells the two apart.
    """

    name: str
    size_px: float
    parameter: str
    sigmas: float | None


@dataclass(frozen=True, kw_only=True)
class Trust:
    """How far a calibration can be believed beyond its own sigmas; `unavailable` says why a part is None."""

    arc_sigma_map: ArcSigmaMap | None = None
    two_halves: TwoHalves | None = None
    efficiency: Efficiency | None = None
    more_data: MoreData | None = None
    drop_one: list[DroppedParameter] | None = None
    nis_over_time: NisOverTime | None = None
    whiteness: Whiteness | None = None
    worst_frames: WorstFrames | None = None
    residuals: Residuals | None = None
    residual_field: ResidualField | None = None
    residual_distribution: ResidualDistribution | None = None
    residual_outliers: ResidualOutliers | None = None
    residual_spline: ResidualSpline | None = None
    stars: list[StarTrust] | None = None
    residual_against: ResidualAgainst | None = None
    drop_one_sentence: str | None = None
    stars_sentence: str | None = None
    stars_in_all: int | None = None
    unseen: list[UnseenDeparture] = field(default_factory=list)
    suspects: list[int] = field(default_factory=list)
    unavailable: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ShadowAnswer:
    """What one state makes of a frame."""

    valid: bool
    matched: int
    reason: str | None


@dataclass(frozen=True, kw_only=True)
class ShadowFrame:
    """A frame under the baseline and under the candidate, with the stars that only one of them accepts."""

    frame: int
    time_utc: str | None
    baseline: ShadowAnswer
    candidate: ShadowAnswer
    lost: list[int]
    gained: list[int]


@dataclass(frozen=True, kw_only=True)
class ShadowSummary:
    """Frames that each state alone solves, with McNemar's exact probability, and sightings gained and lost."""

    baseline_only: int
    candidate_only: int
    both: int
    neither: int
    stars_lost: int
    stars_gained: int
    p: float
    sentence: str


@dataclass(frozen=True, kw_only=True)
class ShadowOfSet:
    """A set under two states side by side, frame by frame: those that differ first."""

    frames: list[ShadowFrame]
    frames_in_set: int
    flight_tolerance_rad: float | None
    summary: ShadowSummary


@dataclass(frozen=True, kw_only=True)
class Shadow:
    """Shadow mode on the calibration set and on the validation set."""

    calibration: ShadowOfSet | None = None
    validation: ShadowOfSet | None = None


@dataclass(frozen=True, kw_only=True)
class HistoryBetween:
    """What the updates that are not kept would have shown, for the interval that each kept one ends."""

    nis_peak: Numbers
    nis_peak_dof: Numbers
    nis_peak_frame: Numbers
    parameters_low: Matrix
    parameters_high: Matrix


@dataclass(frozen=True, kw_only=True)
class History:
    """A filter's updates: state, sigma, tail and aggregate RMS, innovations, an entry an update that is kept."""

    frame: list[int]
    time_utc: list[str | None] | None = None
    parameters: Matrix
    sigma: Matrix
    tail_rms_rad: Numbers
    aggregate_rms_rad: Numbers
    nis: Numbers = field(default_factory=list)
    nis_dof: list[int] = field(default_factory=list)
    linearisations: list[int] = field(default_factory=list)
    between: HistoryBetween | None = None


@dataclass(frozen=True, kw_only=True)
class ProcessNoise:
    """How far a filter lets parameters drift, typical sigmas `per` frame or square root of a day.

    `source`: `given`, `usual` where nobody gave it, or `estimated` from so many `stretches` of data, with the ends of its 95 %
    `interval`, from zero where the data do not show that a parameter moves.
    """

    per: str
    source: str
    sigma: Values[float] = field(default_factory=Values)
    interval: dict[str, Numbers] | None = None
    stretches: int = 0
    sentence: str = ""


@dataclass(frozen=True, kw_only=True)
class Smoothed:
    """The parameters at frames' times given all frames, before and after, with their sigmas, SI: an entry a frame that is kept.

    `chi2`: whitened sum of squares at them. `settled`: whether the smoother came to rest; only then use it.
    """

    frame: list[int]
    time_utc: list[str | None] | None = None
    parameters: Matrix
    sigma: Matrix
    chi2: float | None
    settled: bool
    sentence: str = ""


@dataclass(frozen=True, kw_only=True)
class Iterations:
    """A batch's iterates: state, sigma, cost (half of chi-square), damping and RMS."""

    iteration: list[int]
    parameters: Matrix
    sigma: Matrix
    cost: Numbers
    damping: Numbers
    rms_arc_rad: Numbers


@dataclass(frozen=True, kw_only=True)
class Displacement:
    """Radial displacement of a camera against an undistorted one, pixels, under both states."""

    initial: Numbers
    final: Numbers


@dataclass(frozen=True, kw_only=True)
class StarCounts:
    """Stars between radii."""

    edges_px: Numbers
    stars: list[int]


@dataclass(frozen=True, kw_only=True)
class RadialDifference:
    """Radial displacement of the estimate against its start, one-sigma, and where the data are (E Figure 5)."""

    radius_px: Numbers
    difference_px: Numbers
    sigma_px: Numbers
    difference_arcsec: Numbers
    sigma_arcsec: Numbers
    displacement_px: Displacement | None = None
    data_radius_px: float | None
    counts: StarCounts | None = None


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Star counts over the detector, rows of cells."""

    row_edges_px: Numbers
    col_edges_px: Numbers
    counts: list[list[int]]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """A calibration, ended or on its way (`running`).

    `parameters`, `sigma`, `initial`, `typical_sigma`: SI by name; a sigma is None where it was not estimated or is not determined.
    `sigma` is of noise alone, `sigma_with_misfit` is that widened by what the model does not hold: decide by the second.
    `delta_over_sigma`: estimate less start over sigma. `rms_arc_rad`: unweighted, on common pairs. `pairs`: arcs, two a star less
    three an exposure. `frames_done`: of a filter on its way. `timing_s`: by stage. `advice_codes`: the kind of each sentence of
    `advice`, for its section in the guide; "" where an earlier version wrote none.
    """

    schema: Literal["boresight.calibration/1"] = SCHEMA
    sensor: str = ""
    method: str = ""
    variant: str | None = None
    camera_model: str = ""
    parameter_names: list[str] = field(default_factory=list)
    free: list[str] = field(default_factory=list)
    initial: Values[float] = field(default_factory=Values)
    typical_sigma: Values[float] = field(default_factory=Values)
    units: dict[str, str] = field(default_factory=dict)
    symbols: dict[str, str] = field(default_factory=dict)
    truth: Values[float] | None = None
    frames: int = 0
    exposures: int = 0
    stars: int = 0
    pairs: int = 0
    frames_in_set: int | None = None
    left_out: list[LeftOut] = field(default_factory=list)
    inputs: Inputs = field(default_factory=Inputs)
    parameters: Values[float] = field(default_factory=Values)
    sigma: Values[float | None] = field(default_factory=Values)
    delta_over_sigma: Values[float | None] = field(default_factory=Values)
    covariance: Covariance = field(default_factory=Covariance)
    status: Status
    iterations: int = 0
    chi2_per_dof: float | None = None
    chi2: ChiSquareTest | None = None
    nis: InnovationTest | None = None
    observability: Observability | None = None
    advice: list[str] = field(default_factory=list)
    advice_codes: list[str] = field(default_factory=list)
    rms_arc_rad: Change = field(default_factory=Change)
    robust: Robust | None = None
    removed: list[RemovedStar] = field(default_factory=list)
    removed_of: RemovedOf | None = None
    tests: list[TrustTest] = field(default_factory=list)
    causes: list[Cause] = field(default_factory=list)
    sigma_with_misfit: Values[float | None] = field(default_factory=Values)
    misfit: ModelMisfit | None = None
    minima: Minima | None = None
    noise: Noise | None = None
    assumptions: list[Assumption] = field(default_factory=list)
    validation: Evaluation | None = None
    judged_on: JudgedOn | None = None
    evaluation: Evaluation | None = None
    matching: Matching | None = None
    alignment: Alignment | None = None
    frame_observability: FrameObservability | None = None
    trust: Trust | None = None
    shadow: Shadow = field(default_factory=Shadow)
    history: History | None = None
    trace: Iterations | None = None
    radial: RadialDifference | None = None
    coverage: Coverage | None = None
    timing_s: dict[str, float | None] = field(default_factory=dict)
    stars_off_detector: StarsOffDetector | None = None
    frames_done: int | None = None
    prior: PriorUse | None = None
    variation: PassVariation | None = None
    process_noise: ProcessNoise | None = None
    smoothed: Smoothed | None = None

    def __post_init__(self) -> None:
        """Put what was read of the advice beside its codes."""
        join_codes(self)

    @property
    def reliable_covariance(self) -> Covariance:
        """The covariance to decide by: with misfit where that is known, else of noise alone."""
        return self.covariance if self.misfit is None else self.misfit.covariance

    @property
    def reliable_sigma(self) -> Values[float | None]:
        """The sigmas to decide by: with misfit where that is known, else of noise alone."""
        return self.sigma if self.misfit is None else self.sigma_with_misfit

    @property
    def is_usable(self) -> bool:
        """Whether the estimate converged."""
        return self.status == USABLE

    def to_dict(self) -> dict[str, Any]:
        """Return the calibration JSON as plain lists, numbers and None."""
        document: dict[str, Any] = to_plain(self) | {"advice": list(map(str, self.advice))}
        for name in (
            "stars_off_detector",
            "frames_done",
            "prior",
            "variation",
        ):  # only while it is on its way, or at its end; or of some
            if document[name] is None:
                del document[name]
        if not self.inputs.passes:  # of one set
            del document["inputs"]["passes"]
        return document

    def to_json(self) -> str:
        """Return the calibration JSON as text."""
        return json.dumps(self.to_dict(), ensure_ascii=False, allow_nan=False)

    def save(self, path: str | Path) -> None:
        """Write the calibration JSON to a file."""
        with writing(path):
            Path(path).write_text(self.to_json() + "\n", encoding="utf-8")


#: Classes of what JSON takes as it is.
_AS_THEY_ARE = frozenset((str, int, bool, type(None)))


@cache
def _members(kind: Any) -> tuple[str, ...] | None:
    """Return the names of the members of a dataclass; None of any other class."""
    return tuple(one.name for one in fields(kind)) if is_dataclass(kind) else None


def to_plain(value: Any) -> Any:
    """Return dataclasses and what they hold as dicts, lists, numbers and None, as in JSON, which has no NaN and no infinity.

    Lists of numbers and of lists of numbers are not copied.
    """
    kind: Any = type(value)
    if kind in _AS_THEY_ARE:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if kind is StatedSettings:
        value, kind = value.document(), dict
    if (members := _members(kind)) is not None:
        return {name: one if type(one := getattr(value, name)) in _AS_THEY_ARE else to_plain(one) for name in members}
    if isinstance(value, list | tuple):
        first: Any = type(value[0]) if value else None
        nested = first is not None and _members(first) is not None
        return [to_plain(one) for one in value] if nested else list(value) if kind is tuple else value
    if isinstance(value, dict | Values):
        return {key: to_plain(one) for key, one in value.items()}
    return value


@cache
def _adapter(kind: type[Any]) -> TypeAdapter[Any]:
    """What reads a dataclass; made once, for that of calibrations takes a tenth of a second."""
    from pydantic import TypeAdapter  # noqa: PLC0415 - only where JSON is read

    return TypeAdapter(kind)


def parse_part(kind: type[T], document: Mapping[str, Any], refuse: Callable[[str], Exception]) -> T:
    """Read what a JSON says as one of the dataclasses here; `refuse` makes an error of what is wrong with it."""
    adapter: TypeAdapter[T] = _adapter(kind)  # type: ignore[arg-type]  # every class can be hashed
    return _validate(adapter.validate_python, document, refuse)


def _validate(validate: Callable[[Any], T], document: Any, refuse: Callable[[str], Exception]) -> T:
    from pydantic import ValidationError  # noqa: PLC0415 - only where JSON is read

    try:
        return validate(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise refuse(f"{where}: {first['msg']}" if where else str(first["msg"])) from error


@cache
def _strict_validator() -> SchemaValidator:
    """What reads a calibration and takes no text or truth value for a number, and no NaN."""
    from pydantic_core import SchemaValidator  # noqa: PLC0415 - only where JSON is read

    return SchemaValidator(_make_strict(_adapter(Calibration).core_schema))


def _make_strict(schema: Any) -> Any:
    """Return a schema whose numbers and truth values are of these kinds; a whole number may be written 5.0."""
    if isinstance(schema, list | tuple):
        return type(schema)(_make_strict(one) for one in schema)
    if not isinstance(schema, dict):
        return schema
    if schema.get("type") == "int":
        exact, whole = {"type": "int", "strict": True}, {"type": "float", "strict": True, "multiple_of": 1.0}
        rounded = {"type": "function-after", "function": {"type": "no-info", "function": int}, "schema": whole}
        return {
            "type": "union",
            "choices": [exact, rounded],
            "mode": "left_to_right",
            "custom_error_type": "whole",
            "custom_error_message": "Input should be a whole number",
        }
    if schema.get("type") == "float":
        return schema | {"strict": True, "allow_inf_nan": False}
    if schema.get("type") == "bool":
        return schema | {"strict": True}
    aside = ("metadata", "serialization", "default")
    return {key: one if key in aside else _make_strict(one) for key, one in schema.items()}


#: What every ended calibration says.
REQUIRED = ("schema", "sensor", "method", "camera_model", "parameters", "sigma", "covariance", "rms_arc_rad")


def parse_calibration(document: str | bytes | Mapping[str, Any], name: str = "This document") -> Calibration:
    """Read the calibration JSON of any version of schema 1.

    Parameters
    ----------
    document
        The JSON as text or bytes, or what it says as dict.
    name
        What a refusal calls it.

    Raises
    ------
    RefusedInputError
        When it is no calibration, or a member is missing or of another type: which.
    """
    from pydantic_core import from_json  # noqa: PLC0415 - only where JSON is read

    refuse = partial(_make_refusal, name)
    try:
        said = from_json(document) if isinstance(document, str | bytes) else document
    except ValueError as error:
        raise refuse(str(error)) from error
    found: Calibration = _validate(_strict_validator().validate_python, said, refuse)
    missing = next((one for one in REQUIRED if said.get(one) is None), None)
    if missing is not None and found.status != "running":
        raise refuse(f"{missing}: missing")
    return found


def parse_foreign_calibration(document: str | bytes | Mapping[str, Any], name: str = "This document") -> Calibration:
    """Read a calibration that people hand in: as `parse_calibration`, and its numbers are those of a camera.

    What we stored ourselves is read as it is, so that a page can show a result that no camera has, and its gates refuse it.
    """
    found = parse_calibration(document, name)
    fault = None if found.status == "running" else next(_find_faults(found), None)
    if fault is not None:
        raise _make_refusal(name, fault)
    return found


def _find_faults(found: Calibration) -> Iterator[str]:
    """Yield what the numbers of an ended calibration cannot be, with the member of each."""
    from boresight.cameras import CAMERA_MODELS  # noqa: PLC0415 - they load what compiles

    if (camera := CAMERA_MODELS.get(found.camera_model)) is None:
        yield f"camera_model: {found.camera_model!r} is not one of {', '.join(CAMERA_MODELS)}"
        return
    yield from _find_wrong_parameters(found, camera)
    for member in ("sigma", "sigma_with_misfit", "typical_sigma"):
        for name, value in getattr(found, member).items():
            if name not in camera.parameter_names:
                yield f"{member}.{name}: no parameter of {camera.name}"
            elif value is not None and value < 0.0:
                yield f"{member}.{name}: {value!r} is negative"
    for member in ("frames", "exposures", "stars", "pairs", "iterations"):
        if (count := getattr(found, member)) < 0:
            yield f"{member}: {count} is negative"
    yield from _find_wrong_covariance("covariance", found.covariance, camera.parameter_names)
    if found.misfit is not None:
        yield from _find_wrong_covariance("misfit.covariance", found.misfit.covariance, camera.parameter_names)


def _find_wrong_parameters(found: Calibration, camera: CameraModel) -> Iterator[str]:
    """Yield parameters that are not the camera's, and of an estimate numbers that no camera has."""
    for name in camera.parameter_names:
        if name not in found.parameters:
            yield f"parameters.{name}: missing"
    for member in ("parameters", "free"):
        for name in getattr(found, member):
            if name not in camera.parameter_names:
                yield f"{member}.{name}: no parameter of {camera.name}"
    if found.parameter_names and tuple(found.parameter_names) != camera.parameter_names:
        yield f"parameter_names: expected {', '.join(camera.parameter_names)}"
    if not found.is_usable:
        return
    yield from (f"parameters.{name}: {fault}" for name, fault in camera.find_implausible(found.parameters))


#: How far the two halves of a covariance may differ by rounding, in their sigmas.
ROUNDING = 1e-6


def _find_wrong_covariance(member: str, covariance: Covariance, known: Sequence[str]) -> Iterator[str]:
    """Yield why a covariance is none: it is square, symmetric, as long as its names, and no variance is negative."""
    names, rows = covariance.names, covariance.matrix
    if len(set(names)) < len(names) or not set(names) <= set(known):
        yield f"{member}.names: expected some of {', '.join(known)}, each once"
    n = len(names)
    if len(rows) != n or any(len(row) != n for row in rows):
        yield f"{member}.matrix: expected {n} rows of {n} numbers, as many as names"
        return
    variances = [rows[i][i] for i in range(n)]
    for i, one in enumerate(variances):
        if one is not None and one < 0.0:
            yield f"{member}.matrix.{i}.{i}: {one!r} is negative"
            return
    sigmas = [math.sqrt(one or 0.0) for one in variances]
    for i, row in enumerate(rows):
        for k in range(i):
            a, b = row[k], rows[k][i]
            if a != b and (a is None or b is None or abs(a - b) > ROUNDING * sigmas[i] * sigmas[k]):
                yield f"{member}.matrix.{i}.{k}: {a!r} and {b!r}, expected the same on both sides of the diagonal"


def _make_refusal(name: str, fault: str) -> RefusedInputError:
    return RefusedInputError(
        f"{name} is not a complete calibration ({fault}): give the file that `boresight calibrate --json` wrote, "
        "as it was written.",
        code="incomplete-calibration",
    )


def read_calibration(path: str | Path) -> Calibration:
    """Read the calibration JSON of a file, as `Calibration.save` or `boresight calibrate --json` wrote it.

    Raises
    ------
    RefusedInputError
        When the file cannot be read, or is no calibration: what it lacks.
    """
    try:
        text = Path(path).read_bytes()
    except OSError as error:
        raise RefusedInputError(f"{path} cannot be read ({error.strerror or error}): check the path.") from error
    return parse_foreign_calibration(text, str(path))


def make_schema(kind: type[Any], name: str) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a dataclass; `name` is the schema's."""
    adapter: TypeAdapter[Any] = _adapter(kind)  # type: ignore[arg-type]  # every class can be hashed
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": name,
        **adapter.json_schema(mode="validation"),
    }


def compute_json_schema() -> dict[str, Any]:
    """Return the JSON Schema of the calibration JSON; of one on its way (`running`) only the status is required."""
    return {
        **make_schema(Calibration, SCHEMA),
        "if": {"properties": {"status": {"const": "running"}}},
        "else": {"required": list(REQUIRED)},
    }
