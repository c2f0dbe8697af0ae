"""What a reproduction's document holds whatever the paper: tables of judged rows, counted verdicts, versions.

A cell holds a printed number p, ours o, and the interval [low, high] that our number has (95 % by bootstrap over frames, three
standard deviations of an estimated parameter, or the spread over simulated sets), widened by half of the last printed digit; both
count from an origin, 0 but for a parameter that is judged by its distance from another estimate. Its verdict is

    reproduced            when p lies in the interval, or |o - p| <= 10 % of |p|
    in kind               when o and p have the same sign and 1/2 <= o/p <= 2
    better                when o is an estimation error and |o| < |p| / 2: better by the factor |p| / |o|
    data not published    otherwise, when the cause that the column carries is data that are not public; and always of a number
                          that no simulation can stand for
    not reproduced        otherwise.

Of an error that is as often positive as negative, |o| is the root mean square over the sets. Better is said of estimation errors
alone: a residual that holds the noise of a simulation of ours is no merit.

A row has the last of its cells' verdicts in that order, and is not reproduced when its statement fails: what the paper's text draws
from such a row, as a number that can fail; each table states its own. A figure has no printed numbers, so it is at best in kind:
its statement decides.

The head counts every printed number once, and beside the numbers the statements. Left out of both, by reason:

    circular    the simulation was made from this number, so that ours could not but agree
    repeated    the paper prints it at another place too
    variant     the same number made again under another reading of a setting
    derived     arithmetic on printed numbers that are counted themselves; such a row's statement still counts

Why a cell is not reproduced is never guessed from the number: each column carries beforehand the cause that can move it:
`no orbital data` (the paper's telemetry, noise and skies are not public), `no field data` (nor are its images), `erratum` (a
printed equation or sentence is wrong), or `unstated setting` (Q, P_0, the matching tolerance are not given). A statement carries
the cause that can make it fail likewise.

A reproduction written down, whatever the paper: one HTML file that stands alone, JSON, tables and curves as CSV.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import log10
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import plotly.graph_objects as go
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from boresight import __version__
from boresight.arrays import FloatArray
from boresight.calibration.result import versions
from boresight.errors import RefusedInputError
from boresight.figures.report import embed_figures
from boresight.figures.style import theme
from boresight.resources import folder

REPRODUCED, IN_KIND, BETTER = "reproduced", "in kind", "better"
NOT_PUBLISHED, NOT_REPRODUCED = "data not published", "not reproduced"
VERDICTS = (REPRODUCED, IN_KIND, BETTER, NOT_PUBLISHED, NOT_REPRODUCED)

RELATIVE_TOLERANCE = 0.10
SAME_KIND = 2.0
#: Settings of a grid that the page shows.
NEAREST = 8
#: No ratio counts for more in a typical factor.
FAR = 100.0
NO_DATA = ("no orbital data", "no field data")
CAUSES = (*NO_DATA, "erratum", "unstated setting")
CIRCULAR, REPEATED, VARIANT, DERIVED = "circular", "repeated", "variant", "derived"
LEFT_OUT = (CIRCULAR, REPEATED, VARIANT, DERIVED)


@dataclass(frozen=True)
class Cell:
    """One printed number beside ours.

    `error`: size of ours where it is an estimation error. `published`: False where no simulation can stand for the number.
    `left_out`: why the head does not count it, one of `LEFT_OUT`.
    """

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
    error: float | None = None
    published: bool = True
    left_out: str = ""

    @property
    def verdict(self) -> str:
        """Judge this cell alone."""
        if not self.published:
            return NOT_PUBLISHED
        if self.ours is None:
            return NOT_REPRODUCED
        if self._within(self.ours) or abs(self.ours - self.printed) <= RELATIVE_TOLERANCE * abs(
            self.printed - self.origin
        ):
            return REPRODUCED
        if self._same_kind(self.ours):
            return IN_KIND
        if self.factor is not None:
            return BETTER
        return NOT_PUBLISHED if self.cause in NO_DATA else NOT_REPRODUCED

    @property
    def factor(self) -> float | None:
        """How many times smaller our error is than the printed one, beyond `SAME_KIND`; None for a number that is not an error."""
        if not self.error or abs(self.printed) <= SAME_KIND * self.error:
            return None
        return abs(self.printed) / self.error

    def _within(self, ours: float) -> bool:
        """Whether the printed number, as rounded, touches our interval."""
        low = ours if self.low is None else self.low
        high = ours if self.high is None else self.high
        return low - self.resolution / 2 <= self.printed <= high + self.resolution / 2

    def _same_kind(self, ours: float) -> bool:
        """Whether both have one sign and stay within a factor of two."""
        if self.printed == self.origin:
            return False
        return 1 / SAME_KIND <= (ours - self.origin) / (self.printed - self.origin) <= SAME_KIND


@dataclass(frozen=True)
class Conclusion:
    """What the text states of a row: whether it holds here, by which figures, and which cause could make it fail."""

    holds: bool
    sentence: str
    cause: str = "no orbital data"
    because: str = ""


@dataclass(frozen=True)
class Row:
    """A row with its verdict and the reason; `left_out` says why the head counts neither its numbers nor its statement."""

    label: str
    cells: tuple[Cell, ...]
    conclusion: Conclusion
    verdict: str
    reason: str
    left_out: str = ""


def judge(label: str, cells: Sequence[Cell], conclusion: Conclusion, left_out: str = "") -> Row:
    """Judge a row by its last cell in the order of the verdicts and by its statement, and say why."""
    cells = tuple(replace(cell, left_out=left_out or cell.left_out) for cell in cells)
    found = [cell.verdict for cell in cells] or [IN_KIND]
    verdict = max(found, key=VERDICTS.index) if conclusion.holds else NOT_REPRODUCED
    return Row(label, cells, conclusion, verdict, _reason(cells, conclusion), left_out)


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
    better = [f"{cell.column} by a factor of {cell.factor:.1f}" for cell in cells if cell.verdict == BETTER]
    sentences += [f"Our error is smaller: {', '.join(better)}."] if better else []
    sentences.append(f"Conclusion {'confirmed' if conclusion.holds else 'not confirmed'}: {conclusion.sentence}")
    if not conclusion.holds:
        sentences.append(_sentence(f"{conclusion.cause.capitalize()} (conclusion)", conclusion.because))
    return " ".join(sentences)


def _sentence(cause: str, because: str) -> str:
    return f"{cause}: {because}." if because else f"{cause}."


SCHEMA = "boresight.reproduction/1"
Finding = dict[str, Any]
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
    judged = {"verdict": row.verdict, "holds": conclusion.holds, "reason": row.reason}
    return {"number": number, "title": title, "claim": claim, **judged, "curves": list(curves)}


def styled_curves(drawing: Mapping[str, Any], *keys: str) -> Iterator[Any]:
    """Yield each curve's style and, in the order of the keys, its columns (n,); null is NaN."""
    curves = drawing["curves"]
    for curve, style in zip(curves, theme.label_styles([one["label"] for one in curves]), strict=True):
        yield style, *(np.array(curve[key], dtype=np.float64) for key in keys)


def padded(values: Iterable[float]) -> list[float]:
    """Range of an axis that holds values, with a margin of a twentieth of their reach."""
    seen = list(values)
    margin = 0.05 * (max(seen) - min(seen)) or 1.0
    return [min(seen) - margin, max(seen) + margin]


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
    cells = []
    for cell in row.cells:
        factor = cell.factor if cell.verdict == BETTER else None
        cells.append({**asdict(cell), "verdict": cell.verdict, "factor": factor})
    judged = {"verdict": row.verdict, "holds": row.conclusion.holds, "left_out": row.left_out, "reason": row.reason}
    return {"label": row.label, **judged, "cells": cells}


def compute_typical_factor(ratios: FloatArray) -> float:
    """Typical factor exp sqrt(mean ln^2 r) of ratios r of ours to the print; those beyond `FAR` or below 0 count as `FAR`."""
    r = np.clip(np.nan_to_num(ratios, nan=FAR, posinf=FAR), 1 / FAR, FAR)
    return float(np.exp(np.sqrt(np.mean(np.log(r) ** 2))))


def count_within_two(ratios: FloatArray) -> int:
    """How many of our numbers have the printed sign and lie within a factor of two."""
    return int(np.sum((ratios >= 1 / SAME_KIND) & (ratios <= SAME_KIND)))


def grid_document(title: str, about: str, axes: Sequence[str], found: Sequence[Finding], ours: Finding) -> Finding:
    """Write a grid of settings: what was varied, every setting with its typical factor, and which come nearest.

    `about`: which printed numbers it is held against. `axes`: keys of a setting. `found`: settings with `factor`, `within_two` and
    `numbers`. `ours`: the setting that the tables are made with, one of them.
    """
    found = sorted(found, key=lambda one: float(one["factor"]))
    nearest, most = found[0], max(found, key=lambda one: int(one["within_two"]))
    by_axis = {axis: _best_by_value(found, axis) for axis in axes}
    numbers = nearest["numbers"]
    if most["within_two"] == numbers:
        verdict = f"All {numbers} are reproduced within a factor of two by {_named(most, axes)}"
    else:
        best = f"the best is {_named(most, axes)} with {most['within_two']}"
        verdict = f"No setting reproduces all {numbers} within a factor of two; {best}"
    values = "; ".join(f"{axis} {_listed(best)}" for axis, best in by_axis.items() if len(best) > 1)
    said = [
        f"Of {len(found)} settings the nearest is {_named(nearest, axes)}: typical factor {nearest['factor']:.2f} on {about}.",
        f"Ours is {_named(ours, axes)}: typical factor {ours['factor']:.2f}.",
        f"{verdict} (the nearest {nearest['within_two']}, ours {ours['within_two']}).",
        f"Smallest factor by value: {values}.",
    ]
    return {"title": title, "about": about, "axes": by_axis, "ours": ours, "settings": found, "sentences": said}


def _best_by_value(found: Sequence[Finding], axis: str) -> dict[str, float]:
    """Smallest typical factor of each value of an axis."""
    best: dict[str, float] = {}
    for one in found:
        best.setdefault(str(one[axis]), float(one["factor"]))
    return best


def _named(setting: Finding, axes: Sequence[str]) -> str:
    return ", ".join(f"{axis} {setting[axis]}" for axis in axes)


def _listed(best: Mapping[str, float]) -> str:
    return ", ".join(f"{value}: {factor:.2f}" for value, factor in best.items())


Judged = Sequence[Mapping[str, Any]]


def head(tables: Judged, figures: Judged) -> dict[str, Any]:
    """Count the verdicts of printed numbers, each once, what was left out by reason, and the statements that hold and fail."""
    rows = [row for table in tables for row in table["rows"]]
    cells = [cell for row in rows for cell in row["cells"]]
    found = Counter(cell["verdict"] for cell in cells if not cell["left_out"])
    left_out = Counter(cell["left_out"] for cell in cells)
    holds = [bool(one["holds"]) for one in (*(row for row in rows if not row["left_out"]), *figures)]
    return {
        "verdicts": {verdict: found[verdict] for verdict in VERDICTS},
        "left_out": {reason: left_out[reason] for reason in LEFT_OUT},
        "statements": {"hold": sum(holds), "fail": len(holds) - sum(holds)},
    }


def add_heads(document: Mapping[str, Any]) -> dict[str, dict[str, int]]:
    """Add the counts of what a clock says, which stand apart in a document, to the others."""
    keys, timed = ("verdicts", "left_out", "statements"), document["timing"]
    return {key: {one: count + timed.get(key, {}).get(one, 0) for one, count in document[key].items()} for key in keys}


def head_sentences(document: Mapping[str, Any]) -> list[str]:
    """Say what the head counts."""
    counted = add_heads(document)
    verdicts, statements = counted["verdicts"], counted["statements"]
    said = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    left = ", ".join(f"{count} {reason}" for reason, count in counted["left_out"].items())
    return [
        f"Of {sum(verdicts.values())} printed numbers, each counted once: {said}.",
        f"Of {sum(statements.values())} statements, {statements['hold']} are confirmed and {statements['fail']} are not.",
        f"Left out of the numbers: {left}.",
    ]


Document = Mapping[str, Any]
Lines = Iterable[Sequence[Any]]
Draw = Mapping[str, Callable[[Mapping[str, Any]], go.Figure]]

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
CELL_COLUMNS = (
    "column", "unit", "printed", "ours", "low", "high", "verdict", "factor", "left_out", "cause", "because",
)  # fmt: skip


def write_study(
    name: str, document: Document, page: str, out: Path, curves: tuple[Sequence[str], Sequence[str]], **more: Lines
) -> list[Path]:
    """Write every file of a study: its page, its JSON, and as CSV its tables, its figures and `more`; returns their paths.

    `curves`: what the curves of the figures run over, and what they are named by.
    """
    tables = {"tables": table_lines(document), "figures": figure_lines(document, *curves), **more}
    files = {f"{name}.html": page.encode(), f"{name}.json": json_bytes(document)}
    return write_files(files | {f"{name}-{part}.csv": csv_bytes(lines) for part, lines in tables.items()}, out)


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
        counted=add_heads(document),
        nearest=NEAREST,
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
    """Write a number with as many decimals as the paper prints; zero has no sign."""
    return "–" if value is None else f"{value:z.{max(0, round(-log10(resolution)))}f}".replace("-", "−")


def json_bytes(document: Document) -> bytes:
    """Encode a document for people too."""
    return orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)


def csv_bytes(lines: Lines) -> bytes:
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
