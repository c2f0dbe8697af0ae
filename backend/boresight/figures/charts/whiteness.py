"""Whether what is left over has a memory: the autocorrelation of the residuals over frames, with its bound.

Drawn is the score of the parameter that is least white: what each frame's residuals would change that parameter by. Under
a right model scores of different frames are independent: correlations stay within 1.96 / sqrt(n) in nineteen lags of twenty.
Ljung and Box add them up to one chi-square.
"""

from __future__ import annotations

from collections.abc import Sequence

import plotly.graph_objects as go

from boresight.calibration.calibration import Whiteness
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.verdicts.numbers import number, quantity


def draw(drawn: Sequence[Part[Whiteness]]) -> go.Figure:
    """Draw one bar a lag and run, with the bounds of the first run."""
    figure = go.Figure([_bars(one) for one in drawn])
    many = len(drawn) > 1
    theme.dress(figure, title=_headline(drawn), height_px=520, legend=many, hovermode="closest", barmode="group")
    bound = drawn[0][2].bound
    for level in (-bound, bound):
        figure.add_hline(y=level, line=theme.LEVEL)
    figure.update_xaxes(title_text="lag (frames)", showgrid=False)
    figure.update_yaxes(title_text="autocorrelation")
    return figure


def _bars(one: Part[Whiteness]) -> go.Bar:
    _, style, part = one
    return theme.bars(style, list(part.lags), column(part.autocorrelation), "lag %{x}: %{y:+.3f}")


def _headline(drawn: Sequence[Part[Whiteness]]) -> str:
    part = drawn[0][2]
    if len(drawn) > 1:
        return "Autocorrelation of the residuals"
    word = "white" if part.white else "not white"
    name = quantity(part.name, drawn[0][0].result).markup
    return f"The residuals are {word}, for {name} (Ljung-Box p = {number(part.ljung_box.p, 2)})"


def table(part: Whiteness) -> Table:
    """List one lag a row: the autocorrelation and its bound."""
    return {
        "lag": list(part.lags),
        "autocorrelation": theme.plain(column(part.autocorrelation)),
        "bound": [part.bound] * len(part.lags),
    }


WHITENESS = part_figure(
    draw,
    table,
    "whiteness",
    name="whiteness",
    title="Whiteness of residuals",
    guide=(
        "Each bar is the correlation of the residuals of frames that far apart, for the worst parameter; the dotted bounds "
        "are those that chance alone keeps in nineteen lags of twenty. Bars that stay inside are good; a slow decay is a "
        "drift that constant parameters cannot follow, and makes every sigma too small."
    ),
    advanced=True,
)
