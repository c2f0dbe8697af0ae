"""What the optics bend: the radial displacement under the old and under the new parameters (E Fig. 5 shows their difference).

Both are counted from one pinhole, that of the old focal length, so that new minus old is the radial difference of the
chart below, to the last digit. The band is that of the new curve; of the old parameters no uncertainty is on record.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.charts.radial import arcsec_per_px, column, compute_window, reached_px
from boresight.figures.style import theme
from boresight.figures.style.axes import hatch, share_cursor
from boresight.figures.style.thinning import keep_extremes

TITLE = "Radial distortion, old and new"
OLDER = (
    "This result was made before the curves of old and new were kept: clone its run and start it again to have them."
)
NOT_YET = "The distortion is computed when the run ends; it is not there yet."


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw every run's new curve with its band, and the old curve of the first as a reference."""
    styled = zip(traces, theme.run_styles(traces), strict=True)
    drawn = [(trace, style) for trace, style in styled if _curves(trace.result)]
    if not drawn:
        return theme.missing(TITLE, OLDER if traces[0].result.get("radial") else NOT_YET)
    figure = make_subplots(1, 1, specs=[[{"secondary_y": True}]])
    seen = [0.0]
    for trace, style in drawn:
        seen += _draw_run(figure, trace.result["radial"], style)
    seen += _draw_old(figure, drawn[0][0].result["radial"])
    theme.dress(figure, title=_headline(drawn[0][0].result["radial"]), height_px=400)
    radials = [trace.result["radial"] for trace, _ in drawn]
    _dress(figure, radials, compute_window(seen))
    return share_cursor(figure, "radius_px")


def _curves(result: Result) -> Result:
    return (result.get("radial") or {}).get("displacement_px") or {}


def _displacement(radial: Result, which: str) -> FloatArray:
    """Read one curve, (n_radii,), px."""
    return np.array(radial["displacement_px"][which], dtype=np.float64)


def _draw_run(figure: go.Figure, radial: Result, style: theme.RunStyle) -> list[float]:
    """Add one run's curve and band; return what the axis must hold."""
    radius, y, reach = column(radial, "radius_px"), _displacement(radial, "final"), 3 * column(radial, "sigma_px")
    kept = keep_extremes([y, reach])
    radius, y, reach = radius[kept], y[kept], reach[kept]
    figure.add_trace(theme.band(style, radius, y - reach, y + reach), row=1, col=1)
    hover = f"new %{{y:+.3f}} ±%{{customdata:.3f}} px<extra>{style.label}</extra>"
    options = {"customdata": theme.short(reach), "hovertemplate": hover}
    figure.add_trace(theme.line(style, radius, y, **options), row=1, col=1)
    both = np.concatenate([y - reach, y + reach, y])
    return [float(value) for value in both[np.isfinite(both)]]


def _draw_old(figure: go.Figure, radial: Result) -> list[float]:
    old = theme.RunStyle("old: at launch", theme.REFERENCE_COLOUR, "dot")
    y = _displacement(radial, "initial")
    hover = "old %{y:+.3f} px<extra></extra>"
    figure.add_trace(theme.line(old, column(radial, "radius_px"), y, hovertemplate=hover), row=1, col=1)
    return [float(value) for value in y[np.isfinite(y)]]


def _dress(figure: go.Figure, radials: Sequence[Result], window: list[float]) -> None:
    """Hatch what is extrapolated, and tie arcseconds on the right to pixels on the left where one plate scale holds."""
    reached, end = reached_px(radials)
    figure.update_xaxes(range=[0, end], title_text="radius from the principal point (px)")
    figure.update_yaxes(title_text="displacement (px)", range=window, secondary_y=False, fixedrange=True)
    if reached < end:
        hatch(figure, (reached, end), (window[0], window[1]), named=True, row=1, col=1)
    scale = arcsec_per_px(radials)
    if scale is None:
        figure.update_yaxes(visible=False, secondary_y=True)
        return
    figure.add_trace(go.Scatter(x=[0], y=[0], opacity=0, showlegend=False, hoverinfo="skip"), 1, 1, secondary_y=True)
    right = {"title_text": "arcsec, on axis", "range": [edge * scale for edge in window], "showgrid": False}
    figure.update_yaxes(**right, tickmode="auto", zeroline=False, fixedrange=True, secondary_y=True)


def _headline(radial: Result) -> str:
    radius, new, old = column(radial, "radius_px"), _displacement(radial, "final"), _displacement(radial, "initial")
    reached, _ = reached_px([radial])
    last = int(np.flatnonzero(radius <= reached)[-1])
    return (
        f"At the outermost star, {reached:.0f} px: {theme.signed(old[last])} px old, {theme.signed(new[last])} "
        f"±{3 * column(radial, 'sigma_px')[last]:.2g} px new (3σ)"
    )


def table(result: Result) -> Table:
    """List radius, old and new displacement and the new one's sigma, in px."""
    if not _curves(result):
        return {}
    radial = result["radial"]
    return {
        "radius_px": theme.plain(column(radial, "radius_px")),
        "old_px": theme.plain(_displacement(radial, "initial")),
        "new_px": theme.plain(_displacement(radial, "final")),
        "sigma_px": theme.plain(column(radial, "sigma_px")),
    }


DISTORTION = Figure(
    name="distortion",
    title=TITLE,
    guide=(
        "Each curve is how far the optics bend a star along the radius away from a pinhole of the old focal length: the "
        "old parameters dotted, the new ones with their ±3σ band. The two should have one shape and differ by what a "
        "launch or a change of temperature can do; in the hatched part no star was seen and both are extrapolation."
    ),
    draw=draw,
    table=table,
)
