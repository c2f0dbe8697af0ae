"""Where on the detector the stars were: a count a cell, in the detector's own rows and columns."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import plotly.graph_objects as go

from boresight.calibration.calibration import Calibration, Coverage
from boresight.figures.chart import Table
from boresight.figures.factory import Part, make_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import MAX_MAPS, frame_maps, grid_place, lay_maps, stacked_px
from boresight.verdicts.numbers import count


def read_coverage(result: Calibration) -> Coverage | None:
    """Read the counts of a result; None where it has none."""
    return result.coverage if result.coverage and any(result.coverage.counts) else None


def draw(found: Sequence[Part[Coverage]], beside: int = 2) -> go.Figure:
    """Draw one heat map a run, so many beside each other, on one colour scale; empty cells show the surface."""
    drawn = found[:MAX_MAPS]
    alike = all(coverage.row_edges_px == drawn[0][2].row_edges_px for _, _, coverage in drawn)
    # rows that differ need their own labels, and room for them
    columns, rows = min(beside, len(drawn)), -(-len(drawn) // beside)
    figure = lay_maps(drawn, beside, 0.05 if alike else 0.4 / len(drawn))
    highest = max(float(np.max(coverage.counts)) for _, _, coverage in drawn)
    for number, one in enumerate(drawn):
        figure.add_trace(_map(one, highest), **grid_place(number, columns))
    figure.data[-1].showscale = True
    theme.dress(
        figure, title=_headline(drawn), height_px=stacked_px(460, rows, beside), legend=False, hovermode="closest"
    )
    frame_maps(figure, len(drawn), columns)
    for number in range(len(drawn)):
        figure.update_yaxes(showticklabels=number % columns == 0 or not alike, **grid_place(number, columns))
    return figure


def _map(one: Part[Coverage], highest: float) -> go.Heatmap:
    _, style, coverage = one
    return go.Heatmap(
        x=list(coverage.col_edges_px),
        y=list(coverage.row_edges_px),
        z=[[int(count) or None for count in row] for row in coverage.counts],
        zmin=0,
        zmax=highest or 1,
        colorscale="Cividis",
        xgap=1,
        ygap=1,
        colorbar={"title": {"text": "stars"}, "thickness": 10},
        hovertemplate=f"%{{z}} stars<br>column %{{x:.0f}}, row %{{y:.0f}}<extra>{style.label}</extra>",
        hoverongaps=False,
        showscale=False,
    )


def _headline(drawn: Sequence[Part[Coverage]]) -> str:
    if len(drawn) > 1:
        return f"Stars on the detector, {len(drawn)} runs"
    counts = np.array(drawn[0][2].counts)
    empty = int((counts == 0).sum())
    cells = "no cell is empty" if not empty else f"{empty} of {counts.size} cells are empty"
    return f"{count(int(counts.sum()))} stars on the detector, {cells}"


def table(coverage: Coverage) -> Table:
    """List one cell a row: its edges in px and its stars."""
    rows, columns, counts = coverage.row_edges_px, coverage.col_edges_px, coverage.counts
    places = list(np.ndindex(np.shape(counts)))
    return {
        "row_from_px": [rows[i] for i, _ in places],
        "row_to_px": [rows[i + 1] for i, _ in places],
        "col_from_px": [columns[j] for _, j in places],
        "col_to_px": [columns[j + 1] for _, j in places],
        "stars": [int(counts[i][j]) for i, j in places],
    }


COVERAGE = make_figure(
    draw,
    table,
    read_coverage,
    lambda _: "Not yet: the detector coverage is counted when the run ends.",
    name="coverage",
    title="Detector coverage",
    guide=(
        "Each cell counts the stars that were used there, by the detector's rows and columns; an empty cell shows the "
        "background. Distortion is only as good as the coverage of the corners, and a one-sided field makes the principal "
        "point uncertain."
    ),
    forms={"narrow": partial(draw, beside=1)},
)
