"""What a method made of a data set, in numbers that can be set beside another's: error, cost, convergence, consistency.

Errors are counted in sigmas of the Cramer-Rao bound of the run's own stars, which no method changes. With n free parameters, bound
sigmas b_p, claimed sigmas s_p and, of a simulated sensor, true errors d_p and their claimed covariance P::

    claimed     (prod s_p / b_p)^(1 / n)                 what the method says of itself
    true        sqrt(mean (d_p / b_p)^2)                 what it is, about one for an efficient method
    NEES / n    d^T P^-1 d / n                           whether the one is honest about the other
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.estimation.consistency import ChiSquare, chi_square, nees
from boresight.figures.chart import Result
from boresight.figures.course import Course, course_of, settled_step
from boresight.verdicts.verdict import part_of


@dataclass(frozen=True)
class MethodScores:
    """One run, summed up; None where a number is not known or has no meaning.

    Parameters
    ----------
    claimed, true_error
        In sigmas of the bound, see above.
    honesty
        NEES / n with its 95 % bounds.
    ms_per_frame
        Processor time of the method alone over the frames, matching left out; measured once.
    settled_frames, settled_iterations
        After how many the parameters stay within three final sigmas of their end.
    condition
        Condition number of the whole set's scaled Jacobian at the end.
    chi2_per_dof, consistent
        Of all arcs at the end, whatever was measured.
    """

    claimed: float | None
    true_error: float | None
    honesty: ChiSquare | None
    ms_per_frame: float | None
    settled_frames: int | None
    settled_iterations: int | None
    condition: float | None
    chi2_per_dof: float | None
    consistent: bool | None


def method_scores(result: Result) -> MethodScores:
    """Sum a calibration JSON up, finished or not."""
    settled, axis = _settled(result), (course_of(result) or _NOTHING).axis
    chi2 = result.get("chi2") or {}
    return MethodScores(
        claimed=_claimed(result),
        true_error=_true_error(result),
        honesty=_honesty(result),
        ms_per_frame=_ms_per_frame(result),
        settled_frames=settled if axis == "frame" else None,
        settled_iterations=settled if axis == "iteration" else None,
        condition=(result.get("observability") or {}).get("condition_number"),
        chi2_per_dof=result.get("chi2_per_dof"),
        consistent=chi2.get("consistent"),
    )


_NOTHING = Course("", np.empty(0), (), (), np.empty((0, 0)), np.empty((0, 0)), {})


def bound_of(result: Result) -> dict[str, float]:
    """Read the bound's sigma of each free parameter, SI; empty where it is not known."""
    bound = (part_of(result, "efficiency") or {}).get("cramer_rao_sigma") or {}
    if not bound or not all(isinstance(sigma, int | float) and sigma > 0 for sigma in bound.values()):
        return {}
    return {name: float(sigma) for name, sigma in bound.items()}


def errors_of(result: Result) -> dict[str, float]:
    """Estimate minus truth of each parameter that both know, SI."""
    truth, estimate = result.get("truth") or {}, result.get("parameters") or {}
    return {
        name: float(estimate[name]) - float(value)
        for name, value in truth.items()
        if value is not None and estimate.get(name) is not None
    }


def _claimed(result: Result) -> float | None:
    """Geometric mean of claimed sigma over bound."""
    ratios = list(((part_of(result, "efficiency") or {}).get("ratio") or {}).values())
    if not ratios or not all(isinstance(ratio, int | float) and ratio > 0 for ratio in ratios):
        return None
    return float(np.exp(np.mean(np.log(ratios))))


def _true_error(result: Result) -> float | None:
    """Root mean square of true error over bound."""
    bound, errors = bound_of(result), errors_of(result)
    if not bound or not set(bound) <= set(errors):
        return None
    return float(np.sqrt(np.mean([(errors[name] / sigma) ** 2 for name, sigma in bound.items()])))


def _honesty(result: Result) -> ChiSquare | None:
    """NEES of the free parameters."""
    covariance, errors = result.get("covariance") or {}, errors_of(result)
    names = covariance.get("names") or []
    P = np.array(covariance.get("matrix") or [], dtype=np.float64)
    if not names or P.shape != (len(names), len(names)) or not set(names) <= set(errors):
        return None
    scale = np.sqrt(np.diag(P))  # parameters differ by ten decades in SI
    if not np.isfinite(P).all() or not (scale > 0).all():
        return None
    total = nees(np.array([errors[name] for name in names]) / scale, P / np.outer(scale, scale))
    return chi_square(total, len(names)) if np.isfinite(total) else None


def _ms_per_frame(result: Result) -> float | None:
    """Processor time of the method over the frames; None for a replay, which takes its frames one by one."""
    seconds, frames = (result.get("timing_s") or {}).get("method"), result.get("frames")
    chosen = (result.get("inputs") or {}).get("settings") or {}
    if seconds is None or not frames or (chosen.get("replay_frames_per_s") or 0) > 0:
        return None
    return 1e3 * float(seconds) / int(frames)


def _settled(result: Result) -> int | None:
    """Frames or iterations after which every free parameter stays near its end; None while the run is on its way."""
    course, first = course_of(result), settled_step(result)
    if course is None or first is None:
        return None
    if course.axis == "iteration":
        return int(course.x[first])
    frames = int(result.get("frames") or len(course.x))  # a long history keeps updates spaced evenly
    return 1 + round(first * (frames - 1) / max(len(course.x) - 1, 1))
