"""What is left over on the detector: the residual of each centroid after the best attitude of its exposure.

On the left the stars one by one, on the right their mean in each cell of a grid. Single residuals are noise of the
centroids; a mean that is more than three of its own sigmas long is what the camera model has not understood. The sigma
of a cell's mean is the scatter of its stars over the root of their number.

Where centroids are noisier: the RMS residual of each cell of the detector at the best fit, one map a run.
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
from boresight.figures.charts.trust.arc_uncertainty import MAX_MAPS, frame_maps, short_label
from boresight.figures.style import theme
from boresight.figures.trust_parts import Part, absent, column, parts
from boresight.verdicts.numbers import number
from boresight.verdicts.verdict import read_part

TITLE = "Residuals on the detector"
PART = "residuals"
COLUMNS = ("row_px", "col_px", "d_row_px", "d_col_px")
CELLS = 10  # along the longer side
LEAST_STARS = 4  # in a cell, for a mean with a sigma
CLEAR_SIGMA = 3.0
ARROW_SHARE = 0.03  # of the detector's width: the length of the typical arrow


@dataclass(frozen=True)
class ArrowField:
    """Arrows: where they start and what they say, (n,) each, px; `clear` those that stand out of their noise."""

    row: FloatArray
    col: FloatArray
    d_row: FloatArray
    d_col: FloatArray
    clear: NDArray[np.bool_]


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw the first run's stars as arrows, and the mean arrow of each cell."""
    drawn = parts(traces, PART)
    if not drawn:
        return absent(TITLE, traces, PART)
    stars = _stars(drawn[0][2])
    means = cell_means(stars)
    names = [f"star by star, {_scale(stars):,.0f} times", f"mean of each cell, {_scale(means):,.0f} times"]
    figure = make_subplots(1, 2, shared_yaxes=True, horizontal_spacing=0.05, subplot_titles=names)
    style = drawn[0][1]
    _arrows(figure, stars, style, 1, theme.translucent(style.colour, 0.75))
    _arrows(figure, means, style, 2, style.colour)
    n_clear = int(np.sum(means.clear))
    counted = f"{n_clear} of {len(means.row)} cell means are clear of their noise"
    title = f"Residuals: {counted}{others([style.label for _, style, _ in drawn])}"
    theme.dress(figure, title=title, height_px=470, legend=False, hovermode="closest")
    _frame(figure)
    return figure


def others(labels: Sequence[str]) -> str:
    """Say which runs are compared with but not drawn: arrows over arrows could not be read."""
    if len(labels) <= 1:
        return ""
    more = f" and {len(labels) - 3} more" if len(labels) > 3 else ""
    return f"<br>of {labels[0]} alone; open {', '.join(labels[1:3])}{more} for theirs"


def _stars(part: Result) -> ArrowField:
    row, col, d_row, d_col = (column(part[name]) for name in COLUMNS)
    return ArrowField(row, col, d_row, d_col, clear=np.zeros(len(row), dtype=bool))


def cell_means(stars: ArrowField) -> ArrowField:
    """Average the arrows of each cell of a square grid that has LEAST_STARS of them.

    A mean is clear when either component is more than CLEAR_SIGMA of its own sigmas from zero.
    """
    size = max(np.ptp(stars.row), np.ptp(stars.col)) / CELLS or 1.0
    place = np.stack([stars.row - stars.row.min(), stars.col - stars.col.min()]) // size
    found = []
    for cell in np.unique(place, axis=1).T:
        inside = np.all(cell == place.T, axis=1)
        if (n := int(inside.sum())) >= LEAST_STARS:
            values = np.stack([stars.row, stars.col, stars.d_row, stars.d_col])[:, inside]
            mean, sigma = values.mean(axis=1), values[2:].std(axis=1, ddof=1) / np.sqrt(n)
            found.append([*mean, float(np.any(np.abs(mean[2:]) > CLEAR_SIGMA * sigma))])
    row, col, d_row, d_col, clear = np.array(found, dtype=np.float64).reshape(-1, 5).T
    return ArrowField(row, col, d_row, d_col, clear > 0)


def _scale(arrows: ArrowField) -> float:
    """Choose how many times longer than life the arrows are drawn: 1, 2 or 5 times a power of ten."""
    typical = float(np.median(np.hypot(arrows.d_row, arrows.d_col))) if len(arrows.row) else 0.0
    wanted = ARROW_SHARE * float(np.ptp(arrows.col)) / typical if typical > 0 and len(arrows.row) > 1 else 1.0
    power = 10.0 ** np.floor(np.log10(max(wanted, 1.0)))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= max(wanted, 1.0)) * power)


def _arrows(figure: go.Figure, arrows: ArrowField, style: theme.RunStyle, place: int, colour: str) -> None:
    """Draw each arrow as a line from its star, and the star as a mark: a diamond where the arrow is clear."""
    scale, gap = _scale(arrows), np.full(len(arrows.row), np.nan)
    x = np.stack([arrows.col, arrows.col + scale * arrows.d_col, gap], axis=1).ravel()
    y = np.stack([arrows.row, arrows.row + scale * arrows.d_row, gap], axis=1).ravel()
    line = {"color": colour, "width": 1 if place == 1 else 2}
    where = {"row": 1, "col": place}
    figure.add_trace(
        go.Scatter(x=theme.short(x), y=theme.short(y), mode="lines", line=line, hoverinfo="skip", name=style.label),
        **where,
    )
    figure.add_trace(
        go.Scatter(
            x=theme.short(arrows.col),
            y=theme.short(arrows.row),
            mode="markers",
            name=style.label,
            marker={
                "color": colour,
                "line": {"width": 0},
                "size": np.where(arrows.clear, 9, 3 if place == 1 else 4).astype(np.int8),
                "symbol": ["diamond" if clear else "circle" for clear in arrows.clear] if place > 1 else "circle",
            },
            customdata=theme.short(np.stack([arrows.d_row, arrows.d_col], axis=1)),
            hovertemplate="rows %{customdata[0]:+.3f} px, columns %{customdata[1]:+.3f} px<extra></extra>",
        ),
        **where,
    )


def _frame(figure: go.Figure) -> None:
    quiet = {"showgrid": False, "zeroline": False, "constrain": "domain"}
    for place, anchor in ((1, "x"), (2, "x2")):
        figure.update_xaxes(title_text="column (px)", nticks=6, tickangle=0, **quiet, row=1, col=place)
        figure.update_yaxes(scaleanchor=anchor, scaleratio=1, autorange="reversed", **quiet, row=1, col=place)
    figure.update_yaxes(title_text="row (px)", row=1, col=1)


def table(result: Result) -> Table:
    """List one star a row: frame, star, place and residual in px."""
    part = read_part(result, PART)
    if not part:
        return {}
    columns: Table = {name: list(part[name]) for name in ("frame", "star_id") if part.get(name) is not None}
    return columns | {name: theme.plain(column(part[name])) for name in COLUMNS}


RESIDUAL_MAP = Figure(
    name="residual-map",
    title=TITLE,
    guide=(
        "Each line points from where a star was measured to where the camera model and the best attitude of its "
        "exposure leave it, so many times longer than life; on the right the means of cells, a diamond where a mean "
        "is clear of its noise. Arrows in all directions are good; arrows that turn together are a distortion that "
        "the model does not have."
    ),
    draw=draw,
    table=table,
)


RESIDUAL_RMS_TITLE = "RMS residual over the detector"
RESIDUAL_RMS_PART = "residual_field"


def draw_residual_rms(traces: Sequence[Trace]) -> go.Figure:
    """Lay the maps of the runs beside each other on one scale."""
    drawn = parts(traces, RESIDUAL_RMS_PART)[:MAX_MAPS]
    if not drawn:
        return absent(RESIDUAL_RMS_TITLE, traces, RESIDUAL_RMS_PART)
    titles = [short_label(style.label) for _, style, _ in drawn] if len(drawn) > 1 else None
    figure = make_subplots(1, len(drawn), subplot_titles=titles, horizontal_spacing=0.4 / max(4, len(drawn)))
    top = max(float(np.nanmax(_rms(part))) for _, _, part in drawn)
    for place, one in enumerate(drawn, start=1):
        figure.add_trace(_map(one, top, last=place == len(drawn)), row=1, col=place)
    rms = drawn[0][2]["after"]["rms_in_all_px"]
    theme.dress(
        figure,
        title=f"RMS {number(rms, 3)} px an axis at the best fit",
        height_px=440,
        legend=False,
        hovermode="closest",
    )
    frame_maps(figure, len(drawn))
    return figure


def _rms(part: Result) -> FloatArray:
    """RMS of each cell, px, NaN where it has too few stars."""
    return column(part["after"]["rms_px"])


def _map(one: Part, top: float, *, last: bool) -> go.Heatmap:
    _, style, part = one
    row, col = (column(part[name]) for name in ("row_edges_px", "col_edges_px"))
    return go.Heatmap(
        x=theme.plain((col[1:] + col[:-1]) / 2),
        y=theme.plain((row[1:] + row[:-1]) / 2),
        z=theme.short(_rms(part)),
        customdata=theme.short(column(part["after"]["count"])),
        zmin=0,
        zmax=top,
        colorscale="Cividis",
        colorbar={"title": {"text": "px"}, "thickness": 10},
        showscale=last,
        hovertemplate=f"RMS %{{z:.3f}} px of %{{customdata:.0f}} stars<extra>{style.label}</extra>",
        hoverongaps=False,
    )


def table_residual_rms(result: Result) -> Table:
    """List one cell a row: its edges, RMS before and after in px, and how many stars it has."""
    part = read_part(result, RESIDUAL_RMS_PART)
    if not part:
        return {}
    row, col = column(part["row_edges_px"]), column(part["col_edges_px"])
    i, j = (index.ravel() for index in np.indices((len(row) - 1, len(col) - 1)))
    columns = {"row_from_px": row[i], "row_to_px": row[i + 1], "column_from_px": col[j], "column_to_px": col[j + 1]}
    sides = {f"rms_{side}_px": column(part[side]["rms_px"]).ravel() for side in ("before", "after") if part.get(side)}
    stars = {"stars": column(part["after"]["count"]).ravel()}
    return {name: theme.plain(values) for name, values in (columns | sides | stars).items()}


RESIDUAL_RMS = Figure(
    name="residual-rms",
    title=RESIDUAL_RMS_TITLE,
    guide=(
        "Each cell has the colour of the RMS residual of its stars at the best fit, an axis; a cell with fewer than four stars is "
        "left open. An even colour is good; an edge or a corner that stands out has noisier centroids there, or a "
        "distortion that the model does not have."
    ),
    draw=draw_residual_rms,
    table=table_residual_rms,
)
