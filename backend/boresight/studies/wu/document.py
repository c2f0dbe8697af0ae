"""The study's document, schema `boresight.reproduction/1`: everything but `timing` is a function of the plan alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from boresight.studies.documents import SCHEMA, table_document, verdict_counts
from boresight.studies.wu.drawings import drawings
from boresight.studies.wu.errata import cited, errata
from boresight.studies.wu.estimators import START_SIGMA
from boresight.studies.wu.findings import findings
from boresight.studies.wu.pooled import Pooled
from boresight.studies.wu.tables import NAMES, tables
from boresight.studies.wu.trials import Record

PAPER = "Wu, Xu, Heikkilä, Zhao, Liu, Niu, “A Star Sensor On-Orbit Calibration Method Based on SVD”, Sensors, 2019"
DRAWN = ("course", "observability")
CONSISTENT = (("svd-4-23", "full"), ("angular", "full"), ("svd-4-23", "diagonal"), ("angular", "diagonal"))


def document(plan: dict[str, Any], records: Sequence[Record], timing: dict[str, Any]) -> dict[str, Any]:
    """Write a study as JSON values.

    Parameters
    ----------
    plan
        As `study.Plan` describes it.
    records
        One a set, group, noise and estimator, in order.
    timing
        By the clock.
    """
    pooled = Pooled(records)
    made, drawn = [table_document(table) for table in tables(pooled)], drawings(pooled)
    wrong = errata(pooled)
    for kind, several in (("Table", (*made, *timing["tables"])), ("Figure", drawn)):
        for one in several:
            one["errata"] = cited(f"{kind} {one['number']}", wrong)
    return {
        "schema": SCHEMA,
        "paper": PAPER,
        "plan": plan,
        "start_sigma": dict(zip(NAMES, START_SIGMA.tolist(), strict=True)),
        "verdicts": verdict_counts(made, drawn),
        "tables": made,
        "figures": drawn,
        "consistency": [_consistency(pooled, *place) for place in CONSISTENT],
        "findings": findings(pooled),
        "errata": wrong,
        "records": [{key: value for key, value in record.items() if key not in DRAWN} for record in records],
        "timing": timing,
    }


def _consistency(pooled: Pooled, estimator: str, weights: str) -> dict[str, Any]:
    """NEES of all six parameters over the sets, at 0.2 px."""
    found = pooled.nees(estimator, weights)
    return {
        "estimator": estimator,
        "weights": weights,
        "sets": len(pooled.of(estimator, weights)),
        "nees": 6 * found.mean,
        "expected": 6,
        "lower": 6 * found.lower,
        "upper": 6 * found.upper,
        "consistent": found.consistent,
    }
