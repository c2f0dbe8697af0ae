"""The residual spline over the detector: what the camera model leaves of a star's row and of its column, and where that is clear.

Two fields of colour on one scale about zero, which is as wide as the larger of what is left and three of its sigmas, so that
nothing but noise looks pale; a diamond marks a place that is more than three sigmas from zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import ResidualSpline
from boresight.estimation.statistics.consistency import CLEAR_SIGMAS
from boresight.figures.chart import Table
from boresight.figures.charts.residual_map import others
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import BETWEEN_PANELS, frame_maps, grid_place, stacked_px
from boresight.uplink.correction_table import COLUMNS
from boresight.verdicts.numbers import number

SIDES = {"row": "of rows", "col": "of columns"}


def draw(drawn: Sequence[Part[ResidualSpline]], beside: int = 2) -> go.Figure:
    """Draw the first run's displacement of rows, and of columns beside or below."""
    _, style, part = drawn[0]
    reach = max(_reach(part, side) for side in SIDES)
    titles, rows = [f"displacement {words}" for words in SIDES.values()], 2 // beside
    figure = make_subplots(
        rows, beside, horizontal_spacing=0.1, vertical_spacing=BETWEEN_PANELS / rows, subplot_titles=titles
    )
    for place, side in enumerate(SIDES):
        where = grid_place(place, beside)
        figure.add_trace(_field(part, side, reach, style.label, last=place == len(SIDES) - 1), **where)
        figure.add_trace(_marks(part, side, style.label), **where)
    title = f"{_headline(part)}{others([style.label for _, style, _ in drawn])}"
    height = stacked_px(430, rows, beside)
    theme.dress(figure, title=title, height_px=height, legend=False, hovermode="closest", margin={"t": 66})
    frame_maps(figure, len(SIDES), beside)
    return figure


def _displacement(part: ResidualSpline, side: str) -> tuple[FloatArray, FloatArray]:
    """The displacement along rows or columns and its sigma, (n_rows, n_columns) each, px."""
    if side == "row":
        return column(part.d_row_px), column(part.sigma_row_px)
    return column(part.d_col_px), column(part.sigma_col_px)


def _reach(part: ResidualSpline, side: str) -> float:
    d, sigma = _displacement(part, side)
    return float(max(np.abs(d).max(), CLEAR_SIGMAS * np.median(sigma)))


def _field(part: ResidualSpline, side: str, reach: float, label: str, *, last: bool) -> go.Heatmap:
    d, sigma = _displacement(part, side)
    return go.Heatmap(
        x=list_known(column(part.col_px)),
        y=list_known(column(part.row_px)),
        z=theme.short(d),
        customdata=theme.short(sigma),
        zmin=-reach,
        zmax=reach,
        colorscale="RdBu",
        colorbar={"title": {"text": "px"}, "thickness": 10},
        showscale=last,
        hovertemplate=f"%{{z:+.3f}} ± %{{customdata:.3f}} px<br>column %{{x:.0f}}, row %{{y:.0f}}<extra>{label}</extra>",
    )


def find_clear(part: ResidualSpline, side: str) -> tuple[FloatArray, FloatArray]:
    """Rows and columns of the places that are more than `CLEAR_SIGMAS` sigmas from zero, none where the test finds nothing."""
    d, sigma = _displacement(part, side)
    row, col = np.nonzero((np.abs(d) > CLEAR_SIGMAS * sigma) & part.structure)
    return column(part.row_px)[row], column(part.col_px)[col]


def _marks(part: ResidualSpline, side: str, label: str) -> go.Scatter:
    row, col = find_clear(part, side)
    marker = {"symbol": "diamond", "size": 7, "color": "#222222", "line": {"color": "#ffffff", "width": 1}}
    return go.Scatter(x=list_known(col), y=list_known(row), mode="markers", marker=marker, name=label, hoverinfo="skip")


def _headline(part: ResidualSpline) -> str:
    p = part.test.p
    chance = f"p = {number(p, 2)}" if p >= 1e-4 else "p < 0.0001"
    if not part.structure:
        return f"Nothing left beyond the noise, {chance}; at most {number(part.at_most_px, 2)} px (95 %)"
    largest = part.largest
    return f"Left: up to {number(largest.size_px, 2)} ± {number(largest.sigma_px, 1)} px, {chance}"


def table(part: ResidualSpline) -> Table:
    """List one place a row: its displacement along rows and columns with their sigmas, px."""
    row, col = np.meshgrid(column(part.row_px), column(part.col_px), indexing="ij")
    values = (row, col, *(column(getattr(part, name)) for name in COLUMNS[2:]))
    return {name: list_known(value.ravel()) for name, value in zip(COLUMNS, values, strict=True)}


RESIDUAL_SPLINE = part_figure(
    draw,
    table,
    "residual_spline",
    name="residual-spline",
    title="Displacement left by the camera model",
    guide=(
        "The colour is how far stars are from where the fitted camera puts them, as a smooth surface whose stiffness the "
        "data choose; a diamond marks what is more than three sigmas from zero. A pale detector without diamonds is good; a "
        "pattern is distortion that the camera model does not describe; the advice names a model that does."
    ),
    wide=True,
    advanced=True,
    forms={"narrow": partial(draw, beside=1)},
)
