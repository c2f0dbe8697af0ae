"""Sums of a residual spline over the stars of many exposures, each star touching 16 coefficients an axis.

`estimation.residual_spline` derives them. The loops know no camera: they take directions and derivatives as
`CameraModel.directions_and_jacobian` gives them, and the tests hold them against dense NumPy with SciPy's splines.
"""

from __future__ import annotations

import math

from boresight.kernels.compilation import FAST, loop, part

_FAST = FAST - {"afn"}

_part = part(fastmath=_FAST)


@loop("f2 f3 i i f3 f3 f3", fastmath=_FAST)
def pixel_rows(s, D, p, q, J, K, slope):
    """Turn derivatives of directions into derivatives of places on the detector.

    The caller is `estimation.residual_spline`. `s` (n, 3) and `D` (n, 3, n_parameters) are directions in D and their derivatives,
    p and q the principal point's places in the state. Fills `J` (n, 2, n_parameters) pixels a unit of the parameter, `K`
    (n, 2, 3) pixels a radian of rotation about the axes of D, and `slope` (n, 2, 2) pixels a unit of the tangents.
    """
    N = D.shape[2]
    for i in range(s.shape[0]):
        over = 1.0 / s[i, 2]
        tx, ty = s[i, 0] * over, s[i, 1] * over
        # moving the place is moving the principal point back
        a, b = -(D[i, 0, p] - tx * D[i, 2, p]) * over, -(D[i, 0, q] - tx * D[i, 2, q]) * over
        c, d = -(D[i, 1, p] - ty * D[i, 2, p]) * over, -(D[i, 1, q] - ty * D[i, 2, q]) * over
        inverse = 1.0 / (a * d - b * c)
        xx, xy, yx, yy = d * inverse, -b * inverse, -c * inverse, a * inverse
        slope[i, 0, 0], slope[i, 0, 1], slope[i, 1, 0], slope[i, 1, 1] = xx, xy, yx, yy
        for j in range(N):
            dx, dy = (D[i, 0, j] - tx * D[i, 2, j]) * over, (D[i, 1, j] - ty * D[i, 2, j]) * over
            J[i, 0, j], J[i, 1, j] = xx * dx + xy * dy, yx * dx + yy * dy
        for axis in range(3):
            if axis == 0:
                dx, dy = -tx * ty, -1.0 - ty * ty
            elif axis == 1:
                dx, dy = 1.0 + tx * tx, tx * ty
            else:
                dx, dy = -ty, tx
            K[i, 0, axis], K[i, 1, axis] = xx * dx + xy * dy, yx * dx + yy * dy


@_part
def _basis(at, values):
    """Fill `values` (4,) with the cubic B-splines of a cell at the share 0 <= at <= 1 of it."""
    rest = 1.0 - at
    values[0] = rest * rest * rest / 6.0
    values[1] = (3.0 * at * at * at - 6.0 * at * at + 4.0) / 6.0
    values[2] = (3.0 * rest * rest * rest - 6.0 * rest * rest + 4.0) / 6.0
    values[3] = at * at * at / 6.0


@_part
def _cell(at, low, step, intervals):
    """Return the cell of a place, the first and the last reaching beyond the edges."""
    return min(max(math.floor((at - low) / step), 0), intervals - 1)


@loop(
    "i1 f1 f1 f1 f2 f3 f3",
    (tuple, "f f i"),
    (tuple, "f f i"),
    "f2 f1 i1 f1 f2 f2 f2 f3 f2 f2",
    fastmath=_FAST,
)
def spline_sums(
    star_start, row_px, col_px, weight, r, J, K, rows, columns, b, a, free, scale, G, F, H, Y, X, S
):  # fmt: skip
    """Add the sums of the stars of all exposures that keep an attitude.

    The caller is `estimation.residual_spline`. `weight` (n_stars,) is 1 / sigma^2, 0 of a star left out; `r` (n_stars, 2) the
    residual, NaN without attitude; an exposure of fewer than three such stars is passed over. `rows` and `columns` are (first
    edge, cell, cells) of either axis; `b` (2, 4) and `a` (n + 1,) are room. Adds `G` (m, m) of the splines with themselves, whole
    in its lower triangle alone, `F` (2 m, n + 1) with the free parameters and r, `H` (n + 1, n + 1) of the latter; fills `Y`
    (n_exposures, 3, 2 m + n + 1), whose squares the attitudes take, and adds `X` (3, 2 m + n + 1), `S` (3, 3), the products with
    one rotation common to all.
    """
    n, n_r, n_c = free.shape[0], rows[2] + 3, columns[2] + 3
    m = n_r * n_c
    for e in range(star_start.shape[0] - 1):
        y = Y[e]
        for axis in range(3):
            for j in range(y.shape[1]):
                y[axis, j] = 0.0
        k00, k01, k02, k11, k12, k22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        seen = 0
        for i in range(star_start[e], star_start[e + 1]):
            seen += weight[i] > 0.0 and math.isfinite(r[i, 0])
        if seen < 3:  # two stars give an attitude and say nothing else
            continue
        for i in range(star_start[e], star_start[e + 1]):
            w = weight[i]
            if not (w > 0.0 and math.isfinite(r[i, 0])):
                continue
            u = _cell(row_px[i], rows[0], rows[1], rows[2])
            v = _cell(col_px[i], columns[0], columns[1], columns[2])
            _basis((row_px[i] - rows[0]) / rows[1] - u, b[0])
            _basis((col_px[i] - columns[0]) / columns[1] - v, b[1])
            for axis in range(2):
                k0, k1, k2 = K[i, axis, 0], K[i, axis, 1], K[i, axis, 2]
                k00 += w * k0 * k0
                k01 += w * k0 * k1
                k02 += w * k0 * k2
                k11 += w * k1 * k1
                k12 += w * k1 * k2
                k22 += w * k2 * k2
                for j in range(n):
                    a[j] = J[i, axis, free[j]] * scale[j]
                a[n] = r[i, axis]
                for j in range(n + 1):
                    wj = w * a[j]
                    y[0, 2 * m + j] += k0 * wj
                    y[1, 2 * m + j] += k1 * wj
                    y[2, 2 * m + j] += k2 * wj
                    for h in range(j + 1):
                        H[j, h] += wj * a[h]
                for f in range(4):
                    place = axis * m + (u + f) * n_c + v
                    for g in range(4):
                        wb = w * b[0, f] * b[1, g]
                        y[0, place + g] += k0 * wb
                        y[1, place + g] += k1 * wb
                        y[2, place + g] += k2 * wb
                        for j in range(n + 1):
                            F[place + g, j] += wb * a[j]
            for f in range(4):
                for g in range(4):
                    wb, place = w * b[0, f] * b[1, g], (u + f) * n_c + v + g
                    for ff in range(f + 1):
                        part, across = wb * b[0, ff], (u + ff) * n_c + v
                        G[place, across] += part * b[1, 0]
                        G[place, across + 1] += part * b[1, 1]
                        G[place, across + 2] += part * b[1, 2]
                        G[place, across + 3] += part * b[1, 3]
        for axis in range(3):
            for j in range(y.shape[1]):
                X[axis, j] += y[axis, j]
        S[0, 0] += k00
        S[1, 0] += k01
        S[2, 0] += k02
        S[1, 1] += k11
        S[2, 1] += k12
        S[2, 2] += k22
        # K^T K = L L^T, and y becomes L^-1 y
        l00 = math.sqrt(k00)
        l10, l20 = k01 / l00, k02 / l00
        l11 = math.sqrt(k11 - l10 * l10)
        l21 = (k12 - l20 * l10) / l11
        l22 = math.sqrt(k22 - l20 * l20 - l21 * l21)
        d0, d1, d2 = 1.0 / l00, 1.0 / l11, 1.0 / l22
        for j in range(y.shape[1]):
            first = y[0, j] * d0
            second = (y[1, j] - l10 * first) * d1
            y[0, j], y[1, j], y[2, j] = first, second, (y[2, j] - l20 * first - l21 * second) * d2
