"""How fast a method's error comes down to what the stars allow, and at what price: methods beside each other on one set.

Drawn over frames is the claimed sigma after so many frames over the Cramer-Rao sigma of the whole set, the geometric mean over
the free parameters; for a simulated sensor the root mean square of the true error in the same unit, dotted. One is the end of the
way: an efficient and honest method has its line arrive there and its dots about it (W Figure 6 draws arcs instead, whose noise
hides all but the start). A batch beside filters is a level. The legend has the time of the fit a frame.

What a method made of a data set, in numbers that can be set beside another's: error, cost, convergence, consistency.

Errors are counted in sigmas of the Cramer-Rao bound of the run's own stars, which no method changes. With n free parameters, bound
sigmas b_p, claimed sigmas s_p and, of a simulated sensor, true errors d_p and their claimed covariance P::

    claimed     (prod s_p / b_p)^(1 / n)                 what the method says of itself
    true        sqrt(mean (d_p / b_p)^2)                 what it is, about one for an efficient method
    NEES / n    d^T P^-1 d / n                           whether the one is honest about the other
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import Calibration, Values
from boresight.estimation.statistics.consistency import ChiSquare, chi_square, nees
from boresight.figures.chart import Table, Trace
from boresight.figures.factory import Part, make_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import axis_title, counted, share_cursor
from boresight.figures.style.thinning import keep_extremes
from boresight.verdicts.history import History, read_history, settled_step
from boresight.verdicts.numbers import number
from boresight.verdicts.verdict import why_absent


@dataclass(frozen=True)
class MethodScores:
    """One run, summed up; None where a number is not known or has no meaning."""

    claimed: float | None
    true_error: float | None
    honesty: ChiSquare | None
    ms_per_frame: float | None
    settled_frames: int | None
    settled_iterations: int | None
    condition: float | None
    chi2_per_dof: float | None
    consistent: bool | None


def method_scores(result: Calibration) -> MethodScores:
    """Sum a calibration up, finished or not."""
    settled, history = _settled(result), read_history(result)
    axis = history.axis if history else ""
    return MethodScores(
        claimed=_claimed(result),
        true_error=_true_error(result),
        honesty=_honesty(result),
        ms_per_frame=_ms_per_frame(result),
        settled_frames=settled if axis == "frame" else None,
        settled_iterations=settled if axis == "iteration" else None,
        condition=result.observability.condition_number if result.observability else None,
        chi2_per_dof=result.chi2_per_dof,
        consistent=result.chi2.consistent if result.chi2 else None,
    )


def read_bound(result: Calibration) -> dict[str, float]:
    """Read the bound's sigma of each free parameter, SI; empty where it is not known."""
    efficiency = result.trust.efficiency if result.trust else None
    return _all_positive(efficiency.cramer_rao_sigma) if efficiency else {}


def _all_positive(values: Values[float | None]) -> dict[str, float]:
    """Return the values, none where one of them is unknown or not above zero."""
    known = {name: value for name, value in values.items() if value is not None and value > 0}
    return known if len(known) == len(values) else {}


def compute_errors(result: Calibration) -> dict[str, float]:
    """Estimate minus truth of each parameter that both know, SI."""
    estimates = {name: value for name, value in result.parameters.items() if value is not None}
    return {
        name: estimates[name] - value
        for name, value in (result.truth or {}).items()
        if value is not None and name in estimates
    }


def _claimed(result: Calibration) -> float | None:
    """Geometric mean of claimed sigma over bound."""
    efficiency = result.trust.efficiency if result.trust else None
    ratios = list(_all_positive(efficiency.ratio).values()) if efficiency else []
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else None


def _true_error(result: Calibration) -> float | None:
    """Root mean square of true error over bound."""
    bound, errors = read_bound(result), compute_errors(result)
    if not bound or not set(bound) <= set(errors):
        return None
    return float(np.sqrt(np.mean([(errors[name] / sigma) ** 2 for name, sigma in bound.items()])))


def _honesty(result: Calibration) -> ChiSquare | None:
    """NEES of the free parameters."""
    errors, names = compute_errors(result), result.covariance.names
    P = np.array(result.covariance.matrix, dtype=np.float64)
    if not names or P.shape != (len(names), len(names)) or not set(names) <= set(errors):
        return None
    scale = np.sqrt(np.diag(P))  # parameters differ by ten decades in SI
    if not np.isfinite(P).all() or not (scale > 0).all():
        return None
    total = nees(np.array([errors[name] for name in names]) / scale, P / np.outer(scale, scale))
    return chi_square(total, len(names)) if np.isfinite(total) else None


def _ms_per_frame(result: Calibration) -> float | None:
    """Processor time of the method over the frames; None for a replay, which takes its frames one by one."""
    seconds, frames = result.timing_s.get("method"), result.frames
    if seconds is None or not frames or result.inputs.settings.replay_frames_per_s > 0:
        return None
    return 1e3 * seconds / frames


def _settled(result: Calibration) -> int | None:
    """Frames or iterations after which every free parameter stays near its end; None while the run is on its way."""
    history, first = read_history(result), settled_step(result)
    if history is None or first is None:
        return None
    if history.axis == "iteration":
        return int(history.x[first])
    frames = result.frames or len(history.x)  # a long history keeps updates spaced evenly
    return 1 + round(first * (frames - 1) / max(len(history.x) - 1, 1))


POINT_BUDGET = 8000  # of all runs together


@dataclass(frozen=True)
class _Convergence:
    """A run's way to the bound: claimed and true error (n_steps,) in its sigmas, NaN where not known."""

    history: History
    claimed: FloatArray
    true: FloatArray


def draw(drawn: Sequence[Part[_Convergence]]) -> go.Figure:
    """Draw every run's claimed and true error over frames, or over iterations when every run is a batch."""
    axis = "frame" if any(way.history.axis == "frame" for _, _, way in drawn) else "iteration"
    x = np.concatenate([way.history.x for _, _, way in drawn if way.history.axis == axis])
    span = np.array([x.min(), x.max()])
    figure = go.Figure()
    limit = POINT_BUDGET // (2 * len(drawn))
    for trace, style, way in drawn:
        _draw_run(figure, trace, style, way if way.history.axis == axis else _level(way), span, limit)
    known = any(np.isfinite(way.true).any() for _, _, way in drawn)
    title = "Error over the Cramér-Rao bound: claimed" + (", and true (dotted)" if known else "")
    theme.dress(figure, title=title, height_px=460, hovermode="closest")
    figure.add_hline(y=1, line={"color": theme.REFERENCE_COLOUR, "dash": "dot", "width": 1.4})
    along = [trace for trace, _, _ in drawn]
    figure.update_xaxes(title_text=axis_title(axis, along))
    figure.update_yaxes(title_text="error / bound", type="log", exponentformat="power")
    return share_cursor(figure, counted(axis, along))


def _approach(result: Calibration) -> _Convergence | None:
    """Read how a run came to the bound, or None where the bound or the way is not known."""
    bound, history = read_bound(result), read_history(result)
    if not bound or history is None or not set(bound) <= set(history.names):
        return None
    places = [history.names.index(name) for name in bound]
    b = np.array(list(bound.values()))
    truth: Values[float] = result.truth or Values()
    true = np.array([truth.get(name) for name in bound], dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        claimed = np.exp(np.mean(np.log(history.sigma[:, places] / b), axis=1))
        error = np.sqrt(np.mean(((history.value[:, places] - true) / b) ** 2, axis=1))
    return _Convergence(history, np.asarray(claimed), np.asarray(error))


def _level(way: _Convergence) -> _Convergence:
    """Keep the end of a batch, to be drawn over the frames of the filters beside it."""
    return _Convergence(way.history, way.claimed[[-1, -1]], way.true[[-1, -1]])


def _draw_run(
    figure: go.Figure, trace: Trace, style: theme.RunStyle, way: _Convergence, span: FloatArray, limit: int
) -> None:
    x = way.history.x if len(way.claimed) == len(way.history.x) else span
    kept = keep_extremes([way.claimed, way.true], limit)
    cost = method_scores(trace.result).ms_per_frame
    name = style.label if cost is None else f"{style.label} ({number(cost, 2)} ms per frame)"
    hover = f"claimed %{{y:.3g}} bounds<extra>{style.label}</extra>"
    options = {"meta": theme.tag_run(style.label, "claimed"), "hovertemplate": hover}
    figure.add_trace(theme.line(style, x[kept], way.claimed[kept], name=name, showlegend=True, **options))
    if np.isfinite(way.true).any():
        hover = f"true %{{y:.3g}} bounds<extra>{style.label}</extra>"
        options = {"meta": theme.tag_run(style.label, "true"), "hovertemplate": hover}
        dots = theme.line(style, x[kept], way.true[kept], showlegend=False, **options)
        dots.update(line={"dash": "dot", "width": 1.2, "color": theme.translucent(style.colour, 0.75)})
        figure.add_trace(dots)


def table(way: _Convergence) -> Table:
    """List every step: claimed and true error in sigmas of the bound."""
    return {
        way.history.axis: [int(step) for step in way.history.x],
        "claimed_over_bound": list_known(way.claimed),
        "true_over_bound": list_known(way.true),
    }


METHODS = make_figure(
    draw,
    table,
    _approach,
    lambda result: why_absent(result, "efficiency"),
    name="methods",
    title="Error against the bound",
    guide=(
        "The line is the sigma that the method claims after each number of frames, the dots its true error where a "
        "simulation knows it, both relative to the smallest error that the whole set allows (1) and averaged over the free "
        "parameters. With a good method the line falls to 1 with the dots around it; dots that stay above their line mean "
        "that the method is over-confident."
    ),
    wide=True,
    advanced=True,
)
