"""The types of the arrays, whose dimensions and units docstrings name; units of time and angle; numbers and times as in JSON."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
TimeArray = NDArray[np.datetime64]

DAY_US = 86_400e6
ARCSEC_PER_RAD = float(np.degrees(1.0) * 3600)


def known_or_none(value: float) -> float | None:
    """Return a number as JSON has it: None for what is not finite."""
    return float(value) if np.isfinite(value) else None


def list_known(values: FloatArray | Sequence[float]) -> list[float | None]:
    """Return numbers (n,) as JSON has them, None for what is not finite."""
    return [known_or_none(value) for value in values]


def parse_times(texts: Sequence[str | None]) -> TimeArray:
    """Parse times, (n,), NaT where there is none; raises ValueError where one is no time."""
    return np.array([(text or "NaT").removesuffix("Z") for text in texts], "datetime64[us]")


def to_days(times: TimeArray) -> FloatArray:
    """Return times (n,) as days since 1970, NaN where there is none."""
    return np.where(np.isnat(times), np.nan, times.astype(np.int64) / DAY_US)
