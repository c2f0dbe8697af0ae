"""The one function that calibrates: problem and method in, the contract's JSON out.

The steps, and what is timed: `arcs` (directions, ordering), `fit` (estimator with its weights), `evaluate_result` (statistics,
views), `validate`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from boresight.calibration import result
from boresight.calibration.dataset import CalibrationContext, choose_match_mode, open_dataset, open_validation_set
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.evaluation.result_evaluation import evaluate_result, validate
from boresight.calibration.matching.cycles import CyclesEnd, filter_set, fit_in_cycles
from boresight.calibration.matching.match_report import identification_advice
from boresight.calibration.matching.matched import Dataset
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.calibration.progress_reports import Progress, ProgressReporter
from boresight.calibration.source import StoredTable, TelemetryFile, is_large
from boresight.calibration.streaming.sample import JUDGED_STARS
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.executor import Executor
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

__all__ = ["Progress", "calibrate", "choose_match_mode", "select_free_parameters"]


def calibrate(  # noqa: PLR0913 - what is calibrated, and seven choices of the caller by name
    telemetry: Telemetry | TelemetryFile | StoredTable,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings,
    *,
    validation: Telemetry | TelemetryFile | StoredTable | None = None,
    sha256s: Mapping[str, str] | None = None,
    report: Callable[[Progress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
    cache_folder: Path | None = None,
    scratch_folder: Path | None = None,
    spread: Executor | None = None,
) -> dict[str, Any]:
    """Estimate a sensor's parameters from a telemetry set.

    Parameters
    ----------
    telemetry, sensor, catalogue
        The data, whose they are, and where directions come from that the data do not give. A large file is never in memory.
    settings
        Method and choices.
    validation
        A set that takes no part in the estimate, to check it by.
    sha256s
        Content addresses of the input files by role, kept in the result.
    report
        Told of progress, about four times a second.
    cancelled
        Asked often; True stops.
    cache_folder
        Where lost-in-space identification keeps its tables; None makes them anew when they are needed.
    scratch_folder
        Where the working copy of a large file is made, in a folder that is gone at the end; None is the temporary folder.
    spread
        What computes over a large file; None is this process. It must see the scratch folder under the same path.

    Returns
    -------
    The calibration JSON of the contract as plain lists, numbers and null. A numeric failure is its `status` with `advice`.

    Raises
    ------
    RefusedInputError
        When the free parameters are not the sensor's, too many matched stars lie off its detector, or directions cannot be had.
    CancelledError
        When `cancelled` said so.
    """
    clock = _Timer()
    parameters = select_free_parameters(sensor, settings)
    place = CalibrationContext(cancelled or _never, report, cache_folder, scratch_folder, spread)
    with open_dataset(telemetry, sensor, catalogue, parameters, settings, place) as (sets, off):
        document, ended = _calibrated(sets, parameters, sets.settings, sha256s or {}, place, clock)
    document["stars_off_detector"] = off.document()
    document["advice"] += off.sentences()
    if validation is not None and ended is not None and ended.estimate.status != "diverged":
        judged, off = open_validation_set(validation, sensor, JUDGED_STARS)
        chosen = choose_match_mode(judged, settings)
        validate(document, judged, sensor, catalogue, ended.estimate, parameters, chosen, cache_folder)
        document["advice"] += off.sentences(" in the validation set")
        if is_large(validation):
            frames = len(np.unique(judged.frame))
            document["advice"].append(
                f"The validation set is large: {frames:,} of its frames, evenly spread, were looked at."
            )
        clock.lap("validate")
    if ended is not None:
        document["timing_s"] = clock.laps | {"method": ended.method_s}
    return document


def _calibrated(
    sets: Dataset,
    parameters: Parameters,
    settings: CalibrationSettings,
    sha256s: Mapping[str, str],
    place: CalibrationContext,
    clock: _Timer,
) -> tuple[dict[str, Any], CyclesEnd | None]:
    """Estimate and judge; returns the document, and where it ended, None where there was nothing to estimate from."""
    first = sets.at_start()
    clock.lap("arcs")
    if first.problem.arcs.n_exposures == 0:
        document = result.nothing_estimated(first.problem, parameters, settings, sha256s)
        document["advice"] = [*identification_advice(first.unidentified), *document["advice"]]
        return document, None
    listener = ProgressReporter(first.problem, parameters, settings, sha256s, place.report, sets.prepared)
    run = filter_set if settings.sequential else fit_in_cycles
    ended = run(sets, first, parameters, settings, listener, place.cancelled)
    ended = replace(ended, estimate=_checked(ended.matched.problem, ended.estimate))
    clock.lap("fit")
    document = result.document(ended.matched.problem, parameters, settings, ended.estimate, sha256s)
    if ended.estimate.status != "diverged":
        judged = sets.judged(first, ended.matched)
        evaluate_result(document, judged.sets, judged.first, ended.judged_by(judged.last), parameters, settings)
        _say_what_was_judged(document, judged.last.problem)
        document["advice"] += identification_advice(ended.matched.unidentified)
    clock.lap("judge")
    return document, ended


def _say_what_was_judged(document: dict[str, Any], judged: Problem) -> None:
    """Say of a set too large to be judged whole what was."""
    if judged.arcs.n_frames == document["frames"]:
        return
    document["judged_on"] = {
        "frames": judged.arcs.n_frames,
        "stars": judged.arcs.n_stars,
        "of_frames": document["frames"],
    }
    document["advice"].append(
        f"Flight scores, shadow, alignment and trust are judged on {judged.arcs.n_frames:,} of {document['frames']:,} frames, "
        "whole stretches evenly spread over the set; estimate, sigmas, chi-square, RMS and coverage are of all of them."
    )


def _never() -> bool:
    """Nobody cancels."""
    return False


def select_free_parameters(sensor: Sensor, settings: CalibrationSettings) -> Parameters:
    """Places and scales of the free parameters, in parameter order."""
    names = CAMERA_MODELS[sensor.camera_model].parameter_names
    wanted = sensor.free if settings.free is None else settings.free
    for name in wanted:
        if name not in names:
            raise RefusedInputError(
                f"Parameter {name!r} is not one of the camera model {sensor.camera_model}: choose from {', '.join(names)}."
            )
    free = np.array([place for place, name in enumerate(names) if name in wanted], dtype=np.int64)
    return Parameters(free, sensor.typical_sigma[free])


def _checked(problem: Problem, estimate: Estimate) -> Estimate:
    """Call an estimate diverged when a parameter left the range of what can be, or part of the detector has no direction."""
    low, high = np.array(problem.camera.plausible).T
    inside = np.isfinite(estimate.x).all() and bool(np.all((low <= estimate.x) & (estimate.x <= high)))
    sensor = problem.sensor
    if inside and problem.camera.blind_corner(estimate.x, sensor.rows, sensor.columns, sensor.pixel_pitch_m) is None:
        return estimate
    return replace(estimate, status="diverged")


class _Timer:
    """Seconds spent, lap by lap."""

    def __init__(self) -> None:
        self._last = time.perf_counter()
        self.laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """Book the time since the last lap under a name."""
        now = time.perf_counter()
        self.laps[name], self._last = now - self._last, now
