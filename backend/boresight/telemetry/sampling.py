"""How a set is spread in time, and which exposures two telemetry tables share, told by their centroids alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.telemetry.quality.inputs import QualityInputs
from boresight.telemetry.schema import find_exposures
from boresight.telemetry.working_table import WorkingTable

#: Interval between frames, their median, and which of them are gaps: `interval_s`, `median_s` and `gaps` of a `Sampling`.
Intervals = tuple[FloatArray, float, IntArray]

#: An interval so many times the median is a gap.
GAP_FACTOR = 3.0


@dataclass(frozen=True)
class Sampling:
    """The frames of a set in time.

    `entry`: (n_timed_frames,) first entry of each frame that has a time. `gaps`: (n_gaps,) positions in `interval_s`.
    """

    entry: IntArray
    interval_s: FloatArray
    median_s: float
    gaps: IntArray


def compute_sampling(inputs: QualityInputs) -> Sampling | None:
    """Return how the frames follow in time; None when no frame has a time."""
    time_utc = inputs.telemetry.time_utc
    if time_utc is None or inputs.untimed.all():
        return None
    timed = np.flatnonzero(~inputs.untimed)
    frame = inputs.telemetry.frame[timed]
    entry = timed[np.concatenate([[True], np.diff(frame) != 0])]
    interval_s, median_s, gaps = compute_intervals(time_utc[entry])
    return Sampling(entry=entry, interval_s=interval_s, median_s=median_s, gaps=gaps)


def compute_intervals(time_utc: NDArray[np.datetime64]) -> Intervals:
    """Return the intervals between frames taken at these times (n_timed_frames,), as in `Sampling`."""
    interval_s = np.diff(time_utc) / np.timedelta64(1, "s")
    positive = interval_s[interval_s > 0]
    median_s = float(np.median(positive)) if len(positive) else 0.0
    gaps = np.flatnonzero(interval_s > GAP_FACTOR * median_s) if median_s else np.empty(0, dtype=np.int64)
    return interval_s, median_s, gaps


#: Tables whose exposures are remembered: the files are named by their content, so what was read stays true.
REMEMBERED = 32
DECIMALS = 6


@lru_cache(REMEMBERED)
def exposure_keys(path: Path) -> NDArray[np.complex128]:
    """Return what each exposure of a stored table is known by: sum of rows + i sum of columns, (n_exposures,)."""
    sums = [np.zeros(0, np.complex128)]
    for part in WorkingTable(path).parts():
        start = find_exposures(part).start
        sums.append(np.add.reduceat(part.row_px, start) + 1j * np.add.reduceat(part.col_px, start))
    return np.asarray(np.round(np.concatenate(sums), DECIMALS))


def shared_exposures(one: Path, other: Path) -> tuple[float, float]:
    """Return the share of each table's exposures that the other table has too, 0 to 1."""
    if one == other:
        return 1.0, 1.0
    keys = exposure_keys(one), exposure_keys(other)
    common = len(np.intersect1d(*keys))
    return common / max(len(keys[0]), 1), common / max(len(keys[1]), 1)
