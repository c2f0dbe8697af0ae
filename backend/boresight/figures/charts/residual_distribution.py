"""How residuals over their sigmas are distributed: a histogram beside the normal curve, and quantiles against the normal's.

On the left the share of residuals in each bin of a quarter sigma at the best fit, of the first run at its old parameters too.
On the right sample quantiles less the normal deviates they should equal: the straight line of a QQ plot lies on zero there, and
a tenth of a sigma can be seen beside three sigmas of what so many residuals can be off by chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import Histogram, ResidualDistribution
from boresight.estimation.statistics.consistency import CLEAR_SIGMAS
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import BETWEEN_PANELS, grid_place, stacked_px
from boresight.verdicts.numbers import NARROW_SPACE, percent

NORMAL = np.linspace(-6, 6, 121)
PERCENT = 100.0


def draw(drawn: Sequence[Part[ResidualDistribution]], beside: int = 2) -> go.Figure:
    """Draw the histograms of all runs over the normal curve, and their quantiles beside or below."""
    titles = ["share of residuals", "quantile − normal quantile"]
    rows, (one_panel, other) = 2 // beside, (grid_place(number, beside) for number in range(2))
    figure = make_subplots(
        rows, beside, horizontal_spacing=0.1, vertical_spacing=BETWEEN_PANELS / rows, subplot_titles=titles
    )
    figure.add_trace(_steps(drawn[0], drawn[0][2].before, is_old=True), **one_panel)
    for one in drawn:
        figure.add_trace(_steps(one, one[2].after), **one_panel)
        for trace in _quantiles(one):
            figure.add_trace(trace, **other)
    figure.add_trace(_normal_curve(float(np.diff(column(drawn[0][2].edges)).mean())), **one_panel)
    height = stacked_px(440, rows, beside)
    theme.dress(figure, title=_headline(drawn), height_px=height, hovermode="closest", margin={"t": 96})
    figure.add_hline(y=0, line=theme.LEVEL, **other)
    figure.update_xaxes(title_text="residual (σ)", range=[-6, 6], **one_panel)
    figure.update_xaxes(title_text="normal deviate", **other)
    figure.update_yaxes(rangemode="tozero", ticksuffix=f"{NARROW_SPACE}%", **one_panel)
    figure.update_yaxes(title_text="σ", **other)
    return figure


def shares(histogram: Histogram) -> FloatArray:
    """Share of all residuals that each bin holds, (n_bins,); what lies beyond the bins counts among all."""
    counts = column(histogram.counts)
    return np.asarray(counts / max(counts.sum() + histogram.below + histogram.above, 1))


def _steps(one: Part[ResidualDistribution], histogram: Histogram, *, is_old: bool = False) -> go.Scatter:
    """Draw a histogram as steps; the one at the old parameters in the style of a reference."""
    _, style, part = one
    edges, share = column(part.edges), shares(histogram)
    line: dict[str, Any] = {"shape": "hv", "color": style.colour, "dash": style.dash, "width": 1.8}
    name = style.label
    if is_old:
        beyond = 1 - float(share.sum())
        line |= {"color": theme.REFERENCE_COLOUR, "dash": "dot", "width": 1.4}
        name = f"old parameters, {percent(beyond, 0)} beyond 6 σ"
    return go.Scatter(
        x=theme.short(edges),
        y=theme.short(PERCENT * np.append(share, share[-1])),
        mode="lines",
        name=name,
        legendgroup=name,
        meta=theme.tag_run(style.label),
        line=line,
        hovertemplate=f"%{{y:.2f}}{NARROW_SPACE}% from %{{x}} σ on<extra>{name}</extra>",
    )


def _normal_curve(width: float) -> go.Scatter:
    """Draw the share that a bin of this width has of a standard normal."""
    share = width * np.exp(-(NORMAL**2) / 2) / np.sqrt(2 * np.pi)
    line = {"color": theme.TRUTH_COLOUR, "width": 1.4, "dash": "dash"}
    return go.Scatter(
        x=theme.short(NORMAL),
        y=theme.short(PERCENT * share),
        mode="lines",
        name="normal curve",
        line=line,
        hoverinfo="skip",
    )


def _quantiles(one: Part[ResidualDistribution]) -> list[go.Scatter]:
    """Draw a run's quantiles less the deviates, with the band of chance about zero."""
    _, style, part = one
    normal, off = column(part.normal), column(part.quantile) - column(part.normal)
    reach = CLEAR_SIGMAS * column(part.sigma_of_quantile)
    hover = f"%{{y:+.3f}} σ at %{{x}}<extra>{style.label}</extra>"
    return [
        theme.band(style, normal, -reach, reach),
        theme.line(style, normal, off, hovertemplate=hover, showlegend=False),
    ]


def _headline(drawn: Sequence[Part[ResidualDistribution]]) -> str:
    part = drawn[0][2]
    if len(drawn) > 1:
        return f"Residuals over their sigmas, {len(drawn)} runs"
    tails = f"{percent(part.beyond_share, 2)} beyond 3 spreads, {percent(part.expected_share, 2)} expected"
    return f"Residuals have a standard deviation of {part.sigma:.2f} σ; {tails}"


def table(part: ResidualDistribution) -> Table:
    """List one bin a row with its counts, and beside them the quantiles; the shorter of the two ends in empty cells."""
    edges = column(part.edges)
    columns: Table = {"from_sigma": list_known(edges[:-1]), "to_sigma": list_known(edges[1:])}
    columns |= {
        "count_before": list(part.before.counts),
        "count_after": list(part.after.counts),
        "normal_deviate": list_known(column(part.normal)),
        "quantile_sigma": list_known(column(part.quantile)),
        "sigma_of_quantile": list_known(column(part.sigma_of_quantile)),
    }
    longest = max(map(len, columns.values()))
    return {name: values + [None] * (longest - len(values)) for name, values in columns.items()}


RESIDUAL_DISTRIBUTION = part_figure(
    draw,
    table,
    "residual_distribution",
    name="residual-distribution",
    title="Distribution of residuals",
    guide=(
        "On the left is the share of residuals over their sigmas in each bin, with the normal curve and the result of "
        "the old parameters; on the right are their quantiles minus those of a normal distribution, with the band "
        "expected by chance. Steps on the curve and a line inside the band are good; tails outside the band indicate "
        "wrong stars; a slope indicates a wrong noise."
    ),
    wide=True,
    forms={"narrow": partial(draw, beside=1)},
    advanced=True,
)
