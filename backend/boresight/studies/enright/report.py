"""The study written down: one HTML file that stands alone, its document as JSON, tables and curves as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import log10
from pathlib import Path
from typing import Any

import orjson
import plotly.graph_objects as go
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from boresight import __version__
from boresight.errors import RefusedInputError
from boresight.figures import enright_convergence, enright_radial, enright_rms
from boresight.figures.chart import figure_json
from boresight.figures.theme import LIGHT_TEMPLATE
from boresight.resources import folder
from boresight.studies.enright.estimators import ESTIMATORS, SPARSE_EVERY
from boresight.studies.enright.printed import TABLE_I, TABLE_II

Document = Mapping[str, Any]

DRAW: dict[str, Callable[[Mapping[str, Any]], go.Figure]] = {
    "3a": enright_convergence.draw,
    "3b": enright_convergence.draw,
    "4": enright_rms.draw,
    "5": enright_radial.draw,
}
CELL_COLUMNS = ("column", "unit", "printed", "ours", "low", "high", "verdict", "cause", "because")


def write(document: Document, out: Path) -> list[Path]:
    """Write every file of a study into a folder, made where it is not there; returns their paths.

    Raises
    ------
    RefusedInputError
        When a file cannot be written.
    """
    files = {
        "enright.html": render(document).encode(),
        "enright.json": orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE),
        "enright-tables.csv": _csv(_table_lines(document)),
        "enright-estimators.csv": _csv(_estimator_lines(document)),
        "enright-figures.csv": _csv(_figure_lines(document)),
    }
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, data in files.items():
            (out / name).write_bytes(data)
    except OSError as error:
        raise RefusedInputError(f"{out} cannot be written: {error.strerror}; choose another place.") from error
    return [out / name for name in files]


def render(document: Document) -> str:
    """Render the report as HTML text."""
    loader = FileSystemLoader(folder("frontend") / "templates")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    environment.filters |= {"number": number, "as_printed": printed_digits}
    return environment.get_template("reproduction.html").render(
        document=document,
        plan=document["plan"],
        table_i=TABLE_I,
        table_ii=TABLE_II,
        ukf_cost=ukf_cost(document),
        lines=list(_record_lines(document)),
        figures_json=_inline(document["figures"]),
        plotly=Markup(get_plotlyjs()),  # noqa: S704 - the library's own file, as its writer inlines it
        version=__version__,
    )


def number(value: float | None, digits: int = 4) -> str:
    """Write a number with so many significant digits, a dash where there is none."""
    return "–" if value is None else f"{value:.{digits}g}".replace("-", "−")


def printed_digits(value: float | None, resolution: float) -> str:
    """Write a number with as many decimals as the paper prints."""
    return "–" if value is None else f"{value:.{round(-log10(resolution))}f}".replace("-", "−")


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


def _inline(drawings: Sequence[Mapping[str, Any]]) -> Markup:
    """Encode the figures, in the light template, so that no text in them can end the script element."""
    parts = []
    for drawing in drawings:
        figure = DRAW[drawing["number"]](drawing)
        figure.update_layout(template=LIGHT_TEMPLATE, meta=None)
        parts.append(f'"{drawing["number"]}":{figure_json(figure).decode()}')
    text = "{" + ",".join(parts) + "}"
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))  # noqa: S704 - escaped here


def _csv(lines: Iterable[Sequence[Any]]) -> bytes:
    """Encode lines, None as an empty cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue().encode()


def _table_lines(document: Document) -> Iterable[Sequence[Any]]:
    yield "table", "row", *CELL_COLUMNS, "row_verdict", "row_reason"
    for table in document["tables"]:
        for row in table["rows"]:
            for cell in row["cells"]:
                values = [cell[column] for column in CELL_COLUMNS]
                yield table["number"], row["label"], *values, row["verdict"], row["reason"]


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


def _figure_lines(document: Document) -> Iterable[Sequence[Any]]:
    yield "figure", "curve", "axis", "x", "quantity", "y"
    for drawing in document["figures"]:
        for curve in drawing["curves"]:
            axis = "frame" if "frame" in curve else "radius_px"
            for quantity in sorted(set(curve) - {"estimator", "label", axis}):
                for x, y in zip(curve[axis], curve[quantity], strict=True):
                    yield drawing["number"], curve["estimator"], axis, x, quantity, y
