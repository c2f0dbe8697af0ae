"""The whole study of E: which sets, on how many processes, the document that comes out, and the files that it is written to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.errors import RefusedInputError
from boresight.papers.documents import (
    SCHEMA,
    Finding,
    described,
    head,
    number,
    rendered,
    table_document,
    write_study,
)
from boresight.papers.enright.drawings import draw_convergence, draw_radial, draw_rms, drawings
from boresight.papers.enright.estimators import DRAWN, ESTIMATORS, SPARSE_EVERY, Record, Trial, run_trial
from boresight.papers.enright.findings import findings, questions
from boresight.papers.enright.grid import FEW, SENSOR, SETTINGS, GridTrial, grids, run_grid, split
from boresight.papers.enright.pooled import Pooled
from boresight.papers.enright.printed import TABLE_I, TABLE_II
from boresight.papers.enright.tables import tables
from boresight.papers.processes import Report, run_all
from boresight.simulation.sensors import SENSOR_NUMBERS
from boresight.waiting import ignore_progress

PAPER = "Enright, Jovanovic, Vaz, “Autonomous Recalibration of Star Trackers”, IEEE Sensors Journal, 2018"


def document(
    plan: dict[str, Any], records: Sequence[Record], varied: Sequence[Finding] = (), grid_s: float = 0.0
) -> dict[str, Any]:
    """Write a study as JSON values."""
    pooled = Pooled(records)
    made, drawn = [table_document(table) for table in tables(pooled)], drawings(pooled)
    return {
        "schema": SCHEMA,
        "paper": PAPER,
        "plan": plan,
        "flight_tolerance_rad": next(record["validation"]["flight_tolerance_rad"] for record in records),
        **head(made, drawn),
        "tables": made,
        "figures": drawn,
        "estimators": pooled.statistics(),
        "grids": grids(pooled, varied),
        "findings": findings(pooled),
        "questions": questions(pooled),
        "settings": {key: estimator.settings.document() for key, estimator in ESTIMATORS.items()},
        "records": [_drop_drawn(record) for record in records],
        "timing": _timing(pooled) | {"grid_s": grid_s},
    }


def _drop_drawn(record: Record) -> Record:
    """Leave out of a record what the figures hold, and times."""
    return {key: value for key, value in record.items() if key not in {*DRAWN, "timing_s"}}


def _timing(pooled: Pooled) -> dict[str, Any]:
    """Milliseconds a frame of each estimator, matching included: the median over sets, by the clock of this run."""
    spent = {
        key: [1e3 * record["timing_s"]["calibration"] / max(record["frames"], 1) for record in pooled.list_records(key)]
        for key in ESTIMATORS
    }
    return {"ms_per_frame": {key: float(np.median(times)) for key, times in spent.items() if times}}


#: Share of a study's time that its sets take.
SETS_SHARE = 0.9


@dataclass(frozen=True)
class StudySize:
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

    def grid_trials(self) -> list[GridTrial]:
        """List the settings of the filters where their sensor is run, in a quick study a part of them."""
        trial = Trial(SENSOR, 0, self.frames, self.validation_frames)
        return split(trial, FEW if self.quick else SETTINGS) if SENSOR in self.sensors else []


def run(plan: StudySize, catalogue_folder: Path | None, say: Report = ignore_progress) -> dict[str, Any]:
    """Run the study; returns its document, schema `boresight.reproduction/1`."""
    plan.check()
    found = run_all(
        run_trial,
        plan.trials(),
        catalogue_folder,
        plan.processes,
        lambda trial, share: say(f"sensor {trial.sensor}, set {trial.index + 1} of {plan.sets}", SETS_SHARE * share),
    )
    varied = run_all(
        run_grid,
        plan.grid_trials(),
        catalogue_folder,
        plan.processes,
        lambda _, share: say("settings of the filters", SETS_SHARE + (1 - SETS_SHARE) * share),
    )
    settings, seconds = list(chain(*(made for made, _ in varied))), sum(seconds for _, seconds in varied)
    return document(described(plan), list(chain(*found)), settings, seconds)


Document = Mapping[str, Any]

DRAW: dict[str, Callable[[Mapping[str, Any]], go.Figure]] = {
    "3a": draw_convergence,
    "3b": draw_convergence,
    "4": draw_rms,
    "5": draw_radial,
}


def write(document: Document, out: Path) -> list[Path]:
    """Write every file of a study into a folder, made where it is not there; returns their paths."""
    curves = ("frame", "radius_px"), ("estimator", "label")
    return write_study("enright", document, render(document), out, curves, estimators=_estimator_lines(document))


def render(document: Document) -> str:
    """Render the report as HTML text."""
    inputs = {"table_i": TABLE_I, "table_ii": TABLE_II}
    lines = list(_record_lines(document))
    return rendered("papers/enright.html", document, DRAW, ukf_cost=ukf_cost(document), lines=lines, **inputs)


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
    spreads = *(f"nees_{key}" for key in _NEES), *(f"ratio_to_bound_{key}" for key in _RATIO)
    yield "estimator", "sets", "converged", *spreads
    for found in document["estimators"]:
        nees, ratio = found["nees"] or dict.fromkeys(_NEES), found["ratio_to_bound"] or dict.fromkeys(_RATIO)
        spread = *(nees[key] for key in _NEES), *(ratio[key] for key in _RATIO)
        yield found["estimator"], found["sets"], found["converged"], *spread


_NEES = ("mean", "median", "expected", "lower", "upper")
_RATIO = ("value", "lower", "upper", "median")
