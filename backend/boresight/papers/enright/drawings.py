"""E Figures 3 to 5 as curves, judged by the conclusions their text draws.

Figure 3: difference of the focal length from the batch's along the run, with three sigmas, sensor 4, started at the ground
calibration (a) and at the batch's result (b). Figure 4: tail and aggregate RMS from the batch's result, Q and No-Q, sensor 4.
Figure 5: radial difference of each sequential result from the batch's, sensor 3.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation.statistics.uncertainty import radial_difference
from boresight.figures.style import theme
from boresight.papers.documents import Conclusion, Drawing, drawing, padded, styled_curves
from boresight.papers.enright.estimators import ESTIMATORS
from boresight.papers.enright.pooled import Pooled, Record
from boresight.papers.enright.tables import TOLERANCE, TUNING
from boresight.simulation.sensors import ST16_COLUMNS, ST16_PIXEL_PITCH_M, ST16_ROWS

SEQUENTIAL = ("q", "no-q", "no-refit")
UM_PER_M = 1e6
URAD_PER_RAD = 1e6
RADII = 81
#: Ends of two runs differ when they are so many standard deviations apart.
DIFFERENT_SIGMA = 0.1
#: Radius within which E Figure 5's text calls the curves similar, and what similar means here.
SIMILAR_RADIUS_PX, SIMILAR_PX = 800.0, 0.437


def drawings(pooled: Pooled) -> list[Drawing]:
    """Return every figure with its verdict; a sensor that was not run leaves its figures out."""
    made = []
    if 4 in pooled.sensors:
        made += [_figure_3a(pooled), _figure_3b(pooled), _figure_4(pooled)]
    if 3 in pooled.sensors:
        made.append(_figure_5(pooled))
    return made


def _figure_3a(pooled: Pooled) -> Drawing:
    curves = _focal_curves(pooled, "")
    ends = {curve["estimator"]: _end_in_sigmas(curve) for curve in curves}
    said = ", ".join(f"{key} ends {value:+.2f} σ from the batch" for key, value in ends.items())
    return drawing(
        "3a", "Focal length convergence for sensor 4, from the ground calibration",
        "Q and No-Q end within their own three sigmas of the batch.",
        Conclusion(all(abs(ends.get(key, np.inf)) <= 3 for key in ("q", "no-q")), f"{said}.", *TUNING), curves,
    )  # fmt: skip


def _figure_3b(pooled: Pooled) -> Drawing:
    curves = _focal_curves(pooled, "-from-batch")
    ends = {curve["estimator"]: curve["difference_um"][-1] for curve in _focal_curves(pooled, "")}
    apart = {key: curve["difference_um"][-1] - ends[key] for curve in curves if (key := curve["estimator"]) in ends}
    said = ", ".join(f"{key} {value:+.3f} µm" for key, value in apart.items())
    refitted = max(abs(apart.get(key, np.inf)) for key in ("q", "no-q"))
    sigma = max((curve["three_sigma_um"][-1] / 3 for curve in curves), default=np.inf)
    differs = abs(apart.get("no-refit", 0.0)) > max(refitted, DIFFERENT_SIGMA * sigma)
    return drawing(
        "3b", "Focal length convergence for sensor 4, from the batch's result",
        "Q and No-Q end where they end from the ground calibration; No-Refit does not, because it uses other stars.",
        Conclusion(differs, f"between the two starts the ends differ by {said}; σ is {sigma:.2f} µm.", *TOLERANCE), curves,
    )  # fmt: skip


def _focal_curves(pooled: Pooled, suffix: str) -> list[Drawing]:
    """Delta f_k = f_k - f_batch (E Eq 31) with three sigmas, by variant."""
    batch = pooled.first(4, "batch")
    found = [(key, pooled.first(4, key + suffix)) for key in SEQUENTIAL]
    return [_focal_curve(key, record, batch) for key, record in found if record and batch and record["history"]]


def _focal_curve(key: str, record: Record, batch: Record) -> Drawing:
    history = record["history"]
    place = INVERTED_WANG.parameter_names.index("f_m")
    f = np.array(history["parameters"])[:, place] - batch["parameters"]["f_m"]
    sigma = np.array(history["sigma"], dtype=np.float64)[:, place]
    return {
        "estimator": key,
        "label": ESTIMATORS[key].label,
        "frame": history["frame"],
        "difference_um": (f * UM_PER_M).tolist(),
        "three_sigma_um": (3 * sigma * UM_PER_M).tolist(),
    }


def _end_in_sigmas(curve: Drawing) -> float:
    return float(3 * curve["difference_um"][-1] / curve["three_sigma_um"][-1])


def _figure_4(pooled: Pooled) -> Drawing:
    curves = []
    for key in ("q", "no-q"):
        record = pooled.first(4, f"{key}-from-batch")
        if record and record["history"]:
            curves.append(_rms_curve(key, record["history"]))
    apart = {curve["estimator"]: curve["tail_urad"][-1] - curve["aggregate_urad"][-1] for curve in curves}
    said = ", ".join(f"{key} {value:+.2f} µrad" for key, value in apart.items())
    holds = apart.get("q", 0.0) > abs(apart.get("no-q", np.inf))
    return drawing(
        "4", "Conventional and aggregate errors of Q and No-Q for sensor 4, from the batch's result",
        "No-Q ends close to its aggregate error; Q, which follows single frames, ends farther above its own.",
        Conclusion(holds, f"at the end tail exceeds aggregate by {said}.", *TUNING), curves,
    )  # fmt: skip


def _rms_curve(key: str, history: Record) -> Drawing:
    return {
        "estimator": key,
        "label": ESTIMATORS[key].label,
        "frame": history["frame"],
        "tail_urad": [value * URAD_PER_RAD for value in history["tail_rms_rad"]],
        "aggregate_urad": [value * URAD_PER_RAD for value in history["aggregate_rms_rad"]],
    }


def _figure_5(pooled: Pooled) -> Drawing:
    batch = pooled.first(3, "batch")
    found = [(key, pooled.first(3, key)) for key in SEQUENTIAL]
    curves = [_radial_curve(key, record, batch) for key, record in found if record is not None and batch is not None]
    inside = {curve["estimator"]: _largest(curve, SIMILAR_RADIUS_PX) for curve in curves}
    outside = {curve["estimator"]: _largest(curve, np.inf) for curve in curves}
    said = ", ".join(f"{key} {inside[key]:.3f} px, {outside[key]:.3f} px to the corner" for key in inside)
    return drawing(
        "5", "Radial distortion differences between sequential estimates and batch for sensor 3",
        f"Within {SIMILAR_RADIUS_PX:.0f} px every variant agrees with the batch to one centroid sigma, {SIMILAR_PX} px.",
        Conclusion(max(inside.values()) <= SIMILAR_PX, f"largest difference within {SIMILAR_RADIUS_PX:.0f} px: {said}.", *TUNING),
        curves,
    )  # fmt: skip


def _radial_curve(key: str, record: Record, batch: Record) -> Drawing:
    """Radial displacement against the batch, with three sigmas of the sequential estimate."""
    names = list(INVERTED_WANG.parameter_names)
    x, x_batch = (np.array([one["parameters"][name] for name in names]) for one in (record, batch))
    places = [names.index(name) for name in record["covariance"]["names"]]
    P = np.zeros((len(names), len(names)))
    P[np.ix_(places, places)] = record["covariance"]["matrix"]
    radius = np.linspace(0, np.hypot(ST16_ROWS, ST16_COLUMNS) / 2, RADII)
    curve = radial_difference(INVERTED_WANG, x, x_batch, P, radius, ST16_PIXEL_PITCH_M)
    return {
        "estimator": key,
        "label": ESTIMATORS[key].label,
        "radius_px": curve.radius_px.tolist(),
        "difference_px": curve.difference_px.tolist(),
        "three_sigma_px": (3 * curve.sigma_px).tolist(),
    }


def _largest(curve: Drawing, radius_px: float) -> float:
    within = np.array(curve["radius_px"]) <= radius_px
    return float(np.abs(np.array(curve["difference_px"])[within]).max())


#: The axis holds the curves after this share of the run; before it differences come from tens of micrometres away.
TRANSIENT_SHARE, RMS_TRANSIENT_SHARE = 0.15, 0.1


def draw_convergence(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw a reproduced Figure 3a or 3b: how the focal length nears the batch's along a run, with three-sigma bounds."""
    figure, seen = go.Figure(), [0.0]
    for style, x, y, reach in styled_curves(drawing, "frame", "difference_um", "three_sigma_um"):
        _add_bounded(figure, style, x, y, reach, "µm")
        settled = slice(int(TRANSIENT_SHARE * len(x)), None)
        seen += [*(y - reach)[settled], *(y + reach)[settled]]
    return _dressed(figure, drawing, "Δf against the batch, ±3σ", "Δf (µm)", range=padded(seen), zeroline=True)


def draw_radial(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw a reproduced Figure 5: how far sequential results move a star along the radius against the batch's."""
    figure = go.Figure()
    for style, x, y, reach in styled_curves(drawing, "radius_px", "difference_px", "three_sigma_px"):
        _add_bounded(figure, style, x, y, reach, "px")
    _dressed(figure, drawing, "radial difference from the batch, ±3σ", "sequential − batch (px)", zeroline=True)
    return figure.update_xaxes(title_text="radius from the principal point (px)")


def _dressed(figure: go.Figure, drawing: Mapping[str, Any], title: str, y_title: str, **axis: Any) -> go.Figure:
    """Give a figure over frames its titles."""
    theme.dress(figure, title=f"Figure {drawing['number']}: {title}", height_px=360)
    return figure.update_yaxes(title_text=y_title, **axis).update_xaxes(title_text="frame")


def _add_bounded(
    figure: go.Figure, style: theme.RunStyle, x: FloatArray, y: FloatArray, reach: FloatArray, unit: str
) -> None:
    figure.add_trace(theme.band(style, x, y - reach, y + reach))
    hover = f"%{{y:+.3f}} ±%{{customdata:.3f}} {unit} (3σ)<extra>{style.label}</extra>"
    figure.add_trace(theme.line(style, x, y, customdata=theme.short(reach), hovertemplate=hover))


def draw_rms(drawing: Mapping[str, Any]) -> go.Figure:
    """Draw a reproduced Figure 4: tail against aggregate RMS, dotted, of filters that start at the batch's result."""
    figure, seen = go.Figure(), list[float]()
    for style, x, tail, aggregate in styled_curves(drawing, "frame", "tail_urad", "aggregate_urad"):
        for y, word, dash in ((tail, "tail", style.dash), (aggregate, "aggregate", "dot")):
            name = f"{style.label} · {word}"
            look = theme.RunStyle(name, style.colour, dash)
            figure.add_trace(theme.line(look, x, y, hovertemplate=f"%{{y:.2f}} µrad<extra>{name}</extra>"))
            seen += [float(value) for value in y[int(RMS_TRANSIENT_SHARE * len(y)) :] if np.isfinite(value)]
    return _dressed(figure, drawing, "tail and aggregate RMS", "RMS arc error (µrad)", range=padded(seen or [0.0, 1.0]))
