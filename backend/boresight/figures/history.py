"""The history of an estimate, by frame or by iteration: how parameters and their sigmas moved, and the error once it has settled.

The settled part is the tail of a run, whose RMS is told with its sigma. An RMS of n independent arc errors of one sigma is known to
rms / sqrt(2 n): the square of it is a mean of n squares, each with twice its variance (chi-square with n degrees of freedom). Tail
and aggregate of one set share their arcs, so their difference is known better than either; the sigma tells how far the next set's
RMS may lie from this one's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.result import Result
from boresight.figures.chart import Trace
from boresight.verdicts.verdict import sigma_of_rms

SETTLED_SIGMAS = 3.0


@dataclass(frozen=True)
class History:
    """What a run's history or trace says.

    `x`: (n_steps,) frame numbers or iterations. `names`: (n_parameters,) in model order. `value`, `sigma`: (n_steps,
    n_parameters) SI; sigma is NaN for a fixed parameter.
    """

    axis: str
    x: FloatArray
    names: tuple[str, ...]
    free: tuple[str, ...]
    value: FloatArray
    sigma: FloatArray
    record: Result

    def series(self, key: str) -> FloatArray:
        """Read another column of the same record, (n_steps,), NaN where it says nothing."""
        return _padded(self.record.get(key), len(self.x))


def _padded(values: Any, n_steps: int) -> FloatArray:
    column = np.full(n_steps, np.nan)
    read = np.array(values if values is not None else [], dtype=np.float64)[:n_steps]
    column[: len(read)] = read
    return column


def _matrix(rows: Any, n_steps: int, n_parameters: int) -> FloatArray:
    matrix = np.array(rows if rows is not None else [], dtype=np.float64)
    return matrix if matrix.shape == (n_steps, n_parameters) else np.full((n_steps, n_parameters), np.nan)


def read_history(result: Result) -> History | None:
    """Read the history of a run, or None while it has none."""
    names = parameter_names(result)
    for axis, key in (("frame", "history"), ("iteration", "trace")):
        record = result.get(key)
        if record and record.get(axis):
            x = np.array(record[axis], dtype=np.float64)
            value = _matrix(record.get("parameters"), len(x), len(names))
            sigma = _matrix(record.get("sigma"), len(x), len(names))
            free = tuple(name for name in free_names(result) if name in names)
            return History(axis, x, names, free, value, sigma, record)
    return None


def settled_step(result: Result) -> int | None:
    """Return the index of the step from which on every free parameter stays within `SETTLED_SIGMAS` final sigmas of its end.

    None while the run is on its way, and where an estimate or a sigma is not known.
    """
    history = read_history(result)
    if history is None or result.get("status") in {None, "running"}:
        return None
    free = [history.names.index(name) for name in history.free]
    value, reach = history.value[:, free], SETTLED_SIGMAS * history.sigma[-1, free]
    if not np.isfinite(value).all() or not np.isfinite(reach).all():
        return None
    away = np.flatnonzero((np.abs(value - value[-1]) > reach).any(axis=1))
    return int(away[-1]) + 1 if len(away) else 0


def parameter_names(result: Result) -> tuple[str, ...]:
    """Name the parameters in model order, which is the order of every column."""
    return tuple(result.get("parameter_names") or result.get("parameters") or result.get("initial") or ())


def free_names(result: Result) -> tuple[str, ...]:
    """Name the estimated parameters, in model order."""
    return tuple(result.get("free") or result.get("parameters") or ())


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
