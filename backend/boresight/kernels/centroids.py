"""Linearised centroids and their residuals, star by star in one pass.

`estimation.statistics.cramer_rao` derives the rows, `calibration.evaluation.pixel_residuals` the residuals, in the letters used
here. The loops know no camera: they take directions and derivatives. The tests hold them against plain NumPy.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.kernels.compilation import FAST, loop, part

_FAST = FAST - {"afn"}

_part = part(fastmath=_FAST)


@_part
def _invert(A, N):
    """Fill N (3, 3) with the inverse of a symmetric A, by A = L D L^T; infinite where a pivot is not positive."""
    l10, l20 = A[0, 1] / A[0, 0], A[0, 2] / A[0, 0]
    d1 = A[1, 1] - l10 * A[0, 1]
    l21 = (A[1, 2] - l20 * A[0, 1]) / d1
    d2 = A[2, 2] - l20 * A[0, 2] - l21 * l21 * d1
    if A[0, 0] <= 0.0 or d1 <= 0.0 or d2 <= 0.0:
        N[:] = math.inf
        return
    i0, i1, i2 = 1.0 / A[0, 0], 1.0 / d1, 1.0 / d2
    m20 = l10 * l21 - l20  # of L^-1
    N[0, 0], N[1, 1], N[2, 2] = i0 + l10 * l10 * i1 + m20 * m20 * i2, i1 + l21 * l21 * i2, i2
    N[0, 1] = N[1, 0] = -l10 * i1 - m20 * l21 * i2
    N[0, 2] = N[2, 0] = m20 * i2
    N[1, 2] = N[2, 1] = -l21 * i2


@loop("i1 f2 f3 f2 f2 f2 f2 f1 b1 i1 f1 f3 f3 f3 f3", fastmath=_FAST)
def linearise(star_start, s, D, above, below, right, left, sigma_px, kept, free, scale, inverse, J, K, N):
    """Fill `inverse` (n_stars, 2, 3), `J` (n_stars, 2, n_free), `K` (n_stars, 2, 3) and `N` (n_exposures, 3, 3) of `CentroidRows`.

    Called by `estimation.statistics.cramer_rao`. `s`, `D` are directions and ds/dx; `above`, `below`, `right` and `left`
    (n_stars, 3) directions half a pixel on along rows, back, and along columns; `kept` (n_stars,) the stars attitudes rest on.
    """
    n_free = free.shape[0]
    A, turn = np.empty((3, 3)), np.empty((3, n_free))
    a, b = np.empty(3), np.empty(3)
    for e in range(star_start.shape[0] - 1):
        A[:] = 0.0
        turn[:] = 0.0
        for i in range(star_start[e], star_start[e + 1]):
            aa, ab, bb = 0.0, 0.0, 0.0
            for axis in range(3):
                a[axis], b[axis] = above[i, axis] - below[i, axis], right[i, axis] - left[i, axis]
                aa += a[axis] * a[axis]
                ab += a[axis] * b[axis]
                bb += b[axis] * b[axis]
            over = 1.0 / (aa * bb - ab * ab)
            weight, x, y, z = 1.0 / sigma_px[i], s[i, 0], s[i, 1], s[i, 2]
            for axis in range(3):
                inverse[i, 0, axis] = (bb * a[axis] - ab * b[axis]) * over
                inverse[i, 1, axis] = (aa * b[axis] - ab * a[axis]) * over
            for k in range(2):
                c0, c1, c2 = weight * inverse[i, k, 0], weight * inverse[i, k, 1], weight * inverse[i, k, 2]
                K[i, k, 0], K[i, k, 1], K[i, k, 2] = c1 * z - c2 * y, c2 * x - c0 * z, c0 * y - c1 * x
                for p in range(n_free):
                    q = free[p]
                    J[i, k, p] = (c0 * D[i, 0, q] + c1 * D[i, 1, q] + c2 * D[i, 2, q]) * scale[p]
                if kept[i]:
                    for axis in range(3):
                        for other in range(3):
                            A[axis, other] += K[i, k, axis] * K[i, k, other]
                        for p in range(n_free):
                            turn[axis, p] += K[i, k, axis] * J[i, k, p]
        _invert(A, N[e])
        for i in range(star_start[e], star_start[e + 1]):
            for k in range(2):
                for axis in range(3):
                    along = K[i, k, 0] * N[e, 0, axis] + K[i, k, 1] * N[e, 1, axis] + K[i, k, 2] * N[e, 2, axis]
                    for p in range(n_free):
                        J[i, k, p] -= along * turn[axis, p]


@loop("i1 f3 f2 f f3 f2 f3", fastmath=_FAST)
def see_sky(star_start, C, s_i, parity, inverse, s, from_sky):
    """Fill `s` (n_stars, 3), catalogue directions in D, and `from_sky` (n_stars, 2, 2), pixels a radian to the east and north.

    Called by `calibration.evaluation.pixel_residuals`. C (n_exposures, 3, 3) are attitudes, `inverse` those of `linearise`.
    """
    for e in range(star_start.shape[0] - 1):
        for i in range(star_start[e], star_start[e + 1]):
            x, y, z = s_i[i, 0], s_i[i, 1], s_i[i, 2]
            reach = math.sqrt(x * x + y * y)
            cos_ra, sin_ra = (x / reach, y / reach) if reach > 0.0 else (1.0, 0.0)
            for k in range(2):
                from_sky[i, k, 0], from_sky[i, k, 1] = 0.0, 0.0
            for axis in range(3):
                sign = parity if axis == 1 else 1.0
                c0, c1, c2 = sign * C[e, axis, 0], sign * C[e, axis, 1], sign * C[e, axis, 2]
                s[i, axis] = c0 * x + c1 * y + c2 * z
                east = c1 * cos_ra - c0 * sin_ra
                north = c2 * (x * cos_ra + y * sin_ra) - z * (c0 * cos_ra + c1 * sin_ra)  # s x east
                for k in range(2):
                    from_sky[i, k, 0] += inverse[i, k, axis] * east
                    from_sky[i, k, 1] += inverse[i, k, axis] * north


@loop("i1 f2 f1 b1 f3 f3 f3 f2 f2 f3", fastmath=_FAST)
def settle(star_start, r, sigma_px, kept, J, K, N, P, w, M):
    """Take each exposure's step `w` (n_exposures, 3) out of its residuals `r` (n_stars, 2), pixels; fill `M` (n_stars, 2, 2).

    Called by `calibration.evaluation.pixel_residuals`. J, K, N are those of `linearise`, P (n_free, n_free) the covariance of the
    free parameters; `kept` (n_stars,) the stars that attitudes rest on.
    """
    n_free = P.shape[0]
    score, row = np.empty(3), np.empty((2, n_free))
    for e in range(star_start.shape[0] - 1):
        score[:] = 0.0
        for i in range(star_start[e], star_start[e + 1]):
            for k in range(2):
                if kept[i] and math.isfinite(r[i, k]):
                    for axis in range(3):
                        score[axis] += K[i, k, axis] * r[i, k] / sigma_px[i]
        for axis in range(3):
            w[e, axis] = N[e, axis, 0] * score[0] + N[e, axis, 1] * score[1] + N[e, axis, 2] * score[2]
        for i in range(star_start[e], star_start[e + 1]):
            sign = -1.0 if kept[i] else 1.0
            for k in range(2):
                r[i, k] -= sigma_px[i] * (K[i, k, 0] * w[e, 0] + K[i, k, 1] * w[e, 1] + K[i, k, 2] * w[e, 2])
                for p in range(n_free):
                    row[k, p] = 0.0
                    for q in range(n_free):
                        row[k, p] += J[i, k, q] * P[q, p]
            for k in range(2):
                for j in range(2):
                    value = 0.0
                    for axis in range(3):
                        of = N[e, axis, 0] * K[i, j, 0] + N[e, axis, 1] * K[i, j, 1] + N[e, axis, 2] * K[i, j, 2]
                        value += K[i, k, axis] * of
                    for p in range(n_free):
                        value += row[k, p] * J[i, j, p]
                    M[i, k, j] = (1.0 if k == j else 0.0) + sign * value
