"""From telemetry and a sensor file to the least camera model that suffices.

1. Stars are matched once, as a calibration with everything free of the sensor's own camera matches them. Where another camera with
   everything free then fits better, they are matched again under it, so that no camera has lost the stars that speak against it.
   From then on identities are the same for all candidates.
2. Weights are taken once, at the richest camera's state, and every camera is fitted with one term more at a time.
3. The least sufficient candidate of each camera, and of all cameras, is searched for (`search`).
4. Every candidate is scored on held-out frames, the chosen one is set beside the others over the detector, and what it leaves is
   tested by a spline, which holds any smooth lens (`estimation.residual_spline`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibrate import CalibrationContext, choose_match_mode, open_validation_set
from boresight.calibration.choice.cross_validation import HeldOutScores, cross_validate, validate
from boresight.calibration.choice.detector_change import ChangeOverDetector
from boresight.calibration.choice.fits import Fits, FittedSubset, seen_by, whitened_at
from boresight.calibration.choice.nested_tests import NestedTest
from boresight.calibration.choice.result import Choice, Leftover, Model, OtherCamera, TermTest
from boresight.calibration.choice.search import bic, find_least, fit_ladders
from boresight.calibration.estimate import Parameters, never
from boresight.calibration.evaluation import bootstrap
from boresight.calibration.matching.match_report import Estimation, identification_advice
from boresight.calibration.matching.matched import Dataset, Matched
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import JUDGED_STARS, StoredTable, TelemetryFile, is_large
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.errors import RefusedInputError
from boresight.estimation import batch, residual_spline
from boresight.estimation.arcs import ArcSet
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

Report = Callable[[str, float], None]
NO_FIT = (
    "No camera model could be fitted to these stars, for the fits diverge: check the sensor file's focal length and parity, and "
    "the identities, with `boresight check`."
)


@dataclass(frozen=True)
class _Stars:
    """A matched set: its arcs, not whitened, under which camera it was matched (None: as given), and what to say of it."""

    arcs: ArcSet
    matched_with: str | None
    advice: tuple[str, ...]


def choose(  # noqa: PLR0913 - what is chosen from, and six choices of the caller by name
    telemetry: Telemetry | TelemetryFile | StoredTable,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings | None = None,
    *,
    validation: Telemetry | TelemetryFile | StoredTable | None = None,
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
        Where lost-in-space identification keeps its tables; None makes them anew.

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
    inside, advice = _read(telemetry, sensor, "")
    fits, stars, richest = _common_stars(inside, sensor, catalogue, settings, context)
    tell("fitting every camera", 0.3)
    least = find_least(fits, richest)
    if least is None:
        raise RefusedInputError(NO_FIT)
    noise, chosen = least.noise, least.chosen
    tell("holding frames out", 0.5)
    candidates = list(fits.known.values())
    held = _score_held_out(validation, fits, candidates, richest, catalogue, settings, context, rng)
    advice += held[1]
    tell("looking over the detector", 0.8)
    change = ChangeOverDetector(fits, noise.scale)
    at = {id(one): k for k, one in enumerate(candidates)}

    def shown(test: NestedTest) -> TermTest:
        ratio = None if held[0] is None else held[0].ratio(at[id(test.larger)], at[id(test.smaller)])
        return TermTest(test, change(test.smaller, test.larger), ratio)

    models = tuple(
        Model(one, bic(one, noise), None if held[0] is None else held[0].score(k), change(chosen.fitted, one))
        for k, one in enumerate(candidates)
    )
    answer = Choice(
        sensor=sensor,
        frames=fits.arcs.n_frames,
        stars=fits.arcs.n_stars,
        arcs=fits.arcs.n_arcs,
        noise=noise,
        models=models,
        chosen=at[id(chosen.fitted)],
        needed=tuple(shown(test) for test in chosen.needed),
        beyond=tuple(shown(test) for test in chosen.beyond),
        others=tuple(OtherCamera(one.against.fitted, one.bic_above, one.test) for one in least.between),
        leftover=_leftover(fits, chosen.fitted),
        held_out_by=None if held[0] is None else held[0].source,
        matched_with=stars.matched_with,
        advice=(*advice, *stars.advice),
    )
    tell("done", 1.0)
    return answer


def _read(
    telemetry: Telemetry | TelemetryFile | StoredTable, sensor: Sensor, which: str
) -> tuple[Telemetry, list[str]]:
    """Read a set, of a large one stretches that are evenly spread over it, with what to say of it."""
    inside, off = open_validation_set(telemetry, sensor, JUDGED_STARS)
    words = off.sentences(which)
    if is_large(telemetry):
        words.append(
            f"The set{which} is large: {len(np.unique(inside.frame)):,} of its frames, evenly spread, were looked at."
        )
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
            advice = tuple(identification_advice(under.unidentified))
            stars = _Stars(under.problem.arcs.whole(), richest.camera.name, advice)
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
    unidentified = tuple(identification_advice(first.unidentified))
    if first.problem.arcs.n_exposures == 0:
        raise RefusedInputError(
            "No exposure has four stars that can be used: "
            + (
                unidentified[0]
                if unidentified
                else "check identities, times and the sensor file with `boresight check`."
            )
        )
    ended = Estimation(sets, first, everything, chosen, lambda *_: None, context.cancelled).run()
    last = first if ended.estimate.status == "diverged" else ended.matched
    return _Stars(
        last.problem.arcs.whole(),
        None if sets.stands else sensor.camera_model,
        tuple(identification_advice(last.unidentified)),
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
    validation: Telemetry | TelemetryFile | StoredTable | None, fits: Fits, candidates: list[FittedSubset],
    richest: FittedSubset, catalogue: Catalogue, settings: CalibrationSettings, context: CalibrationContext,
    rng: np.random.Generator,
) -> tuple[HeldOutScores | None, list[str]]:  # fmt: skip
    """Score every candidate on a validation set, matched under the richest camera, or by cross-validation."""
    if validation is None:
        found = cross_validate(fits, candidates, rng)
        return found, [] if found else ["One frame alone leaves nothing to hold out: give a validation set."]
    inside, words = _read(validation, fits.sensor, " in the validation set")
    matched = _matched_under(inside, fits, richest, catalogue, settings, context)
    if matched.problem.arcs.n_exposures == 0:
        raise RefusedInputError(
            "No exposure of the validation set has four stars that can be used: choose another set."
        )
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
    return Leftover(found.test.p, float(size[at]), float(np.sqrt(max(towards @ C @ towards, 0.0))))
