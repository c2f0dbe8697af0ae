"""From telemetry and a sensor file to the least camera model that suffices.

1. Stars are matched once, as a calibration with everything free of the sensor's own camera matches them. Where another camera with
   everything free then fits better, they are matched again under it, so that no camera has lost the stars that speak against it.
   From then on identities are the same for all candidates.
2. Weights are taken once, at the richest camera's state, and every camera is fitted with one term more at a time.
3. Every subset of every camera's terms is fitted, or rejected beforehand by the covariance of a larger one; the least sufficient
   candidate of each camera, and of all cameras, is searched for (`search`).
4. Every candidate is scored on held-out frames, the chosen one is set beside the others over the detector, and what it leaves is
   tested by a spline, which holds any smooth lens (`estimation.residual_spline`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.advice_kinds import Advice, make_advice
from boresight.calibration.calibrate import CalibrationContext, choose_match_mode, open_validation_set
from boresight.calibration.calibration import Values
from boresight.calibration.choice.cross_validation import HeldOutScores, cross_validate, validate
from boresight.calibration.choice.detector_change import ChangeOverDetector
from boresight.calibration.choice.fits import Fits, FittedSubset, seen_by, whitened_at
from boresight.calibration.choice.nested_tests import LEVEL, NestedTest, Noise
from boresight.calibration.choice.result import (
    Candidate,
    Choice,
    ChosenCamera,
    Leftover,
    NoiseFound,
    OtherCamera,
    State,
    Sufficiency,
    TermTest,
    say,
)
from boresight.calibration.choice.search import Between, bic, find_least, fit_ladders
from boresight.calibration.corrections import put_right
from boresight.calibration.estimate import Parameters, never
from boresight.calibration.evaluation import bootstrap
from boresight.calibration.matching.match_report import Estimation
from boresight.calibration.matching.matched import Dataset, Matched
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import JUDGED_STARS, TelemetryInput, is_large
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.errors import RefusedInputError
from boresight.estimation import batch, residual_spline
from boresight.estimation.arcs import ArcSet
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

Report = Callable[[str, float], None]
NO_FIT = (
    "No camera model can be fitted to these stars because the fits diverge: check the sensor file's focal length and parity, and "
    "the identities, with `boresight check`."
)


@dataclass(frozen=True)
class _Stars:
    """A matched set: its arcs, not whitened, and under which camera it was matched (None: as given)."""

    arcs: ArcSet
    matched_with: str | None


def choose(  # noqa: PLR0913 - what is chosen from, and six choices of the caller by name
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings | None = None,
    *,
    validation: TelemetryInput | None = None,
    rng: np.random.Generator | None = None,
    report: Report | None = None,
    cancelled: Callable[[], bool] = never,
    cache_folder: Path | None = None,
) -> Choice:
    """Choose the least camera model that suffices for a telemetry set.

    Parameters
    ----------
    telemetry, sensor, catalogue
        The data, whose they are, and where directions come from that the data do not give. Of a large file whole stretches, evenly
        spread over it, are looked at.
    settings
        Choices of matching count here; what is free does not.
    validation
        A set that candidates are held out against; without it they are cross-validated by frames.
    rng
        Source of the resampling of frames.
    report
        Told of progress: a message, and the share that is done.
    cancelled
        Asked often; True stops.
    cache_folder
        Where lost-in-space identification keeps its tables; None makes them again.

    Raises
    ------
    RefusedInputError
        When no exposure can be used, or no camera could be fitted.
    CancelledError
        When `cancelled` said so.
    """
    tell = report or (lambda _message, _share: None)
    settings = settings or CalibrationSettings()
    rng = rng or np.random.default_rng(bootstrap.SEED)
    context = CalibrationContext(cancelled, cache_folder=cache_folder)
    tell("matching the stars", 0.0)
    inside, advice = _read(telemetry, sensor, catalogue, "")
    fits, stars, richest = _common_stars(inside, sensor, catalogue, settings, context)
    tell("fitting every camera", 0.3)
    least = find_least(fits, richest)
    if least is None:
        raise RefusedInputError(NO_FIT)
    noise, chosen = least.noise, least.chosen
    tell("setting frames aside for validation", 0.5)
    candidates = list(fits.known.values())
    held = _score_held_out(validation, fits, candidates, richest, catalogue, settings, context, rng)
    advice += held[1]
    tell("comparing over the detector", 0.8)
    tables = _CandidateTables(fits, noise, candidates, held[0])
    answer = Choice(
        sensor=sensor.name,
        sensor_camera_model=sensor.camera_model,
        sufficiency=Sufficiency.SUFFICES,
        chosen=tables.chosen(chosen.fitted),
        models=[tables.candidate(one, chosen.fitted) for one in candidates],
        needed=[tables.test(test) for test in chosen.needed],
        beyond=[tables.test(test) for test in chosen.beyond],
        other_cameras=[tables.other(one) for one in least.between],
        leftover=_leftover(fits, chosen.fitted),
        noise=_found(noise),
        noise_of_chosen=_found(Noise(chosen.fitted.chi2 / chosen.fitted.dof, chosen.fitted.dof)),
        level=LEVEL,
        held_out_by=None if held[0] is None else held[0].source,
        matched_with=stars.matched_with,
        frames=fits.arcs.n_frames,
        stars=fits.arcs.n_stars,
        arcs=fits.arcs.n_arcs,
        advice=list(advice),
    )
    answer = replace(answer, sufficiency=_judge(answer))
    tell("done", 1.0)
    return replace(answer, sentence=say(answer))


def _judge(found: Choice) -> Sufficiency:
    """Judge whether the chosen candidate holds all that the stars show."""
    if found.leftover is not None and found.leftover.p < LEVEL:
        return Sufficiency.SOMETHING_LEFT
    return Sufficiency.SUFFICES if found.noise_of_chosen.as_stated else Sufficiency.NOISE_NOT_AS_STATED


def _found(noise: Noise) -> NoiseFound:
    return NoiseFound(variance=noise.variance, dof=noise.dof, as_stated=noise.as_stated)


class _CandidateTables:
    """Describes candidates and tests beside their held-out scores and changes over the detector."""

    def __init__(self, fits: Fits, noise: Noise, candidates: list[FittedSubset], scores: HeldOutScores | None) -> None:
        self._noise, self._scores = noise, scores
        self._at = {id(one): place for place, one in enumerate(candidates)}
        self._change = ChangeOverDetector(fits, noise.scale)

    def chosen(self, fitted: FittedSubset) -> ChosenCamera:
        """Describe the chosen candidate."""
        sigma = np.sqrt(np.diag(fitted.P) * self._noise.scale)
        return ChosenCamera(
            camera_model=fitted.camera.name,
            free=list(fitted.subset.free_names),
            terms=list(fitted.subset.term_names),
            place=self._at[id(fitted)],
            parameters=Values(dict(zip(fitted.camera.parameter_names, fitted.x.tolist(), strict=True))),
            sigma=Values(dict(zip(fitted.subset.free_names, sigma.tolist(), strict=True))),
        )

    def candidate(self, fitted: FittedSubset, chosen: FittedSubset) -> Candidate:
        """Describe a candidate."""
        ended = fitted.state is not State.FAILED
        score = None if self._scores is None else self._scores.score(self._at[id(fitted)])
        largest, three_sigma = self._largest(chosen, fitted)
        return Candidate(
            camera_model=fitted.camera.name,
            free=list(fitted.subset.free_names),
            terms=list(fitted.subset.term_names),
            state=fitted.state,
            chi2=fitted.chi2 if ended else None,
            dof=fitted.dof,
            bic=bic(fitted, self._noise) if ended else None,
            rms_arc_rad=fitted.rms_arc_rad if ended and fitted.state is not State.REJECTED else None,
            held_out_rms_arc_rad=None if score is None else score.value,
            held_out_interval_rad=None if score is None else list(score.interval),
            change_px=largest,
            change_3_sigma_px=three_sigma,
        )

    def test(self, test: NestedTest) -> TermTest:
        """Describe a test."""
        places = self._at[id(test.larger)], self._at[id(test.smaller)]
        ratio = None if self._scores is None else self._scores.ratio(*places)
        largest, three_sigma = self._largest(test.smaller, test.larger)
        return TermTest(
            camera_model=test.larger.camera.name,
            terms=list(test.terms),
            chi2_difference=test.drop,
            df=test.df,
            p=test.p,
            log10_p=test.log_p / math.log(10.0),
            looked_at=test.looked_at,
            p_corrected=test.p_corrected,
            log10_p_corrected=test.log_corrected / math.log(10.0),
            needed=test.rejects,
            held_out_ratio=None if ratio is None else ratio.value,
            held_out_ratio_interval=None if ratio is None else list(ratio.interval),
            change_px=largest,
            change_3_sigma_px=three_sigma,
        )

    def other(self, one: Between) -> OtherCamera:
        """Describe another camera's candidate."""
        fitted = one.against.fitted
        return OtherCamera(
            camera_model=fitted.camera.name,
            place=self._at[id(fitted)],
            bic_above=one.bic_above,
            test=None if one.test is None else self.test(one.test),
        )

    def _largest(self, before: FittedSubset, after: FittedSubset) -> tuple[float | None, float | None]:
        found = self._change(before, after)
        return (None, None) if found is None else found.largest


def _read(
    telemetry: TelemetryInput, sensor: Sensor, catalogue: Catalogue, which: str
) -> tuple[Telemetry, list[Advice]]:
    """Read a set, of a large one stretches that are evenly spread over it, with what to say of it."""
    inside, off = open_validation_set(telemetry, sensor, JUDGED_STARS)
    inside = put_right(inside, sensor, catalogue)
    words = make_advice("off_detector", off.sentences(which))
    if is_large(telemetry):
        said = f"The set{which} is large: {len(np.unique(inside.frame)):,} of its frames, evenly spread, were used."
        words.append(Advice(said, "judged_on"))
    return inside, words


def _common_stars(
    telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue, settings: CalibrationSettings, context: CalibrationContext
) -> tuple[Fits, _Stars, FittedSubset]:  # fmt: skip
    """Match the stars for all candidates, take the weights, and fit every camera's ladder; the last is the richest camera."""
    stars = _matched(telemetry, sensor, catalogue, settings, context)
    camera, x = CAMERA_MODELS[sensor.camera_model], sensor.initial
    fits, richest = _fitted(stars.arcs, camera, x, sensor, context)
    if stars.matched_with not in {None, richest.camera.name}:
        under = _matched_under(telemetry, fits, richest, catalogue, settings, context)
        if under.problem.arcs.n_exposures:
            stars = _Stars(under.problem.arcs.whole(), richest.camera.name)
    fits, richest = _fitted(stars.arcs, richest.camera, richest.x, sensor, context)
    return fits, stars, richest


def _fitted(
    arcs: ArcSet, camera: CameraModel, x: FloatArray, sensor: Sensor, context: CalibrationContext
) -> tuple[Fits, FittedSubset]:
    """Fit every camera's ladder with the weights of one state; returns the fits and the richest camera."""
    fits, richest = fit_ladders(whitened_at(arcs, camera, x), sensor, context.cancelled)
    if richest is None:
        raise RefusedInputError(NO_FIT)
    return fits, richest


def _matched(
    telemetry: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings,
    context: CalibrationContext,
) -> _Stars:
    """Match as a calibration does with everything free."""
    chosen = replace(choose_match_mode(telemetry, settings), method="batch", free=None)
    everything = Parameters(np.arange(len(sensor.initial), dtype=np.int64), sensor.typical_sigma)
    sets = Dataset(telemetry, sensor, catalogue, everything, chosen, context.cache_folder)
    first = sets.at_start()
    if first.problem.arcs.n_exposures == 0:
        raise RefusedInputError(
            "No exposure has four usable stars: check identities, times and the sensor file with `boresight check`."
        )
    ended = Estimation(sets, first, everything, chosen, lambda *_: None, context.cancelled).run()
    last = first if ended.estimate.status == "diverged" else ended.matched
    return _Stars(
        last.problem.arcs.whole(),
        None if sets.is_given else sensor.camera_model,
    )


def _matched_under(
    telemetry: Telemetry, fits: Fits, richest: FittedSubset, catalogue: Catalogue, settings: CalibrationSettings,
    context: CalibrationContext,
) -> Matched:  # fmt: skip
    """Match a set under a fitted camera, as certain of it as its data and the start make it."""
    camera, free = richest.camera, richest.subset.free
    scale = fits.scale(camera)
    described = replace(
        fits.sensor, camera_model=camera.name, initial=richest.x, typical_sigma=scale, free=richest.subset.free_names
    )
    A = batch.normal_equations(seen_by(fits.arcs, camera), richest.x, free, scale[free]).A
    excess = max(1.0, richest.chi2 / richest.dof)
    P = np.asarray(excess * np.linalg.inv(A + np.eye(len(free)) / settings.initial_sigma_scale**2), np.float64)
    chosen = replace(choose_match_mode(telemetry, settings), method="batch", free=None)
    sets = Dataset(telemetry, described, catalogue, Parameters(free, scale[free]), chosen, context.cache_folder)
    return sets.at_covariance(richest.x, P, float(np.sqrt(excess)))


def _score_held_out(
    validation: TelemetryInput | None, fits: Fits, candidates: list[FittedSubset],
    richest: FittedSubset, catalogue: Catalogue, settings: CalibrationSettings, context: CalibrationContext,
    rng: np.random.Generator,
) -> tuple[HeldOutScores | None, list[Advice]]:  # fmt: skip
    """Score every candidate on a validation set, matched under the richest camera, or by cross-validation."""
    if validation is None:
        found = cross_validate(fits, candidates, rng)
        alone = Advice("A single frame leaves nothing to hold out: give a validation set.", "few_frames")
        return found, [] if found else [alone]
    inside, words = _read(validation, fits.sensor, catalogue, " in the validation set")
    matched = _matched_under(inside, fits, richest, catalogue, settings, context)
    if matched.problem.arcs.n_exposures == 0:
        raise RefusedInputError("No exposure of the validation set has four usable stars: choose another set.")
    arcs = whitened_at(matched.problem.arcs.whole(), richest.camera, richest.x)
    return validate(arcs, candidates, rng), words


def _leftover(fits: Fits, chosen: FittedSubset) -> Leftover | None:
    """Test what the chosen candidate leaves; None where the stars do not carry a spline."""
    sensor, free = fits.sensor, chosen.subset.free
    arcs = seen_by(fits.arcs, chosen.camera)
    try:
        found = residual_spline.fit(
            arcs, chosen.camera, chosen.x, free, fits.scale(chosen.camera)[free],
            parity=sensor.parity, detector=(sensor.rows, sensor.columns),
        ).posterior  # fmt: skip
    except np.linalg.LinAlgError:
        return None
    shift = found.surface(arcs.row_px, arcs.col_px)
    size = np.linalg.norm(shift, axis=1)
    at = int(np.argmax(size))
    C = found.covariance(arcs.row_px[at : at + 1], arcs.col_px[at : at + 1])[0]
    towards = shift[at] / max(float(size[at]), 1e-300)
    sigma = float(np.sqrt(max(towards @ C @ towards, 0.0)))
    return Leftover(p=found.test.p, largest_px=float(size[at]), sigma_px=sigma)
