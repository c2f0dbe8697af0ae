"""E Figure 3 made again: how the focal length nears the batch's along a run, with three-sigma bounds.

E Figure 5 made again: how far sequential results move a star along the radius against the batch's.

E Figure 4 made again: tail against aggregate RMS of filters that start at the batch's result.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.figures.chart import Trace
from boresight.figures.style import theme

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


def draw_enright_radial(drawing: Mapping[str, Any]) -> go.Figure:
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


#: The axis holds the curves after this share of the run.
ENRIGHT_RMS_TRANSIENT_SHARE = 0.1


def draw_enright_rms(drawing: Mapping[str, Any]) -> go.Figure:
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
            seen += [float(value) for value in y[int(ENRIGHT_RMS_TRANSIENT_SHARE * len(y)) :] if np.isfinite(value)]
    theme.dress(figure, title=f"Figure {drawing['number']}: tail and aggregate RMS", height_px=360)
    margin = 0.05 * (max(seen, default=1.0) - min(seen, default=0.0)) or 1.0
    figure.update_yaxes(title_text="RMS arc error (µrad)", range=[min(seen) - margin, max(seen) + margin])
    figure.update_xaxes(title_text="frame")
    return figure
