"""The normalised innovations over time, nu^T S^-1 nu of each frame over its degrees of freedom, and whether they have a memory.

The whole run may pass on average while its beginning is too bold and its end too timid; frame by frame that shows. One
frame in twenty is outside by chance. Of a batch run the innovations are each frame's residuals at the final parameters.

Whiteness is the autocorrelation of the residuals over frames, with its bound. Drawn is the score of the parameter that is least
white: what each frame's residuals would change that parameter by. Under a right model scores of different frames are independent:
correlations stay within 1.96 / sqrt(n) in nineteen lags of twenty. Ljung and Box add them up to one chi-square.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import NisOverTime, Whiteness
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import axis_title, hover_place
from boresight.figures.style.thinning import keep_extremes
from boresight.verdicts.numbers import number, percent, quantity

POINT_BUDGET = 6000  # points of all runs together
WINDOW_SHARE = 0.05  # of the frames, over which the mean runs


def draw(drawn: Sequence[Part[NisOverTime]]) -> go.Figure:
    """Draw each run's frames as points, those outside their bounds as crosses, with the bounds and a running mean."""
    figure = go.Figure()
    for one in drawn:
        _draw_run(figure, one, POINT_BUDGET // len(drawn), alone=len(drawn) == 1)
    theme.dress(figure, title=_headline(drawn), height_px=440, hovermode="closest")
    figure.add_hline(y=1, line=theme.LEVEL)
    figure.update_xaxes(title_text=axis_title("frame", [trace for trace, _, _ in drawn]))
    figure.update_yaxes(title_text="NIS / degree of freedom", rangemode="tozero")
    return figure


def _draw_run(figure: go.Figure, one: Part[NisOverTime], limit: int, *, alone: bool) -> None:
    _, style, part = one
    frame, nis = column(part.frame), column(part.nis_per_dof)
    low, high = column(part.lower), column(part.upper)
    kept = keep_extremes([nis], limit // 3)
    for bound in (low, high):
        options = {"name": "95 % bounds", "showlegend": alone and bound is high, "hoverinfo": "skip", "meta": None}
        level = theme.line(style, frame[kept], bound[kept], **options)
        level.update(line={"dash": "dot", "width": 1, "color": theme.translucent(style.colour, 0.8)})
        figure.add_trace(level)
    figure.add_trace(_points(one, frame, nis, (nis < low) | (nis > high), kept, alone=alone))
    mean = running_mean(nis, max(5, int(WINDOW_SHARE * len(nis))))
    sparse = keep_extremes([mean], limit // 3)
    hover = f"mean %{{y:.3g}}<extra>{style.label}</extra>"
    options = {"name": "running mean" if alone else style.label, "hovertemplate": hover, "showlegend": True}
    figure.add_trace(theme.line(style, frame[sparse], mean[sparse], **options))
    if alone:
        figure.update_traces(legendgroup=None)


def _points(
    one: Part[NisOverTime], frame: FloatArray, nis: FloatArray, outside: Any, kept: Any, *, alone: bool
) -> go.Scatter:
    """Draw the frames, a frame outside its bounds by another shape."""
    style = one[1]
    return go.Scatter(
        x=theme.short(frame[kept]),
        y=theme.short(nis[kept]),
        mode="markers",
        name="one frame",
        legendgroup=style.label,
        showlegend=alone,
        marker={
            "color": theme.translucent(style.colour, 0.55),
            "size": np.where(outside[kept], 7, 4).astype(np.int8),
            "symbol": ["x-thin-open" if out else "circle" for out in outside[kept]],
            "line": {"width": np.where(outside[kept], 1.6, 0.0).astype(np.float32), "color": style.colour},
        },
        hovertemplate=f"{hover_place(one[0])}: %{{y:.3g}}<extra>{style.label}</extra>",
    )


def running_mean(values: FloatArray, width: int) -> FloatArray:
    """Average over the `width` values around each, (n,), fewer at the ends; NaN counts as absent."""
    known = np.isfinite(values)
    sums, counts = (np.append(0.0, np.cumsum(part)) for part in (np.where(known, values, 0.0), known))
    start = np.maximum(np.arange(len(values)) - width // 2, 0)
    end = np.minimum(np.arange(len(values)) + (width + 1) // 2, len(values))
    with np.errstate(invalid="ignore"):
        return np.asarray((sums[end] - sums[start]) / (counts[end] - counts[start]))


def _headline(drawn: Sequence[Part[NisOverTime]]) -> str:
    part = drawn[0][2]
    if len(drawn) > 1:
        return f"Normalised innovations by frame, {len(drawn)} runs"
    return f"{percent(part.outside_share)} of the frames are outside, {percent(part.expected_share)} are expected"


def table(part: NisOverTime) -> Table:
    """List one frame a row: the innovation a degree of freedom and its bounds."""
    columns: Table = {"frame": list(part.frame)}
    told = {"nis_per_dof": part.nis_per_dof, "lower": part.lower, "upper": part.upper}
    return columns | {name: list_known(column(values)) for name, values in told.items()}


INNOVATIONS = part_figure(
    draw,
    table,
    "nis_over_time",
    name="innovations",
    title="Innovations over time",
    guide=(
        "Each point is one frame's normalised innovation, a cross where it is outside its 95 % bounds (dotted), and the line "
        "is their running mean. A mean that stays at 1 with one frame in twenty outside means that the covariance is right; "
        "a mean above 1 means over-confidence, and a step or a slope means that the sensor changed."
    ),
    advanced=True,
)


def draw_whiteness(drawn: Sequence[Part[Whiteness]]) -> go.Figure:
    """Draw one bar a lag and run, with the bounds of the first run."""
    figure = go.Figure([_bars(one) for one in drawn])
    many = len(drawn) > 1
    theme.dress(
        figure, title=_whiteness_headline(drawn), height_px=520, legend=many, hovermode="closest", barmode="group"
    )
    bound = drawn[0][2].bound
    for level in (-bound, bound):
        figure.add_hline(y=level, line=theme.LEVEL)
    figure.update_xaxes(title_text="lag (frames)", showgrid=False)
    figure.update_yaxes(title_text="autocorrelation")
    return figure


def _bars(one: Part[Whiteness]) -> go.Bar:
    _, style, part = one
    return theme.bars(style, list(part.lags), column(part.autocorrelation), "lag %{x}: %{y:+.3f}")


def _whiteness_headline(drawn: Sequence[Part[Whiteness]]) -> str:
    part = drawn[0][2]
    if len(drawn) > 1:
        return "Autocorrelation of the residuals"
    word = "white" if part.white else "not white"
    name = quantity(part.name, drawn[0][0].result).markup
    return f"The residuals are {word}, for {name} (Ljung-Box p = {number(part.ljung_box.p, 2)})"


def list_lags(part: Whiteness) -> Table:
    """List one lag a row: the autocorrelation and its bound."""
    return {
        "lag": list(part.lags),
        "autocorrelation": list_known(column(part.autocorrelation)),
        "bound": [part.bound] * len(part.lags),
    }


WHITENESS = part_figure(
    draw_whiteness,
    list_lags,
    "whiteness",
    name="whiteness",
    title="Whiteness of residuals",
    guide=(
        "Each bar is the correlation between residuals of frames at that lag, for the worst parameter; by chance, 95 % of the "
        "lags stay within the dotted bounds. Bars that stay inside are good; a slow decay is a "
        "drift that constant parameters cannot follow, and makes every sigma too small."
    ),
    advanced=True,
)
