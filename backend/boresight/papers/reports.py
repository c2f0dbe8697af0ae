"""A reproduction written down, whatever the paper: one HTML file that stands alone, JSON, tables and curves as CSV."""

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

from boresight import __version__
from boresight.errors import RefusedInputError
from boresight.figures.report import embed_figures
from boresight.resources import folder

Document = Mapping[str, Any]
Draw = Mapping[str, Callable[[Mapping[str, Any]], go.Figure]]

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
CELL_COLUMNS = ("column", "unit", "printed", "ours", "low", "high", "verdict", "cause", "because")


def write_files(files: Mapping[str, bytes], out: Path) -> list[Path]:
    """Write files into a folder, made where it is not there; returns their paths."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, data in files.items():
            (out / name).write_bytes(data)
    except OSError as error:
        raise RefusedInputError(f"{out} cannot be written: {error.strerror}; choose another place.") from error
    return [out / name for name in files]


def rendered(template: str, document: Document, draw: Draw, **more: Any) -> str:
    """Render a study's page."""
    loader = FileSystemLoader(folder("frontend") / "templates")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    environment.filters |= {"number": number, "as_printed": printed_digits}
    return environment.get_template(template).render(
        document=document,
        plan=document["plan"],
        **embed_figures({one["number"]: draw[one["number"]](one) for one in document["figures"]}),
        version=__version__,
        **more,
    )


def number(value: float | None, digits: int = 4) -> str:
    """Write a number with so many significant digits, powers of ten raised; a dash where there is none."""
    if value is None:
        return "–"
    mantissa, _, exponent = f"{value:.{digits}g}".replace("-", "−").partition("e")
    return f"{mantissa}·10{str(int(exponent.replace('−', '-'))).translate(RAISED)}" if exponent else mantissa


def printed_digits(value: float | None, resolution: float) -> str:
    """Write a number with as many decimals as the paper prints; nought has no sign."""
    return "–" if value is None else f"{value:z.{round(-log10(resolution))}f}".replace("-", "−")


def json_bytes(document: Document) -> bytes:
    """Encode a document for people too."""
    return orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)


def csv_bytes(lines: Iterable[Sequence[Any]]) -> bytes:
    """Encode lines, None as an empty cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue().encode()


def table_lines(document: Document) -> Iterator[Sequence[Any]]:
    """One line a cell of the tables, under a heading."""
    yield "table", "row", *CELL_COLUMNS, "row_verdict", "row_reason"
    for table in document["tables"]:
        for row in table["rows"]:
            for cell in row["cells"]:
                values = [cell[column] for column in CELL_COLUMNS]
                yield table["number"], row["label"], *values, row["verdict"], row["reason"]


def figure_lines(document: Document, axes: Sequence[str], named: Sequence[str]) -> Iterator[Sequence[Any]]:
    """One line a point of the figures, under a heading."""
    yield "figure", "curve", "axis", "x", "quantity", "y"
    for drawing in document["figures"]:
        for curve in drawing["curves"]:
            axis = next(key for key in axes if key in curve)
            for quantity in sorted(set(curve) - {*named, axis}):
                for x, y in zip(curve[axis], curve[quantity], strict=True):
                    yield drawing["number"], curve[named[0]], axis, x, quantity, y
