"""What the new parameters change along the radius, with how far that can be trusted (E Fig. 5).

f, b4 and b2 trade against each other, so their separate values say little; their joint effect, the radial displacement
final minus initial at a distance from the principal point, says what the detector will see. Below stand the stars that
carried it, over the same radius; beyond the outermost star the curve is extrapolation, and hatched as such.

Distortion of runs against a reference run: displacement along the radius with its 3-sigma band.

f and the coefficients of the distortion trade against each other, so two runs may differ in each of them and agree on the
detector. The band is that of the difference, which knows what data the runs share; where that leaves no noise there is none.

What the optics bend: the radial displacement under the old and under the new parameters (E Fig. 5 shows their difference).

Both are counted from one pinhole, that of the old focal length, so that new minus old is the radial difference of the
chart below, to the last digit. The band is that of the new curve; of the old parameters no uncertainty is on record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import Calibration, Displacement, RadialDifference, StarCounts
from boresight.calibration.evaluation.contrast import RadialContrast
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, make_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import hatch, share_cursor
from boresight.figures.style.thinning import keep_extremes
from boresight.verdicts.answers import describe_largest_change
from boresight.verdicts.numbers import count, number, signed

TITLE = "Radial difference"
CONTRAST_COLUMNS = ("radius_px", "difference_px", "sigma_px", "difference_arcsec", "sigma_arcsec")


def read_radial(result: Calibration) -> RadialDifference | None:
    """Read the radial difference of a result; None where it has none."""
    return result.radial if result.radial and result.radial.radius_px else None


def draw(drawn: Sequence[Part[RadialDifference]]) -> go.Figure:
    """Draw the radial difference, below it how far it can be trusted, and below that the stars that carried it."""
    panels: dict[str, Any] = {"shared_xaxes": True, "row_heights": [0.5, 0.24, 0.26], "vertical_spacing": 0.05}
    figure = make_subplots(3, 1, specs=[[{"secondary_y": True}], [{}], [{}]], **panels)
    seen, reached = [0.0], [0.0]
    for _, style, radial in drawn:
        seen += _draw_run(figure, radial, style)
        reached += _draw_band(figure, radial, style, named=len(drawn) == 1)
        _draw_counts(figure, radial.counts, style)
    radials = [radial for _, _, radial in drawn]
    theme.dress(figure, title=describe_largest_change(radials[0]) or TITLE, height_px=520)
    windows = [compute_window(seen), compute_window(reached), [0.0, float(_most_stars(radials))]]
    _hatch_extrapolation(figure, radials, windows)
    _scale(figure, windows, radials)
    return share_cursor(figure, "radius_px")


def draw_small(drawn: Sequence[Part[RadialDifference]]) -> go.Figure:
    """Draw the difference and its band, in two panels."""
    _, style, radial = drawn[0]
    figure = make_subplots(2, 1, shared_xaxes=True, row_heights=[0.62, 0.38], vertical_spacing=0.08)
    windows = [
        compute_window([0.0, *_draw_run(figure, radial, style)]),
        compute_window(_draw_band(figure, radial, style)),
    ]
    theme.shrink(figure)
    _hatch_extrapolation(figure, [radial], windows)
    for row, title in enumerate(("px", "±3σ, px"), start=1):
        figure.update_yaxes(range=windows[row - 1], nticks=4, row=row, col=1)
        corner = {"x": 0.01, "y": 1, "xref": "x domain", "yref": "y domain", "xanchor": "left", "yanchor": "top"}
        figure.add_annotation(text=title, showarrow=False, font={"size": 10}, **corner, row=row, col=1)
    figure.update_xaxes(title_text="radius (px)", row=2, col=1)
    return figure


def compute_window(seen: Sequence[float]) -> list[float]:
    """Return the span of an axis that holds some values, with a margin."""
    margin = 0.08 * (max(seen) - min(seen)) or 0.1
    return [min(seen) - margin, max(seen) + margin]


def lay_over(radial: RadialDifference, values: Sequence[float | None]) -> FloatArray:
    """Lay a series over the radii, (n_radii,), NaN where it is not there."""
    n_points = len(radial.radius_px)
    series = np.array(values, dtype=np.float64)
    return series if series.shape == (n_points,) else np.full(n_points, np.nan)


def _draw_run(figure: go.Figure, radial: RadialDifference, style: theme.RunStyle) -> list[float]:
    """Add one run's curve; return what the axis must hold."""
    radius, change = column(radial.radius_px), lay_over(radial, radial.difference_px)
    reach = 3 * lay_over(radial, radial.sigma_px)
    kept = keep_extremes([change, reach])
    angles = np.stack([lay_over(radial, radial.difference_arcsec), 3 * lay_over(radial, radial.sigma_arcsec)])[:, kept]
    seen, spread = change[np.isfinite(change)], theme.short(np.stack([*angles, reach[kept]], axis=-1))
    hover = (
        "%{y:+.3f} ±%{customdata[2]:.3f} px, %{customdata[0]:+.2f} ±%{customdata[1]:.2f}″"
        f"<extra>{style.label}</extra>"
    )
    options = {"customdata": spread, "hovertemplate": hover}
    figure.add_trace(theme.line(style, radius[kept], change[kept], **options), row=1, col=1)
    return [float(value) for value in seen]


def _draw_band(
    figure: go.Figure, radial: RadialDifference, style: theme.RunStyle, *, named: bool = False
) -> list[float]:
    """Add one run's band around zero in a panel of its own: on the curve it would be thinner than the line."""
    radius, reach = column(radial.radius_px), 3 * lay_over(radial, radial.sigma_px)
    kept = keep_extremes([reach])
    radius, reach = radius[kept], reach[kept]
    figure.add_trace(theme.band(style, radius, -reach, reach, showlegend=named), row=2, col=1)
    known = reach[np.isfinite(reach)]
    return [float(value) for value in (*known, *-known)]


def _draw_counts(figure: go.Figure, counts: StarCounts | None, style: theme.RunStyle) -> None:
    """Add the histogram of stars as a filled outline, so that several runs can lie over each other."""
    if counts is None or len(counts.edges_px) != len(counts.stars) + 1:
        return
    stars = counts.stars
    outline = go.Scatter(
        x=list(counts.edges_px),
        y=[*stars, stars[-1] if stars else 0],
        mode="lines",
        line={"color": style.colour, "dash": style.dash, "width": 1.2, "shape": "hv"},
        fill="tozeroy",
        fillcolor=theme.translucent(style.colour, 0.22),
        name=f"{style.label} stars",
        legendgroup=style.label,
        meta=theme.tag_run(style.label, "stars"),
        showlegend=False,
        hovertemplate=f"%{{y}} stars<extra>{style.label}</extra>",
    )
    figure.add_trace(outline, row=3, col=1)


def reached_px(radials: Sequence[RadialDifference]) -> tuple[float, float]:
    """Return the radius of the outermost star of any run, and where the axis ends."""
    reached = [radial.data_radius_px for radial in radials if radial.data_radius_px is not None]
    end = max(float(column(radial.radius_px).max()) for radial in radials)
    return (max(reached) if reached else end), end


def _most_stars(radials: Sequence[RadialDifference]) -> int:
    return max([1, *(count for radial in radials for count in (radial.counts.stars if radial.counts else ()))])


def _hatch_extrapolation(
    figure: go.Figure, radials: Sequence[RadialDifference], windows: Sequence[Sequence[float]]
) -> None:
    """Hatch the radii that no star of any run reached, in every panel over its window."""
    reached, end = reached_px(radials)
    figure.update_xaxes(range=[0, end])
    if reached >= end:
        return
    for row, (low, high) in enumerate(windows, start=1):
        hatch(figure, (reached, end), (low, high), named=row == 1, row=row, col=1)
    line = {"color": theme.REFERENCE_COLOUR, "dash": "dot", "width": 1}
    figure.add_vline(x=reached, line=line, row="all", col=1)


def arcsec_per_px(radials: Sequence[RadialDifference]) -> float | None:
    """Read the plate scale on the axis out of the curves, or None where the runs do not share one."""
    scales = []
    for radial in radials:
        pixels = np.concatenate([lay_over(radial, radial.sigma_px), lay_over(radial, radial.difference_px)])
        angles = np.concatenate([lay_over(radial, radial.sigma_arcsec), lay_over(radial, radial.difference_arcsec)])
        usable = np.isfinite(pixels) & np.isfinite(angles) & (np.abs(pixels) > 1e-12)
        if not usable.any():
            return None
        scales.append(float(np.max(angles[usable] / pixels[usable])))
    return scales[0] if max(scales) < 1.02 * min(scales) else None


def _scale(figure: go.Figure, windows: Sequence[list[float]], radials: Sequence[RadialDifference]) -> None:
    change, band, _ = windows
    figure.update_xaxes(title_text="radius from the principal point (px)", row=3, col=1)
    figure.update_yaxes(title_text="new − old (px)", range=change, zeroline=True, row=1, col=1, secondary_y=False)
    figure.update_yaxes(title_text="±3σ (px)", range=band, zeroline=True, nticks=4, row=2, col=1)
    figure.update_yaxes(title_text="stars", rangemode="tozero", nticks=4, row=3, col=1)
    _tie_arcsec(figure, change, radials)


def _tie_arcsec(figure: go.Figure, window: list[float], radials: Sequence[RadialDifference]) -> None:
    """Put arcseconds on the right of the first panel, tied to the pixels on the left, where one plate scale holds."""
    scale, right = arcsec_per_px(radials), {"row": 1, "col": 1, "secondary_y": True}
    if scale is None:
        figure.update_yaxes(visible=False, **right)
        return
    figure.add_trace(go.Scatter(x=[0], y=[0], opacity=0, showlegend=False, hoverinfo="skip"), **right)
    span = [edge * scale for edge in window]
    figure.update_yaxes(
        title_text="arcsec, on axis", range=span, showgrid=False, tickmode="auto", zeroline=False, **right
    )
    figure.update_yaxes(fixedrange=True, row=1, col=1)  # zoom along the radius: the two scales stay tied


def table(radial: RadialDifference) -> Table:
    """List the curve: radius and difference in px, and the difference as an angle."""
    return {name: list_known(lay_over(radial, getattr(radial, name))) for name in CONTRAST_COLUMNS}


RADIAL = make_figure(
    draw,
    table,
    read_radial,
    lambda _: "Not yet: the radial difference is computed when the run ends.",
    name="radial",
    title=TITLE,
    guide=(
        "Above is how far along the radius the new parameters move a star compared with the old ones, below that its ±3σ "
        "band alone, and at the bottom the number of stars at that radius. Trust it where there are stars and the band is "
        "narrow: in the hatched part there was no star and the curve is extrapolated."
    ),
    wide=True,
    forms={"small": draw_small},
)


RADIAL_CONTRAST_TITLE = "Radial difference to the reference"
GUIDE = (
    "Each curve is how far along the radius a run places a star from where the reference run places it, with the ±3σ band of "
    "that difference. Runs that agree stay at zero within their bands out to where stars reach; the hatched radii beyond are "
    "extrapolated."
)
MARGIN = 0.06  # of the height drawn, above and below
CROWDED = 8  # above so many bands nothing is seen through them


def draw_radial_contrast(labels: Sequence[str], reference: int, curves: Sequence[RadialContrast | None]) -> go.Figure:
    """Draw one curve a run."""
    order = [reference, *(i for i in range(len(labels)) if i != reference)]  # the colours of every other figure
    styles = dict(zip(order, theme.label_styles([labels[i] for i in order]), strict=True))
    shown = [(styles[i], curve) for i in order if (curve := curves[i]) is not None]
    if not shown:
        return theme.missing(
            RADIAL_CONTRAST_TITLE,
            "No other run with the same detector has a result yet: the curves appear when one has.",
        )
    figure = go.Figure()
    for style, curve in shown:
        _draw_contrast(figure, style, curve, banded=len(shown) <= CROWDED)
    told = any(np.isfinite(column(curve.sigma_px)).any() for _, curve in shown)
    words = "±3σ of the difference" if told else "the same data and equal sigmas: only the methods differ"
    theme.dress(figure, title=f"Against {theme.escape(labels[reference])}, {words}", height_px=420)
    figure.update_xaxes(title_text="radius from the principal point (px)")
    figure.update_yaxes(title_text="run − reference (px)", zeroline=True)
    figure.layout.meta = {**(figure.layout.meta or {}), "axis": "radius_px"}
    _hatch_unshared(figure, [curve for _, curve in shown])
    return figure


def _draw_contrast(figure: go.Figure, style: theme.RunStyle, curve: RadialContrast, *, banded: bool) -> None:
    """Add one run's curve, and its band where there is one."""
    radius, change, sigma, angle, sigma_angle = (column(getattr(curve, name)) for name in CONTRAST_COLUMNS)
    reach = 3 * sigma
    if banded and np.isfinite(reach).any():
        figure.add_trace(theme.band(style, radius, change - reach, change + reach))
    angles = np.stack([angle, 3 * sigma_angle, reach], axis=-1)
    spread = (" ±%{customdata[2]:.3f}", " ±%{customdata[1]:.2f}") if np.isfinite(reach).any() else ("", "")
    hover = f"%{{y:+.3f}}{spread[0]} px, %{{customdata[0]:+.2f}}{spread[1]}″<extra>{style.label}</extra>"
    figure.add_trace(theme.line(style, radius, change, customdata=theme.short(angles), hovertemplate=hover))


def _hatch_unshared(figure: go.Figure, curves: Sequence[RadialContrast]) -> None:
    """Hatch the radii that no star of both runs reached, over the height of what is drawn."""
    end = max(float(curve.radius_px[-1]) for curve in curves)
    reached = [curve.data_radius_px for curve in curves if curve.data_radius_px is not None]
    figure.update_xaxes(range=[0, end])
    if reached and min(reached) < end:
        drawn = np.concatenate([[0.0], *(np.asarray(trace.y, dtype=np.float64) for trace in figure.data)])
        low, high = float(np.nanmin(drawn)), float(np.nanmax(drawn))
        margin = MARGIN * (high - low) or 1.0
        window = (low - margin, high + margin)
        hatch(figure, (min(reached), end), window, named=True)
        figure.update_yaxes(range=window)


def table_radial_contrast(run_ids: Sequence[int], curves: Sequence[RadialContrast | None]) -> Table:
    """List every curve below the other, the run's number first."""
    listed: Table = {"run": [], **{name: [] for name in CONTRAST_COLUMNS}}
    for run_id, curve in zip(run_ids, curves, strict=True):
        if curve is not None:
            listed["run"] += [run_id] * len(curve.radius_px)
            for name in CONTRAST_COLUMNS:
                listed[name] += getattr(curve, name)
    return listed


OLDER = "This result has no curves of old and new: clone its run and run it again to get them."
NOT_YET = "Not yet: the distortion is computed when the run ends."


def draw_distortion(drawn: Sequence[Part[Distortion]]) -> go.Figure:
    """Draw every run's new curve with its band, and the old curve of the first as a reference."""
    figure = make_subplots(1, 1, specs=[[{"secondary_y": True}]])
    seen = [0.0]
    for _, style, curves in drawn:
        seen += _draw_new(figure, curves, style)
    radials = [curves.difference for _, _, curves in drawn]
    seen += _draw_old(figure, drawn[0][2])
    theme.dress(figure, title=_outermost(drawn[0][2]), height_px=400)
    _tie_scales(figure, radials, compute_window(seen))
    return share_cursor(figure, "radius_px")


@dataclass(frozen=True)
class Distortion:
    """The difference along the radius, and the two curves that it is of, px."""

    difference: RadialDifference
    displacement: Displacement


def read_distortion(result: Calibration) -> Distortion | None:
    """Read the curves of a result; None where it was made before they were kept."""
    radial = result.radial
    return Distortion(radial, radial.displacement_px) if radial and radial.displacement_px else None


def _draw_new(figure: go.Figure, curves: Distortion, style: theme.RunStyle) -> list[float]:
    """Add one run's curve and band; return what the axis must hold."""
    radial, y = curves.difference, column(curves.displacement.final)
    radius, reach = column(radial.radius_px), 3 * lay_over(radial, radial.sigma_px)
    kept = keep_extremes([y, reach])
    radius, y, reach = radius[kept], y[kept], reach[kept]
    figure.add_trace(theme.band(style, radius, y - reach, y + reach), row=1, col=1)
    hover = f"new %{{y:+.3f}} ±%{{customdata:.3f}} px<extra>{style.label}</extra>"
    options = {"customdata": theme.short(reach), "hovertemplate": hover}
    figure.add_trace(theme.line(style, radius, y, **options), row=1, col=1)
    both = np.concatenate([y - reach, y + reach, y])
    return [float(value) for value in both[np.isfinite(both)]]


def _draw_old(figure: go.Figure, curves: Distortion) -> list[float]:
    old = theme.RunStyle("old: at launch", theme.REFERENCE_COLOUR, "dot")
    y = column(curves.displacement.initial)
    hover = "old %{y:+.3f} px<extra></extra>"
    figure.add_trace(theme.line(old, column(curves.difference.radius_px), y, hovertemplate=hover), row=1, col=1)
    return [float(value) for value in y[np.isfinite(y)]]


def _tie_scales(figure: go.Figure, radials: Sequence[RadialDifference], window: list[float]) -> None:
    """Hatch what is extrapolated, and tie arcseconds on the right to pixels on the left where one plate scale holds."""
    reached, end = reached_px(radials)
    figure.update_xaxes(range=[0, end], title_text="radius from the principal point (px)")
    figure.update_yaxes(title_text="displacement (px)", range=window, secondary_y=False, fixedrange=True)
    if reached < end:
        hatch(figure, (reached, end), (window[0], window[1]), named=True, row=1, col=1)
    _tie_arcsec(figure, window, radials)


def _outermost(curves: Distortion) -> str:
    radial, new, old = curves.difference, column(curves.displacement.final), column(curves.displacement.initial)
    radius = column(radial.radius_px)
    reached, _ = reached_px([radial])
    last = int(np.flatnonzero(radius <= reached)[-1])
    return (
        f"At the outermost star, {count(reached)} px: {signed(old[last])} px old, {signed(new[last])} "
        f"± {number(lay_over(radial, radial.sigma_px)[last], 2)} px new (1σ)"
    )


def table_distortion(curves: Distortion) -> Table:
    """List radius, old and new displacement and the new one's sigma, in px."""
    radial = curves.difference
    return {
        "radius_px": list_known(column(radial.radius_px)),
        "old_px": list_known(column(curves.displacement.initial)),
        "new_px": list_known(column(curves.displacement.final)),
        "sigma_px": list_known(lay_over(radial, radial.sigma_px)),
    }


DISTORTION = make_figure(
    draw_distortion,
    table_distortion,
    read_distortion,
    lambda result: OLDER if result.radial else NOT_YET,
    name="distortion",
    title="Radial distortion, old and new",
    guide=(
        "Each curve is how far along the radius the optics move a star from a pinhole of the old focal length: the old "
        "parameters dotted, the new ones with their ±3σ band. The two should have the same shape and differ only as much as "
        "a launch or a change of temperature can explain; in the hatched part there was no star and both are extrapolated."
    ),
    wide=True,
)
