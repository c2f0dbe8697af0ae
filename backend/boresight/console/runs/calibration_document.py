"""The calibration JSON, `boresight.calibration/1`, as a typed document; while a run computes, members are missing."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.data_version import SizeLimitedCache

Document = dict[str, Any]
Values = dict[str, float | None]
Series = list[float | None]
Matrix = list[Series]
FINAL = ("sensor", "method", "camera_model", "parameters", "sigma", "covariance", "rms_arc_rad")
MOST_REMEMBERED = 4096

#: What was found of a result, by its address: the bytes of an address never change.
_looked_at: SizeLimitedCache[bool] = SizeLimitedCache(MOST_REMEMBERED)


class _Part(BaseModel):
    """A part of the document; what a newer version adds is passed on."""

    model_config = ConfigDict(extra="allow", populate_by_name=True)


class Change(_Part):
    """A number under the initial parameters and under the final ones."""

    initial: float | None
    final: float | None


class Covariance(_Part):
    """Of the estimated parameters, SI."""

    names: list[str]
    matrix: Matrix = Field(description="Rows and columns in the order of `names`.")


class ChiSquareTest(_Part):
    """A chi-square test over its degrees of freedom, with the bounds of 95 %."""

    dof: int
    lower: float | None
    upper: float | None
    consistent: bool


class MeanTest(ChiSquareTest):
    """Mean normalised innovation squared."""

    mean: float | None


class ValueTest(ChiSquareTest):
    """A chi-square."""

    value: float | None


class Direction(_Part):
    """A combination of parameters."""

    direction: Values
    sentence: str


class Observability(_Part):
    """What the data determine, and how well."""

    parameter_names: list[str]
    singular_values: Series
    condition_number: float | None
    right_singular_vectors: Matrix
    sigma_of_direction: Series
    weakest: Direction


class Evaluation(_Part):
    """Flight scores on the frames of a set, under the initial and the final parameters."""

    frames: int
    availability: Change
    matched_star_ratio: float | None
    rms_arc_rad: Change


class History(_Part):
    """A filter's history, an entry an update."""

    frame: list[int]
    parameters: Matrix
    sigma: Matrix
    tail_rms_rad: Series
    aggregate_rms_rad: Series


class LeftOut(_Part):
    """What took no part."""

    what: str
    count: int
    reason: str


class Inputs(_Part):
    """What the result follows from."""

    sha256s: dict[str, str] = Field(default_factory=dict)
    versions: dict[str, str] = Field(default_factory=dict)
    settings: Document = Field(default_factory=dict)


class Calibration(_Part):
    """A calibration, complete or so far; numbers are SI, null is what was not estimated."""

    document_schema: Literal["boresight.calibration/1"] = Field(alias="schema")
    status: Literal["converged", "max_iterations", "rank_deficient", "diverged", "too_few_stars", "running", "none"] = (
        Field(description="`running` while the run computes, `none` where it ended without a result.")
    )
    run_state: str | None = Field(None, description="Of the run, where there is nothing yet.")
    sensor: str | None = None
    method: str | None = None
    variant: str | None = None
    camera_model: str | None = None
    parameter_names: list[str] = Field(default_factory=list)
    free: list[str] = Field(default_factory=list)
    initial: Values | None = None
    typical_sigma: Values | None = None
    units: dict[str, str] | None = None
    truth: Document | None = Field(None, description="True parameters of a simulated sensor.")
    parameters: Values | None = None
    sigma: Values | None = None
    delta_over_sigma: Values | None = None
    covariance: Covariance | None = None
    iterations: int | None = None
    frames: int | None = None
    exposures: int | None = None
    stars: int | None = None
    pairs: int | None = None
    left_out: list[LeftOut] = Field(default_factory=list)
    inputs: Inputs | None = None
    rms_arc_rad: Change | None = Field(None, description="Unweighted, on common pairs.")
    chi2_per_dof: float | None = None
    chi2: ValueTest | None = None
    nis: MeanTest | None = None
    observability: Observability | None = None
    advice: list[str] = Field(default_factory=list)
    validation: Evaluation | None = None
    evaluation: Evaluation | None = None
    history: History | None = None
    trace: Document | None = None
    radial: Document | None = None
    coverage: Document | None = None
    matching: Document | None = None
    alignment: Document | None = None
    frame_observability: Document | None = None
    trust: Document | None = None
    shadow: Document | None = None
    robust: Document | None = None
    timing_s: dict[str, float | None] = Field(default_factory=dict)


def read_result(blobs: BlobStore, sha256: str, run_id: int | None = None) -> Document:
    """Read the stored result of a run, parsed once for all who ask: nobody may change it."""
    try:
        document = blobs.document(sha256)
    except ValueError:
        document = None
    if _looked_at.get(sha256, lambda: (_is_final(document), 1)):
        found: Document = document
        return found
    whose = "" if run_id is None else f" of run {run_id}"
    raise ConflictError(
        f"The stored result {sha256[:12]}{whose} is no calibration that can be read: launch the run again, or restore the "
        "store from a backup."
    )


def _is_final(document: Any) -> bool:
    """Whether a document has every member of an ended calibration, each of its type."""
    return _find_fault(document) is None


def _find_fault(document: Any) -> str | None:
    """Say what keeps a document from being an ended calibration: the first member that is missing or of another type."""
    try:
        Calibration.model_validate(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        return f"{where}: {first['msg']}" if where else str(first["msg"])
    missing = [name for name in FINAL if document.get(name) is None]
    return f"{missing[0]}: missing" if missing else None


def refuse_incomplete(document: Any, name: str) -> None:
    """Refuse a document that somebody gave as an ended calibration and that is none."""
    if (fault := _find_fault(document)) is not None:
        raise RefusedInputError(
            f"{name} is no whole calibration ({fault}): give the file that `boresight calibrate --json` wrote, as it was written."
        )
