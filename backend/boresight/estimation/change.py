"""Which change the passes show: the degree of a polynomial, and a step at a date that nobody knows.

Every model here is linear: pass k sees z_k = B_k (z, s), and a column of B_k beyond the identity is what one parameter is
multiplied by there, a power of the temperature or 1 from a date on (`block_bordered.Regressed`). With A_k and b_k of each pass at
z_k* and r_k = A_k z_k* - b_k, a model's chi-square is, but for a constant that all models share,

    chi2 = -r^T H^-1 r          H = sum_k B_k^T A_k B_k          r = sum_k B_k^T r_k

and one more column v is worth the fall u^2 / V, u = v^T r - a^T H^-1 r, V = v^T A v - a^T H^-1 a, a = B^T A v. Where it is not
needed u / sqrt(V) is a standard normal number times the noise's s. As in `calibration.choice.nested_tests`, s^2 is what the
richest model leaves, and a p-value is multiplied by the number of tests of its kind, so that LEVEL bounds the chance of one false
term in all.

Degree. From the richest polynomials on, the highest power of one parameter is dropped, the least likely first, while its p-value,
multiplied by all powers looked at, is above the level. A power has its lower ones with it, so that the zero of temperature is no
matter.

Steps. For each parameter the date with the largest fall is sought over all gaps between passes (generalised likelihood ratio).
That the largest of many correlated falls is so large by chance has at most the probability (Hunter 1976, Worsley 1979)

    p <= sum_c P(|u_c| > x) - sum_c P(|u_c| > x, |u_c+1| > x)          x^2 the fall over s^2

of which the second sum, over neighbouring gaps, is what Bonferroni's bound forgets: they see nearly the same data. The date's
interval holds every gap whose fall is within s^2 RISE of the largest. A date is no regular parameter, and Wilks' 3.84 would be too
short: with steps that are small against the noise of a pass the rise at the true date is the maximum of two Brownian motions with
drift, whose law is (1 - exp(-x / 2))^2 (Hansen 2000), and RISE is its 95 % point. For larger steps it is on the safe side.

References ---------- Hunter, "An upper bound for the probability of a union", J. Appl. Prob. 13, 1976. Worsley, "On the likelihood
ratio test for a shift in location of normal populations", JASA 74, 1979. Hansen, "Sample splitting and threshold estimation",
Econometrica 68, 2000.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.estimation.batch import NormalEquations
from boresight.estimation.statistics.special import chdtrc, ndtr

#: Level of every decision, over all tests of its kind.
LEVEL = 0.01
#: Rise of chi-square, over the noise's variance, within which dates are in a 95 % interval.
RISE = -2.0 * np.log(1.0 - np.sqrt(0.95))


@dataclass(frozen=True)
class Equations:
    """The passes' normal equations about zero: A (n_passes, n, n) and r (n_passes, n)."""

    A: FloatArray
    r: FloatArray

    @classmethod
    def of(cls, sums: Sequence[NormalEquations], z: FloatArray) -> Equations:
        """Move those of each pass from its state, z (n_passes, n), to zero."""
        A = np.array([one.A for one in sums])
        return cls(A, np.einsum("kij,kj->ki", A, z) - np.array([one.b for one in sums]))


def drop_powers(
    s: FloatArray, covariance: FloatArray, of: IntArray, power: IntArray, variance: float, level: float = LEVEL
) -> BoolArray:
    """Say which columns of polynomials are needed, (n_columns,).

    Parameters
    ----------
    s, covariance
        (n_columns,) coefficients of the richest model and their covariance (n_columns, n_columns).
    of, power
        (n_columns,) the parameter of each column, and its power.
    variance
        Of the noise over the stated one.
    level
        Chance of one false power in all.
    """
    kept = np.ones(len(s), bool)
    while kept.any():
        highest = [j for j in np.flatnonzero(kept) if power[j] == power[kept & (of == of[j])].max()]
        # of a smaller model: what was dropped is held at zero
        gone, left = np.flatnonzero(~kept), np.flatnonzero(kept)
        K = (
            covariance[np.ix_(left, gone)] @ np.linalg.inv(covariance[np.ix_(gone, gone)])
            if len(gone)
            else np.zeros((len(left), 0))
        )
        held = s[left] - K @ s[gone]
        spread = np.diag(covariance[np.ix_(left, left)] - K @ covariance[np.ix_(gone, left)])
        falls = {j: held[i] ** 2 / spread[i] / variance for i, j in enumerate(left) if j in highest}
        weakest = min(falls, key=lambda j: falls[j])
        if len(s) * float(chdtrc(1, falls[weakest])) < level:
            break
        kept[weakest] = False
    return kept


@dataclass(frozen=True)
class Falls:
    """What a step of one parameter in each gap between passes is worth.

    `fall`, `step`: (n_passes - 1,), of chi-square, and in typical sigmas. `agree`: (n_passes - 2,) correlation of neighbours.
    """

    fall: FloatArray
    step: FloatArray
    agree: FloatArray

    def p_value(self, variance: float) -> float:
        """Bound the chance that the largest of them is so large where nothing stepped."""
        x = float(np.sqrt(self.fall.max() / variance))
        known = self.fall > 0.0
        both = sum(_both_beyond(x, float(rho)) for rho in self.agree)
        return float(np.clip(2.0 * float(ndtr(-x)) * known.sum() - both, 2.0 * float(ndtr(-x)), 1.0))

    def interval(self, variance: float) -> tuple[int, int]:
        """First and last gap that the date may be in, 95 %."""
        near = np.flatnonzero(self.fall.max() - self.fall <= RISE * variance)
        return int(near[0]), int(near[-1])


def step_falls(equations: Equations, B: FloatArray, place: int) -> Falls:
    """Look at a step of the parameter at a place in every gap, beside the model B (n_passes, n, n_columns)."""
    A, r = equations.A, equations.r
    inverse = np.linalg.inv(np.einsum("kij,kil,klm->jm", B, A, B))
    rest = inverse @ np.einsum("kij,ki->j", B, r)

    def later(values: FloatArray) -> FloatArray:  # sums over the passes after each gap
        return np.asarray(np.cumsum(values[::-1], axis=0)[::-1][1:])

    a = later(np.einsum("kij,ki->kj", B, A[:, :, place]))
    own = later(A[:, place, place])
    u = later(r[:, place]) - a @ rest
    V = own - np.einsum("ci,ij,cj->c", a, inverse, a)
    open_ = 1e-9 * np.maximum(own, 1e-300) < V  # another step or column is there already
    cross = own[1:] - np.einsum("ci,ij,cj->c", a[:-1], inverse, a[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        agree = np.where(open_[:-1] & open_[1:], cross / np.sqrt(V[:-1] * V[1:]), 0.0)
        return Falls(np.where(open_, u**2 / V, 0.0), np.where(open_, u / V, 0.0), np.clip(agree, -1.0, 1.0))


#: Nodes of the integral over the tail of a normal density, and how far it goes.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(96)
_REACH = 9.0


def _both_beyond(x: float, rho: float) -> float:
    """P(|X| > x, |Y| > x) of standard normal X and Y with correlation rho."""
    t = x + _REACH * (_NODES + 1) / 2
    density = np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi)
    width = np.sqrt(max(1.0 - rho**2, 1e-12))
    beside = np.array([float(ndtr((rho * one - x) / width)) + float(ndtr((-rho * one - x) / width)) for one in t])
    return float(2.0 * np.sum(_WEIGHTS * density * beside) * _REACH / 2)
