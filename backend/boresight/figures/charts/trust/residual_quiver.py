"""The field of residuals before and after: the mean residual of each cell of the detector as an arrow, beside its noise.

A circle about an arrow's foot has three sigmas of that mean as its radius, drawn to the same scale, so an arrow that ends inside
is noise and not structure. Before and after have each a scale of their own, with a bar of a round length under the
detector, because a ground calibration's residuals are ten times those of a fit and more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.charts.trust.residual_map import others
from boresight.figures.style import theme
from boresight.figures.trust_parts import absent, column, parts
from boresight.verdicts.numbers import number
from boresight.verdicts.verdict import read_part

TITLE = "Mean residuals over the detector"
PART = "residual_field"
SIDES = ("before", "after")
CLEAR_SIGMA = 3.0
LONGEST_SHARE = 0.8  # of a cell: the typical arrow among the longest
CIRCLE = np.append(np.exp(2j * np.pi * np.arange(17) / 16), np.nan)


@dataclass(frozen=True)
class MeanCells:
    """Cells that have a mean, (n,) each, px: centre, mean residual, its two sigmas, and how many stars."""

    row: FloatArray
    col: FloatArray
    d_row: FloatArray
    d_col: FloatArray
    s_row: FloatArray
    s_col: FloatArray
    count: FloatArray

    @property
    def clear(self) -> NDArray[np.bool_]:
        """Which means stand out of their noise on either axis."""
        out = np.abs(self.d_row) > CLEAR_SIGMA * self.s_row
        return np.asarray(out | (np.abs(self.d_col) > CLEAR_SIGMA * self.s_col))


def read_cells(part: Result, side: str) -> MeanCells:
    """Read one side of a field."""
    edges = column(part["row_edges_px"]), column(part["col_edges_px"])
    row, col = (middle.ravel() for middle in np.meshgrid(*((e[1:] + e[:-1]) / 2 for e in edges), indexing="ij"))
    names = ("mean_row_px", "mean_col_px", "sigma_row_px", "sigma_col_px", "count")
    values = np.stack([row, col, *(column(part[side][name]).ravel() for name in names)])
    return MeanCells(*values[:, np.isfinite(values[2])])


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw the first run's cells, before on the left and after on the right."""
    drawn = parts(traces, PART)
    if not drawn:
        return absent(TITLE, traces, PART)
    _, style, part = drawn[0]
    sides = [side for side in SIDES if part.get(side)]
    titles = [f"{side}: RMS {number(part[side]['rms_in_all_px'], 3)} px" for side in sides]
    figure = make_subplots(1, len(sides), shared_yaxes=True, horizontal_spacing=0.05, subplot_titles=titles)
    for place, side in enumerate(sides, start=1):
        colour = theme.REFERENCE_COLOUR if side == "before" else style.colour
        _side(figure, part, read_cells(part, side), place, colour, style.label)
    after = read_cells(part, "after")
    counted = f"{int(after.clear.sum())} of {len(after.row)} cell means are clear of their noise after"
    title = f"Residuals: {counted}{others([style.label for _, style, _ in drawn])}"
    theme.dress(figure, title=title, height_px=500, legend=False, hovermode="closest", margin={"t": 66})
    _frame(figure, part, len(sides))
    return figure


def choose_scale(cells: MeanCells, size_px: float) -> float:
    """Choose how many times longer than life arrows are drawn in cells of a size: 1, 2 or 5 times a power of ten."""
    longest = float(np.quantile(np.hypot(cells.d_row, cells.d_col), 0.9)) if len(cells.row) else 0.0
    return _round_down(LONGEST_SHARE * size_px / longest) if longest > 0 else 1.0


def _round_down(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, not above the value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-9)) * power)


def _side(figure: go.Figure, part: Result, cells: MeanCells, place: int, colour: str, label: str) -> None:
    """Draw noise circles, arrows, their feet, and the bar that says how long they are."""
    columns, rows = column(part["col_edges_px"]), column(part["row_edges_px"])
    scale, where = choose_scale(cells, float(np.diff(columns).mean())), {"row": 1, "col": place}
    gap = np.full(len(cells.row), np.nan)
    circle_x = cells.col[:, None] + CLEAR_SIGMA * scale * cells.s_col[:, None] * CIRCLE.real
    circle_y = cells.row[:, None] + CLEAR_SIGMA * scale * cells.s_row[:, None] * CIRCLE.imag
    x = np.stack([cells.col, cells.col + scale * cells.d_col, gap], axis=1)
    y = np.stack([cells.row, cells.row + scale * cells.d_row, gap], axis=1)
    quiet = {"mode": "lines", "hoverinfo": "skip", "name": label}
    for lines, width, shade in (((circle_x, circle_y), 0.8, 0.4), ((x, y), 2, 1.0)):
        line = {"width": width, "color": theme.translucent(colour, shade) if shade < 1 else colour}
        figure.add_trace(
            go.Scatter(x=theme.short(lines[0].ravel()), y=theme.short(lines[1].ravel()), line=line, **quiet), **where
        )
    figure.add_trace(_feet(cells, colour, label), **where)
    _bar(figure, (columns[0], columns[-1], rows[-1]), scale, where)


def _feet(cells: MeanCells, colour: str, label: str) -> go.Scatter:
    """Draw where arrows begin: a diamond where the mean is clear of its noise."""
    return go.Scatter(
        x=theme.short(cells.col),
        y=theme.short(cells.row),
        mode="markers",
        name=label,
        marker={
            "color": colour,
            "line": {"width": 0},
            "size": np.where(cells.clear, 8, 4).astype(np.int8),
            "symbol": ["diamond" if clear else "circle" for clear in cells.clear],
        },
        customdata=theme.short(np.stack([cells.d_row, cells.s_row, cells.d_col, cells.s_col, cells.count], axis=1)),
        hovertemplate=(
            "rows %{customdata[0]:+.3f} ± %{customdata[1]:.3f} px<br>columns %{customdata[2]:+.3f} ± %{customdata[3]:.3f} px"
            "<br>%{customdata[4]:.0f} stars<extra></extra>"
        ),
    )


def _bar(figure: go.Figure, corner: tuple[float, float, float], scale: float, where: dict[str, int]) -> None:
    """Draw a round length of residual under the detector, to scale."""
    left, right, bottom = corner
    length = _round_down(0.15 * (right - left) / scale)
    at = bottom + 0.05 * (right - left)
    figure.add_trace(
        go.Scatter(
            x=[left, left + length * scale],
            y=[at, at],
            mode="lines+markers+text",
            line={"color": theme.REFERENCE_COLOUR, "width": 2},
            marker={"symbol": "line-ns-open", "size": 9, "color": theme.REFERENCE_COLOUR},
            text=["", f"  {number(length, 1)} px, {scale:,.0f} times"],
            textposition="middle right",
            hoverinfo="skip",
        ),
        **where,
    )


def _frame(figure: go.Figure, part: Result, n_sides: int) -> None:
    """Make the subplots detectors, row 0 on top, with room for the bar below."""
    rows, columns = part["row_edges_px"], part["col_edges_px"]
    quiet = {"showgrid": False, "zeroline": False, "constrain": "domain"}
    for place in range(1, n_sides + 1):
        anchor, where = "x" if place == 1 else f"x{place}", {"row": 1, "col": place}
        figure.update_xaxes(
            title_text="column (px)", nticks=6, tickangle=0, range=[columns[0], columns[-1]], **quiet, **where
        )
        bottom = rows[-1] + 0.1 * (columns[-1] - columns[0])
        figure.update_yaxes(scaleanchor=anchor, scaleratio=1, range=[bottom, rows[0]], **quiet, **where)
    figure.update_yaxes(title_text="row (px)", row=1, col=1)


def table(result: Result) -> Table:
    """List one cell a row and side: its centre, mean residual with sigmas in px, and how many stars it has."""
    part = read_part(result, PART)
    if not part:
        return {}
    columns: Table = {"when": []}
    for side in SIDES:
        if part.get(side):
            cells = read_cells(part, side)
            columns["when"] += [side] * len(cells.row)
            for name, values in vars(cells).items():
                columns.setdefault(COLUMN_OF[name], []).extend(theme.plain(values))
    return columns


COLUMN_OF = {
    "row": "row_px",
    "col": "col_px",
    "d_row": "mean_row_px",
    "d_col": "mean_col_px",
    "s_row": "sigma_row_px",
    "s_col": "sigma_col_px",
    "count": "stars",
}
RESIDUAL_QUIVER = Figure(
    name="residual-quiver",
    title=TITLE,
    guide=(
        "Each arrow is the mean residual of the stars in one cell, at the old parameters on the left and the new on the right, "
        "to the scale of the bar; the circle about its foot is three sigmas of that mean. Arrows that end inside their "
        "circles are noise and good; arrows beyond them that turn together are a distortion the model does not have."
    ),
    draw=draw,
    table=table,
)
