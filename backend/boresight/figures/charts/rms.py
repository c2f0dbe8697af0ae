"""Tail against aggregate RMS arc error (E Fig. 4, Eqs. 32 and 33, unweighted by the corrected Eq. 20).

Tail at frame k is the error of the whole set under the parameters x_k; aggregate is the error of frames 1 to k, each
under the parameters it had at the time. An aggregate well below the tail means that the filter follows single frames.
A batch run has the error of the whole set at each iteration; beside sequential runs it is a level.

The first frames fall from the initial error by hundreds of microradians and tail and aggregate then differ by a few, so
a sequential run is drawn twice: whole on the left, and on the right what follows once it had settled, or from where a
reader wants it. The band is what chance alone does to an RMS of so many arcs (`boresight.verdicts.history`).

Residual RMS by axis: rows and columns of the detector, and along and across the radius; on the whole and as it runs.

Pixels are alike in rows and columns, so an axis that stands out is read-out or motion; distortion that is left over shows along
the radius, and roll of single exposures across it. An RMS of n residuals is known to rms / sqrt(2 n). The run of it takes the
sampled residuals in the order of their frames, in bins of one size, so that each bin is known equally well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import Calibration
from boresight.cameras import CAMERA_MODELS
from boresight.figures.chart import Figure, Table, Trace
from boresight.figures.factory import Part, column, make_figure
from boresight.figures.live_traces import follow_errors
from boresight.figures.style import theme
from boresight.figures.style.axes import BETWEEN_PANELS, axis_title, counted, grid_place, share_cursor, stacked_px
from boresight.figures.style.thinning import keep_extremes
from boresight.verdicts.history import History, read_history, tail_start
from boresight.verdicts.numbers import number, urad
from boresight.verdicts.verdict import describe_rms, why_absent

TITLE = "Tail and aggregate RMS"
URAD_PER_RAD = 1e6
LOG_RATIO = 8.0  # beyond this ratio of highest to lowest a log axis reads better
TICKS_URAD = [step * 10**decade for decade in range(-1, 6) for step in (1, 2, 5)]
MOST_BANDS = 3  # runs with their bands; more hide the curves
POINT_BUDGET = 8000  # of all runs and curves together
TRANSIENT_SHARE = 0.05  # of the steps, which the axis need not hold
OLD = "old parameters"
AGGREGATE_COLOUR = theme.RUN_COLOURS[1]


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw RMS arc error over frames, or over iterations when every run is a batch."""
    figure, axis, seen = _draw_curves(traces)
    if not axis:
        return theme.missing(TITLE, "No RMS arc error has been recorded yet: the curves appear as the run proceeds.")
    theme.dress(figure, title=_headline(traces), height_px=380)
    figure.update_xaxes(title_text=axis_title(axis, traces))
    figure.update_yaxes(title_text="RMS arc error (µrad)")
    _scale(figure, traces, axis, seen)
    _mark_tail(figure, traces, axis)
    return follow_errors(share_cursor(figure, counted(axis, traces)), URAD_PER_RAD, traces)


def draw_small(traces: Sequence[Trace]) -> go.Figure:
    """Draw the curves of one run, named where they end."""
    figure, axis, seen = _draw_curves(traces[:1])
    if not axis:
        return theme.missing(TITLE, "No RMS arc error has been recorded yet.")
    theme.shrink(figure)
    figure.update_xaxes(title_text=axis_title(axis, traces))
    figure.update_yaxes(title_text="µrad")
    _scale(figure, traces[:1], axis, seen)
    _name_curves(figure, traces)
    figure.update_annotations(font={"size": 10})
    return follow_errors(share_cursor(figure, counted(axis, traces)), URAD_PER_RAD, traces)


def _name_curves(figure: go.Figure, traces: Sequence[Trace]) -> None:
    """Name tail and aggregate in the corners of their sides, the curve of a batch at its end, and the old parameters' line."""
    ends = [(str(trace.meta["part"]), trace) for trace in figure.data if (trace.meta or {}).get("part")]
    right = {"x": 0.98, "xref": "x domain", "xanchor": "right"}
    above, below = {"yanchor": "bottom"}, {"yanchor": "top"}
    if len(ends) == 1:
        sides = [{"y": _place(figure, float(ends[0][1].y[-1])), "yref": "y", "yshift": 2} | above]
    else:  # beneath the line of the old parameters, and at the foot: a live curve moves on under them
        ends.sort(key=lambda end: -float(end[1].y[-1]))
        sides = [{"y": 1, "yref": "y domain", "yshift": -14} | below, {"y": 0, "yref": "y domain", "yshift": 2} | above]
    for (word, trace), side in zip(ends, sides, strict=False):
        words = {"tail": "tail (whole set)", "aggregate": "aggregate (as it ran)"}.get(word, word)
        figure.add_annotation(text=words, font={"color": trace.line.color, "size": 10}, **right, **side)
    old = traces[0].result.rms_arc_rad.initial
    if old is not None and not any(str(one.text).startswith(OLD) for one in figure.layout.annotations):
        level = {"y": _place(figure, old * URAD_PER_RAD), "yref": "y", "x": 0.55, "xref": "x domain"}
        figure.add_annotation(text=f"{OLD}: {urad(old, 3)}", **level, **(below if len(ends) == 1 else above))


def _place(figure: go.Figure, value: float) -> float:
    """Return where an annotation has to stand for a value of the y axis: of a log axis its power."""
    return float(np.log10(value)) if figure.layout.yaxis.type == "log" else value


def _draw_curves(traces: Sequence[Trace]) -> tuple[go.Figure, str, list[float]]:
    """Draw the curves and levels of the runs; return what the axis counts, nothing where no run has a curve, and must hold."""
    histories = [read_history(trace.result) for trace in traces]
    found = [history for history in histories if history is not None and _has_curve(history)]
    figure, seen = go.Figure(), list[float]()
    if not found:
        return figure, "", seen
    axis = "frame" if any(history.axis == "frame" for history in found) else "iteration"
    along = [history.x for history in found if history.axis == axis]
    span = (min(float(x.min()) for x in along), max(float(x.max()) for x in along))
    for trace, history, style in zip(traces, histories, theme.run_styles(traces), strict=True):
        is_along = history is not None and history.axis == axis
        if history is not None and is_along:
            banded = trace.result.pairs if len(traces) <= MOST_BANDS else 0
            seen += _draw_run(figure, history, style, banded, single=len(traces) == 1, n_runs=len(found))
        if len(traces) == 1 or not is_along:
            seen += _draw_levels(figure, span, trace.result, style, single=len(traces) == 1)
    margin = 0.02 * (span[1] - span[0]) or 0.5
    figure.update_xaxes(range=[span[0] - margin, span[1] + margin])
    return figure, axis, seen


def _curves(history: History) -> dict[str, FloatArray]:
    """The curves of a run, rad, by what they are called."""
    if history.axis == "iteration":
        return {"RMS": history.rms_arc_rad}
    return {"tail": history.tail_rms_rad, "aggregate": history.aggregate_rms_rad}


def _has_curve(history: History) -> bool:
    return any(np.isfinite(values).any() for values in _curves(history).values())


def _draw_run(
    figure: go.Figure, history: History, style: theme.RunStyle, pairs: int, *, single: bool, n_runs: int
) -> list[float]:
    """Add the curves of one run and the band of `pairs`, if any; return what the axis must hold, which the start is not.

    The aggregate is dotted, and where the run is alone it has the second hue: of several, the hue is the run's.
    """
    seen: list[float] = []
    for word, values in _curves(history).items():
        y = values * URAD_PER_RAD
        shown = np.isfinite(y)
        x, y = history.x[shown], y[shown]
        if not len(x):
            continue
        is_aggregate = word == "aggregate"
        hue = AGGREGATE_COLOUR if is_aggregate and single else style.colour
        curve = theme.RunStyle(style.label, hue, "dot" if is_aggregate else style.dash)
        kept = keep_extremes([y], POINT_BUDGET // (3 * n_runs))
        if pairs and not is_aggregate:
            reach = 3 * y[kept] / np.sqrt(2 * pairs)
            band = theme.band(curve, x[kept], y[kept] - reach, y[kept] + reach, showlegend=single)
            figure.add_trace(band)
            seen += [float(y[-1] - reach[-1]), float(y[-1] + reach[-1])]
        name = f"{style.label} · {word}"
        settings = {
            "name": name,
            "meta": theme.tag_run(style.label, word),
            "legendgroup": name,
            "hovertemplate": f"%{{y:.2f}} µrad<extra>{name}</extra>",
            "mode": "lines" if history.axis == "frame" else "lines+markers",
        }
        figure.add_trace(theme.line(curve, x[kept], y[kept], **settings))
        late = y if history.axis == "iteration" else y[int(TRANSIENT_SHARE * len(y)) :]
        seen += [float(late.min()), float(late.max())]
    return seen


def _draw_levels(
    figure: go.Figure, span: tuple[float, float], result: Calibration, style: theme.RunStyle, *, single: bool
) -> list[float]:
    """Add the errors under the old and the new parameters; beside sequential runs a batch is its final level."""
    rms = result.rms_arc_rad
    looks = {
        "old": (rms.initial, theme.REFERENCE_COLOUR, "dot"),
        "new": (rms.final, theme.REFERENCE_COLOUR, "dash"),
    }
    if not single:
        looks = {"new": (rms.final, style.colour, style.dash)}
    for key, (value, colour, dash) in looks.items():
        if value is None:
            continue
        name = f"{key} parameters" if single else f"{style.label} · final"
        settings: dict[str, Any] = {"hovertemplate": f"%{{y:.2f}} µrad<extra>{name}</extra>"}
        settings |= {} if single else {"meta": theme.tag_run(style.label, "final")}
        figure.add_trace(theme.reference(span, value * URAD_PER_RAD, name, colour, dash, **settings))
    return [] if rms.final is None else [rms.final * URAD_PER_RAD]


def _scale(figure: go.Figure, traces: Sequence[Trace], axis: str, seen: Sequence[float]) -> None:
    """Show what follows the start; of the old parameters' error say where it lies if that is elsewhere."""
    low, high = min(seen), max(seen)
    if axis == "iteration" and 0 < low < high / LOG_RATIO:
        figure.update_yaxes(type="log", tickvals=TICKS_URAD, ticktext=[number(tick, 1) for tick in TICKS_URAD])
        return
    margin = 0.1 * (high - low) or 0.05 * high or 1.0
    window = [low - margin, high + 2.5 * margin]
    figure.update_yaxes(range=window)
    old = traces[0].result.rms_arc_rad.initial
    if len(traces) == 1 and old is not None and not window[0] <= old * URAD_PER_RAD <= window[1]:
        arrow = "↑" if old * URAD_PER_RAD > window[1] else "↓"
        place = {"x": 0.98, "y": 0.98, "xref": "x domain", "yref": "y domain", "xanchor": "right", "yanchor": "top"}
        figure.add_annotation(text=f"{OLD}: {urad(old, 3)} {arrow}", **place)


def _mark_tail(figure: go.Figure, traces: Sequence[Trace], axis: str) -> None:
    """Draw where the last of the sequential runs has its tail begin."""
    pairs = [(trace, read_history(trace.result)) for trace in traces]
    starts = [
        tail_start(trace.result, history, trace.tail_from)
        for trace, history in pairs
        if history is not None and history.axis == "frame"
    ]
    if axis != "frame" or not starts:
        return
    words: dict[str, Any] = {"annotation_text": f"tail from {max(starts):.5g}", "annotation_position": "bottom right"}
    figure.add_vline(x=max(starts), line=theme.LEVEL, **words)


def _headline(traces: Sequence[Trace]) -> str:
    rms = traces[0].result.rms_arc_rad
    if len(traces) == 1 and rms.initial is not None and rms.final is not None:
        result = traces[0].result
        return f"RMS arc error {describe_rms(result.evaluation, rms, result.pairs)} µrad, 95 % in brackets"
    return "RMS arc error" if len(traces) == 1 else f"RMS arc error of {len(traces)} runs"


def table(result: Calibration) -> Table:
    """List the RMS arc errors in rad by frame or iteration."""
    history = read_history(result)
    if history is None:
        return {}
    steps: Table = {history.axis: [int(step) for step in history.x]}
    if history.axis == "iteration":
        return steps | {"rms_arc_rad": list_known(history.rms_arc_rad)}
    columns = {"tail_rms_rad": history.tail_rms_rad, "aggregate_rms_rad": history.aggregate_rms_rad}
    return steps | {name: list_known(values) for name, values in columns.items()}


RMS = Figure(
    name="rms",
    title=TITLE,
    guide=(
        "Tail: error of the whole set with the parameters at that point, with ±3σ random scatter; aggregate: cumulative error "
        "of all frames so far, each with the parameters at its own time. The two should agree and be "
        "flat near the final level; an aggregate well below the tail means that the filter follows single frames instead of "
        "the sensor."
    ),
    draw=draw,
    table=table,
    wide=True,
    forms={"small": draw_small},
)


ALONG_RADIUS, ACROSS_RADIUS = "along the radius", "across the radius"
AXES = ("along rows", "along columns", ALONG_RADIUS, ACROSS_RADIUS)
RUNNING = {ALONG_RADIUS: "solid", ACROSS_RADIUS: "dot"}
MOST_BINS, LEAST_IN_BIN = 40, 20


@dataclass(frozen=True)
class AxisResiduals:
    """Residuals of a run by axis: (n,) px each in the order of `AXES`, and the frame of each."""

    by_axis: dict[str, FloatArray]
    frame: FloatArray


def compute_axis_residuals(result: Calibration) -> AxisResiduals | None:
    """Turn a result's residuals to its axes; None where it has none."""
    seen = result.trust.residuals if result.trust else None
    if seen is None:
        return None
    d_row, d_col = column(seen.d_row_px), column(seen.d_col_px)
    row, col, frame = column(seen.row_px), column(seen.col_px), column(seen.frame)
    if not len(d_row) or len({len(values) for values in (d_row, d_col, row, col, frame)}) > 1:
        return None
    row_0, col_0 = _centre(result, row, col)
    radius = np.hypot(row - row_0, col - col_0)
    cosine, sine = (
        np.divide(along, radius, out=np.zeros(len(row)), where=radius > 0) for along in (row - row_0, col - col_0)
    )
    turned = (d_row, d_col, cosine * d_row + sine * d_col, cosine * d_col - sine * d_row)
    return AxisResiduals(dict(zip(AXES, turned, strict=True)), frame)


def _centre(result: Calibration, row: FloatArray, col: FloatArray) -> tuple[float, float]:
    """Return the principal point, or the middle of the stars where the camera model is not known."""
    model, values = CAMERA_MODELS.get(result.camera_model), result.parameters
    if model is None or any(values.get(name) is None for name in model.parameter_names):
        return float(row.mean()), float(col.mean())
    return model.principal_point(np.array([values[name] for name in model.parameter_names], dtype=np.float64))


def draw_rms_axes(drawn: Sequence[Part[AxisResiduals]], beside: int = 2) -> go.Figure:
    """Draw every run's RMS by axis with 3-sigma bars, and how it runs over the frames beside or below."""
    rows, points, over_frames = 2 // beside, grid_place(0, beside), grid_place(1, beside)
    figure = make_subplots(
        rows,
        beside,
        column_widths=[0.35, 0.65][-beside:],
        horizontal_spacing=0.08,
        vertical_spacing=BETWEEN_PANELS / rows,
    )
    for _, style, found in drawn:
        figure.add_trace(_points(found, style), **points)
        for axis in RUNNING if len(drawn) == 1 else (ALONG_RADIUS,):
            _rms_axes_draw_run(figure, found, axis, style, banded=len(drawn) <= 3, **over_frames)
    layout: dict[str, Any] = {"hovermode": "closest", "scattermode": "group"}
    theme.dress(figure, title=_rms_axes_headline(drawn[0][2]), height_px=stacked_px(400, rows, beside), **layout)
    figure.update_yaxes(rangemode="tozero")
    figure.update_yaxes(title_text="RMS residual (px), bars ±3σ", **points)
    figure.update_yaxes(title_text="RMS of a bin of frames (px)", **over_frames)
    broken = [axis.replace(" the ", " ").replace(" ", "<br>") for axis in AXES]  # four names beside each other
    figure.update_xaxes(type="category", tickvals=AXES, ticktext=broken, tickangle=0, **points)
    figure.update_xaxes(title_text="frame", **over_frames)
    return share_cursor(figure, "frame")


def rms_with_sigma(values: FloatArray) -> tuple[float, float]:
    """Return the RMS of residuals and its sigma."""
    known = values[np.isfinite(values)]
    if not len(known):
        return float("nan"), float("nan")
    rms = float(np.sqrt(np.mean(known**2)))
    return rms, rms / float(np.sqrt(2 * len(known)))


def _points(found: AxisResiduals, style: theme.RunStyle) -> go.Scatter:
    levels = np.array([rms_with_sigma(values) for values in found.by_axis.values()])
    return go.Scatter(
        x=list(found.by_axis),
        y=theme.short(levels[:, 0]),
        mode="markers",
        offsetgroup=style.label,
        name=style.label,
        legendgroup=style.label,
        marker={"color": style.colour, "size": 9},
        error_y=theme.error_bars(theme.short(3 * levels[:, 1]), style.colour),
        customdata=theme.short(3 * levels[:, 1]),
        hovertemplate=f"%{{x}}: %{{y:.4f}} ±%{{customdata:.4f}} px (3σ)<extra>{style.label}</extra>",
    )


def _rms_axes_draw_run(
    figure: go.Figure, found: AxisResiduals, axis: str, style: theme.RunStyle, *, banded: bool, **place: Any
) -> None:
    own = theme.RunStyle(style.label, style.colour, RUNNING[axis])
    frame, level, sigma = running(found, axis)
    if banded and axis == ALONG_RADIUS:
        figure.add_trace(theme.band(own, frame, level - 3 * sigma, level + 3 * sigma), **place)
    hover = f"frame %{{x}}: %{{y:.4f}} px {axis}<extra>{style.label}</extra>"
    options = {"name": f"{style.label} · {axis}", "hovertemplate": hover, "legendgroup": f"{style.label} · {axis}"}
    figure.add_trace(theme.line(own, frame, level, meta=theme.tag_run(own.label, axis), **options), **place)


def running(found: AxisResiduals, axis: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean frame, the RMS and its sigma of bins of one size, (n_bins,) each."""
    order = np.argsort(found.frame, kind="stable")
    bins = np.array_split(order, max(1, min(MOST_BINS, len(order) // LEAST_IN_BIN)))
    levels = np.array([rms_with_sigma(found.by_axis[axis][places]) for places in bins])
    return np.array([found.frame[places].mean() for places in bins]), levels[:, 0], levels[:, 1]


def _rms_axes_headline(found: AxisResiduals) -> str:
    (along, sigma), (across, other) = (rms_with_sigma(found.by_axis[axis]) for axis in AXES[2:])
    apart = abs(along - across) > 3 * float(np.hypot(sigma, other))
    words = "differ by more than 3σ" if apart else "agree within 3σ"
    return f"Along the radius {number(along, 3)} px, across it {number(across, 3)} px: they {words}"


def table_rms_axes(found: AxisResiduals) -> Table:
    """List one axis a row: its RMS in px, the RMS's sigma, and how many residuals it rests on."""
    levels = np.array([rms_with_sigma(values) for values in found.by_axis.values()])
    return {
        "axis": list(found.by_axis),
        "rms_px": list_known(levels[:, 0]),
        "sigma_of_rms_px": list_known(levels[:, 1]),
        "residuals": [int(np.isfinite(values).sum()) for values in found.by_axis.values()],
    }


RMS_AXES = make_figure(
    draw_rms_axes,
    table_rms_axes,
    compute_axis_residuals,
    lambda result: why_absent(result, "residuals"),
    name="rms-axes",
    title="Residual RMS by axis",
    guide=(
        "On the left is the residual's RMS along rows and columns and along and across the radius, with ±3σ bars; on the "
        "right is how the last two change over the frames. All four should agree within their bars and be flat: a larger "
        "radial value indicates remaining distortion; an increase over time indicates that the sensor is changing."
    ),
    wide=True,
    advanced=True,
    forms={"narrow": partial(draw_rms_axes, beside=1)},
)
