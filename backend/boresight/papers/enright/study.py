"""The whole study: which sets, on how many processes, and the document that comes out.

Trials are independent, so they run in processes of their own and the document does not depend on their number or order; only what
stands under `timing` does.

The study's document, schema `boresight.reproduction/1`: plan, tables, figures, findings, answers, records.

Everything but `timing` is a function of the plan alone: the same plan gives the same text.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from boresight.errors import RefusedInputError
from boresight.papers.documents import SCHEMA, table_document, verdict_counts, versions
from boresight.papers.enright.drawings import drawings
from boresight.papers.enright.estimators import DRAWN, ESTIMATORS, Record, Trial, run_trial
from boresight.papers.enright.findings import findings, questions
from boresight.papers.enright.pooled import Pooled
from boresight.papers.enright.pooled import Record as document_Record
from boresight.papers.enright.tables import tables
from boresight.papers.processes import run_all
from boresight.simulation.sensors import SENSOR_NUMBERS

PAPER = "Enright, Jovanovic, Vaz, “Autonomous Recalibration of Star Trackers”, IEEE Sensors Journal, 2018"


def document(plan: dict[str, Any], records: Sequence[document_Record]) -> dict[str, Any]:
    """Write a study as JSON values."""
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


def _kept(record: document_Record) -> document_Record:
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


Report = Callable[[str, float], None]


@dataclass(frozen=True)
class Plan:
    """How large a study is."""

    quick: bool = False
    sensors: tuple[int, ...] = SENSOR_NUMBERS
    frames: int = 200
    validation_frames: int = 80
    sets: int = 12
    processes: int = 2

    def check(self) -> None:
        """Refuse sensors that the paper does not have."""
        for number in self.sensors:
            if number not in SENSOR_NUMBERS:
                raise RefusedInputError(f"The paper has no sensor {number}: choose from 1 to {max(SENSOR_NUMBERS)}.")

    def trials(self) -> list[Trial]:
        """List the sets, those of the tables first, for they run more estimators."""
        return [
            Trial(sensor, index, self.frames, self.validation_frames)
            for index in range(self.sets)
            for sensor in self.sensors
        ]


def run(plan: Plan, catalogue_folder: Path | None, report: Report | None = None) -> dict[str, Any]:
    """Run the study; returns its document, schema `boresight.reproduction/1`."""
    plan.check()
    trials, records = plan.trials(), dict[Trial, list[Record]]()
    for trial, found in run_all(run_trial, trials, catalogue_folder, plan.processes):
        records[trial] = found
        if report is not None:
            report(f"sensor {trial.sensor}, set {trial.index + 1} of {plan.sets}", len(records) / len(trials))
    ordered = [record for trial in trials for record in records[trial]]
    return document(_described(plan), ordered)


def _described(plan: Plan) -> dict[str, Any]:
    """The plan as JSON, with the versions that computed it."""
    return {
        "quick": plan.quick,
        "sensors": list(plan.sensors),
        "frames": plan.frames,
        "validation_frames": plan.validation_frames,
        "sets": plan.sets,
        "versions": versions(),
    }
