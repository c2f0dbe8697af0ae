"""The whole study of W: which sets, on how many processes, the document that comes out, and the files that it is written to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from boresight.errors import RefusedInputError
from boresight.papers.documents import (
    SCHEMA,
    csv_bytes,
    described,
    figure_lines,
    json_bytes,
    rendered,
    table_document,
    table_lines,
    verdict_counts,
    write_files,
)
from boresight.papers.processes import run_all, run_on_one_thread
from boresight.papers.wu.drawings import LABELS, draw_criteria, draw_observability, draw_parameters, drawings
from boresight.papers.wu.estimators import FIRST_FRAMES, START_SIGMA, Record, Trial, run_trial
from boresight.papers.wu.findings import cited, errata, findings
from boresight.papers.wu.tables import NAMES, Pooled, tables
from boresight.papers.wu.timing import timing
from boresight.simulation.sensors import WU_START, WU_TRUTH, WU_TYPICAL_SIGMA

PAPER = "Wu, Xu, Heikkilä, Zhao, Liu, Niu, “A Star Sensor On-Orbit Calibration Method Based on SVD”, Sensors, 2019"
DRAWN = ("history", "observability")
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
    return document(described(plan), [record for trial in trials for record in records[trial]], measured)


Document = Mapping[str, Any]

DRAW: dict[str, Callable[[Mapping[str, Any]], go.Figure]] = {
    "3": draw_observability,
    "4": draw_observability,
    "6a": draw_criteria,
    "6b": draw_criteria,
    "8": draw_parameters,
}
HEAD = ("set", "magnitude_limit", "noise_px", "stars", "estimator", "weights")


def write(document: Document, out: Path) -> list[Path]:
    """Write every file of a study into a folder, made where it is not there; returns their paths."""
    files = {
        "wu.html": render(document).encode(),
        "wu.json": json_bytes(document),
        "wu-tables.csv": csv_bytes(table_lines(document)),
        "wu-sets.csv": csv_bytes(_set_lines(document)),
        "wu-figures.csv": csv_bytes(figure_lines(document, ("frame",), ("label", "unit", "truth"))),
    }
    return write_files(files, out)


def render(document: Document) -> str:
    """Render the report as HTML text."""
    parameters = zip(NAMES, WU_TRUTH, WU_TYPICAL_SIGMA, WU_START, document["start_sigma"].values(), strict=True)
    return rendered("papers/wu.html", document, DRAW, parameters=list(parameters), labels=LABELS)


def _set_lines(document: Document) -> Iterator[Sequence[Any]]:
    """One line a record: criteria in arcseconds, errors in SI."""
    yield (
        *HEAD, "a_mean_arcsec", "a_deviation_arcsec", "b_mean_arcsec", "b_deviation_arcsec", "nees",
        *(f"error_{name}" for name in NAMES),
    )  # fmt: skip
    for record in document["records"]:
        errors = record.get("error", [0.0] * len(NAMES))
        yield (*(record[key] for key in HEAD), *record["A"], *record["B"], record["nees"], *errors)
