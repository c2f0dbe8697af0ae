"""How far parameters walk: the drift between passes by maximum likelihood, with its interval.

The parameters of pass k are those of the pass before and a step, p_k = p_{k-1} + w_k, w_k ~ N(0, Q_k), with Q_k = diag(sigma_j^2)
days_k. The first state and the common parameters are free, of which nothing is known before. Integrated over them and over all
steps, the likelihood of the drift is that of the passes' normal equations at one linearisation,

    -2 log L(sigma) = min J + log |H| + sum_k log |Q_k|

where J is chi-square with the cost of the steps and H its matrix of second derivatives (`block_bordered`, whose sweep gives both:
log |H| is that of the factors L_k and of the reduced border). This is the restricted likelihood, which counts what the free
parameters take from the residuals. It is maximised over u = log sigma.

Interval. The ends are where -2 log L has risen by a quantile of chi-square with one degree of freedom (Wilks), the other drifts
following along the curvature at the maximum, u_o = u_o* - H_oo^-1 H_oj (u_j - u_j*). Where it has not risen so far at the least
drift that is looked at, the interval begins at zero: these data do not show that the parameter moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.estimation.batch import NormalEquations
from boresight.estimation.block_bordered import Linked

#: Drifts that are looked at, typical sigmas a square root of a day.
LEAST, MOST = 1e-4, 10.0
#: Smallest step between two passes, typical sigmas: below, it is none.
SMALLEST_STEP = 1e-5
#: Rise of -2 log L at the ends of a 95 % interval.
RISE = 3.841458820694124
#: Step of u for slopes and curvatures.
STEP = 0.02
#: Where the search begins.
STARTS = (0.003, 0.1)


@dataclass(frozen=True)
class Walk:
    """Drift of each parameter, (n_own,) typical sigmas a square root of a day, with the ends of its interval; `low` may be zero."""

    sigma: FloatArray
    low: FloatArray
    high: FloatArray


def link_by_walk(own: IntArray, days: FloatArray, sigma: FloatArray, trend: FloatArray | None = None) -> Linked:
    """Return the link of passes by a walk; `days`: (n_passes - 1,) between them, `sigma`: (n_own,), `trend`: as `Linked`."""
    W = np.zeros((len(days) + 1, len(own)))
    W[1:] = 1.0 / np.maximum(days[:, None] * sigma**2, SMALLEST_STEP**2)
    return Linked(own, W, trend)


def doubt(
    sums: Sequence[NormalEquations],
    z: FloatArray,
    own: IntArray,
    days: FloatArray,
    sigma: FloatArray,
    trend: FloatArray | None = None,
) -> float:
    """-2 log L of a drift (n_own,), but for a constant; `z`: (n_passes, n_free) where the sums were taken."""
    link = link_by_walk(own, days, sigma, trend)
    found = link.solve(sums, z)
    return link.cost(z) - found.decrement + found.log_determinant - float(np.log(link.W[1:]).sum())


def find_walk(
    sums: Sequence[NormalEquations],
    z: FloatArray,
    own: IntArray,
    days: FloatArray,
    rise: float = RISE,
    trend: FloatArray | None = None,
) -> Walk:
    """Estimate the drift between passes.

    Parameters
    ----------
    sums
        A and b of each pass, in typical sigmas.
    z
        (n_passes, n_free) where they were taken.
    own
        (n_own,) places of the parameters that walk among the free ones.
    days
        (n_passes - 1,) between the passes.
    rise
        Of -2 log L at the ends of the interval.
    trend
        (n_passes,) what the slopes of a line are multiplied by, about which the parameters walk; None where there is none.
    """
    from scipy.optimize import minimize  # noqa: PLC0415 - 0.2 s, which calibrations without a walk need not wait for

    def at(u: FloatArray) -> float:
        return doubt(sums, z, own, days, np.exp(u), trend)

    ends = (np.log(LEAST), np.log(MOST))
    tried = [
        minimize(at, np.full(len(own), np.log(start)), method="L-BFGS-B", bounds=[ends] * len(own)) for start in STARTS
    ]
    best = min(tried, key=lambda one: float(one.fun))
    u, least = np.asarray(best.x), float(best.fun)
    curvature = _curvature(at, u)
    low, high = np.empty(len(u)), np.empty(len(u))
    for j in range(len(u)):
        others = np.delete(np.arange(len(u)), j)
        along = np.zeros(len(u))
        along[j] = 1.0
        along[others] = -np.linalg.lstsq(curvature[np.ix_(others, others)], curvature[others, j], rcond=None)[0]
        low[j] = _end(at, u, along, ends[0] - u[j], least + rise, ends)
        high[j] = _end(at, u, along, ends[1] - u[j], least + rise, ends)
    low, high = np.exp(u + low), np.exp(u + high)
    low[low <= LEAST * (1 + STEP)] = 0.0
    return Walk(np.exp(u), low, high)


def _curvature(at: Callable[[FloatArray], float], u: FloatArray) -> FloatArray:
    """Second derivatives (n, n) of -2 log L."""
    steps = STEP * np.eye(len(u))
    middle, beside = at(u), [(at(u + step), at(u - step)) for step in steps]
    H = np.diag([(up - 2 * middle + down) / STEP**2 for up, down in beside])
    for i in range(len(u)):
        for j in range(i):
            both = at(u + steps[i] + steps[j]) + at(u - steps[i] - steps[j])
            mixed = both - sum(beside[i]) - sum(beside[j]) + 2 * middle
            H[i, j] = H[j, i] = mixed / (2 * STEP**2)
    return H


def _end(
    at: Callable[[FloatArray], float],
    u: FloatArray,
    along: FloatArray,
    farthest: float,
    level: float,
    ends: tuple[float, float],
) -> float:
    """Distance along a line at which -2 log L comes to a level, at most the farthest."""
    from scipy.optimize import brentq  # noqa: PLC0415 - as above

    def above(share: float) -> float:
        return at(np.clip(u + share * farthest * along, *ends)) - level

    if abs(farthest) < STEP or above(1.0) <= 0.0:
        return farthest
    return float(brentq(above, 0.0, 1.0, xtol=1e-4)) * farthest
