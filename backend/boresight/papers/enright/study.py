"""The whole study of E: which sets, on how many processes, the document that comes out, and the files that it is written to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.errors import RefusedInputError
from boresight.papers.documents import (
    SCHEMA,
    csv_bytes,  # fmt: skip
    described,
    figure_lines,  # fmt: skip
    json_bytes,  # fmt: skip
    number,  # fmt: skip
    rendered,  # fmt: skip
    table_document,
    table_lines,  # fmt: skip
    verdict_counts,
    write_files,  # fmt: skip
)
from boresight.papers.enright.drawings import draw_convergence, draw_radial, draw_rms, drawings
from boresight.papers.enright.estimators import DRAWN, ESTIMATORS, SPARSE_EVERY, Record, Trial, run_trial
from boresight.papers.enright.findings import findings, questions
from boresight.papers.enright.pooled import Pooled
from boresight.papers.enright.printed import TABLE_I, TABLE_II
from boresight.papers.enright.tables import tables
from boresight.papers.processes import run_all
from boresight.simulation.sensors import SENSOR_NUMBERS

PAPER = "Enright, Jovanovic, Vaz, “Autonomous Recalibration of Star Trackers”, IEEE Sensors Journal, 2018"


def document(plan: dict[str, Any], records: Sequence[Record]) -> dict[str, Any]:
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
        for sensor in self.sensors:
            if sensor not in SENSOR_NUMBERS:
                raise RefusedInputError(f"The paper has no sensor {sensor}: choose from 1 to {max(SENSOR_NUMBERS)}.")

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
    return document(described(plan), ordered)


Document = Mapping[str, Any]

DRAW: dict[str, Callable[[Mapping[str, Any]], go.Figure]] = {
    "3a": draw_convergence,
    "3b": draw_convergence,
    "4": draw_rms,
    "5": draw_radial,
}


def write(document: Document, out: Path) -> list[Path]:
    """Write every file of a study into a folder, made where it is not there; returns their paths."""
    files = {
        "enright.html": render(document).encode(),
        "enright.json": json_bytes(document),
        "enright-tables.csv": csv_bytes(table_lines(document)),
        "enright-estimators.csv": csv_bytes(_estimator_lines(document)),
        "enright-figures.csv": csv_bytes(figure_lines(document, ("frame", "radius_px"), ("estimator", "label"))),
    }
    return write_files(files, out)


def render(document: Document) -> str:
    """Render the report as HTML text."""
    return rendered(
        "papers/enright.html",
        document,
        DRAW,
        table_i=TABLE_I,
        table_ii=TABLE_II,
        ukf_cost=ukf_cost(document),
        lines=list(_record_lines(document)),
    )


def _record_lines(document: Document) -> Iterator[dict[str, Any]]:
    """One line for each estimator and sensor of the sets that the tables show, the numbers with their intervals."""
    for record in document["records"]:
        if record["set"] > 0:
            continue
        found, spread = record["validation"], record["validation"]["intervals"]
        over = record["squared_over_bound"]
        yield {
            "label": ESTIMATORS[record["estimator"]].label,
            "sensor": record["sensor"],
            "cells": (
                _ranged(found["availability"]["final"], spread["availability"]["final"], 1.0),
                _ranged(found["matched_star_ratio"], spread["matched_star_ratio"], 1.0),
                _ranged(found["rms_arc_rad"]["final"], spread["rms_arc_rad"]["final"], 1e6),
                number(record["nees"], 3),
                number(None if over is None else over**0.5, 3),
            ),
        }


def _ranged(value: float | None, interval: Sequence[float | None], factor: float) -> str:
    """Write a number and its interval, in another unit; a dash for an edge that is not known."""
    if value is None:
        return number(None)
    low, high = (number(None if edge is None else edge * factor, 3) for edge in interval)
    return f"{number(value * factor)} ({low} to {high})"


def ukf_cost(document: Document) -> str:
    """Say what the filters cost by the clock, which no seed fixes and the document's findings therefore leave out."""
    spent = document["timing"]["ms_per_frame"]
    said = ", ".join(f"{ESTIMATORS[key].label} {spent[key]:.2f} ms" for key in ("printed", "ekf", "ukf"))
    return (
        f"By the clock of this run, matching included, a frame costs {said}. A UKF on every {SPARSE_EVERY}rd frame can only pay "
        f"where it costs more than {SPARSE_EVERY} times an EKF; here it costs {spent['ukf'] / spent['ekf']:.2f} times."
    )


def _estimator_lines(document: Document) -> Iterable[Sequence[Any]]:
    yield (
        "estimator",
        "sets",
        "converged",
        *(f"nees_{key}" for key in _NEES),
        *(f"ratio_to_bound_{key}" for key in _RATIO),
    )
    for found in document["estimators"]:
        nees, ratio = found["nees"] or dict.fromkeys(_NEES), found["ratio_to_bound"] or dict.fromkeys(_RATIO)
        spread = *(nees[key] for key in _NEES), *(ratio[key] for key in _RATIO)
        yield found["estimator"], found["sets"], found["converged"], *spread


_NEES = ("mean", "median", "expected", "lower", "upper")
_RATIO = ("value", "lower", "upper", "median")
