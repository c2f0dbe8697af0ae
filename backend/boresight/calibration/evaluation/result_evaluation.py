"""Evaluating a finished calibration: matching, flight scores, shadow mode, alignment, trust, validation.

Each is one object of the calibration JSON. Flight scores are kept under `evaluation` for the calibration set and under
`validation` for the set that took no part; `shadow` holds both sets side by side, frame by frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.evaluation import bootstrap
from boresight.calibration.evaluation.alignment import alignment_view
from boresight.calibration.evaluation.evaluate import evaluate_matched_frames
from boresight.calibration.evaluation.shadow import shadow_view
from boresight.calibration.frames.frame_observability import frame_observability
from boresight.calibration.matching.cycles import CyclesEnd
from boresight.calibration.matching.match_report import identification_advice, matching_view, names_advice
from boresight.calibration.matching.matched import Dataset, Matched
from boresight.calibration.matching.matched_frames import apply_flight_check
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.trust import trust_advice, trust_view
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor


def evaluate_result(
    document: dict[str, Any],
    sets: Dataset,
    first: Matched,
    ended: CyclesEnd,
    parameters: Parameters,
    settings: CalibrationSettings,
) -> None:
    """Add everything that the calibration set says of its own result to the document."""
    telemetry, sensor, estimate = sets.telemetry, sets.sensor, ended.estimate
    if estimate.status == "diverged":
        return
    evaluation, document["shadow"]["calibration"] = _flown(sets, first, ended.matched, estimate.x, settings)
    document["evaluation"] = evaluation
    document["matching"] = matching_view(telemetry, sensor, ended, evaluation)
    if document["matching"] is not None:
        document["advice"] += names_advice(document["matching"]["given"], document["matching"]["kept"])
    P = parameters.full_covariance(estimate.P, n=len(estimate.x))
    document["alignment"] = alignment_view(ended.matched.problem, sensor.initial, estimate.x, P)
    problem, matched = ended.matched.problem, ended.matched.telemetry
    document["frame_observability"] = frame_observability(problem, parameters, estimate)
    document["trust"] = trust_view(problem, parameters, settings, estimate, matched, sets.catalogue)
    document["advice"] += trust_advice(document["trust"])
    if document["robust"] is not None:
        document["advice"].append(document["robust"]["sentence"])


def validate(
    document: dict[str, Any],
    telemetry: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    estimate: Estimate,
    parameters: Parameters,
    settings: CalibrationSettings,
    cache_folder: Path | None,
) -> None:
    """Judge an estimate on a set that took no part; adds its sentence to the advice."""
    held_out = Dataset(telemetry, sensor, catalogue, parameters, settings, cache_folder)
    first, last = held_out.at_start(), held_out.at_covariance(estimate.x, estimate.P)
    if last.problem.arcs.n_exposures == 0:
        document["advice"] += identification_advice(last.unidentified)
        document["advice"].append(
            f"The validation set has no exposure with {settings.minimum_stars} usable stars: nothing was checked by it."
        )
        return
    verdict, document["shadow"]["validation"] = _flown(held_out, first, last, estimate.x, settings)
    document["validation"] = verdict
    document["advice"] += _of_validation(verdict)


def _flown(
    sets: Dataset, first: Matched, last: Matched, x: FloatArray, settings: CalibrationSettings
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Flight scores of a set with intervals, and its shadow: as matched first under the sensor's parameters, and last under x."""
    telemetry, sensor = sets.telemetry, sets.sensor
    initial = apply_flight_check(telemetry, sensor, first.matches, sensor.initial, settings)
    final = apply_flight_check(telemetry, sensor, last.matches, x, settings)
    rng = np.random.default_rng(bootstrap.SEED)
    scores = evaluate_matched_frames(telemetry, sensor, initial, final, settings, rng, last.problem.whitened(x).whole())
    return scores, shadow_view(telemetry, initial, final)


def _of_validation(verdict: dict[str, Any]) -> list[str]:
    """Sentences on what the held-out set says."""
    rms, availability = verdict["rms_arc_rad"], verdict["availability"]
    sentences = []
    if rms["final"] is not None and rms["initial"] is not None and rms["final"] >= rms["initial"]:
        sentences.append(
            f"On the validation set the new parameters are no better than the old ({rms['final'] * 1e6:.1f} against "
            f"{rms['initial'] * 1e6:.1f} urad): do not promote them without knowing why."
        )
    if availability["final"] < availability["initial"]:
        sentences.append(
            f"On the validation set fewer frames would give an attitude than before ({availability['final']:.1%} against "
            f"{availability['initial']:.1%}): look at the frames that would be lost."
        )
    return sentences
