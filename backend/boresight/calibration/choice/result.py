"""What was chosen and why, typed; its one sentence; JSON at the border (`boresight.choice/1`)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.choice.cross_validation import Score
from boresight.calibration.choice.detector_change import DetectorChange
from boresight.calibration.choice.fits import FittedSubset, State
from boresight.calibration.choice.nested_tests import LEVEL, NestedTest, Noise
from boresight.telemetry.sensors import Sensor, sensor_document

SCHEMA = "boresight.choice/1"
#: p-values below this are written as below it.
SMALLEST_P = 1e-6


class Sufficiency(StrEnum):
    """Whether the chosen candidate holds all that the stars show."""

    SUFFICES = "suffices"
    NOISE_NOT_AS_STATED = "noise_not_as_stated"
    SOMETHING_LEFT = "something_left"


@dataclass(frozen=True)
class Model:
    """One candidate: its fit, BIC, held-out score, and how far it puts stars from where the chosen one does."""

    fitted: FittedSubset
    bic: float
    held_out: Score | None
    change: DetectorChange | None


@dataclass(frozen=True)
class TermTest:
    """A test with what it means: the change over the detector and held-out RMS, larger candidate over smaller."""

    test: NestedTest
    change: DetectorChange | None
    held_out: Score | None


@dataclass(frozen=True)
class OtherCamera:
    """The least sufficient candidate of another camera: how much its BIC is above, and a nested test where there is one."""

    fitted: FittedSubset
    bic_above: float
    test: NestedTest | None


@dataclass(frozen=True)
class Leftover:
    """What the chosen camera leaves, as `estimation.residual_spline` finds it: chance of as much by noise, and its largest size."""

    p: float
    largest_px: float
    sigma_px: float


@dataclass(frozen=True)
class Choice:
    """The least camera model that suffices for a telemetry set.

    Parameters
    ----------
    sensor
        Whose telemetry it is.
    frames, stars, arcs
        What all candidates were fitted to.
    noise
        Variance over the stated one, as the richest camera leaves it.
    models
        Every candidate that was fitted.
    chosen
        Which of them is chosen.
    needed, beyond
        The test of each term of the chosen one, and of each that it does not have.
    others
        The other cameras.
    leftover
        What the chosen one leaves; None where that could not be computed.
    held_out_by
        `validation` or `cross-validation`; None where there was nothing to hold out.
    matched_with
        Name of the camera under which stars were matched; None where the file's identities stood.
    advice
        What a person should know beside the sentence.
    """

    sensor: Sensor
    frames: int
    stars: int
    arcs: int
    noise: Noise
    models: tuple[Model, ...]
    chosen: int
    needed: tuple[TermTest, ...]
    beyond: tuple[TermTest, ...]
    others: tuple[OtherCamera, ...]
    leftover: Leftover | None
    held_out_by: str | None
    matched_with: str | None
    advice: tuple[str, ...]

    @property
    def model(self) -> Model:
        """The chosen candidate."""
        return self.models[self.chosen]

    @property
    def noise_of_chosen(self) -> Noise:
        """Noise that the chosen candidate leaves."""
        fitted = self.model.fitted
        return Noise(fitted.chi2 / fitted.dof, fitted.dof)

    @property
    def sufficiency(self) -> Sufficiency:
        """Whether it holds all that the stars show."""
        if self.leftover is not None and self.leftover.p < LEVEL:
            return Sufficiency.SOMETHING_LEFT
        return Sufficiency.SUFFICES if self.noise_of_chosen.as_stated else Sufficiency.NOISE_NOT_AS_STATED

    @property
    def sentence(self) -> str:
        """The choice in one sentence."""
        return "; ".join([self._needed_sentence(), *self._camera_sentence(), *self._rest_sentence()]) + "."

    def _needed_sentence(self) -> str:
        camera = self.model.fitted.camera.name
        of = [(one.test.terms[0], f"p {shown_p(one.test.log_corrected)}", _saved(one.held_out)) for one in self.needed]
        if not self.model.fitted.subset.terms:
            return f"{camera} with nothing but its focal length free suffices"
        held = [name for name in self.model.fitted.subset.term_names if name not in {name for name, _, _ in of}]
        if len(of) == 1:
            name, p, saved = of[0]
            stands = f", which stand on {listed(held)}," if held else ""
            return f"{camera}: {name} terms{stands} are needed: {', '.join(part for part in (p, saved) if part)}"
        each = listed([f"{name} ({', '.join(part for part in (p, saved) if part)})" for name, p, saved in of])
        return f"{camera}: {each} terms are needed" + (f", on {listed(held)}" if held else "")

    def _camera_sentence(self) -> Iterable[str]:
        own = self.sensor.camera_model
        for other in self.others:
            if other.fitted.camera.name != own:
                continue
            if other.test is not None and other.test.rejects:
                yield f"{own} does not hold them (p {shown_p(other.test.log_corrected)})"
            else:
                yield f"{own} holds the stars less well (BIC {other.bic_above:.3g} above)"

    def _rest_sentence(self) -> Iterable[str]:
        missing = [one.test for one in self.beyond if one.test.rejects]
        if self.sufficiency is Sufficiency.SOMETHING_LEFT and self.leftover is not None:
            left = self.leftover
            yield (
                f"but no model here suffices: {left.largest_px:.2g} ± {3 * left.sigma_px:.1g} px of smooth displacement is left "
                f"(p {shown_p(math.log(max(left.p, 1e-300)))})"
            )
        elif missing:
            terms = listed(sorted({name for test in missing for name in test.terms}))
            yield f"{terms} would be needed beyond, which these stars do not determine"
        else:
            yield "nothing beyond"
        if not self.noise_of_chosen.as_stated:
            ratio = math.sqrt(self.noise_of_chosen.variance)
            yield f"residuals are {ratio:.3g} times what the stated noise explains, and the tests are scaled by it"

    def sensor_file(self) -> dict[str, Any]:
        """The sensor file with the chosen camera, its fitted parameters as the initial ones, and its free parameters."""
        fitted = self.model.fitted
        own = fitted.camera.name == self.sensor.camera_model
        described = replace(
            self.sensor,
            camera_model=fitted.camera.name,
            initial=fitted.x,
            typical_sigma=self.sensor.typical_sigma if own else np.array(fitted.camera.default_typical_sigma),
            free=fitted.subset.free_names,
        )
        return sensor_document(described)

    def document(self) -> dict[str, Any]:
        """The JSON of the contract."""
        fitted = self.model.fitted
        return {
            "schema": SCHEMA,
            "sensor": self.sensor.name,
            "sentence": self.sentence,
            "sufficiency": self.sufficiency.value,
            "chosen": {
                **_candidate(fitted),
                "parameters": dict(zip(fitted.camera.parameter_names, fitted.x.tolist(), strict=True)),
                "sigma": dict(zip(fitted.subset.free_names, np.sqrt(np.diag(fitted.P)).tolist(), strict=True)),
            },
            "models": [_model(one) for one in self.models],
            "needed": [_evidence(one) for one in self.needed],
            "beyond": [_evidence(one) for one in self.beyond],
            "other_cameras": [
                {
                    **_candidate(one.fitted),
                    "bic_above": one.bic_above,
                    "p": None if one.test is None else one.test.p,
                    "p_corrected": None if one.test is None else one.test.p_corrected,
                }
                for one in self.others
            ],
            "leftover": None if self.leftover is None else vars(self.leftover),
            "noise": {
                "variance": self.noise.variance,
                "dof": self.noise.dof,
                "as_stated": self.noise.as_stated,
                "of_chosen": self.noise_of_chosen.variance,
            },
            "level": LEVEL,
            "held_out_by": self.held_out_by,
            "matched_with": self.matched_with,
            "frames": self.frames,
            "stars": self.stars,
            "arcs": self.arcs,
            "advice": list(self.advice),
        }


def _candidate(fitted: FittedSubset) -> dict[str, Any]:
    return {
        "camera_model": fitted.camera.name,
        "free": list(fitted.subset.free_names),
        "terms": list(fitted.subset.term_names),
    }


def _model(one: Model) -> dict[str, Any]:
    fitted = one.fitted
    ended = fitted.state is not State.FAILED
    largest = None if one.change is None else one.change.largest
    return {
        **_candidate(fitted),
        "state": fitted.state.value,
        "chi2": fitted.chi2 if ended else None,
        "dof": fitted.dof,
        "bic": one.bic if ended else None,
        "rms_arc_rad": fitted.rms_arc_rad if ended else None,
        "held_out_rms_arc_rad": None if one.held_out is None else one.held_out.rms_arc_rad,
        "held_out_interval_rad": None if one.held_out is None else list(one.held_out.interval),
        "change_px": None if largest is None else largest[0],
        "change_3_sigma_px": None if largest is None else largest[1],
    }


def _evidence(one: TermTest) -> dict[str, Any]:
    test, change = one.test, one.change
    largest = None if change is None else change.largest
    return {
        "camera_model": test.larger.camera.name,
        "terms": list(test.terms),
        "chi2_difference": test.drop,
        "df": test.df,
        "p": test.p,
        "log10_p": test.log_p / math.log(10.0),
        "looked_at": test.looked_at,
        "p_corrected": test.p_corrected,
        "needed": test.rejects,
        "held_out_ratio": None if one.held_out is None else one.held_out.rms_arc_rad,
        "held_out_ratio_interval": None if one.held_out is None else list(one.held_out.interval),
        "change_px": None if largest is None else largest[0],
        "change_3_sigma_px": None if largest is None else largest[1],
        "field": None if change is None else _field(change),
    }


def _field(change: DetectorChange) -> dict[str, Any]:
    def flat(values: FloatArray) -> list[float]:
        rounded: list[float] = np.round(values, 6).tolist()
        return rounded

    return {
        "row_px": flat(change.row_px),
        "col_px": flat(change.col_px),
        "change_row_px": flat(change.change_px[:, 0]),
        "change_col_px": flat(change.change_px[:, 1]),
        "sigma_px": flat(change.sigma_px),
    }


def shown_p(log_p: float) -> str:
    """Write a p-value behind its letter: < 1e-6, = 0.003."""
    p = math.exp(min(0.0, log_p))
    return "< 1e-6" if p < SMALLEST_P else f"= {p:.2g}"


def _saved(ratio: Score | None) -> str:
    """Say how much lower the held-out RMS is with a term than without it."""
    if ratio is None:
        return ""
    change = 100.0 * (ratio.rms_arc_rad - 1.0)
    return f"held-out RMS {'down' if change <= 0 else 'up'} by {abs(change):.2g} %"


def listed(words: Sequence[str]) -> str:
    """Join words as a list in a sentence."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
