"""The camera, the arcs between stars, the batch and the square-root filters as compiled loops.

The layout is a structure of arrays. The stars of all exposures stand one exposure after another in the order that
`estimation.arcs` chose; exposure `k` owns the stars `star_start[k]:star_start[k + 1]`, n of them, and their 2n - 3 arcs
begin at arc `2 star_start[k] - 3 k`. Arcs are interleaved: number 2i joins stars i and i+1, number 2i + 1 joins i and i+2, so
the covariance R of an exposure (E Eqs 16-18) has half-bandwidth 4 and its lower factor is kept as five numbers an arc,
`band[a, 4 - d] = L[a, a - d]`.

The derivative of an arc is taken backwards. With c = s_i.s_j and g = (s_j - c s_i) s_z,i / sin phi, the z component of s_i,

    d phi / d x = -(g_i . dt_i/dx) - (g_j . dt_j/dx)        (E Eq 38 with both errata)

where t = (s_x / s_z, s_y / s_z, 1) are the tangents of a star: g is at right angles to the ray, so that whatever changes the ray's
length alone drops out. A model is what fills t and the 2 by 8 derivatives of its first two components; all else is the same for
every model. The loops take the number of the model (`CameraModel.kernel`) before its state x.
`tests/kernels/test_kernels.py` holds every loop against plain NumPy.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.kernels.compilation import FAST, loop, part
from boresight.kernels.star import numbers, star

HALF_BANDWIDTH = 4
_BAND = HALF_BANDWIDTH + 1
_HALVINGS = 6  # of a filter step that raises its frame's cost
_STEPS = 60  # of the search for a place on the detector, which takes about five
_SETTLED_PX = 1e-7  # the last step of it: its error is the square of that
_LEAST_SHARE = 1e-3  # of such a step: where less is needed the goal lies beyond what the camera sees
_THIN = 0.1  # sine of an angle: orders with a thinner triangle are mended
_TIE = 1e-9  # a triangle that is fatter by less is as fat: rounding must not choose an order
_FEW = 7  # stars of which every order is tried

_part = part(fastmath=FAST)
_inlined = part(fastmath=FAST, forceinline=True)


@_part
def _width(camera):
    """Return how many numbers are kept a star: s (3), 1 / |t| = s_z, and the derivatives of t_x and of t_y."""
    return 4 + 2 * len(camera)


@_part
def _stars(camera, x, pitch, row_px, col_px, first, n, w):
    """Fill the first rows of `w` (at least n, width) with n stars from `first` on."""
    at, N = numbers(camera, x), len(camera)
    for i in range(n):
        tx, ty, dx, dy = star(camera, at, pitch, row_px[first + i], col_px[first + i])
        norm = 1.0 / math.sqrt(tx * tx + ty * ty + 1.0)
        w[i, 0], w[i, 1], w[i, 2], w[i, 3] = tx * norm, ty * norm, norm, norm
        for p in range(N):
            w[i, 4 + p], w[i, 4 + N + p] = dx[p], dy[p]


@_part
def _directions(camera, x, pitch, row_px, col_px, first, n, w):
    """Fill the directions alone, the first three numbers of each row of `w`: what derivatives would take is not compiled."""
    at = numbers(camera, x)
    for i in range(n):
        tx, ty, _, _ = star(camera, at, pitch, row_px[first + i], col_px[first + i])
        norm = 1.0 / math.sqrt(tx * tx + ty * ty + 1.0)
        w[i, 0], w[i, 1], w[i, 2] = tx * norm, ty * norm, norm


@_part
def _free_columns(camera, w, n, free):
    """Move the derivatives of n stars by the free parameters, whose places ascend, to the front; zero beyond."""
    n_free, N = free.shape[0], len(camera)
    if n_free == N:
        return
    for i in range(n):
        for p in range(n_free):  # nothing is overwritten before it is read
            w[i, 4 + p], w[i, 4 + N + p] = w[i, 4 + free[p]], w[i, 4 + N + free[p]]
        for p in range(n_free, N):
            w[i, 4 + p], w[i, 4 + N + p] = 0.0, 0.0


@_part
def _pad(scale, whole):
    """Fill `whole` (n_parameters,) with the typical sigmas of the free parameters, zero beyond."""
    for p in range(whole.shape[0]):
        whole[p] = scale[p] if p < scale.shape[0] else 0.0


@_part
def _arclength(w, i, j):
    """Return (phi, cos phi, sin phi) between stars i and j by atan2, exact at every separation."""
    cx = w[i, 1] * w[j, 2] - w[i, 2] * w[j, 1]
    cy = w[i, 2] * w[j, 0] - w[i, 0] * w[j, 2]
    cz = w[i, 0] * w[j, 1] - w[i, 1] * w[j, 0]
    sine = math.sqrt(cx * cx + cy * cy + cz * cz)
    cosine = w[i, 0] * w[j, 0] + w[i, 1] * w[j, 1] + w[i, 2] * w[j, 2]
    return math.atan2(sine, cosine), cosine, sine


@_inlined
def _exposure_rows(camera, x, pitch, s0, n, a0, row_px, col_px, phi, band, free, scale, w, e, H, at):
    """Whitened residuals `e` and scaled Jacobian `H` (., 8) of one exposure, from row `at` on; returns its sum of squares.

    The forward substitution with the banded factor runs while the rows are made: L e' = e, L H' = H (E Eqs 81, 82). The exposure
    has n stars from `s0` and its arcs from `a0` on. Places are passed instead of slices, and the loops over parameters have
    constant length: a slice counts references, a loop of unknown length is not unrolled, and both cost half as much again.
    """
    N = len(camera)
    _stars(camera, x, pitch, row_px, col_px, s0, n, w)
    _free_columns(camera, w, n, free)
    total = 0.0
    for a in range(2 * n - 3):
        i = a // 2
        j = i + 1 + a % 2
        phi_a, c, sine = _arclength(w, i, j)
        residual = phi_a - phi[a0 + a]
        total += residual * residual
        ki, kj = w[i, 3] / sine, w[j, 3] / sine
        ix, iy = ki * (c * w[i, 0] - w[j, 0]), ki * (c * w[i, 1] - w[j, 1])
        jx, jy = kj * (c * w[j, 0] - w[i, 0]), kj * (c * w[j, 1] - w[i, 1])
        row = at + a
        inverse = 1.0 / band[a0 + a, 4]
        if a >= HALF_BANDWIDTH:
            l4, l3, l2, l1 = band[a0 + a, 0], band[a0 + a, 1], band[a0 + a, 2], band[a0 + a, 3]
            for p in range(N):
                h = ix * w[i, 4 + p] + iy * w[i, 4 + N + p] + jx * w[j, 4 + p] + jy * w[j, 4 + N + p]
                h = h * scale[p] - l4 * H[row - 4, p] - l3 * H[row - 3, p] - l2 * H[row - 2, p] - l1 * H[row - 1, p]
                H[row, p] = h * inverse
            residual -= l4 * e[row - 4] + l3 * e[row - 3] + l2 * e[row - 2] + l1 * e[row - 1]
        else:
            for p in range(N):
                h = ix * w[i, 4 + p] + iy * w[i, 4 + N + p] + jx * w[j, 4 + p] + jy * w[j, 4 + N + p]
                h *= scale[p]
                for b in range(a):
                    h -= band[a0 + a, 4 - a + b] * H[at + b, p]
                H[row, p] = h * inverse
            for b in range(a):
                residual -= band[a0 + a, 4 - a + b] * e[at + b]
        e[row] = residual * inverse
    return total


@_inlined
def _exposure_residuals(camera, x, pitch, s0, n, a0, row_px, col_px, phi, band, w, e, at):
    """Whitened residuals `e` of one exposure, from row `at` on, without derivatives; returns its unweighted sum of squares."""
    _directions(camera, x, pitch, row_px, col_px, s0, n, w)
    total = 0.0
    for a in range(2 * n - 3):
        i = a // 2
        residual = _arclength(w, i, i + 1 + a % 2)[0] - phi[a0 + a]
        total += residual * residual
        row = at + a
        if a >= HALF_BANDWIDTH:
            l4, l3, l2, l1 = band[a0 + a, 0], band[a0 + a, 1], band[a0 + a, 2], band[a0 + a, 3]
            residual -= l4 * e[row - 4] + l3 * e[row - 3] + l2 * e[row - 2] + l1 * e[row - 1]
        else:
            for b in range(a):
                residual -= band[a0 + a, 4 - a + b] * e[at + b]
        e[row] = residual / band[a0 + a, 4]
    return total


@_part
def _largest_exposure(star_start):
    """Return the number of stars in the fullest exposure, for scratch space."""
    most = 0
    for k in range(star_start.shape[0] - 1):
        most = max(most, star_start[k + 1] - star_start[k])
    return most


@loop("camera f1 f i i f1 f1 f1", fastmath=FAST)
def solid_angles(camera, x, pitch, p, q, row_px, col_px, omega):
    """Fill `omega` (n_stars,) with the solid angle of one pixel at each star, steradian; p and q are the principal point's places.

    Called by `cameras.model`, which derives it.
    """
    at = numbers(camera, x)
    for i in range(row_px.shape[0]):
        tx, ty, dx, dy = star(camera, at, pitch, row_px[i], col_px[i])
        omega[i] = abs(dx[p] * dy[q] - dx[q] * dy[p]) * (tx * tx + ty * ty + 1.0) ** -1.5


@loop("camera f1 f i i f2 f2", fastmath=FAST)
def project(camera, x, pitch, p, q, s, place):
    """Fill `place` (n, 2) with row and column of directions `s` (n, 3), pixels; p and q are the principal point's places.

    Called by `cameras.model`, which derives it.
    """
    at = numbers(camera, x)
    _, _, dx, dy = star(camera, at, pitch, x[p], x[q])
    sign = 1.0 if dx[p] * dy[q] - dx[q] * dy[p] > 0.0 else -1.0
    for i in range(s.shape[0]):
        place[i, 0], place[i, 1] = math.nan, math.nan
        if not s[i, 2] > 0.0:
            continue
        goal_x, goal_y = s[i, 0] / s[i, 2], s[i, 1] / s[i, 2]
        row, col = x[p], x[q]
        tx, ty, dx, dy = star(camera, at, pitch, row, col)
        off = math.hypot(goal_x - tx, goal_y - ty)
        for _ in range(_STEPS):
            xx, xy, yx, yy = -dx[p], -dx[q], -dy[p], -dy[q]
            determinant = xx * yy - xy * yx
            down = (yy * (goal_x - tx) - xy * (goal_y - ty)) / determinant
            right = (xx * (goal_y - ty) - yx * (goal_x - tx)) / determinant
            share = 1.0
            while share > _LEAST_SHARE:
                tx, ty, dx, dy = star(camera, at, pitch, row + share * down, col + share * right)
                now = math.hypot(goal_x - tx, goal_y - ty)
                if now < off and sign * (dx[p] * dy[q] - dx[q] * dy[p]) > 0.0:
                    break
                share *= 0.5
            settled = abs(down) + abs(right) <= _SETTLED_PX
            if settled or share <= _LEAST_SHARE:
                if settled:
                    place[i, 0], place[i, 1] = row + down, col + right
                break
            row, col, off = row + share * down, col + share * right, now


@loop("camera f1 f f1 f1 f2", fastmath=FAST)
def rays(camera, x, pitch, row_px, col_px, s):
    """Fill `s` (n_stars, 3) with unit directions in D. Called by `cameras.model`."""
    _directions(camera, x, pitch, row_px, col_px, 0, row_px.shape[0], s)


@loop("camera f1 f f1 f1 f2 f3", fastmath=FAST)
def rays_and_jacobians(camera, x, pitch, row_px, col_px, s, D):
    """Fill `s` (n_stars, 3) with unit directions in D and `D` (n_stars, 3, n_parameters) with ds/dx per parameter in SI.

    Called by the filters on stars: ds = (I - s s^T) dt / |t|.
    """
    N = len(camera)
    one = np.empty((1, _width(camera)))
    w = one[0]
    for i in range(row_px.shape[0]):
        _stars(camera, x, pitch, row_px, col_px, i, 1, one)
        s[i, 0], s[i, 1], s[i, 2] = w[0], w[1], w[2]
        for p in range(D.shape[2]):
            x_p, y_p = w[3] * w[4 + p], w[3] * w[4 + N + p]
            along = w[0] * x_p + w[1] * y_p
            D[i, 0, p], D[i, 1, p], D[i, 2, p] = x_p - w[0] * along, y_p - w[1] * along, -w[2] * along


@_inlined
def _add_products(camera, e, H, n_arcs, g, C):
    """Add H^T e to g (8,) and H^T H to C (8, 8), three rows at a time; e and H have room for two more rows than `n_arcs`.

    The whole square, for a triangle is not unrolled; and three rows a turn, for a turn loads and stores every sum once.
    """
    N = len(camera)
    for a in range(n_arcs, n_arcs + 2):
        e[a] = 0.0
        for p in range(N):
            H[a, p] = 0.0
    for a in range(0, n_arcs, 3):
        for p in range(N):
            h0, h1, h2 = H[a, p], H[a + 1, p], H[a + 2, p]
            g[p] += h0 * e[a] + h1 * e[a + 1] + h2 * e[a + 2]
            for q in range(N):
                C[p, q] += h0 * H[a, q] + h1 * H[a + 1, q] + h2 * H[a + 2, q]


@loop("camera f1 f i1 f1 f1 f1 f2 i1 f1 f f2 f1", fastmath=FAST)
def normal_equations(camera, x, pitch, star_start, row_px, col_px, phi, band, free, scale, threshold, A, b):
    """Accumulate A = H'^T W H' (n_free, n_free) and b = H'^T W e' (n_free,); return (cost, unweighted sum of squares).

    Called by `estimation.batch`. H' is whitened and in units of `scale` (the typical sigmas of the free parameters). W holds
    Huber's weights min(1, threshold / |e'|), and an infinite threshold makes the cost chi-square; see `estimation.robust`.
    """
    N = len(camera)
    most = _largest_exposure(star_start)
    n_free = free.shape[0]
    w, e, H = np.empty((most, _width(camera))), np.empty(2 * most), np.empty((2 * most, N))
    C, g, scales = np.zeros((N, N)), np.zeros(N), np.empty(N)
    _pad(scale, scales)
    chi2 = 0.0
    total = 0.0
    for k in range(star_start.shape[0] - 1):
        s0 = star_start[k]
        n = star_start[k + 1] - s0
        total += _exposure_rows(
            camera, x, pitch, s0, n, 2 * s0 - 3 * k, row_px, col_px, phi, band, free, scales, w, e, H, 0
        )
        for a in range(2 * n - 3):
            size = abs(e[a])
            if size <= threshold:
                chi2 += size * size
                continue
            chi2 += threshold * (2.0 * size - threshold)
            root = math.sqrt(threshold / size)  # so that the products below hold the weight once
            e[a] *= root
            for p in range(N):
                H[a, p] *= root
        _add_products(camera, e, H, 2 * n - 3, g, C)
    for p in range(n_free):
        b[p] = g[p]
        for q in range(p + 1):
            A[p, q] = A[q, p] = C[p, q]
    return chi2, total


@loop("camera f1 f i1 f1 f1 f1 f2 f", first=False, fastmath=FAST)
def count_beyond(camera, x, pitch, star_start, row_px, col_px, phi, band, threshold):
    """Return (arcs whose whitened residual is beyond `threshold`, sum of squares of all, each cut off at it).

    Called by `estimation.robust`.
    """
    most = _largest_exposure(star_start)
    w, e = np.empty((most, _width(camera))), np.empty(2 * most)
    beyond, total = 0, 0.0
    for k in range(star_start.shape[0] - 1):
        s0 = star_start[k]
        n = star_start[k + 1] - s0
        _exposure_residuals(camera, x, pitch, s0, n, 2 * s0 - 3 * k, row_px, col_px, phi, band, w, e, 0)
        for a in range(2 * n - 3):
            size = abs(e[a])
            beyond += size > threshold
            total += min(size, threshold) ** 2
    return beyond, total


@loop("camera f1 f i1 f1 f1 f1 f1", fastmath=FAST)
def residuals(camera, x, pitch, star_start, row_px, col_px, phi, e):
    """Fill `e` (n_arcs,) with measured minus catalogue arclength, radians. Called by `estimation.metrics`."""
    w = np.empty((_largest_exposure(star_start), _width(camera)))
    for k in range(star_start.shape[0] - 1):
        s0, s1 = star_start[k], star_start[k + 1]
        a0 = 2 * s0 - 3 * k
        _directions(camera, x, pitch, row_px, col_px, s0, s1 - s0, w)
        for a in range(2 * (s1 - s0) - 3):
            e[a0 + a] = _arclength(w, a // 2, a // 2 + 1 + a % 2)[0] - phi[a0 + a]


@loop("camera f2 f i1 f1 f1 f1 f1", fastmath=FAST)
def sums_of_squares(camera, states, pitch, star_start, row_px, col_px, phi, totals):
    """Fill `totals` (n_states,) with the unweighted sum of squares of the whole set at each state (n_states, 8).

    Called by `estimation.metrics.tail_rms` (E Eq 32).
    """
    w = np.empty((_largest_exposure(star_start), _width(camera)))
    for m in range(states.shape[0]):
        total = 0.0
        for k in range(star_start.shape[0] - 1):
            s0, s1 = star_start[k], star_start[k + 1]
            a0 = 2 * s0 - 3 * k
            _directions(camera, states[m], pitch, row_px, col_px, s0, s1 - s0, w)
            for a in range(2 * (s1 - s0) - 3):
                residual = _arclength(w, a // 2, a // 2 + 1 + a % 2)[0] - phi[a0 + a]
                total += residual * residual
        totals[m] = total


@loop("camera f1 f i1 f1 f1 f1 f2 i1 f1 f1 f2", fastmath=FAST)
def whitened_rows(camera, x, pitch, star_start, row_px, col_px, phi, band, free, scale, e, H):
    """Fill whitened `e` (n_arcs,) and `H` (n_arcs, n_free) of several exposures. Called by `estimation.filters.extended`."""
    N = len(camera)
    most, n_free = _largest_exposure(star_start), free.shape[0]
    w, one = np.empty((most, _width(camera))), np.empty((2 * most, N))
    whitened, scales = np.empty(2 * most), np.empty(N)
    _pad(scale, scales)
    total = 0.0
    for k in range(star_start.shape[0] - 1):
        s0 = star_start[k]
        n, a0 = star_start[k + 1] - s0, 2 * s0 - 3 * k
        total += _exposure_rows(
            camera, x, pitch, s0, n, a0, row_px, col_px, phi, band, free, scales, w, whitened, one, 0
        )
        for a in range(2 * n - 3):
            e[a0 + a] = whitened[a]
            for p in range(n_free):
                H[a0 + a, p] = one[a, p]
    return total


@_inlined
def carlson_update(camera, z, S, h, innovation, f, gain):
    """Take in one whitened scalar measurement; z (8,) and upper triangular S (8, 8) change in place.

    Fewer than eight free parameters leave the last rows and columns zero: loops of constant length run twice as fast.

    f = S^T h (erratum to E Eq 87), alpha = 1 + f.f, and column by column S becomes S (I - f f^T / alpha)^(1/2)
    (erratum to E Eq 84) in Carlson's form, which stays triangular. Returns the normalised innovation squared.
    """
    n = len(camera)
    for j in range(n):
        value = 0.0
        for i in range(n):
            value += S[i, j] * h[i]
        f[j] = value
        gain[j] = 0.0
    alpha = 1.0
    for j in range(n):
        before = alpha
        alpha += f[j] * f[j]
        root = 1.0 / math.sqrt(before * alpha)
        keep = before * root  # sqrt(before / alpha), with one root and one division between them
        move = f[j] * root
        for i in range(n):
            old = S[i, j]
            S[i, j] = keep * old - move * gain[i]
            gain[i] += old * f[j]
    for i in range(n):
        z[i] -= gain[i] / alpha * innovation
    return innovation * innovation / alpha


@_part
def inflate(S, q, M):
    """Replace S by the upper triangular factor of S S^T + diag(q^2), by Givens rotations of [S M] (erratum to E Eq 88)."""
    n = S.shape[0]
    for i in range(n):
        for j in range(n):
            M[i, j] = q[i] if i == j else 0.0
    for k in range(n - 1, -1, -1):
        for j in range(n):
            if M[k, j] == 0.0:
                continue
            r = math.hypot(S[k, k], M[k, j])
            c, s = S[k, k] / r, M[k, j] / r
            for i in range(k + 1):
                a, b = S[i, k], M[i, j]
                S[i, k] = c * a + s * b
                M[i, j] = c * b - s * a


@_part
def _between_frames(S, q, widening, M):
    """Widen S by a forgetting factor's 1 / sqrt(lambda), then add the process noise q (8,)."""
    if widening != 1.0:
        for i in range(S.shape[0]):
            for j in range(i, S.shape[0]):
                S[i, j] *= widening
    most = 0.0
    for j in range(q.shape[0]):
        most = max(most, q[j])
    if most > 0.0:
        inflate(S, q, M)


@_part
def _prior_cost(S, z, z_prior, n_free, y):
    """|S^-1 (z - z_prior)|^2 by back substitution, the prior's share of a frame's cost."""
    cost = 0.0
    for i in range(n_free - 1, -1, -1):
        value = z[i] - z_prior[i]
        for j in range(i + 1, n_free):
            value -= S[i, j] * y[j]
        y[i] = value / S[i, i]
        cost += y[i] * y[i]
    return cost


@_inlined
def _frame_residuals(camera, x, pitch, first, last, star_start, row_px, col_px, phi, band, w, e):
    """Whitened residuals `e` of the exposures first <= m < last, one after another; returns their unweighted sum of squares."""
    total = 0.0
    n_arcs = 0
    for m in range(first, last):
        s0 = star_start[m]
        n = star_start[m + 1] - s0
        total += _exposure_residuals(camera, x, pitch, s0, n, 2 * s0 - 3 * m, row_px, col_px, phi, band, w, e, n_arcs)
        n_arcs += 2 * n - 3
    return total


@_inlined
def _copy(camera, z, S, z_to, S_to):
    """Copy a mean (8,) and a root of its covariance (8, 8) with columns contiguous; assigning slices takes ten times as long."""
    N = len(camera)
    for j in range(N):
        z_to[j] = z[j]
        for i in range(N):
            S_to[i, j] = S[i, j]


@_part
def _largest_frame(frame_start, star_start):
    """Return the number of arcs in the fullest frame, for scratch space."""
    most = 0
    for k in range(frame_start.shape[0] - 1):
        k0, k1 = frame_start[k], frame_start[k + 1]
        most = max(most, 2 * (star_start[k1] - star_start[k0]) - 3 * (k1 - k0))
    return most


@loop("f1 f1 f2F f1 f camera f i1 i1 f1 f1 f1 f2 i1 f1 i f f2 f2 f1 i1 f1 i1", first=False, fastmath=FAST)
def square_root_filter(
    x, z, S, q, widening, camera, pitch, frame_start, star_start, row_px, col_px, phi, band, free, scale, linearisations, rest,
    states, sigmas, nis, dof, squares, passes,
):  # fmt: skip
    """Run the Carlson filter over frames; x (8,), z (8,) and S (8, 8) change in place, zero beyond the free parameters.

    Called by `estimation.filters.square_root`, which derives it. z is the step of the free parameters from their start in
    typical sigmas. Before each frame S is multiplied by `widening`, and q added. Frame k owns exposures
    `frame_start[k]:frame_start[k + 1]`. A frame is linearised again at its own posterior
    until the whitened residual there differs from its linear prediction by less than `rest`, at most `linearisations` times.
    Fills per frame: states (n_frames, 8), sigmas (n_frames, n_free) in typical sigmas, nis, dof, squares (post-update sum of
    squares, E Eq 33) and passes. Returns the number of frames done; fewer than asked when the state stopped being finite.
    """
    N = len(camera)
    n_free = free.shape[0]
    n_frames = frame_start.shape[0] - 1
    most_arcs = _largest_frame(frame_start, star_start)
    w = np.empty((_largest_exposure(star_start), _width(camera)))
    e, H, post = np.empty(most_arcs), np.empty((most_arcs, N)), np.empty(most_arcs)
    z_prior, z_at, S_prior = np.empty(N), np.empty(N), np.empty((N, N)).T
    f, gain, M, x0 = (
        np.empty(N),
        np.empty(N),
        np.empty((N, N)),
        np.empty(n_free),
    )
    scales = np.empty(N)
    _pad(scale, scales)
    for p in range(n_free):
        x0[p] = x[free[p]] - scale[p] * z[p]
    for k in range(n_frames):
        _between_frames(S, q, widening, M)
        _copy(camera, z, S, z_prior, S_prior)
        n_arcs = 0
        total = 0.0
        frame_nis = 0.0
        done = 0
        for turn in range(linearisations):
            for p in range(N):
                z_at[p] = z[p]
            n_arcs = 0
            for m in range(frame_start[k], frame_start[k + 1]):
                s0 = star_start[m]
                n = star_start[m + 1] - s0
                _exposure_rows(
                    camera, x, pitch, s0, n, 2 * s0 - 3 * m, row_px, col_px, phi, band, free, scales, w, e, H, n_arcs
                )
                n_arcs += 2 * n - 3
            _copy(camera, z_prior, S_prior, z, S)
            frame_nis = 0.0
            for a in range(n_arcs):
                innovation = e[a]
                for p in range(N):
                    innovation += H[a, p] * (z[p] - z_at[p])  # it moves inside the frame (erratum to E Eq 83)
                frame_nis += carlson_update(camera, z, S, H[a], innovation, f, gain)
            for p in range(n_free):
                x[free[p]] = x0[p] + scale[p] * z[p]
            before = _prior_cost(S_prior, z_at, z_prior, n_free, f)
            for a in range(n_arcs):
                before += e[a] * e[a]
            for _ in range(_HALVINGS):
                total = _frame_residuals(
                    camera, x, pitch, frame_start[k], frame_start[k + 1], star_start, row_px, col_px, phi, band, w, post
                )
                after = _prior_cost(S_prior, z, z_prior, n_free, f)
                for a in range(n_arcs):
                    after += post[a] * post[a]
                if after <= before * (1.0 + 1e-9):
                    break
                for p in range(n_free):  # overshot: the curvature is real, take half the step and linearise there
                    z[p] = 0.5 * (z[p] + z_at[p])
                    x[free[p]] = x0[p] + scale[p] * z[p]
            done = turn + 1
            worst = 0.0
            for a in range(n_arcs):
                predicted = e[a]
                for p in range(N):
                    predicted += H[a, p] * (z[p] - z_at[p])
                worst = max(worst, abs(post[a] - predicted))
            if worst < rest:
                break
        for p in range(N):
            states[k, p] = x[p]
        for p in range(n_free):
            variance = 0.0
            for j in range(p, n_free):
                variance += S[p, j] * S[p, j]
            sigmas[k, p] = math.sqrt(variance)
        nis[k], dof[k], squares[k], passes[k] = frame_nis, n_arcs, total, done
        if not math.isfinite(total):
            return k
    return n_frames


@loop("f1 f1 f2F f1 f camera f i1 i1 f1 f1 f1 f2 i1 f1 i f f f f2 f2 f1 i1 f1 i1", first=False, fastmath=FAST)
def unscented_filter(
    x, z, S, q, widening, camera, pitch, frame_start, star_start, row_px, col_px, phi, band, free, scale, linearisations, rest,
    shrunk, straight, states, sigmas, nis, dof, squares, passes,
):  # fmt: skip
    """Run the square-root unscented filter over frames; arguments and result as in `square_root_filter`.

    Called by `estimation.filters.unscented`, which derives it. A frame is regressed again about its own posterior until that
    moves by less than `rest` of its sigmas and no sigma shrinks by more than the share `shrunk`; or only once, where the residuals
    are `straight` (trace of C C^T) over a spread that the posterior stays inside.
    """
    N = len(camera)
    n_free = free.shape[0]
    n_frames = frame_start.shape[0] - 1
    most = _largest_frame(frame_start, star_start)
    w = np.empty((_largest_exposure(star_start), _width(camera)))
    e, H, C = np.empty(most), np.zeros((most, N)), np.empty((most, N))
    plus, minus = np.empty((N, most)), np.empty((N, most))
    z_prior, z_at, point = np.empty(N), np.empty(N), np.empty(x.shape[0])
    S_prior, S_at = np.empty((N, N)).T, np.empty((N, N)).T
    f, gain, M, x0 = (
        np.empty(N),
        np.empty(N),
        np.empty((N, N)),
        np.empty(n_free),
    )
    gamma = math.sqrt(n_free)
    for p in range(n_free):
        x0[p] = x[free[p]] - scale[p] * z[p]
    for k in range(n_frames):
        _between_frames(S, q, widening, M)
        _copy(camera, z, S, z_prior, S_prior)
        k0, k1 = frame_start[k], frame_start[k + 1]
        n_arcs = 2 * (star_start[k1] - star_start[k0]) - 3 * (k1 - k0)
        frame_nis = 0.0
        done = 0
        for turn in range(linearisations):
            _copy(camera, z, S, z_at, S_at)
            for i in range(n_free):
                for side in range(2):
                    reach = gamma if side == 0 else -gamma
                    for p in range(N):
                        point[p] = x[p]
                    for p in range(n_free):
                        point[free[p]] = x0[p] + scale[p] * (z_at[p] + reach * S_at[p, i])
                    _frame_residuals(
                        camera, point, pitch, k0, k1, star_start, row_px, col_px, phi, band, w,
                        plus[i] if side == 0 else minus[i],
                    )  # fmt: skip
            _regress(plus, minus, S_at, n_free, n_arcs, e, H, C)
            bent = _whiten_spread(C, n_free, n_arcs, e, H)
            _copy(camera, z_prior, S_prior, z, S)
            frame_nis = 0.0
            for a in range(n_arcs):
                innovation = e[a]
                for p in range(N):
                    innovation += H[a, p] * (z[p] - z_at[p])
                frame_nis += carlson_update(camera, z, S, H[a], innovation, f, gain)
            for p in range(n_free):
                x[free[p]] = x0[p] + scale[p] * z[p]
            done = turn + 1
            if bent < straight and _prior_cost(S_at, z, z_at, n_free, f) < 1.0:
                break
            if math.sqrt(_prior_cost(S, z, z_at, n_free, f)) < rest and _narrowing(S_at, S, n_free) < shrunk:
                break
        for p in range(N):
            states[k, p] = x[p]
        for p in range(n_free):
            variance = 0.0
            for j in range(p, n_free):
                variance += S[p, j] * S[p, j]
            sigmas[k, p] = math.sqrt(variance)
        total = _frame_residuals(camera, x, pitch, k0, k1, star_start, row_px, col_px, phi, band, w, e)
        nis[k], dof[k], squares[k], passes[k] = frame_nis, n_arcs, total, done
        if not math.isfinite(total):
            return k
    return n_frames


@_part
def _regress(plus, minus, S, n_free, n_arcs, e, H, C):
    """Mean e (n_arcs,), slope H (n_arcs, 8) and even part C (n_arcs, 8) of residuals at the points z +- gamma S_i (n_free, n_arcs).

    With D the odd part over gamma, the slope is H = D S^-1, by substitution as S is upper triangular.
    """
    gamma = math.sqrt(n_free)
    for a in range(n_arcs):
        mean = 0.0
        for i in range(n_free):
            mean += plus[i, a] + minus[i, a]
        mean /= 2.0 * n_free
        e[a] = mean
        for i in range(n_free):
            C[a, i] = (0.5 * (plus[i, a] + minus[i, a]) - mean) / gamma
            value = 0.5 * (plus[i, a] - minus[i, a]) / gamma
            for j in range(i):
                value -= H[a, j] * S[j, i]
            H[a, i] = value / S[i, i]


@_part
def _whiten_spread(C, n_free, n_arcs, e, H):
    """Multiply e and H by W with W (I + C C^T) W^T = I, and return a measure of C C^T: its trace, seen through W.

    One column c of C at a time: I - c c^T (1 - 1 / sqrt(1 + c.c)) / c.c.
    """
    bent = 0.0
    for i in range(n_free):
        size = 0.0
        for a in range(n_arcs):
            size += C[a, i] * C[a, i]
        bent += size
        if size == 0.0:
            continue
        beta = (1.0 - 1.0 / math.sqrt(1.0 + size)) / size
        along = 0.0
        for a in range(n_arcs):
            along += C[a, i] * e[a]
        for a in range(n_arcs):
            e[a] -= beta * along * C[a, i]
        for p in range(n_free):
            along = 0.0
            for a in range(n_arcs):
                along += C[a, i] * H[a, p]
            for a in range(n_arcs):
                H[a, p] -= beta * along * C[a, i]
        for j in range(i + 1, n_free):
            along = 0.0
            for a in range(n_arcs):
                along += C[a, i] * C[a, j]
            for a in range(n_arcs):
                C[a, j] -= beta * along * C[a, i]
    return bent


@_part
def _narrowing(before, after, n_free):
    """Largest share by which a conditional sigma, a diagonal entry of S, shrank."""
    worst = 0.0
    for p in range(n_free):
        worst = max(worst, 1.0 - abs(after[p, p] / before[p, p]))
    return worst


@loop("i1 f2 f1 f1 f2 b1", fastmath=FAST)
def arcs_and_factors(star_start, s, sigma, phi, band, bad):
    """Catalogue arcs `phi` (n_arcs,) and the banded factors of R (n_arcs, 5) for directions `s` (n_stars, 3), `sigma` rad.

    Called by `estimation.arcs`, which derives R. `bad` (n_exposures,) is set where R is not positive definite. cos psi of
    E Eq 18 is taken as the product of the unit tangents with which the two arcs leave their common star: no trigonometry,
    and no cancellation for short arcs.
    """
    tangents = np.empty((2 * _largest_exposure(star_start), 6))
    for k in range(star_start.shape[0] - 1):
        s0, s1 = star_start[k], star_start[k + 1]
        a0 = 2 * s0 - 3 * k
        n = s1 - s0
        for a in range(2 * n - 3):
            i = s0 + a // 2
            phi[a0 + a] = _catalogue_arc(s, i, i + 1 + a % 2, tangents[a])
        bad[k] = _factor(n, sigma[s0:s1], tangents, band[a0 : a0 + 2 * n - 3])


@_part
def _catalogue_arc(s, i, j, tangent):
    """Arclength between directions i and j; fills its unit tangents (6,) at i, towards j, and at j, towards i."""
    cx = s[i, 1] * s[j, 2] - s[i, 2] * s[j, 1]
    cy = s[i, 2] * s[j, 0] - s[i, 0] * s[j, 2]
    cz = s[i, 0] * s[j, 1] - s[i, 1] * s[j, 0]
    sine = math.sqrt(cx * cx + cy * cy + cz * cz)
    cosine = s[i, 0] * s[j, 0] + s[i, 1] * s[j, 1] + s[i, 2] * s[j, 2]
    inverse = 1.0 / sine
    for axis in range(3):
        tangent[axis] = (s[j, axis] - cosine * s[i, axis]) * inverse
        tangent[3 + axis] = (s[i, axis] - cosine * s[j, axis]) * inverse
    return math.atan2(sine, cosine)


@_part
def _factor(n, sigma, tangents, band):
    """Banded Cholesky factor of one exposure's R; returns True when a pivot is not positive."""
    n_arcs = 2 * n - 3
    for a in range(n_arcs):
        first = max(0, a - HALF_BANDWIDTH)
        for b in range(first, a):
            value = _covariance(sigma, tangents, a, b)
            for m in range(first, b):
                value -= band[a, 4 - a + m] * band[b, 4 - b + m]
            band[a, 4 - a + b] = value / band[b, 4]
        i = a // 2
        pivot = sigma[i] * sigma[i] + sigma[i + 1 + a % 2] * sigma[i + 1 + a % 2]  # E Eq 16
        for m in range(first, a):
            pivot -= band[a, 4 - a + m] * band[a, 4 - a + m]
        if not pivot > 0.0:
            return True
        band[a, 4] = math.sqrt(pivot)
        for d in range(a + 1, _BAND):
            band[a, 4 - d] = 0.0
    return False


@_part
def _covariance(sigma, tangents, a, b):
    """Covariance of arcs a > b at the star they share, sigma_j^2 cos psi (E Eq 17 with its erratum); 0 when they share none."""
    ai, bi = a // 2, b // 2
    aj, bj = ai + 1 + a % 2, bi + 1 + b % 2
    if ai == bi:
        star, end_a, end_b = ai, 0, 0
    elif ai == bj:
        star, end_a, end_b = ai, 0, 3
    elif aj == bj:
        star, end_a, end_b = aj, 3, 3
    else:
        return 0.0
    cosine = 0.0
    for axis in range(3):
        cosine += tangents[a, end_a + axis] * tangents[b, end_b + axis]
    return sigma[star] * sigma[star] * cosine


@_part
def _fatness(x, y, a, b, c):
    """Sine of the smallest angle of the triangle a b c: 0 for collinear or coincident stars, 0.87 at best."""
    ab2 = (x[a] - x[b]) ** 2 + (y[a] - y[b]) ** 2
    bc2 = (x[b] - x[c]) ** 2 + (y[b] - y[c]) ** 2
    ca2 = (x[c] - x[a]) ** 2 + (y[c] - y[a]) ** 2
    area2 = abs((x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a]))
    longest = max(ab2, bc2, ca2)
    if area2 == 0.0:
        return 0.0
    # the smallest angle lies between the two longest sides: sin = 2 area / (product of those sides)
    middle = ab2 + bc2 + ca2 - longest - min(ab2, bc2, ca2)
    return area2 / math.sqrt(longest * middle)


@_part
def _greedy(x, y, pool, n, window, order):
    """Order the n stars of `pool` so that each new triangle is fat, looking `window` candidates ahead; return the thinnest.

    The candidates are pool[head:n], in their order; the one taken makes room at the head.
    """
    order[0], order[1] = pool[0], pool[1]
    thinnest = 1.0
    for head in range(2, n):
        best, best_fatness = head, -1.0
        for c in range(head, min(head + window, n)):
            fat = _fatness(x, y, order[head - 2], order[head - 1], pool[c])
            if fat > best_fatness + _TIE:
                best, best_fatness = c, fat
            if fat > 0.5:  # 30 degrees is fat enough: leave the rest for later triangles
                break
        order[head] = pool[best]
        for c in range(best, head, -1):
            pool[c] = pool[c - 1]
        thinnest = min(thinnest, best_fatness)
    return thinnest


@_part
def _thinnest(x, y, order, n, first, last):
    """Return the thinnest of the triangles that begin at places first <= place < last of an order, and where it begins."""
    worst, place = 2.0, -1
    for p in range(max(first, 0), min(last, n - 2)):
        fat = _fatness(x, y, order[p], order[p + 1], order[p + 2])
        if fat < worst:
            worst, place = fat, p
    return worst, place


@_part
def _mend(x, y, order, n, wanted):
    """Swap stars of the thinnest triangle with others while that makes all it touches fatter; return the thinnest left.

    A greedy order leaves its last stars no choice: two lines of stars end with three on one line. Each swap looks at six
    triangles, and ends with none as thin as the one it was made for, so at most as many swaps are made as there are thin triangles.
    """
    for _ in range(n):
        worst, place = _thinnest(x, y, order, n, 0, n - 2)
        if worst > wanted:
            return worst
        best, best_a, best_b = worst, 0, 0
        for a in range(place, place + 3):
            for b in range(n):
                order[a], order[b] = order[b], order[a]
                fat = min(_thinnest(x, y, order, n, a - 2, a + 1)[0], _thinnest(x, y, order, n, b - 2, b + 1)[0])
                order[a], order[b] = order[b], order[a]
                if fat > best + _TIE:
                    best, best_a, best_b = fat, a, b
        if best <= worst:
            return worst
        order[best_a], order[best_b] = order[best_b], order[best_a]
    return _thinnest(x, y, order, n, 0, n - 2)[0]


@_part
def _exhaustive(x, y, n, order, trial, choice, used, limit):
    """Try every order of at most seven stars, cutting branches that are already worse; return the best thinnest triangle."""
    for i in range(n):
        choice[i], used[i], limit[i] = -1, False, 1.0
    best = -1.0
    depth = 0
    while depth >= 0:
        if choice[depth] >= 0:
            used[choice[depth]] = False
        choice[depth] += 1
        while choice[depth] < n and used[choice[depth]]:
            choice[depth] += 1
        if choice[depth] == n:
            choice[depth] = -1
            depth -= 1
            continue
        used[choice[depth]] = True
        trial[depth] = choice[depth]
        limit[depth + 1] = limit[depth]
        if depth >= 2:
            limit[depth + 1] = min(limit[depth], _fatness(x, y, trial[depth - 2], trial[depth - 1], trial[depth]))
        if limit[depth + 1] <= best + _TIE:
            continue
        if depth == n - 1:
            best = limit[n]
            for i in range(n):
                order[i] = trial[i]
            continue
        depth += 1
    return best


@loop("i1 f2 i1 f1", fastmath=FAST)
def order_stars(star_start, s, order, fatness):
    """Order the stars of each exposure so that no three in a row are near collinear. Called by `estimation.arcs`.

    Fills `order` (n_stars,) with the place of each star in the input and `fatness` (n_exposures,) with the sine of the
    smallest angle among the triangles of consecutive stars.
    """
    most = _largest_exposure(star_start)
    x, y, azimuth = np.empty(most), np.empty(most), np.empty(most)
    ranked, pool, trial = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.int64)
    few_trial, choice = np.empty(_FEW, np.int64), np.empty(_FEW, np.int64)
    used, limit = np.empty(_FEW, np.bool_), np.empty(_FEW + 1)
    for k in range(star_start.shape[0] - 1):
        s0, n = star_start[k], star_start[k + 1] - star_start[k]
        _flatten(s, s0, n, x, y, azimuth)
        if n <= _FEW:
            fatness[k] = _exhaustive(x, y, n, trial, few_trial, choice, used, limit)
            _take(trial, s0, n, order)
            continue
        _rank(azimuth, n, ranked)
        fatness[k] = -1.0
        for attempt in range(24 if n <= 20 else 6):
            _interleave(ranked, n, attempt, pool)
            thinnest = _greedy(x, y, pool, n, 12, trial)
            if thinnest < _THIN:
                thinnest = _mend(x, y, trial, n, _THIN)
            if thinnest > fatness[k] + _TIE:
                fatness[k] = thinnest
                _take(trial, s0, n, order)
            if thinnest > 0.25:
                break


@_part
def _take(trial, s0, n, order):
    """Keep an order of the n stars from `s0` on."""
    for i in range(n):
        order[s0 + i] = s0 + trial[i]


@_part
def _rank(values, n, ranked):
    """Fill `ranked` with the places of the first n values, ascending, equal ones by their place: a heap sort, in no other space."""
    for i in range(n):
        ranked[i] = i
    for root in range(n // 2 - 1, -1, -1):
        _sift(values, ranked, root, n)
    for last in range(n - 1, 0, -1):
        ranked[0], ranked[last] = ranked[last], ranked[0]
        _sift(values, ranked, 0, last)


@_part
def _sift(values, ranked, root, n):
    """Let the place at `root` sink until both below it have smaller values."""
    while 2 * root + 1 < n:
        child = 2 * root + 1
        if child + 1 < n and _before(values, ranked[child], ranked[child + 1]):
            child += 1
        if not _before(values, ranked[root], ranked[child]):
            return
        ranked[root], ranked[child] = ranked[child], ranked[root]
        root = child


@_part
def _before(values, a, b):
    """Whether the value at place a comes before that at place b."""
    return values[a] < values[b] or (values[a] == values[b] and a < b)


@_part
def _flatten(s, s0, n, x, y, azimuth):
    """Project the n directions from `s0` on onto the tangent plane of their mean; azimuth is about that mean."""
    cx, cy, cz = 0.0, 0.0, 0.0
    for i in range(s0, s0 + n):
        cx += s[i, 0]
        cy += s[i, 1]
        cz += s[i, 2]
    norm = math.sqrt(cx * cx + cy * cy + cz * cz)
    cx, cy, cz = cx / norm, cy / norm, cz / norm
    ax, ay, az = (0.0, -cz, cy) if abs(cx) < 0.7 else (cz, 0.0, -cx)
    norm = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / norm, ay / norm, az / norm
    bx, by, bz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    for i in range(n):
        x[i] = s[s0 + i, 0] * ax + s[s0 + i, 1] * ay + s[s0 + i, 2] * az
        y[i] = s[s0 + i, 0] * bx + s[s0 + i, 1] * by + s[s0 + i, 2] * bz
        azimuth[i] = math.atan2(y[i], x[i])


@_part
def _interleave(ranked, n, turn, pool):
    """Take stars in turn from three sectors of azimuth, so that neighbours in `pool` lie about 120 degrees apart."""
    third = (n + 2) // 3
    place = 0
    for i in range(third):
        for sector in range(3):
            rank = sector * third + i
            if rank < n and place < n:
                pool[place] = ranked[(rank + turn) % n]
                place += 1
