"""What a chart's x axis counts (`layout.meta.axis`), where it goes beyond the data, and the detector as a pair of axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import list_known
from boresight.calibration.calibration import ArcSigmaMap, HalvesMap, Matrix
from boresight.figures.chart import Table, Trace
from boresight.figures.factory import P, Part, column
from boresight.figures.style import theme

#: What the axis of frames is called under each alignment.
ALIGNMENTS = {"frame": "frame", "time": "hours since the first frame", "update": "update"}
EXTRAPOLATED = "no stars: extrapolated"
MAX_MAPS = 4
BETWEEN_PANELS = 0.3  # of the height, over the number of rows
NARROW_PANEL_PX = 260  # the height of a panel among others below each other
QUIET = {"showgrid": False, "zeroline": False, "constrain": "domain"}


def counted(axis: str, traces: Sequence[Trace]) -> str:
    """Return what an axis counts: of frames, whatever the runs are aligned by."""
    return traces[0].along if axis == "frame" else axis


def axis_title(axis: str, traces: Sequence[Trace]) -> str:
    """Write what an axis counts."""
    return ALIGNMENTS.get(counted(axis, traces), axis)


def hover_place(trace: Trace) -> str:
    """Write what a hover says of its place on an axis of frames."""
    return "frame %{x}" if trace.along == "frame" else f"{ALIGNMENTS[trace.along]} %{{x:.5g}}"


def share_cursor(figure: go.Figure, axis: str) -> go.Figure:
    """Say what the x axis counts."""
    figure.layout.meta = {**(figure.layout.meta or {}), "axis": axis}
    return figure


def offer_log(figure: go.Figure, axes: list[str]) -> go.Figure:
    """Name the axes, such as `yaxis9`, that a reader may see on a log or on a linear scale."""
    figure.layout.meta = {**(figure.layout.meta or {}), "log": axes}
    return figure


def hatch(figure: go.Figure, x: tuple[float, float], y: tuple[float, float], *, named: bool, **place: Any) -> None:
    """Hatch the part of a panel that no star reached, from x[0] to x[1] and y[0] to y[1]; `named` puts it into the legend."""
    strokes = {"shape": "/", "fgcolor": theme.REFERENCE_COLOUR, "fgopacity": 0.55, "size": 8, "solidity": 0.16}
    drawn = go.Scatter(
        x=[x[0], x[1], x[1], x[0]],
        y=[y[0], y[0], y[1], y[1]],
        mode="lines",
        line={"width": 0},
        fill="toself",
        fillcolor=theme.translucent(theme.REFERENCE_COLOUR, 0.06),
        fillpattern=strokes,
        name=EXTRAPOLATED,
        legendgroup=EXTRAPOLATED,
        showlegend=named,
        hoverinfo="skip",
    )
    figure.add_trace(drawn, **place)


def grid_place(number: int, columns: int) -> dict[str, int]:
    """Return row and column, from 1, of a panel of a grid."""
    return {"row": number // columns + 1, "col": number % columns + 1}


def name_panel(figure: go.Figure, text: str, **place: int) -> None:
    """Name the y axis of one of many panels above it: beside it the name would move with the ticks, and meet the next panel."""
    above = {"xref": "x domain", "yref": "y domain", "xanchor": "left", "yanchor": "bottom", "yshift": 2}
    figure.add_annotation(text=text, x=0, y=1, showarrow=False, **above, **place)


#: Room for a legend of two lines, and for the names of the panels below it.
ABOVE_NAMED_PX = 90


def space_panels(columns: int, n_rows: int) -> dict[str, float]:
    """Leave room between panels for the ticks of the next column, and for ticks and names between rows."""
    return {"horizontal_spacing": 0.36 / columns, "vertical_spacing": 0.24 / n_rows}


def frame_grid(figure: go.Figure, n_panels: int, columns: int, title: str) -> None:
    """Name the x axis on the lowest panel of each column of a grid, and hide its empty places."""
    for number in range(-(-n_panels // columns) * columns):
        where = grid_place(number, columns)
        if number >= n_panels:
            figure.update_xaxes(visible=False, **where)
            figure.update_yaxes(visible=False, **where)
        elif number + columns >= n_panels:
            figure.update_xaxes(title_text=title, **where)


def detector_map(part: ArcSigmaMap | HalvesMap, values: Matrix, label: str, **scale: Any) -> go.Heatmap:
    """Draw values (n_rows, n_columns) in arcsec over the centres of a map's cells."""
    return go.Heatmap(
        x=list(part.col_px),
        y=list(part.row_px),
        z=theme.short(column(values)),
        colorbar={"title": {"text": "arcsec"}, "thickness": 10},
        hovertemplate=f"%{{z:.3g}} arcsec<br>column %{{x:.0f}}, row %{{y:.0f}}<extra>{label}</extra>",
        hoverongaps=False,
        **scale,
    )


def lay_maps(drawn: Sequence[Part[P]], beside: int, spacing: float | None = None) -> go.Figure:
    """Make room for the maps of several runs, so many beside each other, each under its run's name."""
    titles = [style.short for _, style, _ in drawn] if len(drawn) > 1 else None
    columns, rows = min(beside, len(drawn)), -(-len(drawn) // beside)
    space = 0.5 / max(3, columns) if spacing is None else spacing
    return make_subplots(
        rows, columns, subplot_titles=titles, horizontal_spacing=space, vertical_spacing=BETWEEN_PANELS / rows
    )


def draw_maps(
    drawn: Sequence[Part[P]], draw: Callable[[Part[P], bool], go.Heatmap], *, title: str, height_px: int, beside: int
) -> go.Figure:
    """Draw one map a run, so many beside each other, of which only the last shows the scale that all have."""
    figure = lay_maps(drawn, beside)
    columns, rows = min(beside, len(drawn)), -(-len(drawn) // beside)
    for number, one in enumerate(drawn):
        figure.add_trace(draw(one, number == len(drawn) - 1), **grid_place(number, columns))
    theme.dress(figure, title=title, height_px=stacked_px(height_px, rows, beside), legend=False, hovermode="closest")
    frame_maps(figure, len(drawn), columns)
    return figure


def stacked_px(height_px: int, rows: int, beside: int) -> int:
    """Return the height of a figure: its own, or, with panels below each other as on a phone, what so many need."""
    return height_px if beside > 1 and rows == 1 else 90 + NARROW_PANEL_PX * rows


def frame_maps(figure: go.Figure, n_maps: int, columns: int) -> None:
    """Make the first `n_maps` subplots of a grid detectors: square pixels, row 0 on top."""
    for number in range(n_maps):
        where = grid_place(number, columns)
        anchor = "x" if number == 0 else f"x{number + 1}"
        figure.update_xaxes(nticks=max(2, 8 // max(2, columns)), tickangle=0, **QUIET, **where)
        square = {"scaleanchor": anchor, "scaleratio": 1, "constraintoward": "top"}
        figure.update_yaxes(autorange="reversed", **square, **QUIET, **where)
        if number % columns == 0:
            figure.update_yaxes(title_text="row (px)", **where)
        if number + columns >= n_maps:
            figure.update_xaxes(title_text="column (px)", **where)


def cells(part: ArcSigmaMap | HalvesMap, name: str, values: Matrix) -> Table:
    """List one cell of a map a row: its centre in px and its value, in a column of this name."""
    places = [(row, col) for row in part.row_px for col in part.col_px]
    return {
        "row_px": [row for row, _ in places],
        "col_px": [col for _, col in places],
        name: list_known(column(values).ravel()),
    }
