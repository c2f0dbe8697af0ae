"""How far parameters walk: the drift between passes by maximum likelihood, with its interval.

The parameters of pass k are those of the pass before and a step, p_k = p_{k-1} + w_k, w_k ~ N(0, Q_k), with Q_k = diag(sigma_j^2)
days_k. The first state and the common parameters are free, of which nothing is known before. Integrated over them and over all
steps, the likelihood of the drift is that of the passes' normal equations at one linearisation,

    -2 log L(sigma) = min J + log |H| + sum_k log |Q_k|

where J is chi-square with the cost of the steps and H its matrix of second derivatives (`block_bordered`). This is the restricted
likelihood, which counts what the free parameters take from the residuals. It is maximised over u = log sigma.

It is looked at some hundred times, so it has a loop of its own (`kernels.passes`), an information filter about zero. With
h_k = A_k z_k* - b_k, and A_f, R_f what all passes up to k know of p_k and of its product with the border and h,

    M = A_f + W_k+1        A_f <- A_k+1 + W_k+1 M^-1 A_f        R_f <- R_k+1 + W_k+1 M^-1 R_f

where W M^-1 A_f = (A_f^-1 + Q)^-1 without the difference of two large numbers. What is left of the border is
C - sum R_f^T M^-1 R_f, and log |H| that of each M and of it.

Steps. A parameter that steps between two passes does not walk there: W = 0, and Q is left out. How much a step of one parameter in
any gap would take from chi-square beside the walk follows from what the passes before it know, A_f and R_f, and those after it, A_b
and R_b. With Y = A_f (A_f + A_b)^-1 A_b, the information of both on their difference, the step's is V = W (W + Y)^-1 Y, its product
with border and h is

    W (W + Y)^-1 (A_f (A_f + A_b)^-1 R_b - A_b (A_f + A_b)^-1 R_f)

and the border is reduced as ever (de Jong and Penzer 1998, who look at the same numbers one gap at a time).

Interval. The ends are where -2 log L has risen by a quantile of chi-square with one degree of freedom (Wilks), the other drifts
following along the curvature at the maximum, u_o = u_o* - H_oo^-1 H_oj (u_j - u_j*). Where it has not risen so far at the least
drift that is looked at, the interval begins at zero: these data do not show that the parameter moves.

Caution. Where the passes hardly show a drift the likelihood is often greatest at none, and a fit that takes it at its word is too
sure of the last pass: its NEES was 10.7 of 8 in missions of 300 passes whose drift it had to find, and 8.2 where it was told. So
states are fitted with the drift that maximises L prod sigma_j (Chung et al. 2013: the mode under a prior that vanishes at zero and
nowhere else matters), which is about a standard error higher where nothing is shown, and hardly another where much is. What is told
of the drift is the likeliest, with its interval.

References
----------
Chung, Rabe-Hesketh, Dorie, Gelman and Liu, "A nondegenerate penalized likelihood estimator for variance parameters in multilevel
models", Psychometrika 78, 2013.
De Jong and Penzer, "Diagnosing shocks in time series", JASA 93, 1998.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from boresight import kernels
from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.estimation.batch import NormalEquations
from boresight.estimation.block_bordered import Linked, Regressed

#: Drifts that are looked at, typical sigmas a square root of a day.
LEAST, MOST = 1e-4, 10.0
#: Smallest step between two passes, typical sigmas: below, it is none.
SMALLEST_STEP = 1e-5
#: Rise of -2 log L at the ends of a 95 % interval.
RISE = 3.841458820694124
#: Step of u for slopes and curvatures.
STEP = 0.02
#: Step of u for the slopes of the search.
SLOPE_STEP = 1e-5
#: Power of the drift by which states are fitted with caution, and the fewest steps between passes that bear it.
CAUTION, FEWEST_STEPS = 1.0, 5
#: Where the search begins.
STARTS = (0.003, 0.1)


@dataclass(frozen=True)
class Walk:
    """Drift of each parameter, (n_own,) typical sigmas a square root of a day, with the ends of its interval; `low` may be zero."""

    sigma: FloatArray
    low: FloatArray
    high: FloatArray


def link_by_walk(
    own: IntArray, days: FloatArray, sigma: FloatArray, trend: Regressed | None = None, stepped: BoolArray | None = None
) -> Linked:
    """Return the link of passes by a walk.

    `days`: (n_passes - 1,) between them. `sigma`: (n_own,). `trend`: as `Linked`. `stepped`: (n_passes - 1, n_own) where they step.
    """
    W = np.zeros((len(days) + 1, len(own)))
    W[1:] = 1.0 / np.maximum(days[:, None] * sigma**2, SMALLEST_STEP**2)
    if stepped is not None:
        W[1:][stepped] = 0.0
    return Linked(own, W, trend)


class WalkedPasses:
    """Passes at one linearisation whose own parameters walk, made ready for the loop.

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
    trend
        What the parameters walk about; None where it is nothing.
    stepped
        (n_passes - 1, n_own) which of them step in each gap; None where none does.
    """

    def __init__(
        self,
        sums: Sequence[NormalEquations],
        z: FloatArray,
        own: IntArray,
        days: FloatArray,
        trend: Regressed | None = None,
        stepped: BoolArray | None = None,
    ) -> None:
        self.own, self.days, self.trend, self.stepped = own, days, trend, stepped
        A, b = np.array([one.A for one in sums]), np.array([one.b for one in sums])
        self._about_zero = float(np.einsum("ki,kij,kj->", z, A, z) - 2.0 * np.einsum("ki,ki->", b, z))
        h = (A @ z[:, :, None])[:, :, 0] - b
        G, _ = self._link(np.ones(len(own))).border(A.shape[1])
        columns = np.concatenate([A @ G, h[:, :, None]], axis=2)
        self._A = np.ascontiguousarray(A[:, own][:, :, own])
        self._right = np.ascontiguousarray(columns[:, own])
        n = G.shape[2]
        self._border = np.zeros((n + 1, n + 1))
        self._border[:n] = np.einsum("kij,kil->jl", G, columns)
        self._border[n, :n] = self._border[:n, n]

    def without_step(self, gap: int, place: int) -> WalkedPasses:
        """The same where one parameter walks over a gap as over others."""
        other = copy(self)
        if self.stepped is not None:
            other.stepped = self.stepped.copy()
            other.stepped[gap, place] = False
        return other

    def _link(self, sigma: FloatArray) -> Linked:
        return link_by_walk(self.own, self.days, sigma, self.trend, self.stepped)

    def _filtered(self, W: FloatArray, *, backward: bool = False) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """What all passes up to each, or from each on, know of its own parameters, and what is left of the border."""
        A, right = (self._A[::-1].copy(), self._right[::-1].copy()) if backward else (self._A, self._right)
        W = np.concatenate([W[:1], W[:0:-1]]) if backward else W
        known, known_right, border = np.empty_like(A), np.empty_like(right), self._border.copy()
        log_determinant = kernels.filter_passes(A, right, np.ascontiguousarray(W), known, known_right, border)
        return (known[::-1], known_right[::-1], border, log_determinant) if backward else (
            known, known_right, border, log_determinant
        )  # fmt: skip

    def doubt(self, sigma: FloatArray) -> float:
        """-2 log L of a drift (n_own,), but for a constant; infinite where it leaves a direction open."""
        W = self._link(sigma).W
        *_, border, log_determinant = self._filtered(W)
        inner, h = border[:-1, :-1], border[:-1, -1]
        sign, of_border = np.linalg.slogdet(inner)
        if not (np.isfinite(log_determinant) and sign > 0.0):
            return np.inf
        least = float(border[-1, -1]) - (float(h @ np.linalg.solve(inner, h)) if len(h) else 0.0)
        walks = W[1:][W[1:] > 0.0]
        return least + self._about_zero + log_determinant + float(of_border) - float(np.log(walks).sum())

    def deviance(self, sigma: FloatArray) -> float:
        """-2 log of the likelihood at the best first state and border, so that models with other borders may be compared.

        Only the steps of the walk are integrated over: the filter goes back, so that the first state comes last, and log |H| is
        taken without it and the border. With no walk at all it is the least chi-square, about zero.
        """
        W = self._link(sigma).W
        known, _, border, log_determinant = self._filtered(W, backward=True)
        inner, h = border[:-1, :-1], border[:-1, -1]
        least = float(border[-1, -1]) - (float(h @ np.linalg.solve(inner, h)) if len(h) else 0.0)
        walks = W[1:][W[1:] > 0.0]
        return least + log_determinant - float(np.linalg.slogdet(known[0])[1]) - float(np.log(walks).sum())

    def step_falls(self, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What a step of each parameter in each gap would take from chi-square, and its size, (n_passes - 1, n_own)."""
        W = self._link(sigma).W
        (before, before_right, border, _), (after, after_right, *_) = (
            self._filtered(W, backward=backward) for backward in (False, True)
        )
        A_f, R_f, A_b, R_b = before[:-1], before_right[:-1], after[1:], after_right[1:]
        to_before = np.linalg.solve(A_f + A_b, A_b)
        Y = A_f @ to_before
        apart = (np.eye(len(self.own)) - to_before).transpose(0, 2, 1) @ R_b - to_before.transpose(0, 2, 1) @ R_f
        part = W[1:, :, None] * np.linalg.inv(np.eye(len(self.own)) * W[1:, None, :] + Y)
        V, with_border = part @ Y, part @ apart
        a, u = with_border[:, :, :-1], with_border[:, :, -1]
        inverse = np.linalg.inv(border[:-1, :-1])
        u = u - a @ (inverse @ border[:-1, -1])
        own = np.einsum("kii->ki", V)
        left = own - np.einsum("kic,cd,kid->ki", a, inverse, a)
        open_ = left > 1e-9 * np.maximum(own, 1e-300)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(open_, u**2 / left, 0.0), np.where(open_, u / left, 0.0)


def most_likely(of: WalkedPasses, starts: Sequence[FloatArray], caution: float = 0.0) -> FloatArray:
    """Return the most likely drift (n_own,), the best of what the search finds from each start (n_own,).

    `caution`: power of the drift that the likelihood is multiplied by; `CAUTION` for the one that states are fitted with.
    """
    from scipy.optimize import minimize  # noqa: PLC0415 - 0.2 s, which calibrations without a walk need not wait for

    bounds = [(np.log(LEAST), np.log(MOST))] * len(of.own)
    tried = [
        minimize(
            lambda u: of.doubt(np.exp(u)) - 2.0 * caution * u.sum(),
            np.log(start),
            method="L-BFGS-B",
            bounds=bounds,
            options={"eps": SLOPE_STEP},
        )
        for start in starts
    ]
    best = min(tried, key=lambda one: float(one.fun))
    if not np.isfinite(best.fun):
        raise np.linalg.LinAlgError("Expected passes that determine their parameters, received an open direction")
    return np.asarray(np.exp(best.x))


def find_walk(of: WalkedPasses, rise: float = RISE, begin: FloatArray | None = None) -> Walk:
    """Estimate the drift between passes.

    `rise`: of -2 log L at the ends of the interval. `begin`: (n_own,) where the search starts, where that is known.
    """
    m, ends = len(of.own), (np.log(LEAST), np.log(MOST))

    def at(u: FloatArray) -> float:
        return of.doubt(np.exp(u))

    u = np.log(most_likely(of, [np.full(m, start) for start in STARTS] if begin is None else [begin]))
    least = at(u)
    curvature = _curvature(at, u)
    low, high = np.empty(m), np.empty(m)
    for j in range(m):
        others = np.delete(np.arange(m), j)
        along = np.zeros(m)
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
