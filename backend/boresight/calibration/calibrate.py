"""The one function that calibrates: problem and method in, the contract's JSON out.

The steps, and what is timed: `arcs` (directions, ordering), `fit` (estimator with its weights), `judge` (statistics, views),
`validate`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from boresight.calibration import result
from boresight.calibration.estimate import Estimate, Parameters, run_batch, run_sequential
from boresight.calibration.evaluate import evaluate
from boresight.calibration.problem import Problem, build_problem
from boresight.calibration.settings import CalibrationSettings
from boresight.errors import RefusedInputError
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.detector import check_against_sensor
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

#: Seconds between two progress reports with a partial result; each costs a pass over the set.
REPORT_EVERY_S = 0.25


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
        The calibration JSON so far with status `running`, or None between two of them.
    """

    fraction: float
    message: str
    partial: dict[str, Any] | None


def calibrate(
    telemetry: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings,
    *,
    validation: Telemetry | None = None,
    sha256s: Mapping[str, str] | None = None,
    report: Callable[[Progress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
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
    parameters = _parameters(sensor, settings)
    check_against_sensor(telemetry, sensor)
    problem = build_problem(telemetry, sensor, catalogue, settings.minimum_stars)
    clock.lap("arcs")
    if problem.arcs.n_exposures == 0:
        return result.nothing_estimated(problem, parameters, settings, sha256s or {})
    listener = _Listener(problem, parameters, settings, sha256s or {}, report)
    run = run_sequential if settings.sequential else run_batch
    estimate = _checked(problem, run(problem, parameters, settings, listener, cancelled or _never))
    clock.lap("fit")
    document = result.document(problem, parameters, settings, estimate, sha256s or {})
    clock.lap("judge")
    if validation is not None:
        document["validation"] = _validate(validation, problem, estimate, catalogue, settings, document)
        clock.lap("validate")
    document["timing_s"] = clock.laps
    return document


def _never() -> bool:
    """Nobody cancels."""
    return False


def _parameters(sensor: Sensor, settings: CalibrationSettings) -> Parameters:
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
    """Call an estimate diverged when a parameter left the range of what can be."""
    low, high = np.array(problem.camera.plausible).T
    inside = np.isfinite(estimate.x).all() and bool(np.all((low <= estimate.x) & (estimate.x <= high)))
    if inside:
        return estimate
    return Estimate(**{**vars(estimate), "status": "diverged"})


def _validate(
    telemetry: Telemetry,
    problem: Problem,
    estimate: Estimate,
    catalogue: Catalogue,
    settings: CalibrationSettings,
    document: dict[str, Any],
) -> dict[str, Any] | None:
    """Judge the estimate on a set that took no part; adds its sentence to the advice."""
    check_against_sensor(telemetry, problem.sensor)
    held_out = build_problem(telemetry, problem.sensor, catalogue, settings.minimum_stars)
    if held_out.arcs.n_exposures == 0:
        document["advice"].append(
            f"The validation set has no exposure with {settings.minimum_stars} usable stars: nothing was checked by it."
        )
        return None
    verdict = evaluate(held_out, problem.sensor.initial, estimate.x)
    rms = verdict["rms_arc_rad"]
    if not np.isfinite(rms["final"]):
        rms["final"] = None
    elif rms["final"] >= rms["initial"]:
        document["advice"].append(
            f"On the validation set the new parameters are no better than the old ({rms['final'] * 1e6:.1f} against "
            f"{rms['initial'] * 1e6:.1f} urad): do not promote them without knowing why."
        )
    return verdict


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
    """Turns estimates on their way into progress reports, a partial result at most every `REPORT_EVERY_S`."""

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
        if self._report is None or time.perf_counter() < self._due:
            return
        self._report(Progress(fraction, message, result.document(*self._of, estimate, self._sha256s)))
        self._due = time.perf_counter() + REPORT_EVERY_S
