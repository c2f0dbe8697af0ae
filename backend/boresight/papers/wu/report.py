"""The study written down: one HTML file that stands alone, its document as JSON, tables, sets and curves as CSV."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from boresight.figures.charts import wu as wu_criteria
from boresight.papers.reports import csv_bytes, figure_lines, json_bytes, rendered, table_lines, write_files
from boresight.papers.wu.drawings import LABELS
from boresight.papers.wu.tables import NAMES
from boresight.simulation.sensors import WU_START, WU_TRUTH, WU_TYPICAL_SIGMA

Document = Mapping[str, Any]

DRAW: dict[str, Callable[[Mapping[str, Any]], go.Figure]] = {
    "3": wu_criteria.draw_wu_observability,
    "4": wu_criteria.draw_wu_observability,
    "6a": wu_criteria.draw,
    "6b": wu_criteria.draw,
    "8": wu_criteria.draw_wu_parameters,
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
