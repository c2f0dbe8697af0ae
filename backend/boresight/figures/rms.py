"""Tail against aggregate RMS arc error (E Fig. 4, Eqs. 32 and 33, unweighted by the corrected Eq. 20).

Tail at frame k is the error of the whole set under the parameters x_k; aggregate is the error of frames 1 to k, each
under the parameters it had at the time. An aggregate well below the tail means that the filter follows single frames.
A batch run has the error of the whole set at each iteration; beside sequential runs it is a level.

The first frames fall from the initial error by hundreds of microradians and tail and aggregate then differ by a few, so
a sequential run is drawn twice: whole on the left, and on the right what follows once it had settled, or from where a
reader wants it. The band is what chance alone does to an RMS of so many arcs (`rms_tail`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.figures import theme
from boresight.figures.axes import share_cursor
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.course import Course, course_of
from boresight.figures.following import follow_errors
from boresight.figures.rms_tail import tail_start
from boresight.figures.thinning import keep_extremes

TITLE = "Tail and aggregate RMS"
URAD_PER_RAD = 1e6
LOG_RATIO = 8.0  # beyond this ratio of highest to lowest a log axis reads better
TICKS_URAD = [step * 10**decade for decade in range(-1, 6) for step in (1, 2, 5)]
MOST_BANDS = 3  # runs with their bands; more hide the curves
POINT_BUDGET = 8000  # of all panels, runs and curves together
CURVES = {"frame": {"tail_rms_rad": "tail", "aggregate_rms_rad": "aggregate"}, "iteration": {"rms_arc_rad": "RMS"}}


@dataclass(frozen=True)
class _Panel:
    """One subplot: the steps it shows, with how many points a curve, and what its axis must hold, in µrad."""

    column: int
    start: float
    end: float
    limit: int
    seen: list[float] = field(default_factory=list)


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw RMS arc error over frames, or over iterations when every run is a batch."""
    courses = [course_of(trace.result) for trace in traces]
    found = [course for course in courses if course is not None and _has_curve(course)]
    if not found:
        return theme.missing(TITLE, "No RMS arc error has been recorded yet: the curves appear as the run moves.")
    axis = "frame" if any(course.axis == "frame" for course in found) else "iteration"
    along = [course.x for course in found if course.axis == axis]
    span = (min(float(x.min()) for x in along), max(float(x.max()) for x in along))
    starts = [span[0]] if axis == "iteration" else [span[0], _tail_start(traces, courses)]
    panels = [_Panel(i + 1, start, span[1], POINT_BUDGET // (6 * len(found))) for i, start in enumerate(starts)]
    figure = make_subplots(1, len(panels), column_widths=[0.4, 0.6][: len(panels)] if len(panels) > 1 else None)
    for trace, course, style in zip(traces, courses, theme.run_styles(traces), strict=True):
        for panel in panels:
            if course is not None and course.axis == axis:
                _draw_run(figure, panel, course, style, len(traces) <= MOST_BANDS and trace.result.get("pairs"))
            if len(traces) == 1 or course is None or course.axis != axis:
                _draw_levels(figure, panel, trace.result, style, single=len(traces) == 1)
    return follow_errors(_dress(figure, panels, traces, axis), URAD_PER_RAD, traces)


def _tail_start(traces: Sequence[Trace], courses: Sequence[Course | None]) -> float:
    """Return where the last of the sequential runs has its tail begin."""
    pairs = zip(traces, courses, strict=True)
    return max(tail_start(trace.result, course) for trace, course in pairs if course and course.axis == "frame")


def _has_curve(course: Course) -> bool:
    return any(np.isfinite(course.series(key)).any() for key in CURVES[course.axis])


def _draw_run(figure: go.Figure, panel: _Panel, course: Course, style: theme.RunStyle, pairs: float | None) -> None:
    """Add the curves of one run; tail in the run's dash, aggregate dotted in the same colour; bands where `pairs` is known."""
    for key, word in CURVES[course.axis].items():
        y = course.series(key) * URAD_PER_RAD
        shown = np.isfinite(y) & (course.x >= panel.start)
        x, y = course.x[shown], y[shown]
        if not len(x):
            continue
        kept = keep_extremes([y], panel.limit)
        if pairs and word != "aggregate":
            reach = 3 * y[kept] / np.sqrt(2 * pairs)
            figure.add_trace(theme.band(style, x[kept], y[kept] - reach, y[kept] + reach), row=1, col=panel.column)
        name = f"{style.label} · {word}"
        curve = theme.RunStyle(style.label, style.colour, "dot" if word == "aggregate" else style.dash)
        settings = {
            "name": name,
            "legendgroup": name,
            "showlegend": panel.column == 1,
            "hovertemplate": f"%{{y:.2f}} µrad<extra>{name}</extra>",
            "mode": "lines" if course.axis == "frame" else "lines+markers",
        }
        figure.add_trace(theme.line(curve, x[kept], y[kept], **settings), row=1, col=panel.column)
        panel.seen.extend((float(y.min()), float(y.max())))


def _draw_levels(figure: go.Figure, panel: _Panel, result: Result, style: theme.RunStyle, *, single: bool) -> None:
    """Add the errors under the initial and the final parameters; beside sequential runs a batch is its final level."""
    rms = result.get("rms_arc_rad") or {}
    looks = {"initial": (theme.REFERENCE_COLOUR, "dot"), "final": (theme.REFERENCE_COLOUR, "dash")}
    if not single:
        looks = {"final": (style.colour, style.dash)}
    for key, (colour, dash) in looks.items():
        if rms.get(key) is None or (key == "initial" and panel.column > 1):
            continue
        level = float(rms[key]) * URAD_PER_RAD
        name = f"{key} parameters" if single else f"{style.label} · final"
        settings = {"hovertemplate": f"%{{y:.2f}} µrad<extra>{name}</extra>", "showlegend": panel.column == 1}
        drawn = theme.reference((panel.start, panel.end), level, name, colour, dash, **settings)
        figure.add_trace(drawn, row=1, col=panel.column)
        panel.seen.append(level)


def _dress(figure: go.Figure, panels: list[_Panel], traces: Sequence[Trace], axis: str) -> go.Figure:
    """Choose log or linear by the range of each panel, and say what the panels show."""
    theme.dress(figure, title=_headline(traces), height_px=380)
    for panel in panels:
        scale: dict[str, Any] = {"type": "linear"}
        if panel.seen and 0 < min(panel.seen) < max(panel.seen) / LOG_RATIO:
            scale = {"type": "log", "tickvals": TICKS_URAD}
        figure.update_yaxes(**scale, row=1, col=panel.column)
        figure.update_xaxes(title_text=axis, range=_window(panel.start, panel.end), row=1, col=panel.column)
    if len(panels) > 1:
        figure.update_xaxes(title_text=f"{axis}, whole run", row=1, col=1)
        figure.update_xaxes(title_text=f"{axis}, tail from {panels[1].start:.5g} on", row=1, col=2)
    figure.update_yaxes(title_text="RMS arc error (µrad)", row=1, col=1)
    return share_cursor(figure, axis)


def _window(start: float, end: float) -> list[float]:
    margin = 0.02 * (end - start) or 0.5
    return [start - margin, end + margin]


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
    steps: Table = {course.axis: [int(step) for step in course.x]}
    return steps | {key: theme.plain(course.series(key)) for key in CURVES[course.axis]}


RMS = Figure(
    name="rms",
    title=TITLE,
    guide=(
        "Tail is the error of the whole set under the parameters of that moment, with what chance does to it (±3σ), "
        "aggregate the running error of the frames so far, each under the parameters it had at the time. The two should "
        "meet and lie flat near the final level; an aggregate well below the tail means that the filter follows single "
        "frames instead of the sensor."
    ),
    draw=draw,
    table=table,
)
