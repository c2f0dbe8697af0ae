"""The study written down: one HTML file that stands alone, its document as JSON, tables and curves as CSV."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from boresight.figures import enright_convergence, enright_radial, enright_rms
from boresight.studies.enright.estimators import ESTIMATORS, SPARSE_EVERY
from boresight.studies.enright.printed import TABLE_I, TABLE_II
from boresight.studies.reports import (
    csv_bytes,
    figure_lines,
    json_bytes,
    number,
    rendered,
    table_lines,
    write_files,
)  # fmt: skip

Document = Mapping[str, Any]

DRAW: dict[str, Callable[[Mapping[str, Any]], go.Figure]] = {
    "3a": enright_convergence.draw,
    "3b": enright_convergence.draw,
    "4": enright_rms.draw,
    "5": enright_radial.draw,
}


def write(document: Document, out: Path) -> list[Path]:
    """Write every file of a study into a folder, made where it is not there; returns their paths.

    Raises
    ------
    RefusedInputError
        When a file cannot be written.
    """
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
