"""Where centroids are noisier: the RMS residual of each cell of the detector at the best fit, one map a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.figures import theme
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.detector_maps import MAX_MAPS, frame_maps, short_label
from boresight.figures.trust_parts import Part, absent, column, parts
from boresight.verdicts.numbers import number
from boresight.verdicts.verdict import part_of

TITLE = "RMS residual over the detector"
PART = "residual_field"


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Lay the maps of the runs beside each other on one scale."""
    drawn = parts(traces, PART)[:MAX_MAPS]
    if not drawn:
        return absent(TITLE, traces, PART)
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


def table(result: Result) -> Table:
    """List one cell a row: its edges, RMS before and after in px, and how many stars it has."""
    part = part_of(result, PART)
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
    title=TITLE,
    guide=(
        "Each cell has the colour of the RMS residual of its stars at the best fit, an axis; a cell with fewer than four stars is "
        "left open. An even colour is good; an edge or a corner that stands out has noisier centroids there, or a "
        "distortion that the model does not have."
    ),
    draw=draw,
    table=table,
)
