"""Claimed sigmas over the Cramer-Rao bound: no honest estimator is below one, a good one is close above it.

The bound is (J^T R^-1 J)^-1 at the final parameters, with R the covariance of the arcs that the centroids' noise gives.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import Efficiency
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.verdicts.numbers import number, quantity


def draw(drawn: Sequence[Part[Efficiency]]) -> go.Figure:
    """Draw one bar a parameter and run, and the bound as the level one."""
    figure = go.Figure([_bars(one, labelled=len(drawn) == 1) for one in drawn])
    many = len(drawn) > 1
    theme.dress(figure, title=_headline(drawn), height_px=460, legend=many, hovermode="closest", barmode="group")
    figure.add_hline(y=1, line={"color": theme.REFERENCE_COLOUR, "dash": "dot", "width": 1.4})
    figure.update_yaxes(title_text="claimed σ / bound", rangemode="tozero")
    figure.update_xaxes(showgrid=False)
    return figure


def _ratios(part: Efficiency) -> FloatArray:
    return column([part.ratio.get(name) for name in part.names])


def _bars(one: Part[Efficiency], *, labelled: bool) -> go.Bar:
    trace, style, part = one
    ratios = _ratios(part)
    names = [quantity(name, trace.result).markup for name in part.names]
    text = [number(ratio, 3) if np.isfinite(ratio) else "" for ratio in ratios] if labelled else None
    return theme.bars(style, names, ratios, "%{x}: %{y:.4g} times the bound", text=text)


def _headline(drawn: Sequence[Part[Efficiency]]) -> str:
    ratios = _ratios(drawn[0][2])
    if len(drawn) > 1 or not np.isfinite(ratios).any():
        return "Claimed sigma over the Cramér-Rao bound"
    return f"Claimed sigma over the Cramér-Rao bound: {number(np.nanmin(ratios), 3)} to {number(np.nanmax(ratios), 3)}"


def table(part: Efficiency) -> Table:
    """List one parameter a row: the bound in SI, the claimed sigma in SI, and their ratio."""
    bound = column([part.cramer_rao_sigma.get(name) for name in part.names])
    ratios = _ratios(part)
    return {
        "parameter": list(part.names),
        "cramer_rao_sigma": list_known(bound),
        "claimed_sigma": list_known(bound * ratios),
        "ratio": list_known(ratios),
    }


EFFICIENCY = part_figure(
    draw,
    table,
    "efficiency",
    name="efficiency",
    title="Cramér-Rao efficiency",
    guide=(
        "Each bar is the sigma that the run claims, divided by the smallest that any unbiased estimator can reach with these "
        "stars (dotted, 1). A little above 1 is good; below 1 the claim is too good to be true; far above 1 the method "
        "does not use all the information."
    ),
    advanced=True,
)
