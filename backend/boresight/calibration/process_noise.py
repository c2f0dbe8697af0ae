"""How far parameters step between frames, as filter and smoother take it: by parameter, a frame or by the time that passed.

Drift a frame is what E adds: every frame adds q^2, however long the camera rested. Drift a day is a random walk in time: between
two frames dt days apart it adds q^2 dt, so an hour's gap is not one frame. A frame without a time gets one between those of its
neighbours.

What it does to chi-square. With process noise a filter ends at what its last frames say, x, with a covariance P wider than the
A^-1 of all frames. Over the whole set, whose best fit is x_b,

    chi2(x) = chi2(x_b) + (x - x_b)^T A (x - x_b),        the mean of the second term tr(P A) - n where P holds,

so chi2(x) is above what its degrees of freedom allow although noise, camera and sigmas are sound: tr(P A) is 105 to 250 for the
11 parameters of a decentred camera in 30 frames, and the more, the longer the set. Chi-square at the best fit tells noise and
camera, and it is the one that trust tests.

Which numbers. A person gives them, for all parameters or for some. Where nobody does, they are estimated from the data
(`joint.drift`) if these show the camera at enough times, and are else the usual `USUAL` typical sigmas a frame, which is said.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from boresight.arrays import FloatArray, IntArray, to_days
from boresight.calibration.calibration import Calibration, ProcessNoise, Values
from boresight.calibration.estimate import Drift, Parameters
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.errors import RefusedInputError
from boresight.estimation.arcs import ArcSet

#: Stretches of data, and hours without a frame between two of them, from which drift is estimated where nobody states it.
FEWEST_STRETCHES, GAP_HOURS = 5, 1.0
#: Of a chi-square that process noise explains.
LAST_FRAMES = "it follows the most recent frames, as process noise implies; the best fit of all frames is as expected"
#: By where drift is from.
SOURCES = {
    "given": "as given",
    "usual": "the usual one for every parameter",
    "estimated": "the most likely one of each parameter by {stretches} stretches of data",
}


def parse_drift(texts: tuple[str, ...], names: list[str]) -> dict[str, float]:
    """Read drift by parameter, as f_m=0.5; refuses a parameter that is not among `names`."""
    found: dict[str, float] = {}
    for text in texts:
        name, _, number = text.partition("=")
        if name not in names:
            raise RefusedInputError(f"{name} is not free, so it cannot drift: choose from {', '.join(names)}.")
        found[name] = float(number)
    return found


def choose_drift(parameters: Parameters, names: list[str], settings: CalibrationSettings) -> Drift:
    """Return the drift of a filter's run: estimated where that was done, else as the settings have it; `names` of the free ones."""
    if parameters.drift is not None:
        return parameters.drift
    sigma = np.full(len(names), settings.process_noise)
    if settings.process_noise_of is not None and settings.drifts:
        for name, value in parse_drift(settings.process_noise_of, names).items():
            sigma[names.index(name)] = value
    return Drift(sigma, settings.process_noise_per, "given" if settings.states_drift else "usual")


def free_names(problem: Problem, parameters: Parameters) -> list[str]:
    """Names of the free parameters, in order."""
    return [problem.camera.parameter_names[p] for p in parameters.free]


class FrameSteps:
    """The steps before frames as they come, from drift and the times of a problem's frames."""

    def __init__(self, problem: Problem, drift: Drift) -> None:
        self.drift, self._before = drift, np.nan
        self._frame, self._days = problem.arcs.frame, np.empty(0)
        if drift.per == "frame":
            return
        days = np.full(len(self._frame), np.nan) if problem.time_utc is None else to_days(problem.time_utc)
        known = np.isfinite(days)
        if not known.any():
            raise RefusedInputError("Drift per day requires frame times: add time_utc, or give drift per frame.")
        self._frame, self._days = self._frame[known], days[known]

    def take(self, frame: IntArray) -> FloatArray:
        """Standard deviation of the step before each of the next frames (n,), (n, n_free) typical sigmas."""
        if self.drift.per == "frame":
            return np.tile(self.drift.sigma, (len(frame), 1))
        days = np.interp(frame, self._frame, self._days)
        passed = np.maximum(np.diff(days, prepend=days[:1] if np.isnan(self._before) else self._before), 0.0)
        self._before = float(days[-1])
        return np.asarray(np.sqrt(passed)[:, None] * self.drift.sigma)

    def in_runs(self, arcs: ArcSet) -> Iterator[tuple[ArcSet, FloatArray]]:
        """Cut the next frames where the step changes; yields each part with the step (n_free,) before each of its frames."""
        steps = self.take(arcs.frame)
        ends = [*(np.flatnonzero(np.any(np.diff(steps, axis=0) != 0.0, axis=1)) + 1).tolist(), len(steps)]
        for first, last in zip([0, *ends], ends, strict=False):
            yield arcs.frames(first, last), steps[first]


def explains_chi2(found: Calibration) -> bool:
    """Whether a chi-square above its bounds is only that of a state that follows its last frames, see above."""
    if found.process_noise is None or found.chi2 is None or found.chi2_per_dof is None or found.chi2.upper is None:
        return False
    sound = any(one.name == "chi_square" and not one.noticed for one in found.tests)
    return sound and found.chi2_per_dof > found.chi2.upper


def describe_process_noise(names: list[str], drift: Drift) -> ProcessNoise:
    """Say what process noise a filter had, and where that is from."""
    interval = None
    if drift.low is not None and drift.high is not None:
        ends = zip(names, drift.low.tolist(), drift.high.tolist(), strict=True)
        interval = {name: [low, high] for name, low, high in ends}
    found = ProcessNoise(
        per=drift.per,
        source=drift.source,
        sigma=Values(dict(zip(names, drift.sigma.tolist(), strict=True))),
        interval=interval,
        stretches=drift.stretches,
        sentence="",
    )
    return ProcessNoise(**{**vars(found), "sentence": _sentence(found)})


def _sentence(found: ProcessNoise) -> str:
    unit = "per frame" if found.per == "frame" else "per square root of a day"
    opening = f"Drift in typical sigmas {unit}, {SOURCES[found.source].format(stretches=found.stretches)}"
    if found.interval:
        ends = {name: f" ({low:.2g} to {high:.2g})" for name, (low, high) in found.interval.items()}
        return f"{opening}: {', '.join(f'{name} {value:.2g}{ends[name]}' for name, value in found.sigma.items())}."
    values = set(found.sigma.values())
    listed = f"{values.pop():.3g}" if len(values) == 1 else ", ".join(f"{n} {v:.3g}" for n, v in found.sigma.items())
    if found.source == "given":
        return f"{opening}: {listed}."
    return (
        f"{opening}: {listed}. These data cannot determine it: that requires {FEWEST_STRETCHES} stretches with times, "
        f"{GAP_HOURS:g} h apart. Give more passes, or --process-noise."
    )
