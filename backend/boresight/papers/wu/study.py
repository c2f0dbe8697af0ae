"""The whole study: which sets, on how many processes, and the document that comes out; the clock runs when they are done.

The study's document, schema `boresight.reproduction/1`: everything but `timing` is a function of the plan alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from boresight.errors import RefusedInputError
from boresight.papers.documents import SCHEMA, table_document, verdict_counts, versions
from boresight.papers.processes import run_all, run_on_one_thread
from boresight.papers.wu.drawings import drawings
from boresight.papers.wu.errata import cited, errata
from boresight.papers.wu.estimators import FIRST_FRAMES, START_SIGMA, Record, Trial, run_trial
from boresight.papers.wu.findings import findings
from boresight.papers.wu.pooled import Pooled
from boresight.papers.wu.tables import NAMES, tables
from boresight.papers.wu.timing import timing

PAPER = "Wu, Xu, Heikkilä, Zhao, Liu, Niu, “A Star Sensor On-Orbit Calibration Method Based on SVD”, Sensors, 2019"
DRAWN = ("course", "observability")
CONSISTENT = (("svd-4-23", "full"), ("angular", "full"), ("svd-4-23", "diagonal"), ("angular", "diagonal"))


def document(plan: dict[str, Any], records: Sequence[Record], timing: dict[str, Any]) -> dict[str, Any]:
    """Write a study as JSON values."""
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


Report = Callable[[str, float], None]


@dataclass(frozen=True)
class Plan:
    """How large a study is."""

    quick: bool = False
    frames: int = 2400
    judges: int = 100
    sets: int = 20
    processes: int = 2


def run(plan: Plan, catalogue_folder: Path | None, report: Report | None = None) -> dict[str, Any]:
    """Run the study; returns its document, schema `boresight.reproduction/1`."""
    if plan.frames <= FIRST_FRAMES:
        raise RefusedInputError(f"{plan.frames} images are too few: the study needs more than {FIRST_FRAMES}.")
    trials, records = (
        [Trial(index, plan.frames, plan.judges) for index in range(plan.sets)],
        dict[Trial, list[Record]](),
    )
    for trial, found in run_all(run_trial, trials, catalogue_folder, plan.processes):
        records[trial] = found
        if report is not None:
            report(f"set {trial.index + 1} of {plan.sets}", 0.9 * len(records) / len(trials))
    measured = run_on_one_thread(timing, catalogue_folder)
    if report is not None:
        report("times", 1.0)
    return document(_described(plan), [record for trial in trials for record in records[trial]], measured)


def _described(plan: Plan) -> dict[str, Any]:
    """The plan as JSON, with the versions that computed it."""
    return {
        "quick": plan.quick,
        "frames": plan.frames,
        "judges": plan.judges,
        "sets": plan.sets,
        "versions": versions(),
    }
