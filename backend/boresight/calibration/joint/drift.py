"""Process noise from the data: how far each parameter drifts, by maximum likelihood over the stretches of a set.

A filter needs to be told how far parameters step, and nobody knows it before the camera was seen at several times. Frames that
follow one another within `GAP_HOURS` are a stretch: a pass of a joint calibration, or one of several in a file. From
`FEWEST_STRETCHES` on, every free parameter walks from the middle of a stretch to the next by a drift of its own, typical sigmas a
square root of a day, which is estimated with its interval as that of `--vary-as walk` (`estimation.walk`), and the filter then adds
it by the time between its frames. Fewer have as many steps as drifts, or less, and no interval would end.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from boresight.arrays import FloatArray, to_days
from boresight.calibration.estimate import Asked, Drift, Parameters
from boresight.calibration.joint.passes_fit import PassesProblem
from boresight.calibration.joint.variation import FIRST_WALK, fit_walk
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.calibration.process_noise import FEWEST_STRETCHES, GAP_HOURS
from boresight.calibration.telemetry_pieces import TelemetryInput
from boresight.estimation.walk import link_by_walk
from boresight.telemetry.schema import Telemetry

HOURS = 24.0


def shows_drift(telemetry: TelemetryInput) -> bool:
    """Whether a set has as many stretches with times as an estimate of drift takes; reads it once."""
    before, stretches = np.nan, 0
    for part in [telemetry] if isinstance(telemetry, Telemetry) else telemetry.chunks():
        if part.time_utc is None:
            return False
        days = to_days(part.time_utc)
        days = days[np.isfinite(days)]
        if not len(days):
            continue
        passed = np.diff(days, prepend=before)
        stretches += int(np.count_nonzero(~(passed < GAP_HOURS / HOURS)))
        before = float(days[-1])
    return stretches >= FEWEST_STRETCHES


def find_stretches(days: FloatArray) -> list[tuple[int, int]]:
    """Return the places of each stretch among frames with these times (n_frames,), days."""
    known = np.flatnonzero(np.isfinite(days))
    gaps = np.flatnonzero(np.diff(days[known]) >= GAP_HOURS / HOURS)
    edges = [0, *known[gaps + 1].tolist(), len(days)]
    return list(pairwise(edges))


def estimate_drift(
    problem: Problem, parameters: Parameters, x: FloatArray, settings: CalibrationSettings, cancelled: Asked
) -> Drift | None:
    """Estimate the drift of every free parameter from x (n_parameters,) for all; None where the frames do not show it."""
    if problem.time_utc is None:
        return None
    days = to_days(problem.time_utc)
    ends = find_stretches(days)
    if len(ends) < FEWEST_STRETCHES:
        return None
    middles = np.array([np.nanmean(days[first:last]) for first, last in ends])
    own, between = np.arange(len(parameters.free)), np.diff(middles)
    of = PassesProblem(problem, (), parameters, x, settings, cancelled, ends)
    try:
        _, walk = fit_walk(of, between, own, of.fit(link_by_walk(own, between, np.full(len(own), FIRST_WALK))))
    except np.linalg.LinAlgError:  # all of them leave a direction open
        return None
    return Drift(walk.sigma, "day", "estimated", walk.low, walk.high, len(ends))
