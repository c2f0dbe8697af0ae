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
_HALVINGS = 6  # of a filter step that raises its frame's cost
_STEPS = 60  # of the search for a place on the detector, which takes about five
_SETTLED_PX = 1e-7  # the last step of it: its error is the square of that
_LEAST_SHARE = 1e-3  # of such a step: where less is needed the goal lies beyond what the camera sees
_THIN = 0.1  # sine of an angle: orders with a thinner triangle are mended
_TIE = 1e-9  # a triangle that is fatter by less is as fat: rounding must not choose an order
_FEW = 7  # stars of which every order is tried
_TAN_22_5 = math.sqrt(2.0) - 1.0
_NEXT, _NEXT_BUT_ONE, _TANGENTS, _PRODUCTS = 3, 10, 17, 6  # rows of scratch of a catalogue exposure
# Numbers by which scratch stands apart from what lies before it: where a loop writes within a few vectors behind what it reads, its
# compiled form takes one number at a time and rounds otherwise, and the last bits would depend on where the heap puts arrays.
_GAP = 64
_ROOM = 13  # rows of scratch an exposure: s (3), and five numbers of each of both kinds of arcs

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
def _directions(camera, x, pitch, row_px, col_px, first, n, g):
    """Fill the directions alone, the first three rows of `g` (3, at least n): what derivatives would take is not compiled."""
    at = numbers(camera, x)
    for i in range(n):
        tx, ty, _, _ = star(camera, at, pitch, row_px[first + i], col_px[first + i])
        norm = 1.0 / math.sqrt(tx * tx + ty * ty + 1.0)
        g[0, i], g[1, i], g[2, i] = tx * norm, ty * norm, norm


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


@_inlined
def angle(sine, cosine):
    """Angle in [0, pi] of a sine that is not negative and a cosine: atan2 without a branch or a call, so that loops run on vectors.

    With t the smaller over the larger in size, beyond tan(pi/8) turned back by pi/4, the arctangent is t + t^3 P(t^2) / Q(t^2), to
    2e-16 (S. L. Moshier, "Methods and Programs for Mathematical Functions", 1989, section 2; Cephes).
    """
    size = abs(cosine)
    low, high = (sine, size) if sine < size else (size, sine)
    far = low > _TAN_22_5 * high
    t = (low - high if far else low) / (low + high if far else high)
    z = t * t
    top, bottom = -8.750608600031904122785e-1 * z - 1.615753718733365076637e1, z + 2.485846490142306297962e1
    top, bottom = top * z - 7.500855792314704667340e1, bottom * z + 1.650270098316988542046e2
    top, bottom = top * z - 1.228866684490136173410e2, bottom * z + 4.328810604912902668951e2
    top, bottom = top * z - 6.485021904942025371773e1, bottom * z + 4.853903996359136964868e2
    bottom = bottom * z + 1.945506571482613964425e2
    phi = t + t * z * (top / bottom)
    phi = phi + 0.25 * math.pi if far else phi
    phi = 0.5 * math.pi - phi if sine > size else phi
    return math.pi - phi if cosine < 0.0 else phi


@_inlined
def _sine_and_cosine(g, i, j):
    """Return sine and cosine of the angle between directions i and j, columns of the first three rows of `g`."""
    cx = g[1, i] * g[2, j] - g[2, i] * g[1, j]
    cy = g[2, i] * g[0, j] - g[0, i] * g[2, j]
    cz = g[0, i] * g[1, j] - g[1, i] * g[0, j]
    return math.sqrt(cx * cx + cy * cy + cz * cz), g[0, i] * g[0, j] + g[1, i] * g[1, j] + g[2, i] * g[2, j]


@_inlined
def _angles(g, n, step, at):
    """Fill row `at` of `g` with the angles between n directions and those `step` places on, which are exact at every separation."""
    for i in range(n - step):
        sine, cosine = _sine_and_cosine(g, i, i + step)
        g[at, i] = angle(sine, cosine)


@_inlined
def _arcs(g, n, step, at):
    """Fill five rows of `g` from `at` on: the angles, and what multiplies the derivatives of t_x and t_y at either end."""
    for i in range(n - step):
        j = i + step
        sine, c = _sine_and_cosine(g, i, j)
        g[at, i] = angle(sine, c)
        ki, kj = g[2, i] / sine, g[2, j] / sine
        g[at + 1, i], g[at + 2, i] = ki * (c * g[0, i] - g[0, j]), ki * (c * g[1, i] - g[1, j])
        g[at + 3, i], g[at + 4, i] = kj * (c * g[0, j] - g[0, i]), kj * (c * g[1, j] - g[1, i])


@_inlined
def _exposure_rows(camera, x, pitch, s0, n, a0, row_px, col_px, phi, band, free, scale, w, g, e, H, at):
    """Whitened residuals `e` and scaled Jacobian `H` (., 8) of one exposure, from row `at` on; returns its sum of squares.

    The forward substitution with the banded factor runs while the rows are made: L e' = e, L H' = H (E Eqs 81, 82). The exposure
    has n stars from `s0` and its arcs from `a0` on. Places are passed instead of slices, and the loops over parameters have
    constant length: a slice counts references, a loop of unknown length is not unrolled, and both cost half as much again.
    """
    N = len(camera)
    _stars(camera, x, pitch, row_px, col_px, s0, n, w)
    _free_columns(camera, w, n, free)
    for i in range(n):
        g[0, i], g[1, i], g[2, i] = w[i, 0], w[i, 1], w[i, 2]
        for p in range(N):
            w[i, 4 + p] *= scale[p]
            w[i, 4 + N + p] *= scale[p]
    _arcs(g, n, 1, 3)
    _arcs(g, n, 2, 8)
    total = 0.0
    for a in range(2 * n - 3):
        i, odd = a // 2, a % 2
        j, kind = i + 1 + odd, 3 + 5 * odd
        residual = g[kind, i] - phi[a0 + a]
        ix, iy, jx, jy = g[kind + 1, i], g[kind + 2, i], g[kind + 3, i], g[kind + 4, i]
        total += residual * residual
        row = at + a
        inverse = 1.0 / band[a0 + a, 4]
        if a >= HALF_BANDWIDTH:
            l4, l3, l2, l1 = band[a0 + a, 0], band[a0 + a, 1], band[a0 + a, 2], band[a0 + a, 3]
            for p in range(N):
                h = ix * w[i, 4 + p] + iy * w[i, 4 + N + p] + jx * w[j, 4 + p] + jy * w[j, 4 + N + p]
                h = h - l4 * H[row - 4, p] - l3 * H[row - 3, p] - l2 * H[row - 2, p] - l1 * H[row - 1, p]
                H[row, p] = h * inverse
            residual -= l4 * e[row - 4] + l3 * e[row - 3] + l2 * e[row - 2] + l1 * e[row - 1]
        else:
            for p in range(N):
                h = ix * w[i, 4 + p] + iy * w[i, 4 + N + p] + jx * w[j, 4 + p] + jy * w[j, 4 + N + p]
                for b in range(a):
                    h -= band[a0 + a, 4 - a + b] * H[at + b, p]
                H[row, p] = h * inverse
            for b in range(a):
                residual -= band[a0 + a, 4 - a + b] * e[at + b]
        e[row] = residual * inverse
    return total


@_inlined
def _raw_residuals(camera, x, pitch, s0, n, a0, row_px, col_px, phi, g, e, at):
    """Measured minus catalogue arcs `e` of one exposure, from row `at` on, rad; returns their sum of squares."""
    _directions(camera, x, pitch, row_px, col_px, s0, n, g)
    _angles(g, n, 1, 3)
    _angles(g, n, 2, 4)
    total = 0.0
    for a in range(2 * n - 3):
        residual = g[3 + a % 2, a // 2] - phi[a0 + a]
        e[at + a] = residual
        total += residual * residual
    return total


@_inlined
def _exposure_residuals(camera, x, pitch, s0, n, a0, row_px, col_px, phi, band, g, e, at):
    """Whitened residuals `e` of one exposure, from row `at` on, without derivatives; returns its unweighted sum of squares."""
    total = _raw_residuals(camera, x, pitch, s0, n, a0, row_px, col_px, phi, g, e, at)
    for a in range(2 * n - 3):
        row = at + a
        residual = e[row]
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

    The search begins at what `place` holds, or at the principal point where that is no number or beyond a fold. Called by
    `cameras.model`, which derives it.
    """
    at = numbers(camera, x)
    _, _, dx, dy = star(camera, at, pitch, x[p], x[q])
    sign = 1.0 if dx[p] * dy[q] - dx[q] * dy[p] > 0.0 else -1.0
    for i in range(s.shape[0]):
        row, col = place[i, 0], place[i, 1]
        place[i, 0], place[i, 1] = math.nan, math.nan
        if not s[i, 2] > 0.0:
            continue
        goal_x, goal_y = s[i, 0] / s[i, 2], s[i, 1] / s[i, 2]
        tx, ty, dx, dy = star(camera, at, pitch, row, col)
        if not sign * (dx[p] * dy[q] - dx[q] * dy[p]) > 0.0:
            row, col = x[p], x[q]
            tx, ty, dx, dy = star(camera, at, pitch, row, col)
        off = math.hypot(goal_x - tx, goal_y - ty)
        for _ in range(_STEPS):
            xx, xy, yx, yy = -dx[p], -dx[q], -dy[p], -dy[q]
            determinant = xx * yy - xy * yx
            down = (yy * (goal_x - tx) - xy * (goal_y - ty)) / determinant
            right = (xx * (goal_y - ty) - yx * (goal_x - tx)) / determinant
            if abs(down) + abs(right) <= _SETTLED_PX:
                place[i, 0], place[i, 1] = row + down, col + right
                break
            share = 1.0
            while share > _LEAST_SHARE:
                tx, ty, dx, dy = star(camera, at, pitch, row + share * down, col + share * right)
                now = math.hypot(goal_x - tx, goal_y - ty)
                if now < off and sign * (dx[p] * dy[q] - dx[q] * dy[p]) > 0.0:
                    break
                share *= 0.5
            if share <= _LEAST_SHARE:
                break
            row, col, off = row + share * down, col + share * right, now


@loop("camera f1 f f1 f1 f2", fastmath=FAST)
def rays(camera, x, pitch, row_px, col_px, s):
    """Fill `s` (n_stars, 3) with unit directions in D. Called by `cameras.model`."""
    at = numbers(camera, x)
    for i in range(row_px.shape[0]):
        tx, ty, _, _ = star(camera, at, pitch, row_px[i], col_px[i])
        norm = 1.0 / math.sqrt(tx * tx + ty * ty + 1.0)
        s[i, 0], s[i, 1], s[i, 2] = tx * norm, ty * norm, norm


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
def _add_products(camera, e, H, n_arcs, g, C, T):
    """Add H^T e to g (8,), and H^T H to the lower triangle of C (8, 8); T (8, at least n_arcs) is room to put columns beside."""
    N = len(camera)
    for a in range(n_arcs):
        for p in range(N):
            T[p, a] = H[a, p]
    for p in range(N):
        total = 0.0
        for a in range(n_arcs):
            total += T[p, a] * e[a]
        g[p] += total
        for q in range(p + 1):
            total = 0.0
            for a in range(n_arcs):
                total += T[p, a] * T[q, a]
            C[p, q] += total


@loop("camera f1 f i1 f1 f1 f1 f2 i1 f1 f f2 f1", fastmath=FAST)
def normal_equations(camera, x, pitch, star_start, row_px, col_px, phi, band, free, scale, threshold, A, b):
    """Accumulate A = H'^T W H' (n_free, n_free) and b = H'^T W e' (n_free,); return (cost, unweighted sum of squares).

    Called by `estimation.batch`. H' is whitened and in units of `scale` (the typical sigmas of the free parameters). W holds
    Huber's weights min(1, threshold / |e'|), and an infinite threshold makes the cost chi-square; see `estimation.robust`.
    """
    N = len(camera)
    most = _largest_exposure(star_start)
    n_free = free.shape[0]
    w, room = np.empty((_GAP + most, _width(camera)))[_GAP:], np.empty((1 + _ROOM, max(most, _GAP)))[1:]
    e, H, T = (
        np.empty(_GAP + 2 * most)[_GAP:],
        np.empty((_GAP + 2 * most, N))[_GAP:],
        np.empty((_GAP + N, 2 * most))[_GAP:],
    )
    C, g, scales = np.zeros((N, N)), np.zeros(N), np.empty(N)
    _pad(scale, scales)
    chi2 = 0.0
    total = 0.0
    for k in range(star_start.shape[0] - 1):
        s0 = star_start[k]
        n = star_start[k + 1] - s0
        total += _exposure_rows(
            camera, x, pitch, s0, n, 2 * s0 - 3 * k, row_px, col_px, phi, band, free, scales, w, room, e, H, 0
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
        _add_products(camera, e, H, 2 * n - 3, g, C, T)
    for p in range(n_free):
        b[p] = g[p]
        for q in range(p + 1):
            A[p, q] = A[q, p] = C[p, q]
    return chi2, total


@loop("camera f1 f i1 f1 f1 f1 f2 f", fastmath=FAST)
def count_beyond(camera, x, pitch, star_start, row_px, col_px, phi, band, threshold):
    """Return (arcs whose whitened residual is beyond `threshold`, sum of squares of all, each cut off at it).

    Called by `estimation.robust`, and by `estimation.batch` for chi-square alone.
    """
    most = _largest_exposure(star_start)
    g, e = np.empty((1 + _ROOM, max(most, _GAP)))[1:], np.empty(_GAP + 2 * most)[_GAP:]
    beyond, total = 0, 0.0
    for k in range(star_start.shape[0] - 1):
        s0 = star_start[k]
        n = star_start[k + 1] - s0
        _exposure_residuals(camera, x, pitch, s0, n, 2 * s0 - 3 * k, row_px, col_px, phi, band, g, e, 0)
        for a in range(2 * n - 3):
            size = abs(e[a])
            beyond += size > threshold
            total += min(size, threshold) ** 2
    return beyond, total


@loop("camera f1 f i1 f1 f1 f1 f1", fastmath=FAST)
def residuals(camera, x, pitch, star_start, row_px, col_px, phi, e):
    """Fill `e` (n_arcs,) with measured minus catalogue arclength, radians. Called by `estimation.metrics`."""
    g = np.empty((1 + _ROOM, max(_largest_exposure(star_start), _GAP)))[1:]
    for k in range(star_start.shape[0] - 1):
        s0, a0 = star_start[k], 2 * star_start[k] - 3 * k
        _raw_residuals(camera, x, pitch, s0, star_start[k + 1] - s0, a0, row_px, col_px, phi, g, e, a0)


@loop("camera f2 f i1 f1 f1 f1 f1", fastmath=FAST)
def sums_of_squares(camera, states, pitch, star_start, row_px, col_px, phi, totals):
    """Fill `totals` (n_states,) with the unweighted sum of squares of the whole set at each state (n_states, 8).

    Called by `estimation.metrics.tail_rms` (E Eq 32).
    """
    most = _largest_exposure(star_start)
    g, e = np.empty((1 + _ROOM, max(most, _GAP)))[1:], np.empty(_GAP + 2 * most)[_GAP:]
    for m in range(states.shape[0]):
        total = 0.0
        for k in range(star_start.shape[0] - 1):
            s0, a0 = star_start[k], 2 * star_start[k] - 3 * k
            total += _raw_residuals(
                camera, states[m], pitch, s0, star_start[k + 1] - s0, a0, row_px, col_px, phi, g, e, 0
            )
        totals[m] = total


@loop("camera f1 f i1 f1 f1 f1 f2 i1 f1 f1 f2", fastmath=FAST)
def whitened_rows(camera, x, pitch, star_start, row_px, col_px, phi, band, free, scale, e, H):
    """Fill whitened `e` (n_arcs,) and `H` (n_arcs, n_free) of several exposures. Called by `estimation.filters.extended`."""
    N = len(camera)
    most, n_free = _largest_exposure(star_start), free.shape[0]
    w, g, one = (
        np.empty((_GAP + most, _width(camera)))[_GAP:],
        np.empty((1 + _ROOM, max(most, _GAP)))[1:],
        np.empty((_GAP + 2 * most, N))[_GAP:],
    )
    whitened, scales = np.empty(_GAP + 2 * most)[_GAP:], np.empty(N)
    _pad(scale, scales)
    total = 0.0
    for k in range(star_start.shape[0] - 1):
        s0 = star_start[k]
        n, a0 = star_start[k + 1] - s0, 2 * s0 - 3 * k
        total += _exposure_rows(
            camera, x, pitch, s0, n, a0, row_px, col_px, phi, band, free, scales, w, g, whitened, one, 0
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
def fold(S, M):
    """Replace S (n, n) by the upper triangular factor of S S^T + M M^T, by Givens rotations of [S M]; M (n, m) is used up."""
    for k in range(S.shape[0] - 1, -1, -1):
        for j in range(M.shape[1]):
            if M[k, j] == 0.0:
                continue
            r = math.hypot(S[k, k], M[k, j])
            c, s = S[k, k] / r, M[k, j] / r
            for i in range(k + 1):
                a, b = S[i, k], M[i, j]
                S[i, k] = c * a + s * b
                M[i, j] = c * b - s * a


@_part
def inflate(S, q, M):
    """Replace S by the upper triangular factor of S S^T + diag(q^2) (erratum to E Eq 88)."""
    n = S.shape[0]
    for i in range(n):
        for j in range(n):
            M[i, j] = q[i] if i == j else 0.0
    fold(S, M)


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


@_part
def _frame_cost(
    camera, x, pitch, first, last, star_start, row_px, col_px, phi, band, g, e, S_prior, z, z_prior, n_free, y
):  # fmt: skip
    """Cost of a frame at x, whose step is z: its departure from the prior plus its whitened residuals, both squared."""
    _frame_residuals(camera, x, pitch, first, last, star_start, row_px, col_px, phi, band, g, e)
    cost = _prior_cost(S_prior, z, z_prior, n_free, y)
    for a in range(2 * (star_start[last] - star_start[first]) - 3 * (last - first)):
        cost += e[a] * e[a]
    return cost


@_inlined
def _frame_residuals(camera, x, pitch, first, last, star_start, row_px, col_px, phi, band, g, e):
    """Whitened residuals `e` of the exposures first <= m < last, one after another; returns their unweighted sum of squares."""
    total = 0.0
    n_arcs = 0
    for m in range(first, last):
        s0 = star_start[m]
        n = star_start[m + 1] - s0
        total += _exposure_residuals(camera, x, pitch, s0, n, 2 * s0 - 3 * m, row_px, col_px, phi, band, g, e, n_arcs)
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
    most_arcs, fullest = _largest_frame(frame_start, star_start), _largest_exposure(star_start)
    w, g = np.empty((_GAP + fullest, _width(camera)))[_GAP:], np.empty((1 + _ROOM, max(fullest, _GAP)))[1:]
    e, H, post = (
        np.empty(_GAP + most_arcs)[_GAP:],
        np.empty((_GAP + most_arcs, N))[_GAP:],
        np.empty(_GAP + most_arcs)[_GAP:],
    )
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
                    camera, x, pitch, s0, n, 2 * s0 - 3 * m, row_px, col_px, phi, band, free, scales, w, g, e, H, n_arcs
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
            for halved in range(_HALVINGS + 1):
                total = _frame_residuals(
                    camera, x, pitch, frame_start[k], frame_start[k + 1], star_start, row_px, col_px, phi, band, g, post
                )
                after = _prior_cost(S_prior, z, z_prior, n_free, f)
                for a in range(n_arcs):
                    after += post[a] * post[a]
                if after <= before * (1.0 + 1e-9) or halved == _HALVINGS:
                    break  # x, its residuals and z belong together, after the last halving too
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


@loop("f1 f1 f2F f1 f camera f i1 i1 f1 f1 f1 f2 i1 f1 i f f f f f2 f2 f1 i1 f1 i1", first=False, fastmath=FAST)
def unscented_filter(
    x, z, S, q, widening, camera, pitch, frame_start, star_start, row_px, col_px, phi, band, free, scale, linearisations, rest,
    shrunk, straight, least, states, sigmas, nis, dof, squares, passes,
):  # fmt: skip
    """Run the square-root unscented filter over frames; arguments and result as in `square_root_filter`.

    Called by `estimation.filters.unscented`, which derives it. A frame is regressed again about its own posterior until that
    moves by less than `rest` of its sigmas and no sigma shrinks by more than the share `shrunk`; or only once, where the residuals
    are `straight` (trace of C C^T) over a spread that the posterior stays inside. Where a star has no ray at some point the
    spread is halved, down to the share `least`, and the frame is regressed again. A frame that does not come to rest is taken in
    once more from its prior, and now the spread is halved too where the posterior raises the frame's cost.
    """
    N = len(camera)
    n_free = free.shape[0]
    n_frames = frame_start.shape[0] - 1
    most = _largest_frame(frame_start, star_start)
    g = np.empty((1 + _ROOM, max(_largest_exposure(star_start), _GAP)))[1:]
    e, H, C = np.empty(_GAP + most)[_GAP:], np.empty((_GAP + most, N))[_GAP:], np.empty((_GAP + most, N))[_GAP:]
    H[:] = 0.0
    plus, minus = np.empty((_GAP + N, most))[_GAP:], np.empty((_GAP + N, most))[_GAP:]
    z_prior, z_at, point = np.empty(N), np.empty(N), np.empty(x.shape[0])
    S_prior, S_at = np.empty((N, N)).T, np.empty((N, N)).T
    f, gain, M, x0 = (
        np.empty(N),
        np.empty(N),
        np.empty((N, N)),
        np.empty(n_free),
    )
    gamma = math.sqrt(n_free)
    cost = 0.0
    for p in range(n_free):
        x0[p] = x[free[p]] - scale[p] * z[p]
    for k in range(n_frames):
        _between_frames(S, q, widening, M)
        _copy(camera, z, S, z_prior, S_prior)
        k0, k1 = frame_start[k], frame_start[k + 1]
        n_arcs = 2 * (star_start[k1] - star_start[k0]) - 3 * (k1 - k0)
        frame_nis = 0.0
        done = 0
        for damped in range(2):
            rests = False
            if damped:
                _copy(camera, z_prior, S_prior, z, S)
                for p in range(n_free):
                    x[free[p]] = x0[p] + scale[p] * z[p]
                cost = _frame_cost(
                    camera, x, pitch, k0, k1, star_start, row_px, col_px, phi, band, g, e, S_prior, z, z_prior, n_free, f
                )  # fmt: skip
            for turn in range(linearisations):
                _copy(camera, z, S, z_at, S_at)
                share, before = 1.0, cost
                while True:
                    total = 0.0
                    for i in range(n_free):
                        for side in range(2):
                            reach = gamma if side == 0 else -gamma
                            for p in range(N):
                                point[p] = x[p]
                            for p in range(n_free):
                                point[free[p]] = x0[p] + scale[p] * (z_at[p] + reach * S_at[p, i])
                            total += _frame_residuals(
                                camera, point, pitch, k0, k1, star_start, row_px, col_px, phi, band, g,
                                plus[i] if side == 0 else minus[i],
                            )  # fmt: skip
                    last = turn + 1 == linearisations or share < least
                    if math.isfinite(total) or last:  # a frame does not end on points of less than the whole spread
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
                        if damped:
                            cost = _frame_cost(
                                camera, x, pitch, k0, k1, star_start, row_px, col_px, phi, band, g, e, S_prior, z, z_prior,
                                n_free, f,
                            )  # fmt: skip
                        if not damped or last or cost <= before + n_free:
                            break
                    share *= 0.5
                    for i in range(n_free):
                        for p in range(i + 1):
                            S_at[p, i] *= 0.5
                done = turn + 1
                if share < 1.0:
                    continue
                if bent < straight and _prior_cost(S_at, z, z_at, n_free, f) < 1.0:
                    rests = True
                    break
                if math.sqrt(_prior_cost(S, z, z_at, n_free, f)) < rest and _narrowing(S_at, S, n_free) < shrunk:
                    rests = True
                    break
            if rests or linearisations == 1:
                break
        for p in range(N):
            states[k, p] = x[p]
        for p in range(n_free):
            variance = 0.0
            for j in range(p, n_free):
                variance += S[p, j] * S[p, j]
            sigmas[k, p] = math.sqrt(variance)
        total = _frame_residuals(camera, x, pitch, k0, k1, star_start, row_px, col_px, phi, band, g, e)
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
    g = np.empty((1 + _TANGENTS + _PRODUCTS, max(_largest_exposure(star_start), _GAP)))[1:]
    for k in range(star_start.shape[0] - 1):
        s0, n = star_start[k], star_start[k + 1] - star_start[k]
        a0 = 2 * s0 - 3 * k
        for i in range(n):
            g[0, i], g[1, i], g[2, i] = s[s0 + i, 0], s[s0 + i, 1], s[s0 + i, 2]
        _catalogue_arcs(g, n, 1, _NEXT)
        _catalogue_arcs(g, n, 2, _NEXT_BUT_ONE)
        _cosines(g, n)
        for a in range(2 * n - 3):
            phi[a0 + a] = g[_NEXT_BUT_ONE if a % 2 else _NEXT, a // 2]
        bad[k] = _factor(g, n, sigma, s0, band, a0)


@_inlined
def _catalogue_arcs(g, n, step, at):
    """Fill seven rows of `g` from `at` on: the arcs, and their unit tangents at the first star and at the other (3 each)."""
    for i in range(n - step):
        j = i + step
        sine, c = _sine_and_cosine(g, i, j)
        inverse = 1.0 / sine
        g[at, i] = angle(sine, c)
        g[at + 1, i], g[at + 4, i] = (g[0, j] - c * g[0, i]) * inverse, (g[0, i] - c * g[0, j]) * inverse
        g[at + 2, i], g[at + 5, i] = (g[1, j] - c * g[1, i]) * inverse, (g[1, i] - c * g[1, j]) * inverse
        g[at + 3, i], g[at + 6, i] = (g[2, j] - c * g[2, i]) * inverse, (g[2, i] - c * g[2, j]) * inverse


@_inlined
def _cosines(g, n):
    """Fill six rows of `g` with cos psi of an arc and those before it with which it shares a star (E Eq 17 with its erratum).

    Arc i, i + 1 shares star i with (i - 2, i) and (i - 1, i), and star i + 1 with (i - 1, i + 1); arc i, i + 2 shares star i with
    (i - 2, i), (i - 1, i) and (i, i + 1). Where there is none before, they are zero.
    """
    _cosine(g, n - 1, 2, _NEXT + 1, _NEXT_BUT_ONE + 4, 2, _TANGENTS)
    _cosine(g, n - 1, 1, _NEXT + 1, _NEXT + 4, 1, _TANGENTS + 1)
    _cosine(g, n - 1, 1, _NEXT + 4, _NEXT_BUT_ONE + 4, 1, _TANGENTS + 2)
    _cosine(g, n - 2, 2, _NEXT_BUT_ONE + 1, _NEXT_BUT_ONE + 4, 2, _TANGENTS + 3)
    _cosine(g, n - 2, 1, _NEXT_BUT_ONE + 1, _NEXT + 4, 1, _TANGENTS + 4)
    _cosine(g, n - 2, 0, _NEXT_BUT_ONE + 1, _NEXT + 1, 0, _TANGENTS + 5)


@_inlined
def _cosine(g, n, first, one, other, back, to):
    """Fill row `to` with the products of tangents in three rows from `one` on with those from `other` on, `back` places before."""
    for i in range(min(first, n)):
        g[to, i] = 0.0
    for i in range(first, n):
        b = i - back
        g[to, i] = g[one, i] * g[other, b] + g[one + 1, i] * g[other + 1, b] + g[one + 2, i] * g[other + 2, b]


@_inlined
def _factor(g, n, sigma, s0, band, a0):
    """Banded Cholesky factor of one exposure's R; returns True when a pivot is not positive.

    What the rows before an arc's hold is carried along: `l21` is L[a - 2, a - 3], of the row two before, one before its diagonal.
    """
    l11 = l12 = l13 = l21 = l22 = l31 = 0.0
    d1 = d2 = d3 = d4 = 0.0  # 1 / L[a - b, a - b]
    for a in range(2 * n - 3):
        i = a // 2
        variance, far = sigma[s0 + i] * sigma[s0 + i], sigma[s0 + i + 1 + a % 2] * sigma[s0 + i + 1 + a % 2]
        if a % 2:
            r4, r3, r2, r1 = (
                g[_TANGENTS + 3, i] * variance,
                g[_TANGENTS + 4, i] * variance,
                0.0,
                g[_TANGENTS + 5, i] * variance,
            )
        else:
            r4, r3, r2, r1 = 0.0, g[_TANGENTS, i] * variance, g[_TANGENTS + 1, i] * variance, g[_TANGENTS + 2, i] * far
        r4 *= d4
        r3 = (r3 - r4 * l31) * d3
        r2 = (r2 - r4 * l22 - r3 * l21) * d2
        r1 = (r1 - r4 * l13 - r3 * l12 - r2 * l11) * d1
        pivot = variance + far - (r4 * r4 + r3 * r3 + r2 * r2) - r1 * r1  # E Eq 16
        if not pivot > 0.0:
            return True
        root = math.sqrt(pivot)
        band[a0 + a, 0], band[a0 + a, 1], band[a0 + a, 2], band[a0 + a, 3], band[a0 + a, 4] = r4, r3, r2, r1, root
        l31, l21, l22, l11, l12, l13 = l21, l11, l12, r1, r2, r3
        d4, d3, d2, d1 = d3, d2, d1, 1.0 / root
    return False


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
    few_x, few_y = np.empty(_FEW), np.empty(_FEW)
    few_trial, choice = np.empty(_FEW, np.int64), np.empty(_FEW, np.int64)
    used, limit = np.empty(_FEW, np.bool_), np.empty(_FEW + 1)
    for k in range(star_start.shape[0] - 1):
        s0, n = star_start[k], star_start[k + 1] - star_start[k]
        _flatten(s, s0, n, x, y, azimuth)
        _rank(azimuth, n, ranked)  # so that the order of the rows decides nothing
        if n <= _FEW:
            for i in range(n):
                few_x[i], few_y[i] = x[ranked[i]], y[ranked[i]]
            fatness[k] = _exhaustive(few_x, few_y, n, trial, few_trial, choice, used, limit)
            for i in range(n):
                pool[i] = ranked[trial[i]]
            _take(pool, s0, n, order)
            continue
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
