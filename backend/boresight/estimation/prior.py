"""What was known of the parameters before the data: a Gaussian in the typical sigmas, as a batch and a filter take it in.

Prior x_p with covariance P_0 of the scaled free parameters z = (x - x_p) / sigma_p. In information form, A_0 = P_0^-1, it is one
more row of the least-squares problem, with the cost z^T A_0 z:

    (A + A_0) dz = -(b + A_0 z)          covariance at the optimum (A + A_0)^-1

and a filter starts with S S^T = P_0, S upper triangular. Both are the same problem: a Kalman update is that sum of information.

How much came from it. The error of the estimate is e = P (A_0 e_0 + A e_d), with e_0 the error of the prior, e_d that of the fit of
the data alone, and P = (A + A_0)^-1. So its covariance is P A_0 P + P A P = P, and the share of a variance that the prior gave is

    (P A_0 P)_pp / P_pp

Whether the two agree. With d = x_d - x_p between the fit of the data alone and the prior, d^T (P_0 + A^-1)^-1 d is chi-square with
as many degrees of freedom as the data determine directions. At the joint optimum the data's gradient is -A_0 z, so it is

    z^T A_0 z + (A_0 z)^T A^+ (A_0 z)

without a fit of the data alone, and where these leave a direction open it says nothing of that direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.estimation import batch


@dataclass(frozen=True)
class Prior:
    """A Gaussian before the data.

    Parameters
    ----------
    x
        (n_parameters,) mean, SI.
    P
        (n_free, n_free) covariance of the free parameters in typical sigmas.
    information
        Its inverse, where that is known better than P.
    """

    x: FloatArray
    P: FloatArray
    information: FloatArray | None = None

    @cached_property
    def A(self) -> FloatArray:
        """Information, (n_free, n_free) in typical sigmas."""
        if self.information is not None:
            return self.information
        inverse = np.linalg.inv(self.P)
        return np.asarray((inverse + inverse.T) / 2)

    @cached_property
    def S(self) -> FloatArray:
        """Upper triangular square root of the covariance, S S^T = P."""
        return np.ascontiguousarray(np.linalg.cholesky(self.P[::-1, ::-1])[::-1, ::-1])

    def at(self, x: FloatArray, free: IntArray, scale: FloatArray, held: int) -> Prior:
        """That of the other parameters where the one at place `held` is known to have its value in x (n_parameters,), SI."""
        others = np.delete(np.arange(len(free)), held)
        A = self.A[np.ix_(others, others)]
        z = (x[free[held]] - self.x[free[held]]) / scale[held]
        mean = self.x.copy()
        mean[free[others]] -= scale[others] * np.linalg.solve(A, self.A[others, held] * z)
        return Prior(mean, np.asarray(np.linalg.inv(A)), A)

    def share(self, A: FloatArray) -> FloatArray:
        """Share of each variance (n_free,) that came from the prior, beside data of information A (n_free, n_free)."""
        P = np.linalg.inv(A + self.A)
        return np.asarray(np.einsum("ij,jk,ki->i", P, self.A, P) / np.diag(P))

    def disagreement(self, A: FloatArray, z: FloatArray) -> tuple[float, int]:
        """Chi-square of data against prior, and its degrees of freedom.

        `A`: (n_free, n_free) information of the data. `z`: (n_free,) joint estimate less the prior, typical sigmas.
        """
        pull = self.A @ z
        values, vectors, known = batch.determined(A)
        of_data = float(((vectors.T @ pull)[known] ** 2 / values[known]).sum())
        return float(z @ pull) + of_data, int(known.sum())

    def distance(self, A: FloatArray, z: FloatArray, P: FloatArray) -> tuple[float, int]:
        """Chi-square of the fit of the data alone against the prior's mean under another covariance P, and its degrees of freedom.

        `A`, `z`: as of `disagreement`; `P`: (n_free, n_free) typical sigmas.
        """
        values, vectors, known = batch.determined(A)
        V, information = vectors[:, known], values[known]
        d = V.T @ z + (V.T @ (self.A @ z)) / information
        return float(d @ np.linalg.solve(V.T @ P @ V + np.diag(1.0 / information), d)), int(known.sum())
