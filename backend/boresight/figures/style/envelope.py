"""Many runs as one band: the lowest and the highest of them at every place, with the reference drawn over it.

Nobody tells twenty curves apart. Here the curves of all runs but the first become the span between the lowest and the
highest of them, per panel and kind of curve: `tail` and `aggregate` stay two bands. Between its points a curve is the
straight line that it is drawn as, so on the union of all points the band's edges are exact; beyond its ends a curve says
nothing, and the band is that of the others. Marks that are no curves (bars, maps, single stars) have no band and stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray
from boresight.figures.chart import Trace
from boresight.figures.style import theme
from boresight.figures.style.thinning import keep_extremes

Place = tuple[str, str, str]

POINT_BUDGET = 600  # a band


def as_band(figure: go.Figure, traces: Sequence[Trace]) -> go.Figure:
    """Replace the curves of all runs but the first by their lowest and highest; fewer than three runs stay as they are."""
    others = {theme.escape(trace.label) for trace in traces[1:]}
    if len(others) < 2:
        return figure
    curves: dict[Place, list[Any]] = {}
    kept = []
    for drawn in figure.data:
        said = drawn.meta or {}
        if said.get("run") not in others:
            kept.append(drawn)
        elif drawn.fill is None:  # a filled one is a run's own band, or its histogram
            curves.setdefault((drawn.xaxis or "x", drawn.yaxis or "y", said["part"]), []).append(drawn)
    if not curves:
        return figure
    figure.data = kept
    for number, (place, found) in enumerate(curves.items()):
        _draw(figure, place, found, named=number == 0, runs=len(others))
    return figure


def find_span(curves: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the places (n,) of all curves, the lowest and the highest value there.

    `curves`: x and y of each, (n_points,), x ascending.
    """
    known = [(x[np.isfinite(y)], y[np.isfinite(y)]) for x, y in curves]
    known = [(x, y) for x, y in known if len(x)]
    places = np.unique(np.concatenate([x for x, _ in known])) if known else np.zeros(0)
    if not len(places):
        return places, places, places
    values = np.stack([np.interp(places, x, y, left=np.nan, right=np.nan) for x, y in known])
    return places, np.nanmin(values, axis=0), np.nanmax(values, axis=0)


def _draw(figure: go.Figure, place: Place, found: Sequence[Any], *, named: bool, runs: int) -> None:
    """Add one band, in the grey of what is no run."""
    curves = [(np.asarray(one.x, dtype=np.float64), np.asarray(one.y, dtype=np.float64)) for one in found]
    x, low, high = find_span(curves)
    if not len(x):
        return
    kept = keep_extremes([low, high], POINT_BUDGET)
    x, low, high = x[kept], low[kept], high[kept]
    name = f"lowest to highest of {runs} runs"
    band = go.Scatter(
        x=theme.short(np.concatenate([x, x[::-1]])),
        y=theme.short(np.concatenate([high, low[::-1]])),
        mode="lines",
        fill="toself",
        fillcolor=theme.translucent(theme.REFERENCE_COLOUR, 0.22),
        line={"color": theme.translucent(theme.REFERENCE_COLOUR, 0.7), "width": 0.8},
        name=name,
        legendgroup=name,
        showlegend=named,
        hoverinfo="skip",
        xaxis=place[0],
        yaxis=place[1],
    )
    figure.add_trace(band)
