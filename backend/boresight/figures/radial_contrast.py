"""Distortion of runs against a reference run: displacement along the radius with its 3-sigma band.

f and the coefficients of the distortion trade against each other, so two runs may differ in each of them and agree on the
detector. The band is that of the difference, which knows what data the runs share; where that leaves no noise there is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.figures import theme
from boresight.figures.axes import hatch
from boresight.figures.chart import Table, Trace
from boresight.figures.trust_parts import column

TITLE = "Radial difference to the reference"
GUIDE = (
    "Each curve is how far a run places a star along the radius from where the reference run places it, with the ±3σ band of"
    " that difference. Runs that agree keep zero within their bands out to where stars reach; the hatched radii beyond are"
    " extrapolated."
)
MARGIN = 0.06  # of the height drawn, above and below
CROWDED = 8  # above so many bands nothing is seen through them


def draw(labels: Sequence[str], reference: int, curves: Sequence[Mapping[str, Any] | None]) -> go.Figure:
    """Draw one curve a run.

    Parameters
    ----------
    labels
        Of all runs.
    reference
        Index of the run that the others are set against.
    curves
        Of `calibration.contrast.radial_contrast`, None for the reference and for runs that have none.
    """
    order = [reference, *(i for i in range(len(labels)) if i != reference)]  # the colours of every other figure
    styles = dict(zip(order, theme.run_styles([Trace(labels[i], {}) for i in order]), strict=True))
    shown = [(styles[i], curve) for i in order if (curve := curves[i]) is not None]
    if not shown:
        return theme.missing(
            TITLE, "No other run of the same detector has a result yet: the curves appear when one has."
        )
    figure = go.Figure()
    for style, curve in shown:
        _draw_run(figure, style, curve, banded=len(shown) <= CROWDED)
    told = any(np.isfinite(column(curve["sigma_px"])).any() for _, curve in shown)
    words = "±3σ of the difference" if told else "the same data and equal sigmas: what differs is not noise"
    theme.dress(figure, title=f"Against {theme.escape(labels[reference])}, {words}", height_px=420)
    figure.update_xaxes(title_text="radius from the principal point (px)")
    figure.update_yaxes(title_text="run − reference (px)", zeroline=True)
    figure.layout.meta = {**(figure.layout.meta or {}), "axis": "radius_px"}
    _hatch_extrapolation(figure, [curve for _, curve in shown])
    return figure


def _draw_run(figure: go.Figure, style: theme.RunStyle, curve: Mapping[str, Any], *, banded: bool) -> None:
    """Add one run's curve, and its band where there is one."""
    radius, change, reach = column(curve["radius_px"]), column(curve["difference_px"]), 3 * column(curve["sigma_px"])
    if banded and np.isfinite(reach).any():
        figure.add_trace(theme.band(style, radius, change - reach, change + reach))
    angles = np.stack([column(curve["difference_arcsec"]), 3 * column(curve["sigma_arcsec"]), reach], axis=-1)
    spread = (" ±%{customdata[2]:.3f}", " ±%{customdata[1]:.2f}") if np.isfinite(reach).any() else ("", "")
    hover = f"%{{y:+.3f}}{spread[0]} px, %{{customdata[0]:+.2f}}{spread[1]}″<extra>{style.label}</extra>"
    figure.add_trace(theme.line(style, radius, change, customdata=theme.short(angles), hovertemplate=hover))


def _hatch_extrapolation(figure: go.Figure, curves: Sequence[Mapping[str, Any]]) -> None:
    """Hatch the radii that no star of both runs reached, over the height of what is drawn."""
    end = max(float(curve["radius_px"][-1]) for curve in curves)
    reached = [float(curve["data_radius_px"]) for curve in curves if curve["data_radius_px"] is not None]
    figure.update_xaxes(range=[0, end])
    if reached and min(reached) < end:
        drawn = np.concatenate([[0.0], *(np.asarray(trace.y, dtype=np.float64) for trace in figure.data)])
        low, high = float(np.nanmin(drawn)), float(np.nanmax(drawn))
        margin = MARGIN * (high - low) or 1.0
        window = (low - margin, high + margin)
        hatch(figure, (min(reached), end), window, named=True)
        figure.update_yaxes(range=window)


def table(run_ids: Sequence[int], curves: Sequence[Mapping[str, Any] | None]) -> Table:
    """List every curve below the other, the run's number first."""
    names = ("radius_px", "difference_px", "sigma_px", "difference_arcsec", "sigma_arcsec")
    listed: Table = {"run": [], **{name: [] for name in names}}
    for run_id, curve in zip(run_ids, curves, strict=True):
        if curve is not None:
            listed["run"] += [run_id] * len(curve["radius_px"])
            for name in names:
                listed[name] += curve[name]
    return listed
