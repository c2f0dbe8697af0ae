"""Fit, match again, fit: until the matches rest, or three times (E section II-B), and what was matched on the way.

Better parameters find more stars, and more stars better parameters. A cycle is one fit; after it the set is matched
with the result, and when no star changes, the matches rest. A filter that matches with its latest state does the same
frame by frame, and is judged by the set as its end state matches it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from boresight.calibration.estimate import Asked, Estimate, Parameters, ReportEstimate, run_batch
from boresight.calibration.matching.matched import Dataset, Matched
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.sequence import finished, run_sequential, standing_frames
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


@dataclass(frozen=True)
class CyclesEnd:
    """Where the cycles ended: the set and estimate that belong together, every cycle, and whether the matches rest.

    `method_s` is the processor time of the method alone in its last cycle, matching left out.
    """

    matched: Matched
    estimate: Estimate
    cycles: tuple[Cycle, ...] = ()
    rested: bool = True
    method_s: float = 0.0

    def judged_by(self, matched: Matched) -> CyclesEnd:
        """Put what is in memory of the set, all or a sample, in its place, and of a filter's updates those that are of it."""
        history, frame = self.estimate.history, matched.problem.arcs.frame
        if history is not None and len(frame) < self.matched.problem.arcs.n_frames:
            history = history.of_frames(frame)
        return replace(self, matched=matched, estimate=replace(self.estimate, history=history))


def fit_in_cycles(
    sets: Dataset,
    first: Matched,
    parameters: Parameters,
    settings: CalibrationSettings,
    listen: ReportEstimate,
    cancelled: Asked,
) -> CyclesEnd:
    """Run the batch estimator until its matches rest."""
    matched, cycles = first, list[Cycle]()
    while True:
        began = time.thread_time()
        estimate = run_batch(matched.problem, parameters, settings, listen, cancelled)
        method_s = time.thread_time() - began
        if sets.stands or estimate.status == "diverged":
            return CyclesEnd(matched, estimate, tuple(cycles), sets.stands, method_s)
        again = sets.at(estimate, matched.problem)
        cycles.append(_cycle(len(cycles) + 1, sets.changed(matched, again), matched, again, estimate))
        rested = cycles[-1].changed == 0
        if rested or len(cycles) == MOST_CYCLES or again.problem.arcs.n_exposures == 0:
            return CyclesEnd(matched, estimate, tuple(cycles), rested, method_s)
        matched = again


def filter_set(
    sets: Dataset,
    first: Matched,
    parameters: Parameters,
    settings: CalibrationSettings,
    listen: ReportEstimate,
    cancelled: Asked,
) -> CyclesEnd:
    """Run a filter, on the baseline's matches or on those of its latest state."""
    renewed = settings.matched_with == "latest" and not sets.stands
    frames = sets.frames() if renewed else standing_frames(first.problem)
    began = time.thread_time()
    history = run_sequential(frames, first.problem, parameters, settings, listen, cancelled)
    method_s = time.thread_time() - began - sets.matching_s
    if not renewed or not history.finite:
        return CyclesEnd(first, finished(first.problem, parameters, history), method_s=method_s)
    last = sets.at_covariance(history.last.x, history.last.P)
    if last.problem.arcs.n_exposures == 0:
        return CyclesEnd(first, finished(first.problem, parameters, history), rested=False, method_s=method_s)
    estimate = finished(last.problem, parameters, history)
    return CyclesEnd(last, estimate, (_cycle(1, sets.changed(first, last), first, last, estimate),), method_s=method_s)


def _cycle(number: int, changed: int, before: Matched, after: Matched, estimate: Estimate) -> Cycle:
    """Count what a result changed in its matches."""
    value = rms(before.problem.whitened(estimate.x), estimate.x)
    return Cycle(
        cycle=number,
        matched=before.problem.arcs.n_stars,
        rematched=after.problem.arcs.n_stars,
        changed=changed,
        rms_arc_rad=value if np.isfinite(value) else None,
    )


def cycles_view(ended: CyclesEnd) -> list[dict[str, Any]]:
    """Every cycle as JSON."""
    return [vars(cycle) for cycle in ended.cycles]
