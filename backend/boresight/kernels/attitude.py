"""Attitudes of many exposures as a compiled loop: the rotation that takes the catalogue's directions to the measured ones.

`estimation.attitude` derives it: with B = sum w s_d s_i^T = U diag(s) V^T, Wahba's problem has the solution
C = u_1 v_1^T + u_2 v_2^T + (u_1 x u_2)(v_1 x v_2)^T, which is proper whatever the signs of U and V, and the least singular value
with the sign it has there is (u_1 x u_2)^T B (v_1 x v_2). The decomposition of B is Hestenes' one-sided Jacobi: columns of B V are
turned pairwise until they are orthogonal, which keeps small singular values to their own last digits. The tests hold the
loop against NumPy's decomposition.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.kernels.compilation import loop, part

_SWEEPS = 12
_ORTHOGONAL = 1e-16

_FAST = {"contract", "arcp", "nsz"}

_part = part(fastmath=_FAST)


@_part
def _turned(W, V):
    """Turn the columns of W (3, 3) until they are orthogonal, and those of V (3, 3) with them."""
    for _ in range(_SWEEPS):
        largest = 0.0
        for p, q in ((0, 1), (0, 2), (1, 2)):
            a, b, g = 0.0, 0.0, 0.0
            for k in range(3):
                a += W[k, p] * W[k, p]
                b += W[k, q] * W[k, q]
                g += W[k, p] * W[k, q]
            size = math.sqrt(a * b)
            if not abs(g) > _ORTHOGONAL * size:
                continue
            largest = max(largest, abs(g) / size)
            zeta = (b - a) / (2.0 * g)
            t = math.copysign(1.0, zeta) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
            c = 1.0 / math.sqrt(1.0 + t * t)
            s = c * t
            for k in range(3):
                W[k, p], W[k, q] = c * W[k, p] - s * W[k, q], s * W[k, p] + c * W[k, q]
                V[k, p], V[k, q] = c * V[k, p] - s * V[k, q], s * V[k, p] + c * V[k, q]
        if largest < 1e-14:
            break


@_part
def _cross(a, b, c):
    """Fill c = a x b, (3,) each."""
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]


@_part
def _nearest_rotation(B, C, W, V, u, v):
    """Fill C (3, 3) with the rotation nearest to B (3, 3); returns the curvature s_2 + d s_3. W, V (3, 3), u, v (3, 3) are room."""
    for i in range(3):
        for j in range(3):
            W[i, j] = B[i, j]
            V[i, j] = 1.0 if i == j else 0.0
    _turned(W, V)
    norms = (
        math.sqrt(W[0, 0] ** 2 + W[1, 0] ** 2 + W[2, 0] ** 2),
        math.sqrt(W[0, 1] ** 2 + W[1, 1] ** 2 + W[2, 1] ** 2),
        math.sqrt(W[0, 2] ** 2 + W[1, 2] ** 2 + W[2, 2] ** 2),
    )
    first = 0 if norms[0] >= norms[1] and norms[0] >= norms[2] else (1 if norms[1] >= norms[2] else 2)
    p, q = (first + 1) % 3, (first + 2) % 3
    second = p if norms[p] >= norms[q] else q
    for row, column in ((0, first), (1, second)):
        for k in range(3):
            u[row, k] = W[k, column] / norms[column]
            v[row, k] = V[k, column]
    _cross(u[0], u[1], u[2])
    _cross(v[0], v[1], v[2])
    third = 0.0
    for i in range(3):
        for j in range(3):
            third += u[2, i] * B[i, j] * v[2, j]
            C[i, j] = u[0, i] * v[0, j] + u[1, i] * v[1, j] + u[2, i] * v[2, j]
    return norms[second] + third


@_part
def _inverse(M, out):
    """Fill out (3, 3) with the inverse of a symmetric matrix M (3, 3)."""
    a = M[1, 1] * M[2, 2] - M[1, 2] * M[1, 2]
    b = M[0, 2] * M[1, 2] - M[0, 1] * M[2, 2]
    c = M[0, 1] * M[1, 2] - M[0, 2] * M[1, 1]
    share = 1.0 / (M[0, 0] * a + M[0, 1] * b + M[0, 2] * c)
    out[0, 0], out[0, 1], out[0, 2] = a * share, b * share, c * share
    out[1, 1] = (M[0, 0] * M[2, 2] - M[0, 2] * M[0, 2]) * share
    out[1, 2] = (M[0, 1] * M[0, 2] - M[0, 0] * M[1, 2]) * share
    out[2, 2] = (M[0, 0] * M[1, 1] - M[0, 1] * M[0, 1]) * share
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]


@loop("i1 f2 f2 f1 f f3 f3 f1", fastmath=_FAST)
def attitudes(star_start, s_d, s_i, weight, parallel, C, covariance, cost):
    """Solve Wahba's problem of every exposure.

    The caller is `estimation.attitude.attitudes`. `s_d`, `s_i` (n_stars, 3) are measured directions in the right-handed triad and
    the catalogue's, `weight` (n_stars,) is 1 / sigma^2, `parallel` the share of the curvature that counts as none. Fills `C`
    (n_exposures, 3, 3), `covariance` (n_exposures, 3, 3) and `cost` (n_exposures,), NaN where the stars give no attitude.
    """
    B, M = np.empty((3, 3)), np.empty((3, 3))
    W, V, u, v = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for e in range(len(star_start) - 1):
        B[:], M[:] = 0.0, 0.0
        total = 0.0
        for n in range(star_start[e], star_start[e + 1]):
            total += weight[n]
            for i in range(3):
                for j in range(3):
                    B[i, j] += weight[n] * s_d[n, i] * s_i[n, j]
                    M[i, j] -= weight[n] * s_d[n, i] * s_d[n, j]
        curvature = _nearest_rotation(B, C[e], W, V, u, v)
        if not (curvature > parallel * total and star_start[e + 1] - star_start[e] >= 2):
            C[e], covariance[e], cost[e] = np.nan, np.nan, np.nan
            continue
        for i in range(3):
            M[i, i] += total
        _inverse(M, covariance[e])
        squares = 0.0
        for n in range(star_start[e], star_start[e + 1]):
            for i in range(3):
                left = s_d[n, i] - (C[e, i, 0] * s_i[n, 0] + C[e, i, 1] * s_i[n, 1] + C[e, i, 2] * s_i[n, 2])
                squares += weight[n] * left * left
        cost[e] = 0.5 * squares
