"""Two calibrations from two halves of the data: their difference over the detector, and by parameter in sigmas.

The halves share no frame, so their difference d has the covariance P_1 + P_2, and d^T (P_1 + P_2)^-1 d follows a
chi-square distribution if the model and the noise are what was assumed. A small RMS in either half proves nothing of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import list_known
from boresight.calibration.calibration import TwoHalves
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import BETWEEN_PANELS, cells, detector_map, frame_maps, grid_place, stacked_px
from boresight.verdicts.numbers import fixed, number, quantity

LIMIT_SIGMA = 3.0


def draw(drawn: Sequence[Part[TwoHalves]], beside: int = 2) -> go.Figure:
    """Draw the first run's map, and the bars of every run beside or below; a phone has no room for their numbers."""
    first = drawn[0]
    titles = [f"over the detector ({first[1].label})", "by parameter"] if len(drawn) > 1 else None
    rows = 2 // beside
    figure = make_subplots(
        rows, beside, horizontal_spacing=0.2, vertical_spacing=BETWEEN_PANELS / rows, subplot_titles=titles
    )
    scale = {"x": 0.41, "xanchor": "left"} if beside > 1 else {"len": 0.45, "y": 1, "yanchor": "top"}
    figure.add_trace(_map(first, scale), **grid_place(0, beside))
    for one in drawn:
        figure.add_trace(_bars(one, labelled=len(drawn) == 1 and beside > 1), **grid_place(1, beside))
    _dress(figure, drawn, beside)
    return figure


def _map(one: Part[TwoHalves], scale: dict[str, Any]) -> go.Heatmap:
    part = one[2].map
    reach = float(np.nanmax(np.abs(column(part.difference_arcsec)))) or 1.0
    drawing = detector_map(
        part, part.difference_arcsec, one[1].label, zmin=-reach, zmax=reach, colorscale=theme.DIVERGING
    )
    drawing.update(colorbar=scale)
    return drawing


def _bars(one: Part[TwoHalves], *, labelled: bool) -> go.Bar:
    trace, style, part = one
    values = column(part.difference_in_sigma)
    names = [quantity(name, trace.result).markup for name in part.names]
    written = [f"{'+' * bool(value > 0)}{fixed(value, 1)}" if np.isfinite(value) else "" for value in values]
    text = written if labelled else None
    return theme.bars(style, names, values, "%{x}: %{y:+.2f} σ", text=text, constraintext="none")


def _dress(figure: go.Figure, drawn: Sequence[Part[TwoHalves]], beside: int) -> None:
    many, height = len(drawn) > 1, stacked_px(440, 2 // beside, beside)
    theme.dress(figure, title=_headline(drawn), height_px=height, legend=many, hovermode="closest", barmode="group")
    if many:
        figure.update_layout(margin={"t": 96})
    frame_maps(figure, 1, 1)
    figure.update_traces(showlegend=many, selector={"type": "bar"})
    where = grid_place(1, beside)
    seen = [float(np.nanmax(np.abs(column(part.difference_in_sigma)), initial=0.0)) for _, _, part in drawn]
    reach = 1.15 * max(LIMIT_SIGMA, *seen)
    figure.update_yaxes(title_text="difference (σ of the difference)", range=[-reach, reach], **where)
    figure.update_xaxes(showgrid=False, **where)
    for level in (-LIMIT_SIGMA, LIMIT_SIGMA):
        figure.add_hline(y=level, line=theme.LEVEL, **where)


def _headline(drawn: Sequence[Part[TwoHalves]]) -> str:
    chi2 = drawn[0][2].chi2
    if len(drawn) > 1:
        return f"Two halves of the data, {len(drawn)} runs"
    differ = not chi2.consistent and chi2.value > chi2.upper
    word = "differ by more than their noise" if differ else "agree"
    return f"The halves {word}: χ² {number(chi2.value, 3)} for {chi2.dof} degrees of freedom"


def table(part: TwoHalves) -> Table:
    """List the parameters with their differences in sigmas, and beside them the cells of the map in arcsec."""
    bars: Table = {"parameter": list(part.names), "difference_in_sigma": list_known(column(part.difference_in_sigma))}
    columns = bars | cells(part.map, "difference_arcsec", part.map.difference_arcsec)
    length = max(len(values) for values in columns.values())
    return {name: values + [None] * (length - len(values)) for name, values in columns.items()}


TWO_HALVES = part_figure(
    draw,
    table,
    "two_halves",
    name="two-halves",
    title="Two halves",
    guide=(
        "The set is cut in two and each half is calibrated separately; the map shows where their arcs differ, the bars "
        "show the difference of each parameter in sigmas. Bars within ±3 (dotted) and a small map without pattern are good; larger "
        "differences mean that the model, the matches or the noise are not what the sigmas assume."
    ),
    wide=True,
    forms={"narrow": partial(draw, beside=1)},
)
