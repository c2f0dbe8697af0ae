"""The study written down: one HTML file that stands alone, its document as JSON, tables and curves as CSV.

Words that findings and answers share: what an estimator's sets say, in one clause with its intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from boresight.figures.charts import enright as enright_convergence
from boresight.papers.enright.estimators import ESTIMATORS, SPARSE_EVERY
from boresight.papers.enright.pooled import Pooled, Record
from boresight.papers.enright.printed import TABLE_I, TABLE_II
from boresight.papers.enright.tables import URAD_PER_RAD
from boresight.papers.reports import (
    csv_bytes,  # fmt: skip
    figure_lines,  # fmt: skip
    json_bytes,  # fmt: skip
    number,  # fmt: skip
    rendered,  # fmt: skip
    table_lines,  # fmt: skip
    write_files,  # fmt: skip
)

Document = Mapping[str, Any]

DRAW: dict[str, Callable[[Mapping[str, Any]], go.Figure]] = {
    "3a": enright_convergence.draw,
    "3b": enright_convergence.draw,
    "4": enright_convergence.draw_enright_rms,
    "5": enright_convergence.draw_enright_radial,
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


Finding = dict[str, Any]


def finding(title: str, text: str, sentences: Sequence[str]) -> Finding:
    """Write a finding: what it is about, what the paper's text says, and the sentences that hold figures against it."""
    return {"title": title, "text": text, "sentences": list(sentences)}


def statistics(pooled: Pooled, key: str) -> Record:
    """Return the pooled statistics of one estimator."""
    return next(found for found in pooled.statistics() if found["estimator"] == key)


def described(pooled: Pooled, key: str) -> str:
    """Write NEES and ratio to the bound of an estimator, with their intervals."""
    found = statistics(pooled, key)
    nees, ratio = found["nees"], found["ratio_to_bound"]
    words = [ESTIMATORS[key].label]
    if found["converged"] < found["sets"]:
        words.append(f"{found['converged']} of {found['sets']} sets converged")
    if nees is not None:
        spread = f"median {nees['median']:.4g}; {nees['lower']:.1f} to {nees['upper']:.1f} expected"
        words.append(f"NEES {nees['mean']:.4g} ({spread})")
    if ratio is not None:
        spread = f"{ratio['lower']:.2f} to {ratio['upper']:.2f}; median {ratio['median']:.2f}"
        words.append(f"error {ratio['value']:.2f} times the Cramér-Rao bound ({spread})")
    return ", ".join(words)


def over_bound(pooled: Pooled, key: str) -> float:
    """Ratio of errors to the bound; infinite where no set converged."""
    ratio = statistics(pooled, key)["ratio_to_bound"]
    return float(ratio["value"]) if ratio is not None else float("inf")


def validation_urad(record: Record) -> float:
    """RMS arc error on the validation set, µrad."""
    return float(record["validation"]["rms_arc_rad"]["final"]) * URAD_PER_RAD


def listed(sensors: Sequence[int]) -> str:
    """Name sensors."""
    return "sensor " + ", ".join(map(str, sensors)) if sensors else "no sensor"


def by_sensor(records: Sequence[Record], numbers: Sequence[float | None], decimals: int = 0) -> str:
    """Write a number of each sensor, a dash where there is none."""
    written = ("–" if number is None else f"{number:.{decimals}f}" for number in numbers)
    return ", ".join(f"{record['sensor']}: {text}" for record, text in zip(records, written, strict=True))
