"""Min-max thinning: fewer points, the same picture.

A screen column shows only the lowest and the highest value that falls into it. So the points are cut into buckets and
each bucket keeps the places of its minimum and its maximum, of every series that is to be drawn over the same axis.
No spike is lost, which averaging and every-nth-point sampling both do, and largest-triangle sampling may.

Whoever has zoomed in needs the points that were left out: `thinning(whole=True)` lets figures keep all of them for as
long as the block lasts, and tells afterwards whether any would have gone.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

POINT_LIMIT = 2000


@dataclass
class Thinning:
    """What happens to long series while a figure is drawn: whether they stay whole, and whether one was too long."""

    whole: bool = False
    too_long: bool = False


_UNDER_WAY: ContextVar[Thinning | None] = ContextVar("thinning", default=None)


@contextmanager
def thinning(*, whole: bool = False) -> Iterator[Thinning]:
    """Watch, or put off, the thinning of whatever is drawn in the block; of this thread only."""
    watched = Thinning(whole)
    token = _UNDER_WAY.set(watched)
    try:
        yield watched
    finally:
        _UNDER_WAY.reset(token)


def keep_extremes(series: list[NDArray[np.float64]], limit: int = POINT_LIMIT) -> NDArray[np.int64]:
    """Choose the points to draw.

    `series`: Arrays (n_points,) over one axis. Returns (n_kept,) ascending indices, all of them up to `limit`.
    """
    n_points = len(series[0])
    if n_points <= limit:
        return np.arange(n_points, dtype=np.int64)
    if (watched := _UNDER_WAY.get()) is not None:
        watched.too_long = True
        if watched.whole:
            return np.arange(n_points, dtype=np.int64)
    n_buckets = max(1, limit // (2 * len(series)))
    size = -(-n_points // n_buckets)
    start = np.arange(0, n_points, size, dtype=np.int64)
    kept = [np.array([0, n_points - 1], dtype=np.int64)]
    for values in series:
        for worst, place in ((np.inf, np.argmin), (-np.inf, np.argmax)):
            padded = np.full(len(start) * size, worst)
            padded[:n_points] = np.where(np.isfinite(values), values, worst)
            kept.append(start + place(padded.reshape(len(start), size), axis=1))
    return np.unique(np.minimum(np.concatenate(kept), n_points - 1))
