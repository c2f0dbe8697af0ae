"""The types of the arrays: what each holds; the docstrings name their dimensions and units. And times, as JSON writes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
TimeArray = NDArray[np.datetime64]

DAY_US = 86_400e6


def parse_times(texts: Sequence[str | None]) -> TimeArray:
    """Parse times, (n,), NaT where there is none; raises ValueError where one is no time."""
    return np.array([(text or "NaT").removesuffix("Z") for text in texts], "datetime64[us]")


def to_days(times: TimeArray) -> FloatArray:
    """Return times (n,) as days since 1970, NaN where there is none."""
    return np.where(np.isnat(times), np.nan, times.astype(np.int64) / DAY_US)
