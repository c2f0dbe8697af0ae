"""W Figures 3 and 4 made again: the minimum singular value of single frames, by model or by singular value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.figures import theme
from boresight.figures.chart import Trace


def draw(drawing: Mapping[str, Any]) -> go.Figure:
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
