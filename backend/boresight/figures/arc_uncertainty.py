"""How well an arc is known over the detector, from the covariance of the parameters alone.

The arc lies about the place on the map, five degrees long or a quarter of the field where that is narrower. Its variance
is J P J^T with J the derivative of the arclength by the parameters: what the calibration itself adds to every measured
angle there, whatever the centroids do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from boresight.figures import theme
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.detector_maps import MAX_MAPS, beside, cells, frame_maps
from boresight.figures.trust_parts import Part, absent, column, parts
from boresight.verdicts.verdict import part_of

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
    part = part_of(result, PART)
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
