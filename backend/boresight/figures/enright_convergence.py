"""E Figure 3 made again: how the focal length nears the batch's along a run, with three-sigma bounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.figures import theme
from boresight.figures.chart import Trace

#: The axis holds the curves after this share of the run; before it they come from tens of micrometres away.
TRANSIENT_SHARE = 0.15


def draw(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw the curves of a reproduced Figure 3a or 3b: `label`, `frame`, `difference_um`, `three_sigma_um` each."""
    curves = drawing["curves"]
    styles = theme.run_styles([Trace(curve["label"], {}) for curve in curves])
    figure, seen = go.Figure(), [0.0]
    for curve, style in zip(curves, styles, strict=True):
        x, y, reach = (np.array(curve[key], dtype=np.float64) for key in ("frame", "difference_um", "three_sigma_um"))
        figure.add_trace(theme.band(style, x, y - reach, y + reach))
        hover = f"%{{y:+.3f}} ±%{{customdata:.3f}} µm (3σ)<extra>{style.label}</extra>"
        figure.add_trace(theme.line(style, x, y, customdata=theme.short(reach), hovertemplate=hover))
        settled = slice(int(TRANSIENT_SHARE * len(x)), None)
        seen += [*(y - reach)[settled], *(y + reach)[settled]]
    theme.dress(figure, title=f"Figure {drawing['number']}: Δf against the batch, ±3σ", height_px=360)
    margin = 0.05 * (max(seen) - min(seen)) or 1.0
    figure.update_yaxes(title_text="Δf (µm)", range=[min(seen) - margin, max(seen) + margin], zeroline=True)
    figure.update_xaxes(title_text="frame")
    return figure
