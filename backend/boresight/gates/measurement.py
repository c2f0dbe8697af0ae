"""What a gate found: a value with its interval, or why there is none.

A measurement knows no limit. The same measurements are judged by any profile, so a profile that is tried on past sets
judges exactly what was measured of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

Ends = tuple[float | None, float | None]


@dataclass(frozen=True)
class Measurement:
    """What was measured for one gate.

    Parameters
    ----------
    value
        In the gate's unit; None where there is nothing to measure.
    sentence
        What the value says, or why there is none and what would give one.
    interval
        95 % interval of the value; an end is None where it is unbounded. None for a value that no sample stands behind.
    bounds
        95 % bounds of the value of a sound set, for a gate that asks for a ratio around 1.
    incumbent
        The same quantity of the incumbent, where it has one.
    met
        The answer of a gate that has no number: PASS, MARGINAL or FAIL.
    """

    value: float | None
    sentence: str
    interval: Ends | None = None
    bounds: Ends | None = None
    incumbent: float | None = None
    met: str | None = None


def absent(sentence: str) -> Measurement:
    """Return a measurement of nothing, with why and what to do."""
    return Measurement(None, sentence)


def answer(met: str, sentence: str) -> Measurement:
    """Return the answer of a gate that has no number."""
    return Measurement(None, sentence, met=met)


def ends(pair: Sequence[float | None] | None) -> Ends | None:
    """Return an interval as a pair, None for an end that is not known; one that is known at neither end is none."""
    low, high = (None if end is None or not math.isfinite(end) else float(end) for end in pair or (None, None))
    return None if low is None and high is None else (low, high)
