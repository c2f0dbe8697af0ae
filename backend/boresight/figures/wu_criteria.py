"""W Figure 6 made again: a criterion on the judging images along the run of each method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.figures import theme
from boresight.figures.chart import Trace

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
