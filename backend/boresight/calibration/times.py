"""Times of a calibration: as its JSON writes them, and as days."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from boresight.arrays import FloatArray, TimeArray

DAY_US = 86_400e6


def parse_times(texts: Sequence[str | None]) -> TimeArray:
    """Parse times of a calibration, (n,), NaT where there is none; raises ValueError where one is no time."""
    return np.array([(text or "NaT").removesuffix("Z") for text in texts], "datetime64[us]")


def to_days(times: TimeArray) -> FloatArray:
    """Return times (n,) as days since 1970, NaN where there is none."""
    return np.where(np.isnat(times), np.nan, times.astype(np.int64) / DAY_US)
