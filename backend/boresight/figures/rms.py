"""Tail against aggregate RMS arc error (E Fig. 4, Eqs. 32 and 33, unweighted by the corrected Eq. 20).

Tail at frame k is the error of the whole set under the parameters x_k; aggregate is the error of frames 1 to k, each
under the parameters it had at the time. An aggregate well below the tail means that the filter follows single frames.
A batch run has the error of the whole set at each iteration; beside sequential runs it is a level.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from boresight.figures import theme
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.course import Course, course_of
from boresight.figures.thinning import keep_extremes

FloatArray = NDArray[np.float64]

TITLE = "Tail and aggregate RMS"
URAD_PER_RAD = 1e6
LOG_RATIO = 8.0  # beyond this ratio of highest to lowest a log axis reads better
CURVES = (("tail_rms_rad", "tail"), ("aggregate_rms_rad", "aggregate"))


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw RMS arc error over frames, or over iterations when every run is a batch."""
    courses = [course_of(trace.result) for trace in traces]
    found = [course for course in courses if course is not None and _has_curve(course)]
    if not found:
        return theme.missing(TITLE, "No RMS arc error has been recorded yet: the curves appear as the run moves.")
    axis = "frame" if any(course.axis == "frame" for course in found) else "iteration"
    span = _span([course.x for course in found if course.axis == axis])
    figure, seen = go.Figure(), list[float]()
    for trace, course, style in zip(traces, courses, theme.run_styles(traces), strict=True):
        if course is not None and course.axis == axis:
            seen += _draw_run(figure, course, style)
        if len(traces) == 1 or course is None or course.axis != axis:
            seen += _draw_levels(figure, trace.result, style, span, single=len(traces) == 1)
    theme.dress(figure, title=_headline(traces), height_px=380)
    figure.update_xaxes(title_text=axis)
    log = min(seen) > 0 and max(seen) / min(seen) > LOG_RATIO
    figure.update_yaxes(title_text="RMS arc error (µrad)", type="log" if log else "linear", dtick="D2" if log else None)
    return figure


def _has_curve(course: Course) -> bool:
    keys = [key for key, _ in CURVES] if course.axis == "frame" else ["rms_arc_rad"]
    return any(np.isfinite(course.series(key)).any() for key in keys)


def _span(axes: list[FloatArray]) -> tuple[float, float]:
    return min(float(x.min()) for x in axes), max(float(x.max()) for x in axes)


def _draw_run(figure: go.Figure, course: Course, style: theme.RunStyle) -> list[float]:
    """Add the curves of one run; tail in the run's dash, aggregate dotted in the same colour."""
    seen: list[float] = []
    curves = CURVES if course.axis == "frame" else (("rms_arc_rad", "RMS"),)
    for key, word in curves:
        y = course.series(key) * URAD_PER_RAD
        known = np.isfinite(y)
        x, y = course.x[known], y[known]
        if not len(x):
            continue
        kept = keep_extremes([y])
        curve = theme.RunStyle(style.label, style.colour, "dot" if word == "aggregate" else style.dash)
        settings = {
            "name": f"{style.label} · {word}",
            "hovertemplate": f"%{{y:.2f}} µrad<extra>{style.label} · {word}</extra>",
            "mode": "lines" if course.axis == "frame" else "lines+markers",
        }
        figure.add_trace(theme.line(curve, x[kept], y[kept], **settings))
        seen += [float(y.min()), float(y.max())]
    return seen


def _draw_levels(
    figure: go.Figure, result: Result, style: theme.RunStyle, span: tuple[float, float], *, single: bool
) -> list[float]:
    """Add the errors under the initial and the final parameters; beside sequential runs a batch is its final level."""
    rms = result.get("rms_arc_rad") or {}
    looks = {"initial": (theme.REFERENCE_COLOUR, "dot"), "final": (theme.REFERENCE_COLOUR, "dash")}
    if not single:
        looks = {"final": (style.colour, style.dash)}
    seen: list[float] = []
    for key, (colour, dash) in looks.items():
        if rms.get(key) is not None:
            level = float(rms[key]) * URAD_PER_RAD
            name = f"{key} parameters" if single else f"{style.label} · final"
            hover = f"%{{y:.2f}} µrad<extra>{name}</extra>"
            figure.add_trace(theme.reference(span, level, name, colour, dash, hovertemplate=hover))
            seen.append(level)
    return seen


def _headline(traces: Sequence[Trace]) -> str:
    rms = traces[0].result.get("rms_arc_rad") or {}
    if len(traces) == 1 and rms.get("initial") is not None and rms.get("final") is not None:
        before, after = (rms[key] * URAD_PER_RAD for key in ("initial", "final"))
        return f"RMS arc error {before:.1f} → {after:.1f} µrad"
    return "RMS arc error" if len(traces) == 1 else f"RMS arc error of {len(traces)} runs"


def table(result: Result) -> Table:
    """List the RMS arc errors in rad by frame or iteration."""
    course = course_of(result)
    if course is None:
        return {}
    keys = [key for key, _ in CURVES] if course.axis == "frame" else ["rms_arc_rad"]
    return {course.axis: [int(step) for step in course.x], **{key: theme.plain(course.series(key)) for key in keys}}


RMS = Figure(
    name="rms",
    title=TITLE,
    guide=(
        "Tail is the error of the whole set under the parameters of that moment, aggregate the running error of "
        "the frames so far, each under the parameters it had at the time. The two should meet and lie flat near "
        "the final level; an aggregate well below the tail means that the filter follows single frames instead of "
        "the sensor."
    ),
    draw=draw,
    table=table,
)
