"""How a set is spread in time: its span, the usual interval between frames, and the gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.telemetry.evidence import Evidence

#: Interval between frames, their median, and which of them are gaps: `interval_s`, `median_s` and `gaps` of a `Sampling`.
Intervals = tuple[FloatArray, float, IntArray]

#: An interval so many times the median is a gap.
GAP_FACTOR = 3.0


@dataclass(frozen=True)
class Sampling:
    """The frames of a set in time.

    Parameters
    ----------
    entry
        (n_timed_frames,) first entry of each frame that has a time.
    interval_s
        (n_timed_frames - 1,) from each to the next.
    median_s
        Median of the intervals that are positive; 0 when none is.
    gaps
        (n_gaps,) positions in `interval_s`.
    """

    entry: IntArray
    interval_s: FloatArray
    median_s: float
    gaps: IntArray


def sampling_of(evidence: Evidence) -> Sampling | None:
    """Return how the frames follow in time; None when no frame has a time."""
    time_utc = evidence.telemetry.time_utc
    if time_utc is None or evidence.untimed.all():
        return None
    timed = np.flatnonzero(~evidence.untimed)
    frame = evidence.telemetry.frame[timed]
    entry = timed[np.concatenate([[True], np.diff(frame) != 0])]
    interval_s, median_s, gaps = intervals_of(time_utc[entry])
    return Sampling(entry=entry, interval_s=interval_s, median_s=median_s, gaps=gaps)


def intervals_of(time_utc: NDArray[np.datetime64]) -> Intervals:
    """Return the intervals between frames taken at these times (n_timed_frames,), as in `Sampling`."""
    interval_s = np.diff(time_utc) / np.timedelta64(1, "s")
    positive = interval_s[interval_s > 0]
    median_s = float(np.median(positive)) if len(positive) else 0.0
    gaps = np.flatnonzero(interval_s > GAP_FACTOR * median_s) if median_s else np.empty(0, dtype=np.int64)
    return interval_s, median_s, gaps
