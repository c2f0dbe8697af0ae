"""How well an arc is known over the detector, from the covariance of the parameters alone.

The arc lies about the place on the map, five degrees long or a quarter of the field where that is narrower. Its variance
is J P J^T with J the derivative of the arclength by the parameters: what the calibration itself adds to every measured
angle there, whatever the centroids do.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import plotly.graph_objects as go

from boresight.calibration.calibration import ArcSigmaMap
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, part_figure
from boresight.figures.style.axes import MAX_MAPS, cells, detector_map, draw_maps
from boresight.verdicts.numbers import number


def draw(drawn: Sequence[Part[ArcSigmaMap]], beside: int = 2) -> go.Figure:
    """Draw one map a run on one scale from zero; only the last shows it."""
    highest = max(float(np.nanmax(column(part.sigma_arcsec))) for _, _, part in drawn)
    scale = {"zmin": 0, "zmax": highest or 1, "colorscale": "Cividis"}

    def draw_map(one: Part[ArcSigmaMap], last: bool) -> go.Heatmap:
        return detector_map(one[2], one[2].sigma_arcsec, one[1].label, showscale=last, **scale)

    return draw_maps(drawn[:MAX_MAPS], draw_map, title=_headline(drawn), height_px=460, beside=beside)


def _headline(drawn: Sequence[Part[ArcSigmaMap]]) -> str:
    if len(drawn) > 1:
        return f"1σ of an arc over the detector, {len(drawn)} runs"
    sigma, degrees = column(drawn[0][2].sigma_arcsec), drawn[0][2].arc_deg
    span = f"{number(np.nanmin(sigma), 3)} to {number(np.nanmax(sigma), 3)} arcsec"
    return f"1σ of an arc of {degrees:.3g}°: {span} over the detector"


def table(part: ArcSigmaMap) -> Table:
    """List one cell a row: its centre in px and the sigma of the arc from there in arcsec."""
    return cells(part, "sigma_arcsec", part.sigma_arcsec)


ARC_UNCERTAINTY = part_figure(
    draw,
    table,
    "arc_sigma_map",
    name="arc-uncertainty",
    title="Arc uncertainty",
    guide=(
        "Each place shows the uncertainty of an arc of five degrees (a quarter of a narrower field) around it, from the "
        "uncertainty of the parameters alone. Values well below the centroid noise everywhere are good; in bright corners the "
        "calibration is extrapolated."
    ),
    advanced=True,
    forms={"narrow": partial(draw, beside=1)},
)
