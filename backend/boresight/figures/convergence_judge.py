"""The last two panels of the convergence chart, which judge the run as a whole: its cost, and how far it still steps.

A batch run has its cost, half of chi-square, a filter its normalised innovation squared, sum nis / sum dof of the frames so
far, which is 1 where the covariance is honest. The step norm is the root mean square over the n free parameters of
(x_k - x_{k-1}) / sigma, in sigmas of the end for a batch and of the moment for a filter: a batch at rest steps by nothing, a
filter by about 1 / sqrt(k).

A run is settled from the step on after which every free parameter stays within three final sigmas of its end.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray
from boresight.figures import theme
from boresight.figures.axes import offer_log
from boresight.figures.chart import Trace
from boresight.figures.course import Course, settled_step
from boresight.figures.thinning import keep_extremes

PANELS = 2
POINT_BUDGET = 1200  # a panel, of all runs together
MOST_MARKED = 3  # runs whose settling is marked; more lines than that hide the curves
Place = tuple[int, int]


def draw_judges(
    figure: go.Figure, places: tuple[Place, Place], courses: Sequence[Course | None], traces: Sequence[Trace]
) -> None:
    """Add both panels, in the rows and columns (from 1) of `places`; a course that is None is another axis's."""
    for course, style in zip(courses, theme.run_styles(traces), strict=True):
        if course is not None:
            judged = course.series("cost") if course.axis == "iteration" else innovations(course)
            _draw(figure, places[0], course, judged, style, POINT_BUDGET // len(traces))
            _draw(figure, places[1], course, step_norm(course), style, POINT_BUDGET // len(traces))
    cost, step = ({"row": row, "col": col} for row, col in places)
    figure.update_yaxes(title={"text": "step (σ)", "standoff": 4}, type="log", exponentformat="power", **step)
    names = [_axis_name(figure, *places[1])]
    if any(course is not None and course.axis == "frame" for course in courses):
        figure.add_hline(y=1, line={"color": theme.REFERENCE_COLOUR, "dash": "dot", "width": 1.2}, **cost)
        figure.update_yaxes(title={"text": "NIS / dof, so far", "standoff": 4}, **cost)
    else:
        figure.update_yaxes(title={"text": "cost", "standoff": 4}, type="log", exponentformat="power", **cost)
        names.append(_axis_name(figure, *places[0]))
    offer_log(figure, names)


def _draw(figure: go.Figure, place: Place, course: Course, y: FloatArray, style: theme.RunStyle, limit: int) -> None:
    kept = keep_extremes([y], limit)
    settings = {"hovertemplate": f"%{{y:.4g}}<extra>{style.label}</extra>", "showlegend": False}
    figure.add_trace(theme.line(style, course.x[kept], y[kept], **settings), row=place[0], col=place[1])


def _axis_name(figure: go.Figure, row: int, column: int) -> str:
    """Return the layout's name of a subplot's y axis."""
    return str(next(iter(figure.select_yaxes(row=row, col=column))).plotly_name)


def innovations(course: Course) -> FloatArray:
    """Average the normalised innovation squared over the frames so far, per degree of freedom."""
    nis, dof = (np.nancumsum(course.series(key)) for key in ("nis", "nis_dof"))
    return np.where(dof > 0, nis / np.maximum(dof, 1), np.nan)


def step_norm(course: Course) -> FloatArray:
    """Return the root mean square step in sigmas, (n_steps,); the first, which has none before it, is NaN."""
    free = [course.names.index(name) for name in course.free]
    sigma = course.sigma[-1:, free] if course.axis == "iteration" else course.sigma[1:, free]
    steps = np.diff(course.value[:, free], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        norm = np.sqrt(np.mean((steps / sigma) ** 2, axis=1))
    norm[~(norm > 0)] = np.nan  # a log axis has no place for nothing
    return np.concatenate([[np.nan], norm])


def mark_settled(figure: go.Figure, courses: Sequence[Course | None], traces: Sequence[Trace], n_panels: int) -> None:
    """Draw a vertical line in every panel where a run had settled, and name it in the legend."""
    if len(traces) > MOST_MARKED:
        return
    shapes: list[dict[str, Any]] = []
    for trace, course, style in zip(traces, courses, theme.run_styles(traces), strict=True):
        first = settled_step(trace.result)
        if course is None or first is None or not first < len(course.x):
            continue
        x = float(course.x[first])
        line = {"color": style.colour, "dash": "dot", "width": 1.2}
        shapes += [
            {"type": "line", "x0": x, "x1": x, "y0": 0, "y1": 1, "line": line, "xref": f"x{n}", "yref": f"y{n} domain"}
            for n in ["", *range(2, n_panels + 1)]
        ]
        named = go.Scatter(x=[None], y=[None], mode="lines", line=line, name=_words(style, x, len(traces)))
        figure.add_trace(named, row=1, col=1)
    figure.update_layout(shapes=[*figure.layout.shapes, *shapes])


def _words(style: theme.RunStyle, x: float, n_runs: int) -> str:
    whose = f"{style.label} · " if n_runs > 1 else ""
    return f"{whose}settled at {x:.5g}"
