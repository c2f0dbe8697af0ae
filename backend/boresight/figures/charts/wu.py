"""W Figure 6 made again: a criterion on the judging images along the run of each method.

W Figures 3 and 4 made again: the minimum singular value of single frames, by model or by singular value.

W Figure 8 made again: the six parameters along a run, with three-sigma bounds and the truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.figures.chart import Trace
from boresight.figures.style import theme

DECADE = 10


def draw(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw the curves of Figure 6a or 6b: `label`, `frame`, `criterion_arcsec` each.

    Frames run in decades, and so does a criterion that spans at least one: criterion B does not, and decades would leave its axis
    without a number.
    """
    curves = drawing["curves"]
    figure = go.Figure()
    for curve, style in zip(curves, theme.run_styles([Trace(one["label"], {}) for one in curves]), strict=True):
        x, y = (np.array(curve[key], dtype=np.float64) for key in ("frame", "criterion_arcsec"))
        figure.add_trace(theme.line(style, x, y, hovertemplate=f"%{{y:.3f}}″<extra>{style.label}</extra>"))
    theme.dress(figure, title=f"Figure {drawing['number']}: mean RMS angle error of the judging images", height_px=380)
    values = [value for curve in curves for value in curve["criterion_arcsec"]]
    decades = {"type": "log", "dtick": 1} if max(values) >= DECADE * min(values) else {"type": "linear"}
    figure.update_yaxes(title_text="arcseconds", **decades)
    figure.update_xaxes(title_text="frame", type="log", dtick=1)
    return figure


def draw_wu_observability(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw the curves of Figure 3 or 4: `label`, `frame`, `minimum_singular_value` each, null where a frame has too few rows."""
    curves = drawing["curves"]
    figure = go.Figure()
    for curve, style in zip(curves, theme.run_styles([Trace(one["label"], {}) for one in curves]), strict=True):
        x, y = (np.array(curve[key], dtype=np.float64) for key in ("frame", "minimum_singular_value"))
        hover = f"%{{y:.3g}}<extra>{style.label}</extra>"
        figure.add_trace(theme.line(style, x, y, connectgaps=False, hovertemplate=hover))
    theme.dress(figure, title=f"Figure {drawing['number']}: minimum singular value of H W", height_px=360)
    figure.update_yaxes(title_text="minimum singular value (rad)", type="log", exponentformat="power")
    figure.update_xaxes(title_text="frame")
    return figure


COLUMNS = 3
#: An axis holds the bounds from this frame on; before it they come from far away.
FIRST_FRAME = 5


def draw_wu_parameters(drawing: Mapping[str, Any]) -> go.Figure:
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
