"""What a chart's x axis counts, so that charts of one quantity share the cursor on a page; and where it goes beyond the data.

`layout.meta.axis` is the name of the quantity: `frame`, `time`, `update`, `iteration` or `radius_px`. Charts with the same
name show the same place when the pointer is over one of them.
"""

from __future__ import annotations

from typing import Any

import plotly.graph_objects as go

from boresight.figures.style import theme

EXTRAPOLATED = "no stars: extrapolated"


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
