"""What a reproduction's document holds whatever the paper: tables of judged rows, counted verdicts, versions.

The rule that judges a row: reproduced, in kind, or not reproduced.

A cell holds the printed number p, ours o, and the interval [low, high] that our number has (95 % by bootstrap over frames, three
standard deviations of an estimated parameter, or the spread over simulated sets), widened by half of the last printed digit; both
count from an origin, 0 but for a focal length. Then

    reproduced        p lies in the interval, or |o - p| <= 10 % of |p|
    in kind           o and p have the same sign and 1/sqrt(10) <= o/p <= sqrt(10)
    not reproduced    otherwise

and a row is

    reproduced        when all of its cells are and its conclusion holds
    in kind           when every cell is reproduced or in kind and its conclusion holds
    not reproduced    otherwise.

The conclusion is the statement that the paper's text draws from such a row, as a number that can fail; each table states its
own. A figure has no printed numbers, so it is at best in kind: its conclusion decides.

Why a cell is not reproduced is never guessed from the number: each column carries beforehand the cause that can move it:
`no orbital data` (the paper's telemetry, noise and skies are not public), `no field data` (nor are its images), `erratum` (a
printed equation or sentence is wrong), or `unstated setting` (Q, P_0, the matching tolerance are not given). A conclusion carries
the cause that can make it fail likewise.

A reproduction written down, whatever the paper: one HTML file that stands alone, JSON, tables and curves as CSV.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import log10
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import plotly.graph_objects as go
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from boresight import __version__
from boresight.calibration.result import versions
from boresight.errors import RefusedInputError
from boresight.figures.report import embed_figures
from boresight.figures.style import theme
from boresight.resources import folder

REPRODUCED, IN_KIND, NOT_REPRODUCED = "reproduced", "in kind", "not reproduced"
VERDICTS = (REPRODUCED, IN_KIND, NOT_REPRODUCED)

RELATIVE_TOLERANCE = 0.10
SAME_ORDER = 10**0.5
CAUSES = ("no orbital data", "no field data", "erratum", "unstated setting")


@dataclass(frozen=True)
class Cell:
    """One printed number beside ours."""

    column: str
    unit: str
    printed: float
    ours: float | None
    low: float | None = None
    high: float | None = None
    resolution: float = 0.0
    origin: float = 0.0
    cause: str = "no orbital data"
    because: str = ""

    @property
    def verdict(self) -> str:
        """Judge this cell alone."""
        if self.ours is None:
            return NOT_REPRODUCED
        if self._within(self.ours) or abs(self.ours - self.printed) <= RELATIVE_TOLERANCE * abs(
            self.printed - self.origin
        ):
            return REPRODUCED
        return IN_KIND if self._same_order() else NOT_REPRODUCED

    def _within(self, ours: float) -> bool:
        """Whether the printed number, as rounded, touches our interval."""
        low = ours if self.low is None else self.low
        high = ours if self.high is None else self.high
        return low - self.resolution / 2 <= self.printed <= high + self.resolution / 2

    def _same_order(self) -> bool:
        """Whether both have one sign and stay within half a decade."""
        if self.ours is None or self.printed == self.origin:
            return False
        return 1 / SAME_ORDER <= (self.ours - self.origin) / (self.printed - self.origin) <= SAME_ORDER


@dataclass(frozen=True)
class Conclusion:
    """What the text draws from a row: whether it holds here, by which figures, and which cause could make it fail."""

    holds: bool
    sentence: str
    cause: str = "no orbital data"
    because: str = ""


@dataclass(frozen=True)
class Row:
    """A row with its verdict and the reason."""

    label: str
    cells: tuple[Cell, ...]
    conclusion: Conclusion
    verdict: str
    reason: str


def judge(label: str, cells: Sequence[Cell], conclusion: Conclusion) -> Row:
    """Judge a row by its worst cell and its conclusion, and say why."""
    found = [cell.verdict for cell in cells] or [IN_KIND]
    worst = max(found, key=VERDICTS.index)
    verdict = worst if conclusion.holds else NOT_REPRODUCED
    return Row(label, tuple(cells), conclusion, verdict, _reason(cells, conclusion))


def _reason(cells: Sequence[Cell], conclusion: Conclusion) -> str:
    """Name what agreed and, by cause, what did not."""
    apart: dict[tuple[str, str], list[str]] = {}
    for cell in cells:
        if cell.verdict != REPRODUCED:
            apart.setdefault((cell.cause, cell.because), []).append(cell.column)
    agreed = len(cells) - sum(map(len, apart.values()))
    sentences = [f"{agreed} of {len(cells)} numbers agree."] if cells else ["The paper's figure prints no numbers."]
    sentences += [
        _sentence(f"{cause.capitalize()} ({', '.join(columns)})", because)
        for (cause, because), columns in apart.items()
    ]
    sentences.append(f"Conclusion {'holds' if conclusion.holds else 'fails'}: {conclusion.sentence}")
    if not conclusion.holds:
        sentences.append(_sentence(f"{conclusion.cause.capitalize()} (conclusion)", conclusion.because))
    return " ".join(sentences)


def _sentence(cause: str, because: str) -> str:
    return f"{cause}: {because}." if because else f"{cause}."


SCHEMA = "boresight.reproduction/1"
Finding = dict[str, str | list[str] | bool]
Drawing = dict[str, Any]


def finding(title: str, text: str, *sentences: str, is_timed: bool = False) -> Finding:
    """Write a finding: what it is about, what the paper's text says, and the sentences that hold figures against it.

    `is_timed`: The report adds what it cost by the clock; named in the document only where it is so.
    """
    written: Finding = {"title": title, "text": text, "sentences": list(sentences)}
    return written | {"is_timed": True} if is_timed else written


def drawing(number: str, title: str, claim: str, conclusion: Conclusion, curves: Sequence[Drawing]) -> Drawing:
    """Write a figure, judged by its conclusion."""
    row = judge(number, (), conclusion)
    judged = {"verdict": row.verdict, "reason": row.reason}
    return {"number": number, "title": title, "claim": claim, **judged, "curves": list(curves)}


def styled_curves(drawing: Mapping[str, Any], *keys: str) -> Iterator[Any]:
    """Yield each curve's style and, in the order of the keys, its columns (n,); null is NaN."""
    curves = drawing["curves"]
    for curve, style in zip(curves, theme.label_styles([one["label"] for one in curves]), strict=True):
        yield style, *(np.array(curve[key], dtype=np.float64) for key in keys)


def described(plan: Any) -> dict[str, Any]:
    """Write a plan as JSON, with the versions that computed it; on how many processes it ran changes nothing."""
    return {key: value for key, value in asdict(plan).items() if key != "processes"} | {"versions": dict(versions())}


@dataclass(frozen=True)
class Table:
    """One table: number and title of the paper, what its rows are judged by, the heading of the labels, and the rows."""

    number: str
    title: str
    conclusion: str
    head: str
    rows: tuple[Row, ...]


def table_document(table: Table) -> dict[str, Any]:
    """Write a table as JSON values."""
    return {
        "number": table.number,
        "title": table.title,
        "conclusion": table.conclusion,
        "head": table.head,
        "rows": [_row(row) for row in table.rows],
    }


def _row(row: Row) -> dict[str, Any]:
    cells = [{**asdict(cell), "verdict": cell.verdict} for cell in row.cells]
    return {"label": row.label, "verdict": row.verdict, "reason": row.reason, "cells": cells}


def verdict_counts(tables: Sequence[Mapping[str, Any]], figures: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Count the verdicts of all rows and figures, each of the three named."""
    counts = Counter(item["verdict"] for item in (*(row for table in tables for row in table["rows"]), *figures))
    return {verdict: counts[verdict] for verdict in VERDICTS}


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
