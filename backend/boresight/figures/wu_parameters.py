"""W Figure 8 made again: the six parameters along a run, with three-sigma bounds and the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.figures import theme
from boresight.figures.chart import Trace

COLUMNS = 3
#: An axis holds the bounds from this frame on; before it they come from far away.
FIRST_FRAME = 5


def draw(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw the panels of Figure 8: `label`, `unit`, `truth`, `frame`, `value`, `three_sigma` each."""
    curves = drawing["curves"]
    names = [f"{curve['label']} ({curve['unit']})" for curve in curves]
    figure = make_subplots(rows=-(-len(curves) // COLUMNS), cols=COLUMNS, subplot_titles=names, horizontal_spacing=0.09)
    style = theme.run_styles([Trace("SVD", {})])[0]
    for place, curve in enumerate(curves):
        row, column = place // COLUMNS + 1, place % COLUMNS + 1
        x, y, reach = (np.array(curve[key], dtype=np.float64) for key in ("frame", "value", "three_sigma"))
        figure.add_trace(theme.band(style, x, y - reach, y + reach), row=row, col=column)
        hover = f"%{{y:.7g}}<extra>{theme.escape(curve['label'])}</extra>"
        figure.add_trace(theme.line(style, x, y, hovertemplate=hover, showlegend=False), row=row, col=column)
        figure.add_hline(y=curve["truth"], line={"color": theme.TRUTH_COLOUR, "dash": "dot"}, row=row, col=column)
        shown = x >= min(FIRST_FRAME, x[-1])
        figure.update_yaxes(range=_window(y[shown], reach[shown], curve["truth"]), row=row, col=column)
    theme.dress(figure, title="Figure 8: parameters along the run, ±3σ, and the truth", height_px=520, legend=False)
    figure.update_layout(hovermode="closest", margin={"t": 76})
    figure.update_xaxes(title_text="frame", type="log", dtick=1)
    return figure


def _window(y: np.ndarray[Any, Any], reach: np.ndarray[Any, Any], truth: float) -> list[float]:
    """Range of an axis that holds bounds and truth."""
    low, high = min(float((y - reach).min()), truth), max(float((y + reach).max()), truth)
    margin = 0.05 * (high - low) or 1.0
    return [low - margin, high + margin]
