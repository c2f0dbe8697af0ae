"""The history of an estimate, by frame or by iteration: how parameters and their sigmas moved, and the error once it has settled.

The settled part is the tail of a run, whose RMS is told with its sigma. An RMS of n independent arc errors of one sigma is known to
rms / sqrt(2 n): the square of it is a mean of n squares, each with twice its variance (chi-square with n degrees of freedom). Tail
and aggregate of one set share their arcs, so their difference is known better than either; the sigma tells how far the next set's
RMS may lie from this one's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration import calibration as tree
from boresight.calibration.calibration import Calibration, Evaluation

Ends = tuple[float, float]

SETTLED_SIGMAS = 3.0  # of the end, within which a parameter that has settled stays


def _nothing() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True)
class History:
    """What a run's history or trace says.

    `x`: (n_steps,) frame numbers or iterations. `names`: (n_parameters,) in model order. `value`, `sigma`: (n_steps,
    n_parameters) SI; sigma is NaN for a fixed parameter. The other columns are (n_steps,), NaN where nothing is known, and
    empty where runs of this kind have none.
    """

    axis: str
    x: FloatArray
    names: tuple[str, ...]
    free: tuple[str, ...]
    value: FloatArray
    sigma: FloatArray
    time_utc: Sequence[str | None] | None = None
    tail_rms_rad: FloatArray = field(default_factory=_nothing)
    aggregate_rms_rad: FloatArray = field(default_factory=_nothing)
    nis: FloatArray = field(default_factory=_nothing)
    nis_dof: FloatArray = field(default_factory=_nothing)
    cost: FloatArray = field(default_factory=_nothing)
    rms_arc_rad: FloatArray = field(default_factory=_nothing)


def _padded(values: Any, n_steps: int) -> FloatArray:
    column = np.full(n_steps, np.nan)
    read = np.array(values if values is not None else [], dtype=np.float64)[:n_steps]
    column[: len(read)] = read
    return column


def _matrix(rows: Any, n_steps: int, n_parameters: int) -> FloatArray:
    matrix = np.array(rows if rows is not None else [], dtype=np.float64)
    return matrix if matrix.shape == (n_steps, n_parameters) else np.full((n_steps, n_parameters), np.nan)


def read_history(result: Calibration) -> History | None:
    """Read the history of a run, or None while it has none."""
    updates, iterates = result.history, result.trace
    if updates is not None and updates.frame:
        n_steps = len(updates.frame)
        return replace(
            _states(result, "frame", updates.frame, updates),
            time_utc=updates.time_utc,
            tail_rms_rad=_padded(updates.tail_rms_rad, n_steps),
            aggregate_rms_rad=_padded(updates.aggregate_rms_rad, n_steps),
            nis=_padded(updates.nis, n_steps),
            nis_dof=_padded(updates.nis_dof, n_steps),
        )
    if iterates is not None and iterates.iteration:
        n_steps = len(iterates.iteration)
        return replace(
            _states(result, "iteration", iterates.iteration, iterates),
            cost=_padded(iterates.cost, n_steps),
            rms_arc_rad=_padded(iterates.rms_arc_rad, n_steps),
        )
    return None


def _states(result: Calibration, axis: str, steps: Sequence[int], record: tree.History | tree.Iterations) -> History:
    """Read the parameters and their sigmas at every step."""
    names = parameter_names(result)
    x = np.array(steps, dtype=np.float64)
    value, sigma = (_matrix(rows, len(x), len(names)) for rows in (record.parameters, record.sigma))
    return History(axis, x, names, tuple(name for name in free_names(result) if name in names), value, sigma)


def settled_step(result: Calibration) -> int | None:
    """Return the index of the step from which on every free parameter stays within `SETTLED_SIGMAS` final sigmas of its end.

    None while the run is on its way, and where an estimate or a sigma is not known.
    """
    history = read_history(result)
    if history is None or result.status == "running":
        return None
    free = [history.names.index(name) for name in history.free]
    value, reach = history.value[:, free], SETTLED_SIGMAS * history.sigma[-1, free]
    if not np.isfinite(value).all() or not np.isfinite(reach).all():
        return None
    away = np.flatnonzero((np.abs(value - value[-1]) > reach).any(axis=1))
    return int(away[-1]) + 1 if len(away) else 0


def parameter_names(result: Calibration) -> tuple[str, ...]:
    """Name the parameters in model order, which is the order of every column."""
    return tuple(result.parameter_names or result.parameters or result.initial)


def free_names(result: Calibration) -> tuple[str, ...]:
    """Name the estimated parameters, in model order."""
    return tuple(result.free or result.parameters)


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


def sigma_of_rms(rms_rad: float | None, arcs: float | None) -> float | None:
    """Return one sigma of an RMS over so many arcs, in its unit."""
    return None if rms_rad is None or not arcs else float(rms_rad / np.sqrt(2 * arcs))


SIGMAS_OF_INTERVAL = 1.96  # half of a 95 % interval


def interval_of_rms(rms_rad: float | None, arcs: float | None, resampled: Ends | None = None) -> Ends | None:
    """Return the 95 % interval of an RMS: as wide, for its size, as resampled frames say, else as of so many independent arcs.

    `resampled`: from `find_relative_intervals`. It is of the pairs that the flight code accepts, whose RMS is smaller than that of
    all fitted pairs where some of these are far off; so it is scaled, and contains the RMS whatever that is of.
    """
    if rms_rad is not None and resampled is not None:
        return rms_rad * resampled[0], rms_rad * resampled[1]
    sigma = sigma_of_rms(rms_rad, arcs)
    if rms_rad is None or sigma is None:
        return None
    return max(0.0, rms_rad - SIGMAS_OF_INTERVAL * sigma), rms_rad + SIGMAS_OF_INTERVAL * sigma


def interval_of_fit(result: Calibration, rms_rad: float | None) -> Ends | None:
    """Return the 95 % interval of an RMS of the fitted frames at some state: as wide, for its size, as that of the estimate."""
    return interval_of_rms(rms_rad, result.pairs, find_relative_intervals(result.evaluation)[1])


def find_relative_intervals(scores: Evaluation | None) -> tuple[Ends | None, Ends | None]:
    """Return the 95 % intervals of a set's RMS before and after by resampled frames, as shares of it; None where there is none."""
    if scores is None or scores.intervals is None:
        return None, None
    rms, known = scores.rms_arc_rad, scores.intervals.rms_arc_rad
    return _as_shares(rms.initial, known.initial), _as_shares(rms.final, known.final)


def _as_shares(rms_rad: float | None, ends_rad: Sequence[float | None]) -> Ends | None:
    low, high = ends_rad or (None, None)
    return None if not rms_rad or low is None or high is None else (max(0.0, low / rms_rad), high / rms_rad)


def tail_start(result: Calibration, history: History, tail_from: float | None) -> float:
    """Return the step at which the tail begins, on the history's axis; `tail_from` is where a reader wants it."""
    low, high = float(history.x.min()), float(history.x.max())
    latest = low + LATEST_SHARE * (high - low)
    if tail_from is not None:
        return float(np.clip(tail_from, low, latest))
    first = settled_step(result)
    settled = low + SETTLING_SHARE * (high - low) if first is None else float(history.x[first])
    return min(settled, latest)


def summarise_tail(result: Calibration, tail_from: float | None = None) -> RmsTail | None:
    """Sum up what follows the start of the tail; None for a batch, which has no way behind it, and before any step."""
    history = read_history(result)
    if history is None or history.axis != "frame":
        return None
    start = tail_start(result, history, tail_from)
    shown = history.x >= start
    tail, aggregate = history.tail_rms_rad[shown], history.aggregate_rms_rad
    known, seen = tail[np.isfinite(tail)], aggregate[np.isfinite(aggregate)]
    mean = float(known.mean()) if len(known) else None
    return RmsTail(
        axis=history.axis,
        start=start,
        end=float(history.x.max()),
        points=int(shown.sum()),
        tail_rad=mean,
        aggregate_rad=float(seen[-1]) if len(seen) else None,
        sigma_rad=sigma_of_rms(mean, result.pairs),
        chosen=tail_from is not None,
    )
