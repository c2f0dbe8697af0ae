"""How fast a method's error comes down to what the stars allow, and at what price: methods beside each other on one set.

Drawn over frames is the claimed sigma after so many frames over the Cramer-Rao sigma of the whole set, the geometric mean over
the free parameters; for a simulated sensor the root mean square of the true error in the same unit, dotted. One is the end of the
way: an efficient and honest method has its line arrive there and its dots about it (W Figure 6 draws arcs instead, whose noise
hides all but the start). A batch beside filters is a level. The legend has the time of the fit a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray
from boresight.figures import theme
from boresight.figures.axes import share_cursor
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.course import Course, course_of
from boresight.figures.method_scores import bound_of, method_scores
from boresight.figures.thinning import keep_extremes
from boresight.verdicts.numbers import number
from boresight.verdicts.verdict import why_absent

TITLE = "Error against the bound"
POINT_BUDGET = 8000  # of all runs together


@dataclass(frozen=True)
class _Approach:
    """A run's way to the bound: claimed and true error (n_steps,) in its sigmas, NaN where not known."""

    course: Course
    claimed: FloatArray
    true: FloatArray


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw every run's claimed and true error over frames, or over iterations when every run is a batch."""
    styled = zip(traces, theme.run_styles(traces), strict=True)
    drawn = [(trace, style, way) for trace, style in styled if (way := _approach(trace.result)) is not None]
    if not drawn:
        return theme.missing(TITLE, why_absent(traces[0].result, "efficiency"))
    axis = "frame" if any(way.course.axis == "frame" for _, _, way in drawn) else "iteration"
    along = np.concatenate([way.course.x for _, _, way in drawn if way.course.axis == axis])
    span = np.array([along.min(), along.max()])
    figure = go.Figure()
    for trace, style, way in drawn:
        _draw_run(
            figure,
            trace,
            style,
            way if way.course.axis == axis else _level(way),
            span,
            POINT_BUDGET // (2 * len(drawn)),
        )
    known = any(np.isfinite(way.true).any() for _, _, way in drawn)
    title = "Error over the Cramér-Rao bound: claimed" + (", and true (dotted)" if known else "")
    theme.dress(figure, title=title, height_px=460, hovermode="closest")
    figure.add_hline(y=1, line={"color": theme.REFERENCE_COLOUR, "dash": "dot", "width": 1.4})
    figure.update_xaxes(title_text=axis)
    figure.update_yaxes(title_text="error / bound", type="log", exponentformat="power")
    return share_cursor(figure, axis)


def _approach(result: Result) -> _Approach | None:
    """Read how a run came to the bound, or None where the bound or the way is not known."""
    bound, course = bound_of(result), course_of(result)
    if not bound or course is None or not set(bound) <= set(course.names):
        return None
    places = [course.names.index(name) for name in bound]
    b = np.array(list(bound.values()))
    truth = result.get("truth") or {}
    true = np.array([np.nan if truth.get(name) is None else float(truth[name]) for name in bound])
    with np.errstate(invalid="ignore", divide="ignore"):
        claimed = np.exp(np.mean(np.log(course.sigma[:, places] / b), axis=1))
        error = np.sqrt(np.mean(((course.value[:, places] - true) / b) ** 2, axis=1))
    return _Approach(course, np.asarray(claimed), np.asarray(error))


def _level(way: _Approach) -> _Approach:
    """Keep the end of a batch, to be drawn over the frames of the filters beside it."""
    return _Approach(way.course, way.claimed[[-1, -1]], way.true[[-1, -1]])


def _draw_run(
    figure: go.Figure, trace: Trace, style: theme.RunStyle, way: _Approach, span: FloatArray, limit: int
) -> None:
    """Add a run's two curves."""
    x = way.course.x if len(way.claimed) == len(way.course.x) else span
    kept = keep_extremes([way.claimed, way.true], limit)
    cost = method_scores(trace.result).ms_per_frame
    name = style.label if cost is None else f"{style.label} ({number(cost, 2)} ms a frame)"
    hover = f"claimed %{{y:.3g}} bounds<extra>{style.label}</extra>"
    figure.add_trace(theme.line(style, x[kept], way.claimed[kept], name=name, hovertemplate=hover, showlegend=True))
    if np.isfinite(way.true).any():
        hover = f"true %{{y:.3g}} bounds<extra>{style.label}</extra>"
        dots = theme.line(style, x[kept], way.true[kept], hovertemplate=hover, showlegend=False)
        dots.update(line={"dash": "dot", "width": 1.2, "color": theme.translucent(style.colour, 0.75)})
        figure.add_trace(dots)


def table(result: Result) -> Table:
    """List every step: claimed and true error in sigmas of the bound."""
    way = _approach(result)
    if way is None:
        return {}
    return {
        way.course.axis: [int(step) for step in way.course.x],
        "claimed_over_bound": theme.plain(way.claimed),
        "true_over_bound": theme.plain(way.true),
    }


METHODS = Figure(
    name="methods",
    title=TITLE,
    guide=(
        "The line is the sigma that the method claims after so many frames, the dots its true error where a simulation knows "
        "it, both over the smallest error that the whole set allows (one) and averaged over the free parameters. A good "
        "method brings its line down to one with the dots about it; dots that stay above their line are a claim too bold."
    ),
    draw=draw,
    table=table,
)
