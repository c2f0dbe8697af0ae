"""How surely two estimates differ, when part of their data is the same.

Estimates x_a and x_b of one state from the data A and B, with covariances P_a and P_b and cross-covariance C:

    D = cov(x_a - x_b) = P_a + P_b - C - C^T.

Let both be efficient, so that near the truth x_a = x + P_a s_A with s_A the score of its data, a sum over its independent
exposures with covariance P_a^-1. Scores of different exposures are independent, and the shared ones have the information I_S:

    C = P_a cov(s_A, s_B) P_b = P_a I_S P_b.

- Disjoint data: I_S = 0, so D = P_a + P_b.
- A within B: I_S = P_a^-1, so C = P_b and D = P_a - P_b. It holds also where x_a is unbiased but not efficient, for no
  combination of x_a and x_b may beat x_b (Hausman 1978, Econometrica 46, 1251): the same data by a worse estimator, or by one
  with more free parameters, differ from the better by P_a - P_b.
- The same data by two estimators that are as good: D = 0. What is left between them is not noise but how they got there
  (linearisation, stopping), and no sigma measures it.
- Partly shared: only the shares s_a, s_b of exposures that A and B have in common are known. With every exposure as good as
  any, I_S = s_a P_a^-1 = s_b P_b^-1; between the two, C = (s_a P_b + s_b P_a) / 2, so

      D = (1 - s_b) P_a + (1 - s_a) P_b,

  which is the sum for disjoint data, nothing for equal data, and for nested data of n_a among n_b exposures
  (1 - n_a / n_b) P_a = P_a - P_b again. It is never negative.

D of nested data is a difference of two estimated matrices: its eigenvalues below zero, in units of P_a's sigmas, are put to zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from boresight.arrays import FloatArray

#: Below this share of the larger variance a difference of variances is rounding and linearisation, not noise.
LEAST_SHARE = 0.01
#: Directions whose variance is below this share of the largest, each in its own sigmas, say nothing together.
LEAST_EIGENVALUE = 1e-6


@dataclass(frozen=True)
class SharedData:
    """What two runs' data have in common: the share of each one's exposures that the other has too."""

    share_a: float
    share_b: float

    @property
    def kind(self) -> str:
        """`same`, `inside` (A within B), `around` (B within A), `partly` or `disjoint`."""
        if self.share_a == 0 or self.share_b == 0:
            return "disjoint"
        whole = (self.share_a == 1, self.share_b == 1)
        return {(True, True): "same", (True, False): "inside", (False, True): "around"}.get(whole, "partly")


def covariance_of_difference(P_a: FloatArray, P_b: FloatArray, shared: SharedData) -> FloatArray:
    """Covariance of x_a - x_b.

    Parameters
    ----------
    P_a, P_b
        (n_parameters, n_parameters) covariances, SI; zero rows for what was not estimated.
    shared
        What their data have in common.

    Returns
    -------
    (n_parameters, n_parameters), without negative eigenvalues.
    """
    kind = shared.kind
    if kind == "disjoint":
        return P_a + P_b
    if kind == "partly":
        return np.asarray((1 - shared.share_b) * P_a + (1 - shared.share_a) * P_b)
    scale = np.sqrt(np.maximum(np.diag(P_a), np.diag(P_b)))
    scale = np.where(scale > 0, scale, 1.0)
    Q_a, Q_b = (P / np.outer(scale, scale) for P in (P_a, P_b))
    smaller_is_b = kind == "inside" or (kind == "same" and np.trace(Q_a) >= np.trace(Q_b))
    values, vectors = np.linalg.eigh(Q_a - Q_b if smaller_is_b else Q_b - Q_a)
    D = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(D * np.outer(scale, scale))


def sigma_of_difference(P_a: FloatArray, P_b: FloatArray, D: FloatArray) -> FloatArray:
    """One-sigma of each parameter's difference, (n_parameters,) SI; NaN where what differs is not noise."""
    variance = np.diag(D)
    told = variance > LEAST_SHARE * np.maximum(np.diag(P_a), np.diag(P_b))
    return np.sqrt(np.where(told & (variance > 0), variance, np.nan))


def joint_test(difference: FloatArray, D: FloatArray, sigma: FloatArray) -> tuple[float, int, float] | None:
    """Test all parameters together: d^T D^+ d, chi-square of as many degrees of freedom as D has directions.

    Parameters
    ----------
    difference, D
        (n_parameters,) x_a - x_b and its covariance, SI.
    sigma
        (n_parameters,) of `sigma_of_difference`; parameters without one are left out.

    Returns
    -------
    The statistic, its degrees of freedom and the chance of a larger one if the runs had one truth; None where nothing is left.
    """
    told = np.isfinite(sigma)
    if not told.any():
        return None
    z, spread = difference[told] / sigma[told], np.outer(sigma[told], sigma[told])
    values, vectors = np.linalg.eigh(D[np.ix_(told, told)] / spread)
    kept = values > LEAST_EIGENVALUE * values[-1]
    statistic = float(np.sum((vectors.T @ z)[kept] ** 2 / values[kept]))
    dof = int(kept.sum())
    return statistic, dof, float(chdtrc(dof, statistic))
