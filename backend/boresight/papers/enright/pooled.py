"""All records of a study put together: look-ups, and statistics over its sets.

With m sets of n degrees of freedom each, T = sum of NEES is chi-square with m n degrees of freedom when every covariance is what it
claims; so is T = sum of e^T F e for an estimate at the Cramer-Rao bound. The ratio of errors to either is sqrt(T / m n), with the
95 % interval sqrt(T / chi2_0.975), sqrt(T / chi2_0.025). A mean is drawn up by a few sets that went astray, so the median stands
beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri

from boresight.estimation.statistics.consistency import CONFIDENCE, chi_square
from boresight.papers.enright.estimators import ESTIMATORS
from boresight.simulation.sensors import TYPICAL_SIGMA

Record = dict[str, Any]


@dataclass(frozen=True)
class Pooled:
    """The records of a study."""

    records: Sequence[Record]

    @property
    def sensors(self) -> list[int]:
        """Sensors that were run, ascending."""
        return sorted({record["sensor"] for record in self.records})

    def first(self, sensor: int, estimator: str) -> Record | None:
        """Return the record that tables and figures show, or None where that sensor was not run."""
        for record in self.records:
            if (record["sensor"], record["estimator"], record["set"]) == (sensor, estimator, 0):
                return record
        return None

    def get_first(self, sensor: int, estimator: str) -> Record:
        """Return the same of a sensor that was run."""
        record = self.first(sensor, estimator)
        if record is None:
            raise ValueError(f"Expected a record of {estimator} on sensor {sensor}, received none")
        return record

    def firsts(self, estimator: str) -> list[Record]:
        """Return the records of all sensors that the tables show."""
        return [record for sensor in self.sensors if (record := self.first(sensor, estimator)) is not None]

    def list_records(self, estimator: str) -> list[Record]:
        """Return every record of an estimator."""
        return [record for record in self.records if record["estimator"] == estimator]

    def statistics(self) -> list[dict[str, Any]]:
        """Return, an estimator each, what its sets say about its covariance and its efficiency."""
        return [_statistics(key, found) for key in ESTIMATORS if (found := self.list_records(key))]


def _statistics(key: str, found: Sequence[Record]) -> dict[str, Any]:
    """Pool NEES and ratio to the bound of one estimator."""
    claimed = [record for record in found if record["nees"] is not None]
    bound = [record["squared_over_bound"] * 8 for record in found if record["squared_over_bound"] is not None]
    dof = sum(record["nees_dof"] for record in claimed)
    n = claimed[0]["nees_dof"] if claimed else 0
    test = chi_square(sum(record["nees"] for record in claimed), dof) if dof else None
    return {
        "estimator": key,
        "label": ESTIMATORS[key].label,
        "sets": len(found),
        "converged": sum(record["status"] == "converged" for record in found),
        "nees": None
        if test is None
        else {
            "mean": test.mean * n,
            "median": float(np.median([record["nees"] for record in claimed])),
            "expected": n,
            "lower": test.lower * n,
            "upper": test.upper * n,
            "consistent": test.consistent,
        },
        "ratio_to_bound": _ratio(bound) if bound else None,
    }


def _ratio(totals: Sequence[float]) -> dict[str, float]:
    """Error over bound with its 95 % interval, from e^T F e of each set, (n_sets,) with 8 degrees of freedom each."""
    total, dof, tail = float(np.sum(totals)), 8 * len(totals), (1 - CONFIDENCE) / 2
    return {
        "value": float(np.sqrt(total / dof)),
        "lower": float(np.sqrt(total / chdtri(dof, tail))),
        "upper": float(np.sqrt(total / chdtri(dof, 1 - tail))),
        "median": float(np.sqrt(np.median(totals) / 8)),
    }


def mean(records: Sequence[Record], value: Callable[[Record], float]) -> float:
    """Average a number over records."""
    return float(np.mean([value(record) for record in records]))


def compute_unscaled_condition(observed: Record) -> float:
    """Condition number of the Jacobian in SI units, from its scaled singular values and vectors."""
    values, vectors = np.array(observed["singular_values"]), np.array(observed["right_singular_vectors"])
    singular = np.linalg.svd(values[:, None] * vectors / TYPICAL_SIGMA, compute_uv=False)
    return float(singular[0] / singular[-1])
