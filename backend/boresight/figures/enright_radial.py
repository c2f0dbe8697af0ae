"""E Figure 5 made again: how far sequential results move a star along the radius against the batch's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.figures import theme
from boresight.figures.chart import Trace


def draw(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw the curves of a reproduced Figure 5: `label`, `radius_px`, `difference_px`, `three_sigma_px` each."""
    curves = drawing["curves"]
    figure = go.Figure()
    for curve, style in zip(curves, theme.run_styles([Trace(one["label"], {}) for one in curves]), strict=True):
        keys = ("radius_px", "difference_px", "three_sigma_px")
        x, y, reach = (np.array(curve[key], dtype=np.float64) for key in keys)
        figure.add_trace(theme.band(style, x, y - reach, y + reach))
        hover = f"%{{y:+.3f}} ±%{{customdata:.3f}} px (3σ)<extra>{style.label}</extra>"
        figure.add_trace(theme.line(style, x, y, customdata=theme.short(reach), hovertemplate=hover))
    theme.dress(figure, title=f"Figure {drawing['number']}: radial difference from the batch, ±3σ", height_px=360)
    figure.update_yaxes(title_text="sequential − batch (px)", zeroline=True)
    figure.update_xaxes(title_text="radius from the principal point (px)")
    return figure
