"""The angular distances of all pairs of stars: the reference that W sets the singular values against.

Of the N stars of an exposure all m = N (N - 1) / 2 pairs are measured. With the unit tangents t_ij at star i, towards j,

    d phi_ij = -t_ij . dw_i - t_ji . dw_j

so with the isotropic direction error sigma_i of `arcs.angular_sigma`, and two coordinates across each star in units of it, the row
of a pair in G (m, 2 N) has four entries, and R = G G^T. It is singular: N directions less a bulk rotation have 2 N - 3
dimensions, and the pairs beyond repeat what others say. W's filter, whose R is not printed, takes no account of that.

Whitening
---------
What is determined is the displacement of the stars that explains the residuals e best, less bulk rotations, which do nothing:

    y = G^+ e = (G^T G + K K^T)^-1 G^T e,       K (2 N, 3) the rotations, scaled like G^T G,

because e^T R^+ e = |G^+ e|^2. Its 2 N entries are white in 2 N - 3 dimensions; [e H] is whitened so at a cost of N^3, not of
m^3 = N^6 / 8. H^T R^+ H is then all that the invariants of the directions hold: the same as that of the 2 N - 3 arcs of
`estimation.arcs` with their full R, which need N only.

The m by m gain form of the paper, K = P H^T (H P H^T + R)^-1, needs an R that can be inverted. Rows are first projected on the
range of G, which is all that y keeps of them; then the null space of R may be filled with anything: R + tau (I - G G^+).

This module is the plain form; `kernels.angles` holds the compiled one, which the tests hold against it.
"""

from __future__ import annotations

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.estimation.arcs import arclength


def all_pairs(n: int) -> IntArray:
    """Both stars of every pair, (n (n - 1) / 2, 2), by the first and then the second."""
    return np.stack(np.triu_indices(n, 1), axis=1)


def angles(s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angular distances (m,) of directions s (n, 3) and their gradients (m, n, 3)."""
    i, j = all_pairs(len(s)).T
    cosine = np.sum(s[i] * s[j], axis=1, keepdims=True)
    sine = np.linalg.norm(np.cross(s[i], s[j]), axis=1, keepdims=True)
    g = np.zeros((len(i), len(s), 3))
    g[np.arange(len(i)), i] = -(s[j] - cosine * s[i]) / sine
    g[np.arange(len(i)), j] = -(s[i] - cosine * s[j]) / sine
    return arclength(s[i], s[j]), g


def covariance(s_i: FloatArray, sigma_rad: FloatArray) -> FloatArray:
    """R (m, m) of all pairs of the directions s_i (n, 3) with direction errors sigma_rad (n,), rad^2; of rank 2 n - 3."""
    G = sigma_rad[:, None] * angles(s_i)[1]
    return np.asarray(np.einsum("rnj,snj->rs", G, G))
