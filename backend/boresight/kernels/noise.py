"""Sums of the noise model's restricted likelihood over exposures, as two compiled passes.

`calibration.noise` derives them, in the letters used here: rotations are eliminated exposure by exposure, then what is left of the
rows gives score and information of the noise. Between the two lie products of whole matrices, which NumPy makes. The tests hold
both loops against plain NumPy.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.kernels.compilation import FAST, loop

_FAST = FAST - {"afn"}


@loop("i1 f2 f3 f3 f3 f1 f3 f3", fastmath=_FAST)
def take_rotations_out(star_start, r, J, K, D, weight, L, X):
    """Fill `X` (n, 2, n_free + q + 1) with the weighted rows [J D r] less what a rotation of their exposure makes of them.

    Called by `calibration.noise`. `L` (n_exposures, 3, 3) becomes the Cholesky factor of the rotations' covariance; NaN where the
    stars of an exposure leave one open.
    """
    n_free, q = J.shape[2], D.shape[2]
    m = n_free + q + 1
    A, S, F = np.empty((3, 3)), np.empty((3, m)), np.empty((3, 3))
    for e in range(star_start.shape[0] - 1):
        A[:] = 0.0
        S[:] = 0.0
        for i in range(star_start[e], star_start[e + 1]):
            w = weight[i]
            for k in range(2):
                for p in range(n_free):
                    X[i, k, p] = w * J[i, k, p]
                for p in range(q):
                    X[i, k, n_free + p] = w * D[i, k, p]
                X[i, k, m - 1] = w * r[i, k]
                for a in range(3):
                    along = w * K[i, k, a]
                    for b in range(a + 1):
                        A[a, b] += along * w * K[i, k, b]
                    for p in range(m):
                        S[a, p] += along * X[i, k, p]
        # A = F F^T, so F^-T is a factor of its inverse
        F[0, 0] = math.sqrt(A[0, 0])
        F[1, 0], F[2, 0] = A[1, 0] / F[0, 0], A[2, 0] / F[0, 0]
        F[1, 1] = math.sqrt(A[1, 1] - F[1, 0] * F[1, 0])
        F[2, 1] = (A[2, 1] - F[2, 0] * F[1, 0]) / F[1, 1]
        F[2, 2] = math.sqrt(A[2, 2] - F[2, 0] * F[2, 0] - F[2, 1] * F[2, 1])
        i00, i11, i22 = 1.0 / F[0, 0], 1.0 / F[1, 1], 1.0 / F[2, 2]
        i10 = -F[1, 0] * i00 * i11
        i21 = -F[2, 1] * i11 * i22
        i20 = -(F[2, 0] * i00 + F[2, 1] * i10) * i22
        L[e, 0, 0], L[e, 0, 1], L[e, 0, 2] = i00, i10, i20
        L[e, 1, 0], L[e, 1, 1], L[e, 1, 2] = 0.0, i11, i21
        L[e, 2, 0], L[e, 2, 1], L[e, 2, 2] = 0.0, 0.0, i22
        for p in range(m):
            s0, s1, s2 = i00 * S[0, p], i10 * S[0, p] + i11 * S[1, p], i20 * S[0, p] + i21 * S[1, p] + i22 * S[2, p]
            S[0, p], S[1, p], S[2, p] = i00 * s0 + i10 * s1 + i20 * s2, i11 * s1 + i21 * s2, i22 * s2
        for i in range(star_start[e], star_start[e + 1]):
            for k in range(2):
                x, y, z = weight[i] * K[i, k, 0], weight[i] * K[i, k, 1], weight[i] * K[i, k, 2]
                for p in range(m):
                    X[i, k, p] -= x * S[0, p] + y * S[1, p] + z * S[2, p]


@loop("i1 f3 f1 f3 f2 f3 f2 f1 f1 f2", fastmath=_FAST)
def score_noise(star_start, K, weight, L, g, X, solved, c, score, A):
    """Fill score (n_terms,) and information `A` (n_terms, n_terms) of the noise.

    Called by `calibration.noise`. L, X are those of `take_rotations_out`; `solved` (2 n, m) the rows of X but their last column
    times the inverse of their information, `c` (m,) the coefficients of least squares. g (n, n_terms) are the noise's quantities.
    """
    terms, m = g.shape[1], solved.shape[1]
    u, outer, joint = np.empty(3), np.empty(6), np.empty((terms, 6))
    score[:] = 0.0
    A[:] = 0.0
    for e in range(star_start.shape[0] - 1):
        joint[:] = 0.0
        for i in range(star_start[e], star_start[e + 1]):
            outer[:] = 0.0
            excess, level = 0.0, 0.0
            for k in range(2):
                x, y, z = weight[i] * K[i, k, 0], weight[i] * K[i, k, 1], weight[i] * K[i, k, 2]
                u[0] = x * L[e, 0, 0]
                u[1] = x * L[e, 0, 1] + y * L[e, 1, 1]
                u[2] = x * L[e, 0, 2] + y * L[e, 1, 2] + z * L[e, 2, 2]
                left, h = X[i, k, m], u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
                for p in range(m):
                    left -= X[i, k, p] * c[p]
                    h += solved[2 * i + k, p] * X[i, k, p]
                excess += left * left - 1.0 + h
                level += 1.0 - 2.0 * h
                outer[0] += u[0] * u[0]
                outer[1] += u[1] * u[1]
                outer[2] += u[2] * u[2]
                outer[3] += u[0] * u[1]
                outer[4] += u[0] * u[2]
                outer[5] += u[1] * u[2]
            for t in range(terms):
                score[t] += g[i, t] * excess
                for j in range(6):
                    joint[t, j] += g[i, t] * outer[j]
                for v in range(t + 1):
                    A[t, v] += 2.0 * g[i, t] * g[i, v] * level
        for t in range(terms):
            for v in range(t + 1):
                on = joint[t, 0] * joint[v, 0] + joint[t, 1] * joint[v, 1] + joint[t, 2] * joint[v, 2]
                off = joint[t, 3] * joint[v, 3] + joint[t, 4] * joint[v, 4] + joint[t, 5] * joint[v, 5]
                A[t, v] += 2.0 * on + 4.0 * off
    for t in range(terms):
        for v in range(t):
            A[v, t] = A[t, v]
