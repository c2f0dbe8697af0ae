"""What was chosen and why, as a tree of frozen dataclasses, and its JSON, `boresight.choice/1`.

Numbers are SI unless a name says otherwise; None stands where a number cannot be known, never NaN. `parse_choice` reads what
`Choice.to_dict` writes; a member that is not known here is dropped.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from boresight.calibration.advice_kinds import join_codes
from boresight.calibration.calibration import Numbers, Values, to_plain
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.telemetry.sensors import Sensor
from boresight.wording import join_words

if TYPE_CHECKING:
    from pydantic import TypeAdapter

SCHEMA: Final = "boresight.choice/1"
#: Difference of chi-square or BIC below which two cameras say the same of the stars: numerics, not data.
ALIKE = 0.05
#: p-values below this are written as below it.
SMALLEST_P = 1e-6


class State(StrEnum):
    """How the fit of a candidate ended; only what is determined can be chosen.

    `REJECTED` was not fitted: by the covariance of one that contains it, it misses the stars many times more than a test takes.
    """

    DETERMINED = "determined"
    UNDETERMINED = "undetermined"
    IMPLAUSIBLE = "implausible"
    FAILED = "failed"
    REJECTED = "rejected"


class Sufficiency(StrEnum):
    """Whether the chosen candidate holds all that the stars show."""

    SUFFICES = "suffices"
    NOISE_NOT_AS_STATED = "noise_not_as_stated"
    SOMETHING_LEFT = "something_left"


class HeldOutBy(StrEnum):
    """What candidates were held out against."""

    VALIDATION = "validation"
    CROSS_VALIDATION = "cross-validation"


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A camera with some of its terms free, fitted; of one that is rejected beforehand chi-square is linearised.

    `bic`: Schwarz's criterion with the noise found. `held_out_rms_arc_rad`: on frames it was not fitted to, with its 95 % interval.
    `change_px`: how far it puts stars from where the chosen one does, where that is most, with three sigma.
    """

    camera_model: str
    free: list[str]
    terms: list[str]
    state: State
    chi2: float | None
    dof: int
    bic: float | None
    rms_arc_rad: float | None
    held_out_rms_arc_rad: float | None = None
    held_out_interval_rad: Numbers | None = None
    change_px: float | None = None
    change_3_sigma_px: float | None = None


@dataclass(frozen=True, kw_only=True)
class ChosenCamera:
    """The chosen candidate, `models[place]`: parameters and their sigmas, by the noise found where the stated one is rejected."""

    camera_model: str
    free: list[str]
    terms: list[str]
    place: int
    parameters: Values[float]
    sigma: Values[float]


@dataclass(frozen=True, kw_only=True)
class TermTest:
    """A chi-square difference test between nested candidates, and what its terms mean.

    `looked_at`: how many such tests there were, which `p_corrected` counts. `needed`: whether the smaller candidate is rejected.
    `held_out_ratio`: held-out RMS with the terms over that without them. `change_px`: the most that they move a star.
    """

    camera_model: str
    terms: list[str]
    chi2_difference: float
    df: int
    p: float
    log10_p: float
    looked_at: int
    p_corrected: float
    log10_p_corrected: float
    needed: bool
    held_out_ratio: float | None = None
    held_out_ratio_interval: Numbers | None = None
    change_px: float | None = None
    change_3_sigma_px: float | None = None


@dataclass(frozen=True, kw_only=True)
class OtherCamera:
    """Another camera's least sufficient candidate, `models[place]`: its BIC over the chosen one's, and a nested test or None."""

    camera_model: str
    place: int
    bic_above: float
    test: TermTest | None = None


@dataclass(frozen=True, kw_only=True)
class Leftover:
    """What the chosen camera leaves, as `estimation.residual_spline` finds it: chance of as much by noise, and its largest size."""

    p: float
    largest_px: float
    sigma_px: float


@dataclass(frozen=True, kw_only=True)
class NoiseFound:
    """Variance of the arcs over the stated one, as a camera leaves it, and whether the stated noise explains it."""

    variance: float
    dof: int
    as_stated: bool


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The least camera model that suffices for a telemetry set.

    `frames`, `stars`, `arcs`: what all candidates were fitted to. `sensor_camera_model`: what the sensor file has. `models`: every
    camera with every subset of its terms. `needed`, `beyond`: the test of each term of the chosen one, and of each that it does not
    have. `leftover`: None where the stars do not carry a spline. `noise`: as the richest camera leaves it, which tests are held
    against. `matched_with`: the camera under which stars were matched; None where the file's identities stood.
    """

    schema: Literal["boresight.choice/1"] = SCHEMA
    sensor: str
    sensor_camera_model: str
    sentence: str = ""
    sufficiency: Sufficiency
    chosen: ChosenCamera
    models: list[Candidate]
    needed: list[TermTest]
    beyond: list[TermTest]
    other_cameras: list[OtherCamera]
    leftover: Leftover | None
    noise: NoiseFound
    noise_of_chosen: NoiseFound
    level: float
    held_out_by: HeldOutBy | None
    matched_with: str | None
    frames: int
    stars: int
    arcs: int
    advice: list[str] = field(default_factory=list)
    advice_codes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Put what was read of the advice beside its codes."""
        join_codes(self)

    @property
    def model(self) -> Candidate:
        """The chosen candidate."""
        return self.models[self.chosen.place]

    def list_cameras(self) -> list[Candidate]:
        """List each camera's least sufficient candidate, the chosen one first, then by BIC."""
        others = sorted(self.other_cameras, key=lambda one: one.bic_above)
        return [self.model, *(self.models[one.place] for one in others)]

    def bic_above(self, one: Candidate) -> float | None:
        """Return by how much a candidate's BIC is above the chosen one's; None where its fit failed."""
        return None if one.bic is None or self.model.bic is None else one.bic - self.model.bic

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON of the contract as plain lists, numbers and None."""
        document: dict[str, Any] = to_plain(self) | {"advice": list(map(str, self.advice))}
        return document

    def to_json(self) -> str:
        """Return the JSON as text."""
        return json.dumps(self.to_dict(), ensure_ascii=False, allow_nan=False)

    def save(self, path: str | Path) -> None:
        """Write the JSON to a file."""
        Path(path).write_text(self.to_json() + "\n", encoding="utf-8")

    def describe_sensor(self, sensor: Sensor) -> Sensor:
        """Return the sensor with the chosen camera, what was found of it as start, and its free parameters.

        Raises
        ------
        RefusedInputError
            When this version does not have the chosen camera, or the choice not all of its parameters.
        """
        chosen, camera = self.chosen, CAMERA_MODELS.get(self.chosen.camera_model)
        if camera is None or not set(chosen.free) <= set(camera.parameter_names) <= set(chosen.parameters):
            raise RefusedInputError(
                f"The chosen camera {chosen.camera_model} is not the one of this version: choose again with this version."
            )
        return replace(
            sensor,
            camera_model=camera.name,
            initial=np.array([chosen.parameters[name] for name in camera.parameter_names], np.float64),
            typical_sigma=sensor.typical_sigma if camera.name == sensor.camera_model else np.array(camera.default_typical_sigma),
            free=tuple(chosen.free),
        )  # fmt: skip


@cache
def _adapter() -> TypeAdapter[Choice]:
    """What reads choices; made once."""
    from pydantic import TypeAdapter  # noqa: PLC0415 - only where JSON is read

    return TypeAdapter(Choice)


def parse_choice(document: str | bytes | Mapping[str, Any], name: str = "This document") -> Choice:
    """Read the JSON of a choice, as text, bytes or dict; `name` is what a refusal calls it.

    Raises
    ------
    RefusedInputError
        When it is no choice, or a member is missing or of another type: which.
    """
    from pydantic import ValidationError  # noqa: PLC0415 - only where JSON is read

    advice = "give the file that `boresight choose --json` wrote, as it was written"
    try:
        read = _adapter()
        found = read.validate_json(document) if isinstance(document, str | bytes) else read.validate_python(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise RefusedInputError(
            f"{name} is not a complete choice of a camera ({where}: {first['msg']}): {advice}."
        ) from error
    if fault := _find_fault(found):
        raise RefusedInputError(f"{name} contradicts itself ({fault}): {advice}.")
    return found


def _find_fault(found: Choice) -> str | None:
    """Say which members of a choice do not fit one another; None where all do."""
    placed = [(found.chosen.place, found.chosen.camera_model)]
    placed += [(one.place, one.camera_model) for one in found.other_cameras]
    for place, camera_model in placed:
        if not 0 <= place < len(found.models) or found.models[place].camera_model != camera_model:
            return f"there is no candidate of {camera_model} at place {place}"
    pairs = [one.held_out_interval_rad for one in found.models]
    pairs += [one.held_out_ratio_interval for one in (*found.needed, *found.beyond)]
    return "an interval has two ends" if any(pair is not None and len(pair) != 2 for pair in pairs) else None


def say(found: Choice) -> str:
    """Say a choice in one sentence."""
    return "; ".join([_say_needed(found), *_say_camera(found), *_say_rest(found)]) + "."


def _say_needed(found: Choice) -> str:
    camera, terms = found.chosen.camera_model, found.chosen.terms
    if not terms:
        return f"{camera} with only its focal length free suffices"
    of = [(one.terms[0], _say_p(one.log10_p_corrected), _say_saved(one.held_out_ratio)) for one in found.needed]
    tested = {name for name, _, _ in of}
    held = [name for name in terms if name not in tested]
    if len(of) == 1:
        name, p, saved = of[0]
        stands = f", in addition to {join_words(held)}," if held else ""
        return f"{camera}: {name} terms{stands} are needed: {', '.join(part for part in (p, saved) if part)}"
    each = join_words([f"{name} ({', '.join(part for part in (p, saved) if part)})" for name, p, saved in of])
    return f"{camera}: {each} terms are needed" + (f", on {join_words(held)}" if held else "")


def _say_camera(found: Choice) -> Iterable[str]:
    own = found.sensor_camera_model
    for other in found.other_cameras:
        if other.camera_model != own:
            continue
        if other.test is not None and other.test.needed:
            yield f"{own} lacks these terms ({_say_p(other.test.log10_p_corrected)})"
        else:
            fits = "less well" if other.bic_above >= ALIKE else "equally well"
            yield f"{own} fits the stars {fits} (BIC {say_bic(other.bic_above, '.3g')})"


def say_bic(above: float, form: str) -> str:
    """Say how far a BIC is above another, or below it, or that they are equal."""
    if abs(above) < ALIKE:
        return "equal"
    return f"{abs(above):{form}} {'above' if above > 0 else 'below'}"


def _say_rest(found: Choice) -> Iterable[str]:
    missing = [one for one in found.beyond if one.needed]
    if found.sufficiency is Sufficiency.SOMETHING_LEFT and found.leftover is not None:
        left = found.leftover
        yield (
            "but no available model is sufficient: a smooth displacement of "
            f"{_say_spread(left.largest_px, 3 * left.sigma_px)} px (3 sigma) remains ({_say_p(math.log10(max(left.p, 1e-300)))})"
        )
    elif missing:
        terms = join_words(sorted({name for test in missing for name in test.terms}))
        yield f"{terms} would also be needed, but these stars do not determine them"
    else:
        yield "no further terms are needed"
    if not found.noise_of_chosen.as_stated:
        ratio = math.sqrt(found.noise_of_chosen.variance)
        yield f"residuals are {ratio:.3g} times as large as the stated noise predicts; the tests are scaled accordingly"


def _say_spread(value: float, spread: float) -> str:
    """Write a number and its spread with the same decimals: two digits of the number, and one of the spread at least."""
    sizes = [(abs(value), 1), (spread, 0)]
    decimals = max((digits - math.floor(math.log10(size)) for size, digits in sizes if size > 0.0), default=0)
    return f"{value:.{max(decimals, 0)}f} ± {spread:.{max(decimals, 0)}f}"


def write_p(log10_p: float) -> str:
    """Write a p-value: < 1e-6, 0.003."""
    p = 10.0 ** min(0.0, log10_p)
    return "< 1e-6" if p < SMALLEST_P else f"{p:.2g}"


def _say_p(log10_p: float) -> str:
    """Write a p-value behind its letter: p < 1e-6, p = 0.003."""
    return f"p {'' if 10.0 ** min(0.0, log10_p) < SMALLEST_P else '= '}{write_p(log10_p)}"


def _say_saved(ratio: float | None) -> str:
    """Say how much lower the held-out RMS is with a term than without it."""
    if ratio is None:
        return ""
    change = 100.0 * (ratio - 1.0)
    return f"held-out RMS {'decreases' if change <= 0 else 'increases'} by {abs(change):.2g} %"
