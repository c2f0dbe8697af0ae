"""The tail of a run: what its error is once it has settled, in numbers with their sigma.

An RMS of n independent arc errors of one sigma is known to rms / sqrt(2 n): the square of it is a mean of n squares, each with
twice its variance (chi-square with n degrees of freedom). Tail and aggregate of one set share their arcs, so their
difference is known better than either; the sigma tells how far the next set's RMS may lie from this one's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from boresight.figures.chart import Result, Trace
from boresight.figures.history import History, read_history, settled_step
from boresight.verdicts.verdict import sigma_of_rms

SETTLING_SHARE = 0.2  # of the run, where nothing says when it settled
LATEST_SHARE = 0.95  # of the run: a tail that is shorter than the rest says nothing


@dataclass(frozen=True)
class RmsTail:
    """Error of a run from a step on."""

    axis: str
    start: float
    end: float
    points: int
    tail_rad: float | None
    aggregate_rad: float | None
    sigma_rad: float | None
    chosen: bool


def tailed(traces: Sequence[Trace], tail_from: float | None) -> list[Trace]:
    """Tell every run where a reader wants its tail to begin."""
    if tail_from is None:
        return list(traces)
    return [replace(trace, result={**trace.result, "tail_from": tail_from}) for trace in traces]


def tail_start(result: Result, history: History) -> float:
    """Return the step at which the tail begins, on the history's axis."""
    low, high = float(history.x.min()), float(history.x.max())
    latest = low + LATEST_SHARE * (high - low)
    if (chosen := result.get("tail_from")) is not None:
        return float(np.clip(chosen, low, latest))
    first = settled_step(result)
    settled = low + SETTLING_SHARE * (high - low) if first is None else float(history.x[first])
    return min(settled, latest)


def summarise_tail(result: Result) -> RmsTail | None:
    """Sum up what follows the start of the tail; None for a batch, which has no way behind it, and before any step."""
    history = read_history(result)
    if history is None or history.axis != "frame":
        return None
    start = tail_start(result, history)
    shown = history.x >= start
    tail = history.series("tail_rms_rad")[shown]
    aggregate = history.series("aggregate_rms_rad")
    known, seen = tail[np.isfinite(tail)], aggregate[np.isfinite(aggregate)]
    mean = float(known.mean()) if len(known) else None
    arcs = result.get("pairs")
    return RmsTail(
        axis=history.axis,
        start=start,
        end=float(history.x.max()),
        points=int(shown.sum()),
        tail_rad=mean,
        aggregate_rad=float(seen[-1]) if len(seen) else None,
        sigma_rad=sigma_of_rms(mean, arcs),
        chosen=result.get("tail_from") is not None,
    )
