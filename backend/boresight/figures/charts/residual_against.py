"""The residual against what might explain it: radius, magnitude, temperature, time, colour, row, column, pixel phase.

In each bin the mean of the radial residual (outward is positive) with twice its sigma, and the RMS; against row, column and the
phases within a pixel it is the residual along that axis. A mean that leaves zero with radius is distortion, with magnitude charge
or a bloomed core, with temperature a focal length that breathes, with time ageing, with colour a lens that refracts blue and red
unlike, with row or column a readout line after line, with the phase centroids drawn to pixel centres. An RMS that grows with
magnitude is noise that does.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import RESIDUAL_UNITS, Calibration, ResidualAgainst, ResidualDependence
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import grid_place

PART = "residual_against"
#: What an axis is called where that is not the cause's own name.
TITLES = {"colour": "B−V", "row_phase": "row phase", "column_phase": "column phase"}
NARROW_LINE_PX = 170  # the height that a phone gives a panel of lines
REASON_LETTERS = 24  # a line of a reason inside its panel
REACH_SIGMA = 1.96


def draw(drawn: Sequence[Part[ResidualAgainst]], beside: int = 3) -> go.Figure:
    """Draw a panel a cause, so many beside each other; one without data says why."""
    rows = -(-len(RESIDUAL_UNITS) // beside)
    figure = make_subplots(rows, beside, horizontal_spacing=0.08, vertical_spacing=0.39 / rows)
    for number, cause in enumerate(RESIDUAL_UNITS):
        _panel(figure, drawn, cause, number, grid_place(number, beside))
    many, title = len(drawn) > 1, "Mean residual, 95 % bars; dotted: RMS"
    height = 760 if beside > 1 else 80 + NARROW_LINE_PX * rows
    theme.dress(figure, title=title, height_px=height, legend=many, hovermode="closest")
    figure.update_xaxes(nticks=4 if beside > 1 else 6, tickangle=0)
    _name_once(figure)
    return figure


def _panel(
    figure: go.Figure, drawn: Sequence[Part[ResidualAgainst]], cause: str, number: int, where: dict[str, int]
) -> None:
    """Add one cause: every run's means and RMS, or the reason why there is nothing."""
    known = [(style, bins) for _, style, part in drawn if (bins := part.by_cause[cause]) is not None]
    for style, bins in known:
        figure.add_trace(_means(style, bins), **where)
        figure.add_trace(_rms(style, bins), **where)
    unit = known[0][1].unit if known else RESIDUAL_UNITS[cause]
    figure.update_xaxes(title_text=f"{TITLES.get(cause, cause)} ({unit})", **where)
    figure.update_yaxes(title_text="residual (px)" if where["col"] == 1 else None, **where)
    if not known:
        _say(figure, _why(drawn[0][0].result, cause), number + 1, where)


def _why(result: Calibration, cause: str) -> str:
    unavailable = result.trust.unavailable if result.trust else {}
    return unavailable.get(f"{PART}.{cause}") or f"The telemetry has no {cause}."


def _say(figure: go.Figure, sentence: str, number: int, where: dict[str, int]) -> None:
    """Write a sentence into an empty panel, folded to its width."""
    words = "<br>".join(folded(theme.escape(sentence), REASON_LETTERS))
    figure.add_trace(
        go.Scatter(x=[None], y=[None], showlegend=False, hoverinfo="skip"), **where
    )  # makes the axes stand
    place = f"{number if number > 1 else ''} domain"
    figure.add_annotation(text=words, x=0.5, y=0.5, xref=f"x{place}", yref=f"y{place}")
    bare = {"showticklabels": False, "ticks": "", "showgrid": False, "zeroline": False, "range": [0, 1]}
    figure.update_xaxes(**bare, **where)
    figure.update_yaxes(title_text=None, **bare, **where)


def folded(sentence: str, letters: int) -> list[str]:
    """Break a sentence into lines of about so many letters."""
    lines = [""]
    for word in sentence.split():
        if len(lines[-1]) + len(word) > letters:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def _centres(bins: ResidualDependence) -> FloatArray:
    edges = column(bins.edges)
    return np.asarray((edges[1:] + edges[:-1]) / 2)


def _means(style: theme.RunStyle, bins: ResidualDependence) -> go.Scatter:
    error = REACH_SIGMA * column(bins.sigma_of_mean_px)
    hover = f"%{{y:+.3f}} px, %{{customdata:.0f}} stars<extra>{style.label}</extra>"
    options: dict[str, Any] = {"mode": "lines+markers", "customdata": theme.short(column(bins.count))}
    drawn = theme.line(style, _centres(bins), column(bins.mean_px), hovertemplate=hover, **options)
    known = np.where(np.isfinite(error), error, 0.0)
    drawn.update(error_y={"array": theme.short(known), "thickness": 1.2, "width": 2}, marker={"size": 5})
    drawn.update(connectgaps=False)
    return drawn


def _rms(style: theme.RunStyle, bins: ResidualDependence) -> go.Scatter:
    hover = f"RMS %{{y:.3f}} px<extra>{style.label}</extra>"
    drawn = theme.line(style, _centres(bins), column(bins.rms_px), hovertemplate=hover)
    drawn.update(line={"dash": "dot", "width": 1.2}, connectgaps=False)
    return drawn


def _name_once(figure: go.Figure) -> None:
    """Name every run once in the legend, though it is drawn in many panels."""
    seen: set[str] = set()
    for trace in figure.data:
        trace.showlegend = trace.name is not None and trace.name not in seen
        trace.legendgroup = trace.name
        seen.add(trace.name)


def table(part: ResidualAgainst) -> Table:
    """List one bin a row: cause, edges with their unit, stars, mean with its sigma, and RMS in px."""
    rows: list[tuple[Any, ...]] = []
    for cause, bins in part.by_cause.items():
        if bins is None:
            continue
        columns = (bins.edges, bins.mean_px, bins.sigma_of_mean_px, bins.rms_px, bins.count)
        edges, means, sigma, spreads, counts = (list_known(column(values)) for values in columns)
        rows += [
            (cause, edges[i], edges[i + 1], bins.unit, counts[i], means[i], sigma[i], spreads[i])
            for i in range(len(means))
        ]
    names = ("against", "from", "to", "unit", "stars", "mean_px", "sigma_of_mean_px", "rms_px")
    return {name: list(values) for name, values in zip(names, zip(*rows, strict=True), strict=True)} if rows else {}


RESIDUAL_AGAINST = part_figure(
    draw,
    table,
    PART,
    name="residual-against",
    title="Residual against causes",
    guide=(
        "Each panel shows the binned residual against one possible cause: mean with 95 % bar, and RMS (dotted); the "
        "residual is radial (outward positive), or along the axis for row, column and pixel phase. Means that are zero "
        "within their bars are good; a slope shows what the model or the centroiding does not include."
    ),
    advanced=True,
    forms={"narrow": partial(draw, beside=1)},
)
