"""The records of all sets put together: one number with its spread, or its NEES."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from boresight.estimation.statistics.consistency import ChiSquare, chi_square
from boresight.papers.wu.estimators import Record

#: Standard deviations over the sets that an interval reaches to either side.
REACH = 2.0


@dataclass(frozen=True)
class Spread:
    """Mean over the sets, and where about 95 % of single sets fall; no interval of a single set."""

    mean: float
    low: float | None
    high: float | None


class Pooled:
    """Records by estimator, weights, noise and group."""

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = list(records)

    def of(self, estimator: str, weights: str = "full", noise_px: float = 0.2, limit: float = 5.5) -> list[Record]:
        """Return the records of all sets, in order."""
        wanted = (estimator, weights, noise_px, limit)
        return [
            record
            for record in self.records
            if (record["estimator"], record["weights"], record["noise_px"], record["magnitude_limit"]) == wanted
        ]

    def nees(self, estimator: str, weights: str = "full", noise_px: float = 0.2) -> ChiSquare:
        """Test the errors of all sets against their claimed covariance; `mean` per parameter."""
        found = self.of(estimator, weights, noise_px)
        return chi_square(sum(record["nees"] for record in found), 6 * len(found))


def spread(records: Sequence[Record], value: Callable[[Record], float], least: float = -np.inf) -> Spread:
    """Take a number of every set together; no interval reaches below the least that the number can be."""
    values = np.array([value(record) for record in records])
    mean = float(values.mean())
    if len(values) < 2:
        return Spread(mean, None, None)
    reach = REACH * float(values.std(ddof=1))
    return Spread(mean, max(mean - reach, least), mean + reach)


def criterion(name: str, which: str) -> Callable[[Record], float]:
    """Read criterion `A` or `B` of a record: its `mean` or `deviation` over the judging images."""
    place = ("mean", "deviation").index(which)
    return lambda record: float(record[name][place])


def compute_mean(records: Sequence[Record], name: str, which: str = "mean") -> float:
    """Mean of a criterion over the sets, arcseconds."""
    return spread(records, criterion(name, which)).mean
