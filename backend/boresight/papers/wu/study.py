"""The whole study of W: which sets, on how many processes, the document that comes out, and the files that it is written to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from boresight.errors import RefusedInputError
from boresight.papers.documents import (
    SCHEMA,
    described,
    head,
    rendered,
    table_document,
    write_study,
)
from boresight.papers.processes import Report, run_all, run_on_one_thread
from boresight.papers.wu.drawings import LABELS, draw_criteria, draw_observability, draw_parameters, drawings
from boresight.papers.wu.estimators import FIRST_FRAMES, START_SIGMA, Record, Trial, run_trial
from boresight.papers.wu.findings import cited, errata, findings
from boresight.papers.wu.grid import ORDERS, GridTrial, grids, run_grid
from boresight.papers.wu.tables import NAMES, Pooled, tables
from boresight.papers.wu.timing import timing
from boresight.simulation.sensors import WU_START, WU_TRUTH, WU_TYPICAL_SIGMA
from boresight.waiting import ignore_progress

PAPER = "Wu, Xu, Heikkilä, Zhao, Liu, Niu, “A Star Sensor On-Orbit Calibration Method Based on SVD”, Sensors, 2019"
DRAWN = ("history", "observability")
CONSISTENT = (("svd-4-23", "full"), ("angular", "full"), ("svd-4-23", "diagonal"), ("angular", "diagonal"))


def document(
    plan: dict[str, Any], records: Sequence[Record], timing: dict[str, Any], varied: Sequence[dict[str, Any]]
) -> dict[str, Any]:
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
        **head(made, drawn),
        "tables": made,
        "figures": drawn,
        "consistency": [_consistency(pooled, *place) for place in CONSISTENT],
        "grids": grids(varied),
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
        "sets": len(pooled.list_records(estimator, weights)),
        "nees": 6 * found.mean,
        "expected": 6,
        "lower": 6 * found.lower,
        "upper": 6 * found.upper,
        "consistent": found.consistent,
    }


#: Sets that a full study runs the grid of settings on, about a minute of a processor each.
GRID_SETS = 2
#: Share of a study's time that its sets take.
SETS_SHARE = 0.7


@dataclass(frozen=True)
class StudySize:
    """How large a study is."""

    quick: bool = False
    frames: int = 2400
    judges: int = 100
    sets: int = 20
    processes: int = 2

    def trials(self, sets: int) -> list[Trial]:
        """List so many sets."""
        return [Trial(index, self.frames, self.judges) for index in range(sets)]

    def grid_trials(self) -> list[GridTrial]:
        """List what the grid of settings is run on: in a quick study one set in one order."""
        sets, chosen = (1, ORDERS[:1]) if self.quick else (min(GRID_SETS, self.sets), ORDERS)
        return [GridTrial(trial, order) for trial in self.trials(sets) for order in chosen]


def run(plan: StudySize, catalogue_folder: Path | None, say: Report = ignore_progress) -> dict[str, Any]:
    """Run the study; returns its document, schema `boresight.reproduction/1`."""
    if plan.frames <= FIRST_FRAMES:
        raise RefusedInputError(f"{plan.frames} images are too few: give more than {FIRST_FRAMES}.")
    found = run_all(
        run_trial, plan.trials(plan.sets), catalogue_folder, plan.processes,
        lambda trial, share: say(f"set {trial.index + 1} of {plan.sets}", SETS_SHARE * share),
    )  # fmt: skip
    varied = run_all(
        run_grid, plan.grid_trials(), catalogue_folder, plan.processes,
        lambda trial, share: say(f"settings, stars in {trial.order}", SETS_SHARE + (0.95 - SETS_SHARE) * share),
    )  # fmt: skip
    measured = run_on_one_thread(timing, catalogue_folder) | {"grid_s": sum(seconds for _, seconds in varied)}
    say("times", 1.0)
    return document(described(plan), list(chain(*found)), measured, list(chain(*(records for records, _ in varied))))


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
    curves = ("frame",), ("label", "unit", "truth")
    return write_study("wu", document, render(document), out, curves, sets=_set_lines(document))


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
