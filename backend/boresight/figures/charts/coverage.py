"""Where on the detector the stars were: a count a cell, in the detector's own rows and columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.charts.trust.arc_uncertainty import short_label
from boresight.figures.style import theme

TITLE = "Detector coverage"
MAX_MAPS = 4


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw one heat map a run, beside each other on one colour scale; empty cells show the surface."""
    drawn = [trace for trace in traces if _counts(trace.result) is not None][:MAX_MAPS]
    if not drawn:
        return theme.missing(TITLE, "The detector coverage is counted when the run ends; it is not there yet.")
    titles = [theme.escape(short_label(trace.label)) for trace in drawn] if len(drawn) > 1 else None
    alike = all(trace.result["coverage"]["row_edges_px"] == _rows(drawn[0]) for trace in drawn)
    spacing = 0.05 if alike else 0.4 / len(drawn)  # rows that differ need their own labels, and room for them
    figure = make_subplots(1, len(drawn), subplot_titles=titles, horizontal_spacing=spacing)
    highest = max(float(np.max(trace.result["coverage"]["counts"])) for trace in drawn)
    for column, trace in enumerate(drawn, start=1):
        figure.add_trace(_map(trace, highest), row=1, col=column)
    figure.update_traces(showscale=True, col=len(drawn))
    theme.dress(figure, title=_headline(drawn), height_px=460, legend=False, hovermode="closest")
    figure.update_xaxes(title_text="column (px)", showgrid=False, zeroline=False, constrain="domain")
    figure.update_yaxes(autorange="reversed", showgrid=False, zeroline=False, constrain="domain")
    figure.update_yaxes(title_text="row (px)", row=1, col=1)
    for column in range(1, len(drawn) + 1):
        anchor = "x" if column == 1 else f"x{column}"
        labelled = column == 1 or not alike
        figure.update_yaxes(scaleanchor=anchor, scaleratio=1, showticklabels=labelled, row=1, col=column)
        figure.update_xaxes(nticks=max(2, 8 // len(drawn)), tickangle=0, row=1, col=column)
    return figure


def _rows(trace: Trace) -> list[float]:
    return list(trace.result["coverage"]["row_edges_px"])


def _counts(result: Result) -> FloatArray | None:
    counts = np.array((result.get("coverage") or {}).get("counts") or [], dtype=np.float64)
    return counts if counts.ndim == 2 and counts.size else None


def _map(trace: Trace, highest: float) -> go.Heatmap:
    coverage = trace.result["coverage"]
    counts = [[int(count) or None for count in row] for row in coverage["counts"]]
    return go.Heatmap(
        x=list(coverage["col_edges_px"]),
        y=list(coverage["row_edges_px"]),
        z=counts,
        zmin=0,
        zmax=highest or 1,
        colorscale="Cividis",
        xgap=1,
        ygap=1,
        colorbar={"title": {"text": "stars"}, "thickness": 10},
        hovertemplate="%{z} stars<br>column %{x:.0f}, row %{y:.0f}<extra>" + theme.escape(trace.label) + "</extra>",
        hoverongaps=False,
        showscale=False,
    )


def _headline(drawn: Sequence[Trace]) -> str:
    if len(drawn) > 1:
        return f"Stars on the detector, {len(drawn)} runs"
    counts = np.array(drawn[0].result["coverage"]["counts"])
    empty = int((counts == 0).sum())
    cells = "no cell is empty" if not empty else f"{empty} of {counts.size} cells are empty"
    return f"{int(counts.sum()):,} stars on the detector, {cells}"


def table(result: Result) -> Table:
    """List one cell a row: its edges in px and its stars."""
    counts = _counts(result)
    if counts is None:
        return {}
    rows, columns = result["coverage"]["row_edges_px"], result["coverage"]["col_edges_px"]
    cells: list[tuple[Any, ...]] = [
        (rows[i], rows[i + 1], columns[j], columns[j + 1], int(counts[i, j]))
        for i in range(counts.shape[0])
        for j in range(counts.shape[1])
    ]
    names = ("row_from_px", "row_to_px", "col_from_px", "col_to_px", "stars")
    return {name: list(column) for name, column in zip(names, zip(*cells, strict=True), strict=True)}


COVERAGE = Figure(
    name="coverage",
    title=TITLE,
    guide=(
        "Each cell counts the stars that were used there, in the detector's rows and columns; an empty cell shows "
        "the background. Distortion is only as good as the coverage of the corners, and a one-sided field weakens "
        "the principal point."
    ),
    draw=draw,
    table=table,
)
