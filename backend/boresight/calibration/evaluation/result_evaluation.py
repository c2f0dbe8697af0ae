"""Evaluating a finished calibration: matching, flight scores, shadow mode, alignment, trust, validation.

Each is one object of the calibration JSON. Flight scores are kept under `evaluation` for the calibration set and under
`validation` for the set that took no part; `shadow` holds both sets side by side, frame by frame.

`frame_observability` tells what single frames can say under each reference (W section 3.3, Figures 3 and 4), and what each holds
of all there is; `estimation.statistics.references` derives both. Of every frame the smallest singular value of H' = H W is kept,
under Models 1 to 4 with sigma_2 and sigma_3, and under Model 4 with each singular value alone; null where a frame does not
determine all free parameters. It says how far the measurements move and not how well they are known, so beside it stands the
information of each reference, whitened by its full covariance: per parameter the variance of the Cramer-Rao bound over the
reference's own, and of these the geometric mean. A parameter that a reference leaves open has none.

Both cost a decomposition a frame, so they are taken on frames spaced evenly over the set: at most `MOST_FRAMES`, and fewer where
exposures are full: up to 60 stars the cost of an exposure was found to grow as their square.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray
from boresight.calibration.advice_kinds import Advice, make_advice
from boresight.calibration.calibration import (
    Calibration,
    Evaluation,
    FrameObservability,
    Matching,
    ReferenceInformation,
    RemovedOf,
    ShadowOfSet,
)
from boresight.calibration.estimate import Asked, Estimate, Parameters
from boresight.calibration.evaluation import bootstrap
from boresight.calibration.evaluation.alignment import alignment_view
from boresight.calibration.evaluation.evaluate import evaluate_matched_frames, shadow_view
from boresight.calibration.matching.match_report import (
    CyclesEnd,
    list_refused_names,
    matching_view,
    names_advice,
)
from boresight.calibration.matching.matched import Dataset, Matched
from boresight.calibration.matching.matched_frames import apply_flight_check
from boresight.calibration.matching.rematch import Matches
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem, whiten_at
from boresight.calibration.trust import cause_advice, judge_trust, trust_advice
from boresight.calibration.trust.fitted_set import chosen, nested
from boresight.calibration.trust.misfit import misfit_advice
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import determined, normal_equations
from boresight.estimation.executor import refuse_cancelled
from boresight.estimation.singular_values import CHOSEN, STAR_MODELS, VALUES, Selection
from boresight.estimation.statistics.cramer_rao import centroid_rows
from boresight.estimation.statistics.references import EvaluationPoint, information_of_pairs, judged, relative, seen
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

MOST_FRAMES = 150
#: Sum of the squared numbers of stars over the exposures that are taken.
MOST_SQUARES = 8e4
#: Subsets of the three singular values whose information is told of Model 4, beside the models' own.
SUBSETS = ((1,), (2,), (3,), (1, 2, 3))
#: What is told of singular values: name in the document, and model with values.
REFERENCES = {f"model_{model}": Selection(model, CHOSEN.values) for model in STAR_MODELS} | {
    "sigma_" + "".join(map(str, values)): Selection(CHOSEN.model, values) for values in SUBSETS
}
SELECTIONS = tuple(dict.fromkeys(REFERENCES.values()))
#: Those of which every frame is told.
TOLD = ([Selection(model, CHOSEN.values) for model in STAR_MODELS], [Selection(CHOSEN.model, (k,)) for k in VALUES])
#: Smallest singular values below it are rounding: the values that are measured are of order one, their slopes at most that.
ROUNDING = 1e-12
#: Shares less than this apart are the same.
ADDS_NOTHING = 0.005


def frame_observability(problem: Problem, parameters: Parameters, estimate: Estimate) -> FrameObservability:
    """Judge single frames and references at the estimate."""
    arcs = whiten_at(chosen(problem.arcs.whole(), _taken(problem.arcs.whole())), problem.camera, estimate.x)
    view = EvaluationPoint(problem.camera, estimate.x, parameters.free, parameters.scale)
    runs = seen(view, arcs)
    untold = [selection for selection in SELECTIONS if not any(selection in told for told in TOLD)]
    smallest, of_selection = judged(view, runs, SELECTIONS, untold)
    of_frames, information_of = (
        dict(zip(SELECTIONS, smallest, strict=True)),
        dict(zip(SELECTIONS, of_selection, strict=True)),
    )
    models, values = (_known([of_frames[selection] for selection in told]) for told in TOLD)
    names = [*(f"model_{model}" for model in STAR_MODELS), *(f"sigma_{k}" for k in VALUES)]
    curves = zip(names, (*models, *values), strict=True)
    held = {name: information_of[selection] for name, selection in REFERENCES.items()}
    held = {"angular": information_of_pairs(view, runs)} | held
    information = _information(view, arcs, held, [problem.camera.parameter_names[p] for p in parameters.free])
    return FrameObservability(
        frame=arcs.frame.tolist(),
        frames_used=arcs.n_frames,
        frames=problem.arcs.n_frames,
        minimum_singular_value={name: nested(curve) for name, curve in curves},
        information=information,
        sentence=_sentence(information, models),
    )


def _taken(arcs: ArcSet) -> NDArray[np.bool_]:
    squares = np.sum(np.diff(arcs.star_start).astype(float) ** 2)
    n = arcs.n_frames
    most = int(np.clip(MOST_SQUARES / squares * n, 1, MOST_FRAMES))
    taken = np.zeros(n, np.bool_)
    taken[np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int))] = True
    return taken


def _known(smallest: list[FloatArray]) -> FloatArray:
    """Curves (n_curves, n_frames) from smallest singular values, (n_frames,) each, NaN where not all is determined."""
    curves = np.stack(smallest)
    return np.where(curves > ROUNDING, curves, np.nan)


def _information(
    view: EvaluationPoint, arcs: ArcSet, held: dict[str, FloatArray], names: list[str]
) -> list[ReferenceInformation]:
    """Every reference beside the bound; empty where these frames leave a parameter open whatever the reference."""
    try:
        bound = centroid_rows(view.camera, view.x, arcs, view.free, view.scale).information
    except np.linalg.LinAlgError:
        return []
    if not np.isfinite(bound).all() or not determined(bound)[2].all():
        return []
    held = {"arcs": normal_equations(arcs, view.x, view.free, view.scale).A} | held
    return [_share(name, relative(A, bound), names) for name, A in held.items()]


def _share(reference: str, shares: FloatArray, names: list[str]) -> ReferenceInformation:
    """Put a reference's shares (n_free,) into two numbers."""
    if not (shares > 0).all():
        return ReferenceInformation(reference=reference, share=None, least_share=None, least=None)
    least = int(np.argmin(shares))
    share = float(np.exp(np.mean(np.log(shares))))
    return ReferenceInformation(reference=reference, share=share, least_share=float(shares[least]), least=names[least])


def _sentence(information: list[ReferenceInformation], models: FloatArray) -> str:
    """Say in words what the references hold, and what W's measure makes of the models (4, n_frames)."""
    if not information:
        return "These frames do not determine one direction of the parameters, so there is no bound: hold a parameter fixed."
    share = {entry.reference: entry.share for entry in information}
    of_models = ", ".join(f"{_percent(share[f'model_{model}'])} under Model {model}" for model in STAR_MODELS)
    return (
        f"Share of the information in these centroids that is retained: arcs {_percent(share['arcs'])}, all pairs "
        f"{_percent(share['angular'])}, σ2 and σ3 {of_models}; "
        f"{_say_first_value(share['model_4'], share['sigma_123'])}.{_say_measure(models)}"
    )


def _say_first_value(without: float | None, with_it: float | None) -> str:
    if without is not None and with_it is not None and with_it - without < ADDS_NOTHING:
        return "σ1 adds nothing to them"
    return f"with σ1 added, {_percent(with_it)} under Model 4"


def _say_measure(models: FloatArray) -> str:
    measured = models[:, np.isfinite(models).any(axis=0)]
    if not measured.size:
        return " No frame alone determines all free parameters."
    firsts = np.bincount(np.nanargmax(measured, axis=0), minlength=len(STAR_MODELS)) / measured.shape[1]
    first = int(np.argmax(firsts))
    share = f"{100 * firsts[first]:.0f} % of the frames"
    return f" Model {STAR_MODELS[first]} has the largest minimum singular value in {share}."


def _percent(share: float | None) -> str:
    """Write a share, or say that there is none; above one it is the isotropic error of `arcs`, and one is meant."""
    return "too little to determine all" if share is None else f"{100 * min(share, 1.0):.0f} %"


def evaluate_result(
    calibration: Calibration,
    sets: Dataset,
    first: Matched,
    ended: CyclesEnd,
    parameters: Parameters,
    settings: CalibrationSettings,
    cancelled: Asked,
) -> Calibration:
    """Add everything that the calibration set says of its own result; raises CancelledError when `cancelled` says so."""
    telemetry, sensor, estimate = sets.telemetry, sets.sensor, ended.estimate
    evaluation, shadow = _flown(sets, first, ended.matched, estimate.x, settings)
    refuse_cancelled(cancelled, "after the flight scores")
    matching = matching_view(telemetry, sensor, ended, evaluation)
    P = parameters.full_covariance(estimate.P, n=len(estimate.x))
    problem, matched = ended.matched.problem, ended.matched.telemetry
    judged = judge_trust(
        problem, parameters, settings, estimate, matched, sets.catalogue, calibration.minima, cancelled
    )
    return with_advice(
        replace(
            calibration,
            advice=[*cause_advice(judged.trust, judged.causes), *calibration.advice],
            evaluation=evaluation,
            shadow=replace(calibration.shadow, calibration=shadow),
            matching=matching,
            **_refused_names(telemetry, ended.matched, matching),
            alignment=alignment_view(problem, sensor.initial, estimate.x, P),
            frame_observability=frame_observability(problem, parameters, estimate),
            trust=judged.trust,
            tests=judged.tests,
            causes=judged.causes,
            sigma_with_misfit=judged.sigma_with_misfit,
            misfit=judged.misfit,
        ),
        *([] if matching is None else names_advice(matching.given, matching.kept)),
        *trust_advice(judged.trust, calibration.coverage),
        *misfit_advice(judged.misfit),
        *([] if calibration.robust is None else [Advice(calibration.robust.sentence, "robust")]),
    )


def _refused_names(telemetry: Telemetry, matched: Matched, matching: Matching | None) -> dict[str, Any]:
    """What a calibration lists of given stars that matching refused; nothing where given stars are verified instead."""
    if matching is None or not isinstance(matched.matches, Matches):
        return {}
    of = RemovedOf(proposed=matching.given, removed=matching.removed)
    return {"removed": list_refused_names(telemetry, matched.matches), "removed_of": of}


def with_advice(calibration: Calibration, *sentences: Advice) -> Calibration:
    """Add sentences to the advice."""
    return replace(calibration, advice=[*calibration.advice, *sentences])


def validate(
    calibration: Calibration,
    telemetry: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    estimate: Estimate,
    parameters: Parameters,
    settings: CalibrationSettings,
    cache_folder: Path | None,
) -> Calibration:
    """Judge an estimate on a set that took no part; adds its sentence to the advice."""
    validation = Dataset(telemetry, sensor, catalogue, parameters, settings, cache_folder)
    last = validation.at_covariance(estimate.x, estimate.P)
    first = last if validation.is_given else validation.at_start()
    if last.problem.arcs.n_exposures == 0:
        return with_advice(
            calibration,
            Advice(
                f"The validation set has no exposure with {settings.minimum_stars} usable stars: nothing was validated.",
                "validation_rms",
            ),
        )
    scores, shadow = _flown(validation, first, last, estimate.x, settings)
    judged = replace(calibration, validation=scores, shadow=replace(calibration.shadow, validation=shadow))
    return with_advice(judged, *_advise_on_validation(scores))


def _flown(
    sets: Dataset, first: Matched, last: Matched, x: FloatArray, settings: CalibrationSettings
) -> tuple[Evaluation, ShadowOfSet]:
    """Flight scores of a set with intervals, and its shadow: as matched first under the sensor's parameters, and last under x."""
    telemetry, sensor = sets.telemetry, sets.sensor
    initial = apply_flight_check(telemetry, sensor, first.matches, sensor.initial, settings)
    final = apply_flight_check(telemetry, sensor, last.matches, x, settings)
    rng = np.random.default_rng(bootstrap.SEED)
    scores = evaluate_matched_frames(telemetry, sensor, initial, final, settings, rng, last.problem.whitened(x).whole())
    return scores, shadow_view(telemetry, initial, final)


def _advise_on_validation(scores: Evaluation) -> list[Advice]:
    rms, availability = scores.rms_arc_rad, scores.availability
    sentences = []
    if rms.final is not None and rms.initial is not None and rms.final >= rms.initial:
        sentences.append(
            f"On the validation set the new parameters are no better than the old ({rms.final * 1e6:.1f} against "
            f"{rms.initial * 1e6:.1f} µrad): find out why before you promote them."
        )
    if (
        availability.final is not None
        and availability.initial is not None
        and availability.final < availability.initial
    ):
        sentences.append(
            f"On the validation set fewer frames would give an attitude than before ({availability.final:.1%} against "
            f"{availability.initial:.1%}): check the frames that would be lost."
        )
    return make_advice("validation_rms", sentences)
