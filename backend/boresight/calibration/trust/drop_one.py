"""Whether each free parameter is needed: one is held at its start, the others are fitted again, and the cost shows.

Near the optimum z_0 of all parameters the chi-square is quadratic with Hessian A, so holding parameter p a distance d from its
optimum costs d^2 / (A^-1)_pp and moves the others by (A^-1)_:p d / (A^-1)_pp. Starts lie a thousand sigmas off and the camera
is not linear over that far, so this step is only where a true fit begins. By Wilks' theorem the increase is chi-square with one
degree of freedom when the start is the truth; beyond its 99 % point, 6.63, the data ask for the parameter.

Beyond `MOST_FRAMES` the true fits run on frames spaced evenly over the set. The increase over all frames is then the quadratic
one over all, times the ratio of true to quadratic on those frames, which is one for a start that is near. A fit that does not
come to rest in `MOST_ITERATIONS` is not `settled`: the increase is then at most what is told.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri

from boresight.arrays import FloatArray
from boresight.calibration.estimate import covariance
from boresight.calibration.trust.fitted_set import FittedSet, Unavailable
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet

MOST_FRAMES = 200
MOST_ITERATIONS = 30
NEEDED = float(chdtri(1, 0.01))


@dataclass(frozen=True)
class Optimum:
    """The fit of all free parameters: state (n_parameters,), covariance (n_free, n_free) in typical sigmas, and its cost."""

    x: FloatArray
    P: FloatArray
    cost: float


def drop_one(ground: FittedSet) -> list[dict[str, Any]]:
    """One entry a free parameter, in parameter order."""
    if len(ground.names) < 2:
        raise Unavailable("Only one parameter is free, so there is no other to fit without it.")
    if not ground.determined:
        raise Unavailable("The data leave a direction of the parameters open already: hold some fixed and run again.")
    arcs = ground.thinned(MOST_FRAMES)
    fitted = batch.fit(
        arcs, ground.x, ground.parameters.free, ground.parameters.scale,
        threshold=ground.threshold, max_iterations=MOST_ITERATIONS,
    )  # fmt: skip
    if fitted.status != "converged":
        raise Unavailable(
            "The fit of all parameters does not come to rest, so none can be compared with it: free fewer."
        )
    best = Optimum(fitted.x, covariance(fitted.A), _cost(ground, arcs, fitted.x))
    whole = best if arcs.n_frames == ground.arcs.n_frames else Optimum(ground.x, covariance(ground.A), np.nan)
    return [_without(ground, arcs, place, best, whole) for place in range(len(ground.names))]


def _cost(fitted: FittedSet, arcs: ArcSet, x: FloatArray) -> float:
    """What the fit minimises, at a state: chi-square, or Huber's loss."""
    free, scale = fitted.parameters.free, fitted.parameters.scale
    return batch.normal_equations(arcs, x, free, scale, fitted.threshold).chi2


def quadratic_increase(fitted: FittedSet, place: int, best: Optimum) -> tuple[float, FloatArray]:
    """Increase of chi-square and step (n_free,) in typical sigmas that the quadratic model foresees."""
    p = fitted.parameters.free[place]
    d = (fitted.problem.sensor.initial[p] - best.x[p]) / fitted.parameters.scale[place]
    return float(d * d / best.P[place, place]), best.P[:, place] * d / best.P[place, place]


def _without(ground: FittedSet, arcs: ArcSet, place: int, best: Optimum, whole: Optimum) -> dict[str, Any]:
    """Hold one parameter at its start and fit the others."""
    free, scale = ground.parameters.free, ground.parameters.scale
    others = np.delete(np.arange(len(free)), place)
    foreseen, step = quadratic_increase(ground, place, best)
    x = best.x.copy()
    x[free] += scale * step
    fitted = batch.fit(
        arcs, _start(arcs, x, best, ground, place), free[others], scale[others],
        threshold=ground.threshold, max_iterations=MOST_ITERATIONS,
    )  # fmt: skip
    increase = max(_cost(ground, arcs, fitted.x) - best.cost, 0.0)
    if whole is not best:
        foreseen_of_all = quadratic_increase(ground, place, whole)[0]
        increase = foreseen_of_all * (increase / foreseen if foreseen > NEEDED else 1.0)
    moved = np.abs((fitted.x - best.x)[free[others]]) / (scale[others] * np.sqrt(np.diag(best.P)[others]))
    most = int(np.argmax(moved))
    return {
        "name": ground.names[place],
        "chi2_increase": increase,
        "rms_arc_rad": float(np.sqrt(fitted.sum_of_squares / arcs.n_arcs)),
        "shift_in_sigma_of_others": float(moved[most]),
        "most_shifted": ground.names[others[most]],
        "needed": increase > NEEDED,
        "frames_used": arcs.n_frames,
        "settled": fitted.status == "converged",
    }


def _start(arcs: ArcSet, foreseen: FloatArray, best: Optimum, fitted: FittedSet, place: int) -> FloatArray:
    """The state foreseen, or the optimum with only this parameter held where that is nearer."""
    p = fitted.parameters.free[place]
    held = best.x.copy()
    held[p] = foreseen[p] = fitted.problem.sensor.initial[p]
    return foreseen if _cost(fitted, arcs, foreseen) <= _cost(fitted, arcs, held) else held


def drop_one_sentence(fitted: FittedSet, entries: list[dict[str, Any]]) -> str:
    """Which parameters the data ask for."""
    symbols = dict(zip(fitted.names, fitted.symbols, strict=True))
    spare = [symbols[entry["name"]] for entry in entries if not entry["needed"]]
    weakest = min(entries, key=lambda entry: float(entry["chi2_increase"]))
    least = f"{symbols[weakest['name']]} costs least to hold, {weakest['chi2_increase']:.3g} in chi-square"
    if not spare:
        return f"The data ask for every free parameter: {least}, and beyond {NEEDED:.3g} a parameter is needed (1 % level)."
    return (
        f"These data do not ask for {', '.join(spare)}: held at the start, chi-square grows by less than {NEEDED:.3g} (1 % "
        f"level); {least}. It may be held fixed, one parameter at a time."
    )
