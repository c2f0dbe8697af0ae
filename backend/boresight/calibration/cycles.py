"""Fit, match again, fit: until the matches rest, or three times (E section II-B), and what was matched on the way.

Better parameters find more stars, and more stars better parameters. A cycle is one fit; after it the set is matched
with the result, and when no star changes, the matches rest. A filter that matches with its latest state does the same
frame by frame, and is judged by the set as its end state matches it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.estimate import Asked, Estimate, Listener, Parameters, run_batch
from boresight.calibration.matched import Judged, Matched
from boresight.calibration.problem import AnyProblem
from boresight.calibration.sequence import Frames, ProblemFrames, finished, run_sequential
from boresight.calibration.settings import CalibrationSettings
from boresight.estimation.metrics import rms

MOST_CYCLES = 3


@dataclass(frozen=True)
class Cycle:
    """One fit or one filter run.

    Parameters
    ----------
    cycle
        Its number, from 1.
    matched
        Stars in the arcs it was made from.
    rematched
        Stars that its result matches afterwards.
    changed
        Detections whose star is another, or gone, or new, afterwards.
    rms_arc_rad
        Unweighted RMS of the arcs at its result.
    """

    cycle: int
    matched: int
    rematched: int
    changed: int
    rms_arc_rad: float | None


class AnyMatched(Protocol):
    """A set under one state, in memory or in files."""

    @property
    def problem(self) -> AnyProblem:
        """Its arcs."""

    @property
    def unidentified(self) -> int:
        """Exposures that want the lost-in-space extra, which is not installed."""


class MatchedFrames(Frames, Protocol):
    """Frames that are matched with the state of the filter that takes them; `matching_s` is the processor time that took."""

    matching_s: float


class Renewed(Protocol):
    """A set that can be matched under any state."""

    def at(self, estimate: Estimate, problem: AnyProblem) -> AnyMatched:
        """Match with an estimate made from a problem."""

    def at_covariance(self, x: FloatArray, P: FloatArray) -> AnyMatched:
        """Match with a state and its covariance in typical sigmas."""

    def matched_frames(self) -> MatchedFrames:
        """Its frames for a filter."""

    def changed(self, before: Any, after: Any) -> int:
        """Count the detections whose star differs between two of its matchings."""


class AnySet(Protocol):
    """A set in memory (`MatchedSet`) or in files."""

    @property
    def settings(self) -> CalibrationSettings:
        """How it is matched."""

    @property
    def renewed(self) -> Renewed | None:
        """What matches it under other states; None where the given matches stand."""

    @property
    def prepared(self) -> float:
        """Share of a calibration's progress that making it ready took."""

    def at_start(self) -> AnyMatched:
        """The set under the sensor's own parameters."""

    def judged(self, first: Any, last: Any) -> Judged:
        """What of two of its matchings is judged in memory."""


@dataclass(frozen=True)
class Ended:
    """Where the cycles ended: the set and estimate that belong together, every cycle, and whether the matches rest.

    `method_s` is the processor time of the method alone in its last cycle, matching left out.
    """

    matched: Matched
    estimate: Estimate
    cycles: tuple[Cycle, ...] = ()
    rested: bool = True
    method_s: float = 0.0


@dataclass(frozen=True)
class Cycled:
    """The same of a set that may be in files."""

    matched: AnyMatched
    estimate: Estimate
    cycles: tuple[Cycle, ...] = ()
    rested: bool = True
    method_s: float = 0.0

    def judged_by(self, matched: Matched) -> Ended:
        """Put what is in memory of the set, all or a sample, in its place, and of a filter's updates those that are of it."""
        history, frame = self.estimate.history, matched.problem.arcs.frame
        if history is not None and len(frame) < self.matched.problem.arcs.n_frames:
            history = history.of_frames(frame)
        estimate = replace(self.estimate, history=history)
        return Ended(matched, estimate, self.cycles, self.rested, self.method_s)


def fit_in_cycles(
    sets: AnySet,
    first: AnyMatched,
    parameters: Parameters,
    settings: CalibrationSettings,
    listen: Listener,
    cancelled: Asked,
) -> Cycled:
    """Run the batch estimator until its matches rest."""
    matched, cycles, renewed = first, list[Cycle](), sets.renewed
    while True:
        began = time.thread_time()
        estimate = run_batch(matched.problem, parameters, settings, listen, cancelled)
        method_s = time.thread_time() - began
        if renewed is None or estimate.status == "diverged":
            return Cycled(matched, estimate, tuple(cycles), renewed is None, method_s)
        again = renewed.at(estimate, matched.problem)
        cycles.append(_cycle(len(cycles) + 1, renewed.changed(matched, again), matched, again, estimate))
        rested = cycles[-1].changed == 0
        if rested or len(cycles) == MOST_CYCLES or again.problem.arcs.n_exposures == 0:
            return Cycled(matched, estimate, tuple(cycles), rested, method_s)
        matched = again


def filter_set(
    sets: AnySet,
    first: AnyMatched,
    parameters: Parameters,
    settings: CalibrationSettings,
    listen: Listener,
    cancelled: Asked,
) -> Cycled:
    """Run a filter, on the baseline's matches or on those of its latest state."""
    renewed = sets.renewed if settings.matched_with == "latest" else None
    matched = None if renewed is None else renewed.matched_frames()
    frames = ProblemFrames(first.problem) if matched is None else matched
    began = time.thread_time()
    history = run_sequential(frames, first.problem, parameters, settings, listen, cancelled)
    method_s = time.thread_time() - began - (0.0 if matched is None else matched.matching_s)
    if renewed is None or not history.finite:
        return Cycled(first, finished(first.problem, parameters, history), method_s=method_s)
    last = renewed.at_covariance(history.last.x, history.last.P)
    if last.problem.arcs.n_exposures == 0:
        return Cycled(first, finished(first.problem, parameters, history), rested=False, method_s=method_s)
    estimate = finished(last.problem, parameters, history)
    return Cycled(last, estimate, (_cycle(1, renewed.changed(first, last), first, last, estimate),), method_s=method_s)


def _cycle(number: int, changed: int, before: AnyMatched, after: AnyMatched, estimate: Estimate) -> Cycle:
    """Count what a result changed in its matches."""
    value = rms(before.problem.weighed(estimate.x), estimate.x)
    return Cycle(
        cycle=number,
        matched=before.problem.arcs.n_stars,
        rematched=after.problem.arcs.n_stars,
        changed=changed,
        rms_arc_rad=value if np.isfinite(value) else None,
    )


def cycles_view(ended: Ended) -> list[dict[str, Any]]:
    """Every cycle as JSON."""
    return [vars(cycle) for cycle in ended.cycles]
