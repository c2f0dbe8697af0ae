"""What a gate found: a value with its interval, or why there is none.

A measurement knows no limit. The same measurements are judged by any profile, so a profile that is tried on past sets
judges exactly what was measured of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

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

    def document(self) -> dict[str, Any]:
        """Return it as JSON."""
        return asdict(self)


def absent(sentence: str) -> Measurement:
    """Return a measurement of nothing, with why and what to do."""
    return Measurement(None, sentence)


def answer(met: str, sentence: str) -> Measurement:
    """Return the answer of a gate that has no number."""
    return Measurement(None, sentence, met=met)


def ends(pair: Sequence[float | None] | None) -> Ends | None:
    """Return an interval as a pair; one that is not known at either end is none."""
    if pair is None or (pair[0] is None and pair[1] is None):
        return None
    return (pair[0], pair[1])


def parse_measurement(document: Mapping[str, Any]) -> Measurement:
    """Read a measurement back from a report."""
    values = dict(document)
    for key in ("interval", "bounds"):
        values[key] = ends(values.get(key))
    return Measurement(**values)
