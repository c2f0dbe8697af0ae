"""The study's document, schema `boresight.reproduction/1`: plan, tables, figures, findings, answers, records.

Everything but `timing` is a function of the plan alone: the same plan gives the same text.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from boresight.studies.documents import SCHEMA, table_document, verdict_counts
from boresight.studies.enright.drawings import drawings
from boresight.studies.enright.estimators import ESTIMATORS
from boresight.studies.enright.findings import findings
from boresight.studies.enright.pooled import Pooled, Record
from boresight.studies.enright.questions import questions
from boresight.studies.enright.tables import tables
from boresight.studies.enright.trials import DRAWN

PAPER = "Enright, Jovanovic, Vaz, “Autonomous Recalibration of Star Trackers”, IEEE Sensors Journal, 2018"


def document(plan: dict[str, Any], records: Sequence[Record]) -> dict[str, Any]:
    """Write a study as JSON values.

    Parameters
    ----------
    plan
        As `study.Plan` describes it.
    records
        One a sensor, set and estimator, in order.
    """
    pooled = Pooled(records)
    made, drawn = [table_document(table) for table in tables(pooled)], drawings(pooled)
    return {
        "schema": SCHEMA,
        "paper": PAPER,
        "plan": plan,
        "flight_tolerance_rad": next(record["validation"]["flight_tolerance_rad"] for record in records),
        "verdicts": verdict_counts(made, drawn),
        "tables": made,
        "figures": drawn,
        "estimators": pooled.statistics(),
        "findings": findings(pooled),
        "questions": questions(pooled),
        "settings": {key: estimator.settings.document() for key, estimator in ESTIMATORS.items()},
        "records": [_kept(record) for record in records],
        "timing": _timing(pooled),
    }


def _kept(record: Record) -> Record:
    """Leave out of a record what the figures hold, and times."""
    return {key: value for key, value in record.items() if key not in {*DRAWN, "timing_s"}}


def _timing(pooled: Pooled) -> dict[str, Any]:
    """Milliseconds a frame of each estimator, matching included: the median over sets, by the clock of this run."""
    return {
        "ms_per_frame": {
            key: float(
                np.median([1e3 * record["timing_s"]["calibration"] / max(record["frames"], 1) for record in found])
            )
            for key in ESTIMATORS
            if (found := pooled.of(key))
        }
    }
