"""Each parameter left out in turn: how much worse the fit becomes, and how far the others move to make up for it.

With the parameter held at its initial value, chi-square rises by one on average if the parameter has nothing to do, and
by more than 6.63 in one case of a hundred. The others' shift is counted in their own sigmas.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.calibration.calibration import DroppedParameter
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.verdicts.numbers import quantity

BY_CHANCE = 6.63  # the 99 % point of chi-square with one degree of freedom
LEAST = 0.1  # the log axis starts here; a fit that became no worse is drawn as a bar of no height


def draw(drawn: Sequence[Part[list[DroppedParameter]]]) -> go.Figure:
    """Draw the rise of chi-square on a log axis, and below it the shift of the others."""
    figure = make_subplots(2, 1, shared_xaxes=True, vertical_spacing=0.1)
    for one in drawn:
        rises = column([row.chi2_increase for row in one[2]])
        shifts = column([largest_shift(row) for row in one[2]])
        figure.add_trace(_bars(one, np.maximum(rises, LEAST), rises, "Δχ² %{customdata:.4g}"), row=1, col=1)
        figure.add_trace(_bars(one, np.maximum(shifts, LEAST), shifts, "%{customdata:.3g} σ"), row=2, col=1)
    many = len(drawn) > 1
    theme.dress(figure, title=_headline(drawn), height_px=440, legend=many, hovermode="closest", barmode="group")
    figure.update_traces(showlegend=False, row=2, col=1)
    figure.update_yaxes(type="log", dtick=1, exponentformat="power", minexponent=3)
    figure.update_yaxes(title_text="χ² rises by", range=_window(figure, 0), row=1, col=1)
    figure.update_yaxes(title_text="others move (σ)", range=_window(figure, 1), row=2, col=1)
    figure.update_xaxes(showgrid=False)
    figure.add_hline(y=BY_CHANCE, line=theme.LEVEL, row=1, col=1)
    return figure


def _window(figure: go.Figure, half: int) -> list[float]:
    """Choose the decades of a half's log axis, from below LEAST to above its highest bar."""
    highest = max(float(np.nanmax(np.asarray(trace.y, dtype=np.float64))) for trace in figure.data[half::2])
    return [float(np.log10(LEAST)) - 0.1, float(np.log10(max(highest, 2 * BY_CHANCE))) + 0.3]


def largest_shift(row: DroppedParameter) -> float | None:
    """Return how far the other parameters moved at most, in their sigmas."""
    return None if row.shift_in_sigma_of_others is None else abs(row.shift_in_sigma_of_others)


def _bars(one: Part[list[DroppedParameter]], values: FloatArray, told: FloatArray, hover: str) -> go.Bar:
    """Draw one run's bars; a parameter that is not needed is hatched."""
    trace, style, part = one
    names = [quantity(row.name, trace.result).markup for row in part]
    pattern = {"shape": ["" if row.needed else "/" for row in part]}
    more = {"customdata": theme.short(told), "marker": {"color": style.colour, "pattern": pattern}}
    return theme.bars(style, names, values, f"without %{{x}}: {hover}", offsetgroup=style.label, **more)


def _headline(drawn: Sequence[Part[list[DroppedParameter]]]) -> str:
    if len(drawn) > 1:
        return f"Leaving one parameter out, {len(drawn)} runs; hatched is not needed"
    spare = [quantity(row.name, drawn[0][0].result).markup for row in drawn[0][2] if not row.needed]
    return f"Not needed by these data: {', '.join(spare)} (hatched)" if spare else "Every free parameter is needed"


def table(part: list[DroppedParameter]) -> Table:
    """List one left-out parameter a row: rise of chi-square, RMS in rad, largest shift of the others in sigmas."""
    return {
        "left_out": [row.name for row in part],
        "chi2_increase": [row.chi2_increase for row in part],
        "rms_arc_rad": [row.rms_arc_rad for row in part],
        "largest_shift_in_sigma": [largest_shift(row) for row in part],
        "needed": [row.needed for row in part],
    }


DROP_ONE = part_figure(
    draw,
    table,
    "drop_one",
    name="drop-one",
    title="Leaving one parameter out",
    guide=(
        "Each column fixes one parameter at its initial value and fits the others; top: increase of chi-square (dotted: "
        "exceeded by chance in 1 % of cases); bottom: how much the others change. A hatched parameter is not "
        "needed, and freeing it only widens the sigmas of the rest."
    ),
    advanced=True,
)
