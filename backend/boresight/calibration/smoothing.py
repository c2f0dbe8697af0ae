"""The smoother beside a filter's run: the same model of change, every frame of the set, and the matches that the run ended with.

Every frame is an update of its own here, where a filter pools the first, and rows are those of arcs whatever the filter measured.
So it is the least-squares problem of the whole set with steps between frames (`estimation.smoother`), and the filter's end is its
last state but for where the filter linearised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.arrays import FloatArray, known_or_none
from boresight.calibration.calibration import Smoothed
from boresight.calibration.estimate import WHITENING_ROUNDS, Asked, Estimate, Parameters
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.calibration.process_noise import FrameSteps, choose_drift, free_names
from boresight.calibration.result import kept_points, numbers, written_times
from boresight.estimation.smoother import SmoothedFrames, smooth


@dataclass(frozen=True)
class SmoothedSet:
    """A smoothed set: `states` and `sigma` (n_frames, n_parameters), SI, NaN where a parameter is held, and how it was found."""

    states: FloatArray
    sigma: FloatArray
    found: SmoothedFrames


def smooth_set(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, x: FloatArray, cancelled: Asked
) -> SmoothedSet:
    """Smooth over a problem's frames from a filter's end x (n_parameters,), weights taken at the last state."""
    free, scale, n_frames = parameters.free, parameters.scale, problem.arcs.n_frames
    drift = choose_drift(parameters, free_names(problem, parameters), settings)
    q = FrameSteps(problem, drift).take(problem.arcs.frame)
    start = parameters.start(problem.sensor.initial, settings)
    for _ in range(WHITENING_ROUNDS):
        found = smooth(problem.whitened(x), start, free, scale, q, x, cancelled)
        x = start.x.copy()
        x[free] += scale * (found.z[-1] - start.z)
    states, sigma = np.tile(start.x, (n_frames, 1)), np.full((n_frames, len(start.x)), np.nan)
    states[:, free] += scale * (found.z - start.z)
    sigma[:, free] = scale * found.sigma
    return SmoothedSet(states, sigma, found)


def describe_smoothed(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, estimate: Estimate, cancelled: Asked
) -> Smoothed:
    """Smooth over a set, and keep as many frames of it as a history keeps."""
    of_set = smooth_set(problem, parameters, settings, estimate.x, cancelled)
    kept = kept_points(problem.arcs.n_frames, problem.arcs.n_frames)
    frame = problem.arcs.frame[kept]
    found = of_set.found
    return Smoothed(
        frame=frame.tolist(),
        time_utc=written_times(problem, frame),
        parameters=numbers(of_set.states[kept]),
        sigma=numbers(of_set.sigma[kept]),
        chi2=known_or_none(found.chi2),
        settled=found.settled,
        sentence=_sentence(of_set, estimate, parameters),
    )


def _sentence(of_set: SmoothedSet, estimate: Estimate, parameters: Parameters) -> str:
    n_frames = len(of_set.states)
    if not of_set.found.settled:
        return (
            f"The smoother did not converge over {n_frames:,} frames: do not use it; specify less drift or a closer starting "
            "point."
        )
    said = f"Parameters at {n_frames:,} frames given all of them"
    if not estimate.history:
        return f"{said}."
    middle = estimate.history.taken(np.array([len(estimate.history) // 2]))
    ratio = of_set.sigma[n_frames // 2, parameters.free] / (middle["sigmas"][0] * parameters.scale)
    return f"{said}: in the middle of the set the sigmas are {np.median(ratio):.2f} of the filter's."
