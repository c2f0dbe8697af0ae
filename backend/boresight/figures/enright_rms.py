"""E Figure 4 made again: tail against aggregate RMS of filters that start at the batch's result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.figures import theme
from boresight.figures.chart import Trace

#: The axis holds the curves after this share of the run.
TRANSIENT_SHARE = 0.1


def draw(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw the curves of a reproduced Figure 4: `label`, `frame`, `tail_urad`, `aggregate_urad` each; aggregate is dotted."""
    curves = drawing["curves"]
    figure, seen = go.Figure(), list[float]()
    for curve, style in zip(curves, theme.run_styles([Trace(one["label"], {}) for one in curves]), strict=True):
        x = np.array(curve["frame"], dtype=np.float64)
        for key, word, dash in (("tail_urad", "tail", style.dash), ("aggregate_urad", "aggregate", "dot")):
            y = np.array(curve[key], dtype=np.float64)
            name = f"{style.label} · {word}"
            look = theme.RunStyle(name, style.colour, dash)
            figure.add_trace(theme.line(look, x, y, hovertemplate=f"%{{y:.2f}} µrad<extra>{name}</extra>"))
            seen += [float(value) for value in y[int(TRANSIENT_SHARE * len(y)) :] if np.isfinite(value)]
    theme.dress(figure, title=f"Figure {drawing['number']}: tail and aggregate RMS", height_px=360)
    margin = 0.05 * (max(seen, default=1.0) - min(seen, default=0.0)) or 1.0
    figure.update_yaxes(title_text="RMS arc error (µrad)", range=[min(seen) - margin, max(seen) + margin])
    figure.update_xaxes(title_text="frame")
    return figure
