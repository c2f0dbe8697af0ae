"""How well an arc is known over the detector, from the covariance of the parameters alone.

The arc lies about the place on the map, five degrees long or a quarter of the field where that is narrower. Its variance
is J P J^T with J the derivative of the arclength by the parameters: what the calibration itself adds to every measured
angle there, whatever the centroids do.

Maps of a quantity over the detector, one a run, beside each other on one colour scale, first row on top.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.style import theme
from boresight.figures.trust_parts import Part, absent, column, parts
from boresight.verdicts.verdict import read_part

MAX_MAPS = 4
TITLE_LENGTH = 14


def detector_map(part: Any, key: str, label: str, **scale: Any) -> go.Heatmap:
    """Draw `part[key]` (n_rows, n_columns) in arcsec over the centres of its cells."""
    return go.Heatmap(
        x=list(part["col_px"]),
        y=list(part["row_px"]),
        z=theme.short(column(part[key])),
        colorbar={"title": {"text": "arcsec"}, "thickness": 10},
        hovertemplate=f"%{{z:.3g}} arcsec<br>column %{{x:.0f}}, row %{{y:.0f}}<extra>{label}</extra>",
        hoverongaps=False,
        **scale,
    )


def beside(drawn: Sequence[Part], key: str, **scale: Any) -> go.Figure:
    """Lay the maps of several runs out in one row; only the last shows the scale, which is common."""
    shown = drawn[:MAX_MAPS]
    titles = [short_label(style.label) for _, style, _ in shown] if len(shown) > 1 else None
    figure = make_subplots(1, len(shown), subplot_titles=titles, horizontal_spacing=0.4 / max(4, len(shown)))
    for place, (_, style, part) in enumerate(shown, start=1):
        drawing = detector_map(part, key, style.label, showscale=place == len(shown), **scale)
        figure.add_trace(drawing, row=1, col=place)
    return figure


def frame_maps(figure: go.Figure, n_maps: int) -> None:
    """Make the first `n_maps` subplots detectors: square pixels, row 0 on top."""
    for place in range(1, n_maps + 1):
        where = {"row": 1, "col": place}
        quiet = {"showgrid": False, "zeroline": False, "constrain": "domain"}
        anchor = "x" if place == 1 else f"x{place}"
        figure.update_xaxes(title_text="column (px)", nticks=max(2, 8 // n_maps), tickangle=0, **quiet, **where)
        figure.update_yaxes(autorange="reversed", scaleanchor=anchor, scaleratio=1, **quiet, **where)
    figure.update_yaxes(title_text="row (px)", row=1, col=1)


def cells(part: Any, key: str) -> dict[str, list[Any]]:
    """List one cell a row: its centre in px and its value."""
    values: FloatArray = column(part[key])
    places = [(row, col) for row in part["row_px"] for col in part["col_px"]]
    return {
        "row_px": [row for row, _ in places],
        "col_px": [col for _, col in places],
        key: theme.plain(values.ravel()),
    }


def short_label(label: str) -> str:
    """Keep of a label what stands over a narrow map: its first part; the hover has the whole."""
    first = label.split(" · ", maxsplit=1)[0]
    return first if len(first) <= TITLE_LENGTH else f"{first[: TITLE_LENGTH - 1]}…"


TITLE = "Arc uncertainty"
PART, KEY = "arc_sigma_map", "sigma_arcsec"


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw one map a run on one scale from zero."""
    drawn = parts(traces, PART)
    if not drawn:
        return absent(TITLE, traces, PART)
    highest = max(float(np.nanmax(column(part[KEY]))) for _, _, part in drawn)
    figure = beside(drawn, KEY, zmin=0, zmax=highest or 1, colorscale="Cividis")
    theme.dress(figure, title=_headline(drawn), height_px=460, legend=False, hovermode="closest")
    frame_maps(figure, min(len(drawn), MAX_MAPS))
    return figure


def _headline(drawn: Sequence[Part]) -> str:
    if len(drawn) > 1:
        return f"1σ of an arc over the detector, {len(drawn)} runs"
    sigma, degrees = column(drawn[0][2][KEY]), drawn[0][2].get("arc_deg")
    arc = f"an arc of {degrees:.3g}°" if degrees is not None else "an arc"
    return f"1σ of {arc}: {np.nanmin(sigma):.3g} to {np.nanmax(sigma):.3g} arcsec over the detector"


def table(result: Result) -> Table:
    """List one cell a row: its centre in px and the sigma of the arc from there in arcsec."""
    part = read_part(result, PART)
    return cells(part, KEY) if part else {}


ARC_UNCERTAINTY = Figure(
    name="arc-uncertainty",
    title=TITLE,
    guide=(
        "Each place shows how uncertain an arc of five degrees (a quarter of a narrower field) is about it, "
        "from the uncertainty of the parameters alone. Everywhere well below the noise of a centroid is good; a "
        "bright corner is where this calibration extrapolates."
    ),
    draw=draw,
    table=table,
)
