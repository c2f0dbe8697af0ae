"""What is left over on the detector: the residual of each centroid after the best attitude of its exposure.

On the left the stars one by one, on the right their mean in each cell of a grid. Single residuals are noise of the
centroids; a mean that is more than three of its own sigmas long is what the camera model has not understood. The sigma
of a cell's mean is the scatter of its stars over the root of their number.

Where centroids are noisier: the RMS residual of each cell of the detector at the best fit, one map a run.

The field of residuals before and after: the mean residual of each cell of the detector as an arrow, beside its noise.

A circle about an arrow's foot has three sigmas of that mean as its radius, drawn to the same scale, so an arrow that ends inside
is noise and not structure. Before and after have each a scale of their own, with a bar of a round length under the
detector, because a ground calibration's residuals are ten times those of a fit and more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import FieldOfResiduals, ResidualField, Residuals
from boresight.estimation.statistics.consistency import CLEAR_SIGMAS
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import BETWEEN_PANELS, MAX_MAPS, draw_maps, frame_maps, grid_place, stacked_px
from boresight.verdicts.numbers import count, number

COLUMNS = ("row_px", "col_px", "d_row_px", "d_col_px")
CELLS = 10  # along the longer side
LEAST_STARS = 4  # in a cell, for a mean with a sigma
ARROW_SHARE = 0.03  # of the detector's width: the length of the typical arrow


@dataclass(frozen=True)
class ArrowField:
    """Arrows: where they start and what they say, (n,) each, px; `clear` those that stand out of their noise."""

    row: FloatArray
    col: FloatArray
    d_row: FloatArray
    d_col: FloatArray
    clear: NDArray[np.bool_]


def draw(drawn: Sequence[Part[Residuals]], beside: int = 2) -> go.Figure:
    """Draw the first run's stars as arrows, and the mean arrow of each cell beside or below."""
    stars = _stars(drawn[0][2])
    means = cell_means(stars)
    names = [f"star by star, {count(_scale(stars))} times", f"mean of each cell, {count(_scale(means))} times"]
    figure = _lay_pair(names, beside)
    style = drawn[0][1]
    _arrows(figure, stars, style, theme.translucent(style.colour, 0.75), is_mean=False, **grid_place(0, beside))
    _arrows(figure, means, style, style.colour, is_mean=True, **grid_place(1, beside))
    n_clear = int(np.sum(means.clear))
    counted = f"{n_clear} of {len(means.row)} cell means exceed their noise"
    title = f"Residuals: {counted}{others([style.label for _, style, _ in drawn])}"
    theme.dress(figure, title=title, height_px=stacked_px(470, 2 // beside, beside), legend=False, hovermode="closest")
    frame_maps(figure, 2, beside)
    return figure


def _lay_pair(titles: Sequence[str], beside: int) -> go.Figure:
    """Make room for one or two maps of a detector, so many beside each other, of which the left one has the labels of rows."""
    columns, rows = min(beside, len(titles)), -(-len(titles) // beside)
    return make_subplots(
        rows, columns, shared_yaxes=True, horizontal_spacing=0.05, vertical_spacing=BETWEEN_PANELS / rows,
        subplot_titles=titles,
    )  # fmt: skip


def others(labels: Sequence[str]) -> str:
    """Say which runs are compared with but not drawn: arrows over arrows could not be read."""
    if len(labels) <= 1:
        return ""
    more = f" and {len(labels) - 3} more" if len(labels) > 3 else ""
    return f"<br>for {labels[0]} only; open {', '.join(labels[1:3])}{more} to see the others"


def _stars(part: Residuals) -> ArrowField:
    row, col, d_row, d_col = (column(getattr(part, name)) for name in COLUMNS)
    return ArrowField(row, col, d_row, d_col, clear=np.zeros(len(row), dtype=bool))


def cell_means(stars: ArrowField) -> ArrowField:
    """Average the arrows of each cell of a square grid that has LEAST_STARS of them.

    A mean is clear when either component is more than CLEAR_SIGMAS of its own sigmas from zero.
    """
    size = max(np.ptp(stars.row), np.ptp(stars.col)) / CELLS or 1.0
    place = np.stack([stars.row - stars.row.min(), stars.col - stars.col.min()]) // size
    found = []
    for cell in np.unique(place, axis=1).T:
        inside = np.all(cell == place.T, axis=1)
        if (n := int(inside.sum())) >= LEAST_STARS:
            values = np.stack([stars.row, stars.col, stars.d_row, stars.d_col])[:, inside]
            mean, sigma = values.mean(axis=1), values[2:].std(axis=1, ddof=1) / np.sqrt(n)
            found.append([*mean, float(np.any(np.abs(mean[2:]) > CLEAR_SIGMAS * sigma))])
    row, col, d_row, d_col, clear = np.array(found, dtype=np.float64).reshape(-1, 5).T
    return ArrowField(row, col, d_row, d_col, clear > 0)


def _scale(arrows: ArrowField) -> float:
    """Choose how many times longer than life the arrows are drawn: 1, 2 or 5 times a power of ten."""
    typical = float(np.median(np.hypot(arrows.d_row, arrows.d_col))) if len(arrows.row) else 0.0
    wanted = ARROW_SHARE * float(np.ptp(arrows.col)) / typical if typical > 0 and len(arrows.row) > 1 else 1.0
    power = 10.0 ** np.floor(np.log10(max(wanted, 1.0)))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= max(wanted, 1.0)) * power)


def _arrows(
    figure: go.Figure, arrows: ArrowField, style: theme.RunStyle, colour: str, *, is_mean: bool, **where: int
) -> None:
    """Draw each arrow as a line from its star, and the star as a mark: a diamond where the arrow is clear."""
    scale, gap = _scale(arrows), np.full(len(arrows.row), np.nan)
    x = np.stack([arrows.col, arrows.col + scale * arrows.d_col, gap], axis=1).ravel()
    y = np.stack([arrows.row, arrows.row + scale * arrows.d_row, gap], axis=1).ravel()
    line = {"color": colour, "width": 2 if is_mean else 1}
    figure.add_trace(
        go.Scatter(x=theme.short(x), y=theme.short(y), mode="lines", line=line, hoverinfo="skip", name=style.label),
        **where,
    )
    figure.add_trace(
        go.Scatter(
            x=theme.short(arrows.col),
            y=theme.short(arrows.row),
            mode="markers",
            name=style.label,
            marker={
                "color": colour,
                "line": {"width": 0},
                "size": np.where(arrows.clear, 9, 4 if is_mean else 3).astype(np.int8),
                "symbol": ["diamond" if clear else "circle" for clear in arrows.clear] if is_mean else "circle",
            },
            customdata=theme.short(np.stack([arrows.d_row, arrows.d_col], axis=1)),
            hovertemplate="rows %{customdata[0]:+.3f} px, columns %{customdata[1]:+.3f} px<extra></extra>",
        ),
        **where,
    )


def table(part: Residuals) -> Table:
    """List one star a row: frame, star, place and residual in px."""
    columns: Table = {"frame": list(part.frame)} | ({} if part.star_id is None else {"star_id": list(part.star_id)})
    return columns | {name: list_known(column(getattr(part, name))) for name in COLUMNS}


RESIDUAL_MAP = part_figure(
    draw,
    table,
    "residuals",
    name="residual-map",
    title="Residuals on the detector",
    guide=(
        "Each line points from where a star was measured to where the camera model and the best attitude of its exposure put "
        "it, enlarged as stated; on the right are the means of cells, with a diamond where a mean exceeds its noise. Arrows "
        "in all directions are good; a common pattern of arrows indicates distortion that the model does not describe."
    ),
    wide=True,
    advanced=True,
    forms={"narrow": partial(draw, beside=1)},
)


def draw_residual_rms(found: Sequence[Part[ResidualField]], beside: int = 2) -> go.Figure:
    """Lay the maps of the runs on one scale, so many beside each other."""
    drawn = found[:MAX_MAPS]
    top = max(float(np.nanmax(_rms(part))) for _, _, part in drawn)
    title = f"RMS {number(drawn[0][2].after.rms_in_all_px, 3)} px an axis at the best fit"
    return draw_maps(drawn, partial(_map, top), title=title, height_px=440, beside=beside)


def _rms(part: ResidualField) -> FloatArray:
    """RMS of each cell, px, NaN where it has too few stars."""
    return column(part.after.rms_px)


def _map(top: float, one: Part[ResidualField], last: bool) -> go.Heatmap:
    _, style, part = one
    row, col = column(part.row_edges_px), column(part.col_edges_px)
    return go.Heatmap(
        x=list_known((col[1:] + col[:-1]) / 2),
        y=list_known((row[1:] + row[:-1]) / 2),
        z=theme.short(_rms(part)),
        customdata=theme.short(column(part.after.count)),
        zmin=0,
        zmax=top,
        colorscale="Cividis",
        colorbar={"title": {"text": "px"}, "thickness": 10},
        showscale=last,
        hovertemplate=f"RMS %{{z:.3f}} px of %{{customdata:.0f}} stars<extra>{style.label}</extra>",
        hoverongaps=False,
    )


def table_residual_rms(part: ResidualField) -> Table:
    """List one cell a row: its edges, RMS before and after in px, and how many stars it has."""
    row, col = column(part.row_edges_px), column(part.col_edges_px)
    i, j = (index.ravel() for index in np.indices((len(row) - 1, len(col) - 1)))
    columns = {"row_from_px": row[i], "row_to_px": row[i + 1], "column_from_px": col[j], "column_to_px": col[j + 1]}
    sides = {f"rms_{side}_px": column(field.rms_px).ravel() for side, field in list_sides(part).items()}
    stars = {"stars": column(part.after.count).ravel()}
    return {name: list_known(values) for name, values in (columns | sides | stars).items()}


RESIDUAL_RMS = part_figure(
    draw_residual_rms,
    table_residual_rms,
    "residual_field",
    name="residual-rms",
    title="RMS residual over the detector",
    guide=(
        "Each cell has the colour of the RMS residual per axis of its stars at the best fit; a cell with fewer than four "
        "stars is left empty. An even colour is good; an edge or a corner that stands out has noisier centroids, or a "
        "distortion that the model does not have."
    ),
    advanced=True,
    forms={"narrow": partial(draw_residual_rms, beside=1)},
)


LONGEST_SHARE = 0.8  # of a cell: the typical arrow among the longest
CIRCLE = np.append(np.exp(2j * np.pi * np.arange(17) / 16), np.nan)


@dataclass(frozen=True)
class MeanCells:
    """Cells that have a mean, (n,) each, px: centre, mean residual, its two sigmas, and how many stars."""

    row: FloatArray
    col: FloatArray
    d_row: FloatArray
    d_col: FloatArray
    s_row: FloatArray
    s_col: FloatArray
    count: FloatArray

    @property
    def clear(self) -> NDArray[np.bool_]:
        """Which means stand out of their noise on either axis."""
        out = np.abs(self.d_row) > CLEAR_SIGMAS * self.s_row
        return np.asarray(out | (np.abs(self.d_col) > CLEAR_SIGMAS * self.s_col))


def list_sides(part: ResidualField) -> dict[str, FieldOfResiduals]:
    """Return the residuals before, where they are known, and after."""
    return ({} if part.before is None else {"before": part.before}) | {"after": part.after}


def read_cells(part: ResidualField, field: FieldOfResiduals) -> MeanCells:
    """Read the cells of one side."""
    edges = column(part.row_edges_px), column(part.col_edges_px)
    row, col = (middle.ravel() for middle in np.meshgrid(*((e[1:] + e[:-1]) / 2 for e in edges), indexing="ij"))
    told = (field.mean_row_px, field.mean_col_px, field.sigma_row_px, field.sigma_col_px, field.count)
    values = np.stack([row, col, *(column(cells).ravel() for cells in told)])
    return MeanCells(*values[:, np.isfinite(values[2])])


def draw_quiver(drawn: Sequence[Part[ResidualField]], beside: int = 2) -> go.Figure:
    """Draw the first run's cells, before first and after second."""
    _, style, part = drawn[0]
    sides = list_sides(part)
    titles = [f"{side}: RMS {number(field.rms_in_all_px, 3)} px" for side, field in sides.items()]
    figure = _lay_pair(titles, beside)
    for place, (side, field) in enumerate(sides.items()):
        colour = theme.REFERENCE_COLOUR if side == "before" else style.colour
        _side(figure, part, read_cells(part, field), colour, style.label, **grid_place(place, beside))
    after = read_cells(part, part.after)
    n_cells = sum(map(len, part.after.mean_row_px))
    few = "" if len(after.row) == n_cells else f" ({n_cells - len(after.row)} of {n_cells} have too few stars)"
    counted = f"{int(after.clear.sum())} of {len(after.row)} cells{few} have a mean clear of its noise after"
    title = f"Residuals: {counted}{others([style.label for _, style, _ in drawn])}"
    height = stacked_px(500, -(-len(sides) // beside), beside)
    theme.dress(figure, title=title, height_px=height, legend=False, hovermode="closest", margin={"t": 66})
    _frame_cells(figure, part, len(sides), beside)
    return figure


def choose_scale(cells: MeanCells, size_px: float) -> float:
    """Choose how many times longer than life arrows are drawn in cells of a size: 1, 2 or 5 times a power of ten."""
    longest = float(np.quantile(np.hypot(cells.d_row, cells.d_col), 0.9)) if len(cells.row) else 0.0
    return _round_down(LONGEST_SHARE * size_px / longest) if longest > 0 else 1.0


def _round_down(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, not above the value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-9)) * power)


def _side(figure: go.Figure, part: ResidualField, cells: MeanCells, colour: str, label: str, **where: int) -> None:
    """Draw noise circles, arrows, their feet, and the bar that says how long they are."""
    columns, rows = column(part.col_edges_px), column(part.row_edges_px)
    scale = choose_scale(cells, float(np.diff(columns).mean()))
    gap = np.full(len(cells.row), np.nan)
    circle_x = cells.col[:, None] + CLEAR_SIGMAS * scale * cells.s_col[:, None] * CIRCLE.real
    circle_y = cells.row[:, None] + CLEAR_SIGMAS * scale * cells.s_row[:, None] * CIRCLE.imag
    x = np.stack([cells.col, cells.col + scale * cells.d_col, gap], axis=1)
    y = np.stack([cells.row, cells.row + scale * cells.d_row, gap], axis=1)
    quiet = {"mode": "lines", "hoverinfo": "skip", "name": label}
    for lines, width, shade in (((circle_x, circle_y), 0.8, 0.4), ((x, y), 2, 1.0)):
        line = {"width": width, "color": theme.translucent(colour, shade) if shade < 1 else colour}
        figure.add_trace(
            go.Scatter(x=theme.short(lines[0].ravel()), y=theme.short(lines[1].ravel()), line=line, **quiet), **where
        )
    figure.add_trace(_feet(cells, colour, label), **where)
    _bar(figure, (columns[0], columns[-1], rows[-1]), scale, where)


def _feet(cells: MeanCells, colour: str, label: str) -> go.Scatter:
    """Draw where arrows begin: a diamond where the mean is clear of its noise."""
    return go.Scatter(
        x=theme.short(cells.col),
        y=theme.short(cells.row),
        mode="markers",
        name=label,
        marker={
            "color": colour,
            "line": {"width": 0},
            "size": np.where(cells.clear, 8, 4).astype(np.int8),
            "symbol": ["diamond" if clear else "circle" for clear in cells.clear],
        },
        customdata=theme.short(np.stack([cells.d_row, cells.s_row, cells.d_col, cells.s_col, cells.count], axis=1)),
        hovertemplate=(
            "rows %{customdata[0]:+.3f} ± %{customdata[1]:.3f} px<br>columns %{customdata[2]:+.3f} ± %{customdata[3]:.3f} px"
            "<br>%{customdata[4]:.0f} stars<extra></extra>"
        ),
    )


def _bar(figure: go.Figure, corner: tuple[float, float, float], scale: float, where: dict[str, int]) -> None:
    """Draw a round length of residual under the detector, to scale."""
    left, right, bottom = corner
    length = _round_down(0.15 * (right - left) / scale)
    at = bottom + 0.05 * (right - left)
    figure.add_trace(
        go.Scatter(
            x=[left, left + length * scale],
            y=[at, at],
            mode="lines+markers+text",
            line={"color": theme.REFERENCE_COLOUR, "width": 2},
            marker={"symbol": "line-ns-open", "size": 9, "color": theme.REFERENCE_COLOUR},
            text=["", f"  {number(length, 1)} px, {count(scale)} times"],
            textposition="middle right",
            hoverinfo="skip",
        ),
        **where,
    )


def _frame_cells(figure: go.Figure, part: ResidualField, n_sides: int, beside: int) -> None:
    """Make the subplots detectors, row 0 on top, with room for the bar below."""
    rows, columns = column(part.row_edges_px), column(part.col_edges_px)
    frame_maps(figure, n_sides, min(beside, n_sides))
    bottom = rows[-1] + 0.1 * (columns[-1] - columns[0])
    figure.update_xaxes(range=[columns[0], columns[-1]])
    figure.update_yaxes(range=[bottom, rows[0]], autorange=False)


def table_quiver(part: ResidualField) -> Table:
    """List one cell a row and side: its centre, mean residual with sigmas in px, and how many stars it has."""
    columns: Table = {"when": []}
    for side, field in list_sides(part).items():
        cells = read_cells(part, field)
        columns["when"] += [side] * len(cells.row)
        for name, values in vars(cells).items():
            columns.setdefault(COLUMN_OF[name], []).extend(list_known(values))
    return columns


COLUMN_OF = {
    "row": "row_px",
    "col": "col_px",
    "d_row": "mean_row_px",
    "d_col": "mean_col_px",
    "s_row": "sigma_row_px",
    "s_col": "sigma_col_px",
    "count": "stars",
}
RESIDUAL_QUIVER = part_figure(
    draw_quiver,
    table_quiver,
    "residual_field",
    name="residual-quiver",
    title="Mean residuals over the detector",
    guide=(
        "Each arrow is the mean residual of the stars in one cell, with the old parameters on the left and the new on the "
        "right, to the scale of the bar; the circle around its foot is three sigmas of that mean. Arrows that end inside "
        "their circles are noise and good; a common pattern of longer arrows indicates distortion that the model does not "
        "describe."
    ),
    wide=True,
    forms={"narrow": partial(draw_quiver, beside=1)},
)
