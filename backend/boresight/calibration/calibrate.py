"""The one function that calibrates: problem and method in, the contract's JSON out.

The steps, and what is timed: `arcs` (directions, ordering), `fit` (estimator with its weights), `judge` (statistics, views),
`validate`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from boresight.calibration import result
from boresight.calibration.cycles import filter_set, fit_in_cycles
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.judgement import judge, validate
from boresight.calibration.matched import MatchedSet
from boresight.calibration.problem import Problem
from boresight.calibration.settings import CalibrationSettings
from boresight.errors import RefusedInputError
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.detector import check_against_sensor
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

#: Seconds between two progress reports with a partial result.
REPORT_EVERY_S = 0.25
#: Most of the time that may go into reports, for on a long set each costs many passes over it.
REPORT_SHARE = 0.2


@dataclass(frozen=True)
class Progress:
    """How far a calibration is.

    Parameters
    ----------
    fraction
        0 to 1.
    message
        One line for a log.
    partial
        The calibration JSON so far with status `running` and `frames_done`, how many frames a filter has taken in, which is
        None for a batch; or None between two of them.
    """

    fraction: float
    message: str
    partial: dict[str, Any] | None


def calibrate(  # noqa: PLR0913 - what is calibrated, and five choices of the caller by name
    telemetry: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings,
    *,
    validation: Telemetry | None = None,
    sha256s: Mapping[str, str] | None = None,
    report: Callable[[Progress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
    cache_folder: Path | None = None,
) -> dict[str, Any]:
    """Estimate a sensor's parameters from a telemetry set.

    Parameters
    ----------
    telemetry, sensor, catalogue
        The data, whose they are, and where directions come from that the data do not give.
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

    Returns
    -------
    The calibration JSON of the contract as plain lists, numbers and null. A numeric failure is its `status` with `advice`.

    Raises
    ------
    RefusedInputError
        When the free parameters are not the sensor's, matched stars lie off its detector, or directions cannot be had.
    CancelledError
        When `cancelled` said so.
    """
    clock = _Stopwatch()
    parameters = parameters_of(sensor, settings)
    check_against_sensor(telemetry, sensor)
    settings = matchable(telemetry, settings)
    sets = MatchedSet(telemetry, sensor, catalogue, parameters, settings, cache_folder)
    first = sets.at_start()
    clock.lap("arcs")
    if first.problem.arcs.n_exposures == 0:
        return result.nothing_estimated(first.problem, parameters, settings, sha256s or {})
    listener = _Listener(first.problem, parameters, settings, sha256s or {}, report)
    run = filter_set if settings.sequential else fit_in_cycles
    ended = run(sets, first, parameters, settings, listener, cancelled or _never)
    ended = replace(ended, estimate=_checked(ended.matched.problem, ended.estimate))
    clock.lap("fit")
    document = result.document(ended.matched.problem, parameters, settings, ended.estimate, sha256s or {})
    judge(document, sets, first, ended, parameters, settings)
    clock.lap("judge")
    if validation is not None and ended.estimate.status != "diverged":
        held_out = matchable(validation, settings)
        validate(document, validation, sensor, catalogue, ended.estimate, parameters, held_out, cache_folder)
        clock.lap("validate")
    document["timing_s"] = clock.laps | {"method": ended.method_s}
    return document


def matchable(telemetry: Telemetry, settings: CalibrationSettings) -> CalibrationSettings:
    """Let the matches of a file stand that gives directions but names no stars: there is nothing to match them with."""
    if telemetry.star_id is None and telemetry.ra_rad is not None:
        return replace(settings, match="given")
    return settings


def _never() -> bool:
    """Nobody cancels."""
    return False


def parameters_of(sensor: Sensor, settings: CalibrationSettings) -> Parameters:
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


class _Stopwatch:
    """Seconds spent, lap by lap."""

    def __init__(self) -> None:
        self._last = time.perf_counter()
        self.laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """Book the time since the last lap under a name."""
        now = time.perf_counter()
        self.laps[name], self._last = now - self._last, now


class _Listener:
    """Turns estimates on their way into progress reports with a partial result, as often as is worth it."""

    def __init__(
        self,
        problem: Problem,
        parameters: Parameters,
        settings: CalibrationSettings,
        sha256s: Mapping[str, str],
        report: Callable[[Progress], None] | None,
    ) -> None:
        self._of = (problem, parameters, settings)
        self._sha256s = sha256s
        self._report = report
        self._due = 0.0

    def __call__(self, estimate: Estimate, fraction: float, message: str) -> None:
        """Report one estimate when it is time to."""
        began = time.perf_counter()
        if self._report is None or began < self._due:
            return
        partial = result.document(*self._of, estimate, self._sha256s) | {"frames_done": self._frames_done(estimate)}
        self._report(Progress(fraction, message, partial))
        ended = time.perf_counter()
        self._due = ended + max(REPORT_EVERY_S, (ended - began) / REPORT_SHARE)

    def _frames_done(self, estimate: Estimate) -> int | None:
        """Count the frames of the set up to the last that a filter took in; its first update may be of several."""
        if estimate.updated is None or not len(estimate.updated):
            return None
        return int(np.searchsorted(self._of[0].arcs.frame, estimate.updated[-1], side="right"))
