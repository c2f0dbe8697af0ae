"""Residual RMS by axis: rows and columns of the detector, and along and across the radius; on the whole and as it runs.

Pixels are alike in rows and columns, so an axis that stands out is read-out or motion; distortion that is left over shows along
the radius, and roll of single exposures across it. An RMS of n residuals is known to rms / sqrt(2 n). The run of it takes the
sampled residuals in the order of their frames, in bins of one size, so that each bin is known equally well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.figures import theme
from boresight.figures.axes import share_cursor
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.trust_parts import absent, column, parts
from boresight.verdicts.verdict import part_of

TITLE = "Residual RMS by axis"
PART = "residuals"
AXES = ("along rows", "along columns", "along the radius", "across the radius")
RUNNING = {"along the radius": "solid", "across the radius": "dot"}
MOST_BINS, LEAST_IN_BIN = 40, 20


@dataclass(frozen=True)
class Spread:
    """Residuals of a run by axis: (n,) px each in the order of `AXES`, and the frame of each."""

    by_axis: dict[str, FloatArray]
    frame: FloatArray


def spread_of(result: Result) -> Spread | None:
    """Turn a result's residuals to its axes; None where it has none."""
    seen = part_of(result, PART)
    if not seen:
        return None
    d_row, d_col = column(seen.get("d_row_px")), column(seen.get("d_col_px"))
    row, col, frame = (column(seen.get(key)) for key in ("row_px", "col_px", "frame"))
    if not len(d_row) or len({len(values) for values in (d_row, d_col, row, col, frame)}) > 1:
        return None
    row_0, col_0 = _centre(result, row, col)
    radius = np.hypot(row - row_0, col - col_0)
    cosine, sine = (
        np.divide(along, radius, out=np.zeros(len(row)), where=radius > 0) for along in (row - row_0, col - col_0)
    )
    turned = (d_row, d_col, cosine * d_row + sine * d_col, cosine * d_col - sine * d_row)
    return Spread(dict(zip(AXES, turned, strict=True)), frame)


def _centre(result: Result, row: FloatArray, col: FloatArray) -> tuple[float, float]:
    """Return the principal point, or the middle of the stars where the camera model is not known."""
    model, values = CAMERA_MODELS.get(str(result.get("camera_model"))), result.get("parameters") or {}
    if model is None or any(values.get(name) is None for name in model.parameter_names):
        return float(row.mean()), float(col.mean())
    return model.principal_point(np.array([values[name] for name in model.parameter_names], dtype=np.float64))


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw every run's RMS by axis with 3-sigma bars, and how it runs over the frames."""
    drawn = [(trace, style, found) for trace, style, _ in parts(traces, PART) if (found := spread_of(trace.result))]
    if not drawn:
        return absent(TITLE, traces, PART)
    figure = make_subplots(1, 2, column_widths=[0.35, 0.65], horizontal_spacing=0.08)
    for _, style, found in drawn:
        figure.add_trace(_points(found, style), row=1, col=1)
        for axis in RUNNING if len(drawn) == 1 else ("along the radius",):
            _draw_run(figure, found, axis, style, banded=len(drawn) <= 3)
    theme.dress(figure, title=_headline(drawn[0][2]), height_px=400, hovermode="closest", scattermode="group")
    figure.update_yaxes(rangemode="tozero")
    figure.update_yaxes(title_text="RMS residual (px), bars ±3σ", row=1, col=1)
    figure.update_yaxes(title_text="RMS of a bin of frames (px)", row=1, col=2)
    figure.update_xaxes(type="category", row=1, col=1)
    figure.update_xaxes(title_text="frame", row=1, col=2)
    return share_cursor(figure, "frame")


def rms_with_sigma(values: FloatArray) -> tuple[float, float]:
    """Return the RMS of residuals and its sigma."""
    known = values[np.isfinite(values)]
    if not len(known):
        return float("nan"), float("nan")
    rms = float(np.sqrt(np.mean(known**2)))
    return rms, rms / float(np.sqrt(2 * len(known)))


def _points(found: Spread, style: theme.RunStyle) -> go.Scatter:
    levels = np.array([rms_with_sigma(values) for values in found.by_axis.values()])
    return go.Scatter(
        x=list(found.by_axis),
        y=theme.short(levels[:, 0]),
        mode="markers",
        offsetgroup=style.label,
        name=style.label,
        legendgroup=style.label,
        marker={"color": style.colour, "size": 9},
        error_y={
            "type": "data",
            "array": theme.short(3 * levels[:, 1]),
            "color": style.colour,
            "thickness": 1.4,
            "width": 4,
        },
        customdata=theme.short(3 * levels[:, 1]),
        hovertemplate=f"%{{x}}: %{{y:.4f}} ±%{{customdata:.4f}} px (3σ)<extra>{style.label}</extra>",
    )


def _draw_run(figure: go.Figure, found: Spread, axis: str, style: theme.RunStyle, *, banded: bool) -> None:
    """Add how one axis runs over the frames."""
    own = theme.RunStyle(style.label, style.colour, RUNNING[axis])
    frame, level, sigma = running(found, axis)
    place: dict[str, Any] = {"row": 1, "col": 2}
    if banded and axis == "along the radius":
        figure.add_trace(theme.band(own, frame, level - 3 * sigma, level + 3 * sigma), **place)
    hover = f"frame %{{x}}: %{{y:.4f}} px {axis}<extra>{style.label}</extra>"
    options = {"name": f"{style.label} · {axis}", "hovertemplate": hover, "legendgroup": f"{style.label} · {axis}"}
    figure.add_trace(theme.line(own, frame, level, **options), **place)


def running(found: Spread, axis: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean frame, the RMS and its sigma of bins of one size, (n_bins,) each."""
    order = np.argsort(found.frame, kind="stable")
    bins = np.array_split(order, max(1, min(MOST_BINS, len(order) // LEAST_IN_BIN)))
    levels = np.array([rms_with_sigma(found.by_axis[axis][places]) for places in bins])
    return np.array([found.frame[places].mean() for places in bins]), levels[:, 0], levels[:, 1]


def _headline(found: Spread) -> str:
    (along, sigma), (across, other) = (rms_with_sigma(found.by_axis[axis]) for axis in AXES[2:])
    apart = abs(along - across) > 3 * float(np.hypot(sigma, other))
    words = "differ by more than 3σ" if apart else "agree within 3σ"
    return f"Along the radius {along:.3g} px, across it {across:.3g} px: they {words}"


def table(result: Result) -> Table:
    """List one axis a row: its RMS in px, the RMS's sigma, and how many residuals it rests on."""
    found = spread_of(result)
    if found is None:
        return {}
    levels = np.array([rms_with_sigma(values) for values in found.by_axis.values()])
    return {
        "axis": list(found.by_axis),
        "rms_px": theme.plain(levels[:, 0]),
        "sigma_of_rms_px": theme.plain(levels[:, 1]),
        "residuals": [int(np.isfinite(values).sum()) for values in found.by_axis.values()],
    }


RMS_AXES = Figure(
    name="rms-axes",
    title=TITLE,
    guide=(
        "On the left is the residual's RMS along rows and columns and along and across the radius, with ±3σ bars; on the "
        "right how the last two run over the frames. All four should agree within their bars and run level: more along "
        "the radius is distortion that is left over, a rise in time a sensor that changes."
    ),
    draw=draw,
    table=table,
)
