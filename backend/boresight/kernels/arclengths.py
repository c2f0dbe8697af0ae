"""The camera, the arcs between stars, the batch and the square-root filters as compiled loops.

The layout is a structure of arrays. The stars of all exposures stand one exposure after another in the order that
`estimation.arcs` chose; exposure `k` owns the stars `star_start[k]:star_start[k + 1]`, n of them, and their 2n - 3 arcs
begin at arc `2 star_start[k] - 3 k`. Arcs are interleaved: number 2i joins stars i and i+1, number 2i + 1 joins i and i+2, so
the covariance R of an exposure (E Eqs 16-18) has half-bandwidth 4 and its lower factor is kept as five numbers an arc,
`band[a, 4 - d] = L[a, a - d]`.

The derivative of an arc is taken backwards. With c = s_i.s_j and g = (s_j - c s_i) / (|r_i| sin phi),

    d phi / d x = -(g_i . dr_i/dx) - (g_j . dr_j/dx)        (E Eq 38 with both errata)

and g.dr/dx collapses to a few products. Model 0, `inverted_wang`: r = (B U, B V, f) depends on the pixel through (U, V) alone,
dB = (2 b2 + 4 b4 rho^2)(U dU + V dV), which is also what E Eq 43 means, without its 0/0 on the principal point. Model 1,
`pinhole_radial`: r = (p, q, B), and dB follows from its radial equation. The loops take the number of the model before its state x.
`tests/test_kernels.py` holds every loop against plain NumPy.
"""

from __future__ import annotations

import math

import numba
import numpy as np

N_PARAMETERS = 8
HALF_BANDWIDTH = 4
_BAND = HALF_BANDWIDTH + 1
_HALVINGS = 6  # of a filter step that raises its frame's cost
_THIN = 0.1  # sine of an angle: orders with a thinner triangle are mended
# numbers kept a star: s(3), 1/|r|, then of model 0 M(3), U_u U_v V_u V_v, U_f V_f, u v, f/D^2, rho2, U V, column offset;
# of model 1 p q, 2 dB/dR^2, dB/dk1 dB/dk2, p/s, Delta/f, 1/f, B^2/T
_STAR = 20
_INVERTED_WANG = 0
_STEPS = 60  # of a bracketed Newton search, which takes about five
_SETTLED = 1e-11  # share of the root that the last step may be: its error is the square of that

# Reordering of sums and fused products are allowed; NaN and infinity keep their meaning.
_FAST = {"contract", "reassoc", "arcp", "nsz", "afn"}
_jit = numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")


@_jit
def _undistorted_radius(reach, k1, k2):
    """Solve r (1 + k1 r^2 + k2 r^4) = reach on the branch that rises from zero; NaN where it turns back before reach.

    Newton's method, halving a bracket where a step would leave it: [0, r_turn], r_turn the first zero of the slope.
    """
    turn2 = _turn_squared(k1, k2)
    low, high = 0.0, math.sqrt(turn2)
    if math.isfinite(high) and not high * (1.0 + turn2 * (k1 + k2 * turn2)) > reach:
        return math.nan
    r = min(reach, 0.99 * high)
    for _ in range(_STEPS):
        r2 = r * r
        excess = r * (1.0 + r2 * (k1 + k2 * r2)) - reach
        if excess > 0.0:
            high = r
        else:
            low = r
        step = excess / (1.0 + r2 * (3.0 * k1 + 5.0 * k2 * r2))
        r -= step
        if not low <= r <= high:
            r = 0.5 * (low + high)
        elif abs(step) <= _SETTLED * r:
            break
    return r


@_jit
def _turn_squared(k1, k2):
    """Smallest positive zero of the slope 1 + 3 k1 r^2 + 5 k2 r^4 in r^2; infinite where it does not below 1e12."""
    half = 1.5 * k1
    inside = half * half - 5.0 * k2
    if inside < 0.0:
        return math.inf
    root = math.sqrt(inside)
    if root - half > 1e-12:  # both forms of the quadratic's zeros without cancellation: 1 / (sqrt - 3 k1 / 2)
        return 1.0 / (root - half)
    return math.inf


@_jit
def _pinhole_star(x, pitch, row_px, col_px, w):
    """Fill `w` (20,) with one star's ray and derivatives of model 1; its module derives them."""
    s, f, u0, v0, k1, k2 = x[0], x[1], x[2], x[3], x[4], x[5]
    scale = pitch / f
    across = scale * (row_px - v0)
    p, q = s * across, scale * (col_px - u0)
    r = _undistorted_radius(math.sqrt(p * p + q * q), k1, k2)
    r2 = r * r
    B = 1.0 + r2 * (k1 + k2 * r2)
    T = 1.0 + r2 * (3.0 * k1 + 5.0 * k2 * r2)
    norm = 1.0 / math.sqrt(p * p + q * q + B * B)
    w[0], w[1], w[2], w[3] = p * norm, q * norm, B * norm, norm
    w[4], w[5], w[6] = p, q, (2.0 * k1 + 4.0 * k2 * r2) / (B * T)
    w[7], w[8] = r2 * B / T, r2 * r2 * B / T
    w[9], w[10], w[11], w[12] = across, scale, 1.0 / f, B * B / T


@_jit
def _wang_star(x, pitch, row_px, col_px, w):
    """Fill `w` (20,) with one star's ray and what its derivatives need of model 0 (E Eqs 1-7, 44-77)."""
    f, m0, n0, b4, b2, a1, a2, g_y = x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]
    dn = pitch * (col_px - n0)
    u = pitch * (row_px - m0)
    v = g_y * dn
    tilt = a1 * v + a2 * u
    inverse = 1.0 / (tilt + f)
    U = u * f * inverse
    V = v * f * inverse
    rho2 = U * U + V * V
    B = 1.0 + rho2 * (b2 + rho2 * b4)
    slope = 2.0 * b2 + 4.0 * b4 * rho2
    rx, ry = B * U, B * V
    norm = 1.0 / math.sqrt(rx * rx + ry * ry + f * f)
    fd2 = f * inverse * inverse
    w[0], w[1], w[2], w[3] = rx * norm, ry * norm, f * norm, norm
    w[4], w[5], w[6] = B + slope * U * U, slope * U * V, B + slope * V * V
    w[7], w[8] = fd2 * (a1 * v + f), -fd2 * a1 * u
    w[9], w[10] = -fd2 * a2 * v, fd2 * (a2 * u + f)
    w[11], w[12] = u * tilt * inverse * inverse, v * tilt * inverse * inverse
    w[13], w[14], w[15], w[16], w[17], w[18], w[19] = u, v, fd2, rho2, U, V, dn


@_jit
def _star(model, x, pitch, row_px, col_px, w):
    """Fill `w` (20,) with one star's ray and what its derivatives need."""
    if model == _INVERTED_WANG:
        _wang_star(x, pitch, row_px, col_px, w)
    else:
        _pinhole_star(x, pitch, row_px, col_px, w)


@_jit
def _aspect(model, x):
    """Scale between the pixel's sides, which derivatives need beside `w`: g_y, or s."""
    return x[7] if model == _INVERTED_WANG else x[0]


@_jit
def _subtract_pinhole_end(w, gx, gy, gz, aspect, h):
    """Subtract g . dr/dx of one end of an arc from its row `h` (8,) for model 1."""
    kx, ky = gx + gz * w[6] * w[4], gy + gz * w[6] * w[5]
    h[0] -= kx * w[9]
    h[1] += (kx * w[4] + ky * w[5]) * w[11]
    h[2] += ky * w[10]
    h[3] += kx * w[10] * aspect
    h[4] -= gz * w[7]
    h[5] -= gz * w[8]


@_jit
def _subtract_wang_end(w, gx, gy, gz, pitch, g_y, h):
    """Subtract g . dr/dx of one end of an arc from its row `h` (8,) for model 0."""
    radial = gx * w[17] + gy * w[18]
    h1 = gx * w[4] + gy * w[5]
    h2 = gx * w[5] + gy * w[6]
    ku = h1 * w[7] + h2 * w[9]
    kv = h1 * w[8] + h2 * w[10]
    tilt = w[15] * (h1 * w[13] + h2 * w[14])
    h[0] -= h1 * w[11] + h2 * w[12] + gz
    h[1] += pitch * ku
    h[2] += g_y * pitch * kv
    h[3] -= w[16] * w[16] * radial
    h[4] -= w[16] * radial
    h[5] += w[14] * tilt
    h[6] += w[13] * tilt
    h[7] -= w[19] * kv


@_jit
def _subtract_end(model, w, gx, gy, gz, pitch, aspect, h):
    """Subtract g . dr/dx of one end of an arc from its row `h` (8,)."""
    if model == _INVERTED_WANG:
        _subtract_wang_end(w, gx, gy, gz, pitch, aspect, h)
    else:
        _subtract_pinhole_end(w, gx, gy, gz, aspect, h)


@_jit
def _arclength(w, i, j):
    """Return (phi, cos phi, sin phi) between stars i and j by atan2, exact at every separation."""
    cx = w[i, 1] * w[j, 2] - w[i, 2] * w[j, 1]
    cy = w[i, 2] * w[j, 0] - w[i, 0] * w[j, 2]
    cz = w[i, 0] * w[j, 1] - w[i, 1] * w[j, 0]
    sine = math.sqrt(cx * cx + cy * cy + cz * cz)
    cosine = w[i, 0] * w[j, 0] + w[i, 1] * w[j, 1] + w[i, 2] * w[j, 2]
    return math.atan2(sine, cosine), cosine, sine


@_jit
def _arc(model, w, i, j, pitch, aspect, h):
    """Return the measured arc between stars i and j and fill its derivative row `h` (8,)."""
    phi, c, s = _arclength(w, i, j)
    ki, kj = w[i, 3] / s, w[j, 3] / s
    h[:] = 0.0
    _subtract_end(
        model, w[i],
        ki * (w[j, 0] - c * w[i, 0]), ki * (w[j, 1] - c * w[i, 1]), ki * (w[j, 2] - c * w[i, 2]),
        pitch, aspect, h,
    )  # fmt: skip
    _subtract_end(
        model, w[j],
        kj * (w[i, 0] - c * w[j, 0]), kj * (w[i, 1] - c * w[j, 1]), kj * (w[i, 2] - c * w[j, 2]),
        pitch, aspect, h,
    )  # fmt: skip
    return phi


@_jit
def _exposure_rows(model, x, pitch, row_px, col_px, phi, band, free, scale, w, h, e, H):
    """Whitened residuals `e` and scaled Jacobian `H` of one exposure; returns its unweighted sum of squares.

    The forward substitution with the banded factor runs while the rows are made: L e' = e, L H' = H (E Eqs 81, 82).
    """
    n = row_px.shape[0]
    n_free = free.shape[0]
    aspect = _aspect(model, x)
    for i in range(n):
        _star(model, x, pitch, row_px[i], col_px[i], w[i])
    total = 0.0
    for a in range(2 * n - 3):
        i = a // 2
        residual = _arc(model, w, i, i + 1 + a % 2, pitch, aspect, h) - phi[a]
        total += residual * residual
        inverse = 1.0 / band[a, 4]
        first = max(0, a - HALF_BANDWIDTH)
        for b in range(first, a):
            residual -= band[a, 4 - a + b] * e[b]
        e[a] = residual * inverse
        for p in range(n_free):
            value = h[free[p]] * scale[p]
            for b in range(first, a):
                value -= band[a, 4 - a + b] * H[b, p]
            H[a, p] = value * inverse
    return total


@_jit
def _exposure_residuals(model, x, pitch, row_px, col_px, phi, band, w, e):
    """Whitened residuals `e` of one exposure without derivatives; returns its unweighted sum of squares."""
    n = row_px.shape[0]
    for i in range(n):
        _star(model, x, pitch, row_px[i], col_px[i], w[i])
    total = 0.0
    for a in range(2 * n - 3):
        i = a // 2
        residual = _arclength(w, i, i + 1 + a % 2)[0] - phi[a]
        total += residual * residual
        for b in range(max(0, a - HALF_BANDWIDTH), a):
            residual -= band[a, 4 - a + b] * e[b]
        e[a] = residual / band[a, 4]
    return total


@_jit
def _largest_exposure(star_start):
    """Return the number of stars in the fullest exposure, for scratch space."""
    most = 0
    for k in range(star_start.shape[0] - 1):
        most = max(most, star_start[k + 1] - star_start[k])
    return most


@_jit
def solid_angles(model, x, pitch, row_px, col_px, omega):
    """Fill `omega` (n_stars,) with the solid angle of one pixel at each star, steradian.

    Called by `estimation.cameras`: omega = |det[r, dr/dm, dr/dn]| / |r|^3. Model 0, r = (B U, B V, f): dr has no third component,
    so the determinant is f det M det d(U, V)/d(u, v) times the pixel's area g_y Delta^2. Model 1, r = (p, q, B): it is
    B^2 / T times s Delta^2 / f^2.
    """
    w = np.empty(_STAR)
    for i in range(row_px.shape[0]):
        _star(model, x, pitch, row_px[i], col_px[i], w)
        if model == _INVERTED_WANG:
            stretch = (w[4] * w[6] - w[5] * w[5]) * (w[7] * w[10] - w[8] * w[9]) * x[0] * pitch * pitch
        else:
            stretch = w[12] * w[10] * w[10]
        omega[i] = abs(_aspect(model, x) * stretch) * w[3] * w[3] * w[3]


@_jit
def rays_and_jacobians(model, x, pitch, row_px, col_px, s, D):
    """Fill `s` (n_stars, 3) with unit directions in D and `D` (n_stars, 3, n_parameters) with ds/dx per parameter in SI.

    Called by `estimation.cameras` and the filters on singular values. ds = (I - s s^T) dr / |r|, so row k of D is g . dr with
    g = (e_k - s_k s) / |r|.
    """
    w, h = np.empty(_STAR), np.empty(N_PARAMETERS)
    aspect = _aspect(model, x)
    for i in range(row_px.shape[0]):
        _star(model, x, pitch, row_px[i], col_px[i], w)
        for k in range(3):
            s[i, k] = w[k]
            along = w[3] * w[k]
            h[:] = 0.0
            _subtract_end(
                model, w,
                (w[3] if k == 0 else 0.0) - along * w[0],
                (w[3] if k == 1 else 0.0) - along * w[1],
                (w[3] if k == 2 else 0.0) - along * w[2],
                pitch, aspect, h,
            )  # fmt: skip
            for p in range(D.shape[2]):
                D[i, k, p] = -h[p]


@_jit
def normal_equations(model, x, pitch, star_start, row_px, col_px, phi, band, free, scale, threshold, A, b):
    """Accumulate A = H'^T W H' (n_free, n_free) and b = H'^T W e' (n_free,); return (cost, unweighted sum of squares).

    Called by `estimation.batch`. H' is whitened and in units of `scale` (the typical sigmas of the free parameters). W holds
    Huber's weights min(1, threshold / |e'|), and an infinite threshold makes the cost chi-square; see `estimation.robust`.
    """
    most = _largest_exposure(star_start)
    n_free = free.shape[0]
    w, h = np.empty((most, _STAR)), np.empty(N_PARAMETERS)
    e, H = np.empty(2 * most), np.empty((2 * most, n_free))
    A[:] = 0.0
    b[:] = 0.0
    chi2 = 0.0
    total = 0.0
    for k in range(star_start.shape[0] - 1):
        s0, s1 = star_start[k], star_start[k + 1]
        a0, a1 = 2 * s0 - 3 * k, 2 * s1 - 3 * (k + 1)
        total += _exposure_rows(
            model, x, pitch, row_px[s0:s1], col_px[s0:s1], phi[a0:a1], band[a0:a1], free, scale, w, h, e, H
        )
        for a in range(a1 - a0):
            size = abs(e[a])
            if size > threshold:
                chi2 += threshold * (2.0 * size - threshold)
                weight = threshold / size
                e[a] *= weight
                for p in range(n_free):
                    b[p] += H[a, p] * e[a]
                    for q in range(p + 1):
                        A[p, q] += weight * H[a, p] * H[a, q]
                continue
            chi2 += e[a] * e[a]
            for p in range(n_free):
                b[p] += H[a, p] * e[a]
                for q in range(p + 1):
                    A[p, q] += H[a, p] * H[a, q]
    for p in range(n_free):
        for q in range(p):
            A[q, p] = A[p, q]
    return chi2, total


@_jit
def count_beyond(model, x, pitch, star_start, row_px, col_px, phi, band, threshold):
    """Return (arcs whose whitened residual is beyond `threshold`, sum of squares of all, each cut off at it).

    Called by `estimation.robust`.
    """
    most = _largest_exposure(star_start)
    w, e = np.empty((most, _STAR)), np.empty(2 * most)
    beyond, total = 0, 0.0
    for k in range(star_start.shape[0] - 1):
        s0, s1 = star_start[k], star_start[k + 1]
        a0, a1 = 2 * s0 - 3 * k, 2 * s1 - 3 * (k + 1)
        _exposure_residuals(model, x, pitch, row_px[s0:s1], col_px[s0:s1], phi[a0:a1], band[a0:a1], w, e)
        for a in range(a1 - a0):
            size = abs(e[a])
            beyond += size > threshold
            total += min(size, threshold) ** 2
    return beyond, total


@_jit
def residuals(model, x, pitch, star_start, row_px, col_px, phi, e):
    """Fill `e` (n_arcs,) with measured minus catalogue arclength, radians. Called by `estimation.metrics`."""
    w = np.empty((_largest_exposure(star_start), _STAR))
    for k in range(star_start.shape[0] - 1):
        s0, s1 = star_start[k], star_start[k + 1]
        a0 = 2 * s0 - 3 * k
        for i in range(s1 - s0):
            _star(model, x, pitch, row_px[s0 + i], col_px[s0 + i], w[i])
        for a in range(2 * (s1 - s0) - 3):
            e[a0 + a] = _arclength(w, a // 2, a // 2 + 1 + a % 2)[0] - phi[a0 + a]


@_jit
def sums_of_squares(model, states, pitch, star_start, row_px, col_px, phi, totals):
    """Fill `totals` (n_states,) with the unweighted sum of squares of the whole set at each state (n_states, 8).

    Called by `estimation.metrics.tail_rms` (E Eq 32).
    """
    w = np.empty((_largest_exposure(star_start), _STAR))
    for m in range(states.shape[0]):
        total = 0.0
        for k in range(star_start.shape[0] - 1):
            s0, s1 = star_start[k], star_start[k + 1]
            a0 = 2 * s0 - 3 * k
            for i in range(s1 - s0):
                _star(model, states[m], pitch, row_px[s0 + i], col_px[s0 + i], w[i])
            for a in range(2 * (s1 - s0) - 3):
                residual = _arclength(w, a // 2, a // 2 + 1 + a % 2)[0] - phi[a0 + a]
                total += residual * residual
        totals[m] = total


@_jit
def whitened_rows(model, x, pitch, star_start, row_px, col_px, phi, band, free, scale, e, H):
    """Fill whitened `e` (n_arcs,) and `H` (n_arcs, n_free) of several exposures. Called by `estimation.filters.extended`."""
    w, h = np.empty((_largest_exposure(star_start), _STAR)), np.empty(N_PARAMETERS)
    total = 0.0
    for k in range(star_start.shape[0] - 1):
        s0, s1 = star_start[k], star_start[k + 1]
        a0, a1 = 2 * s0 - 3 * k, 2 * s1 - 3 * (k + 1)
        total += _exposure_rows(
            model,
            x,
            pitch,
            row_px[s0:s1],
            col_px[s0:s1],
            phi[a0:a1],
            band[a0:a1],
            free,
            scale,
            w,
            h,
            e[a0:a1],
            H[a0:a1],
        )
    return total


@_jit
def carlson_update(z, S, h, innovation, f, gain):
    """Take in one whitened scalar measurement; z (8,) and upper triangular S (8, 8) change in place.

    Fewer than eight free parameters leave the last rows and columns zero: loops of constant length run twice as fast.

    f = S^T h (erratum to E Eq 87), alpha = 1 + f.f, and column by column S becomes S (I - f f^T / alpha)^(1/2)
    (erratum to E Eq 84) in Carlson's form, which stays triangular. Returns the normalised innovation squared.
    """
    n = N_PARAMETERS
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


@_jit
def inflate(S, q, M):
    """Replace S by the upper triangular factor of S S^T + diag(q^2), by Givens rotations of [S M] (erratum to E Eq 88)."""
    n = S.shape[0]
    M[:] = 0.0
    for j in range(n):
        M[j, j] = q[j]
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


@_jit
def _between_frames(S, q, widening, M):
    """Widen S by a forgetting factor's 1 / sqrt(lambda), then add the process noise q (8,)."""
    if widening != 1.0:
        for i in range(S.shape[0]):
            for j in range(i, S.shape[0]):
                S[i, j] *= widening
    if q.max() > 0.0:
        inflate(S, q, M)


@_jit
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


@_jit
def _frame_residuals(model, x, pitch, first, last, star_start, row_px, col_px, phi, band, w, e):
    """Whitened residuals `e` of the exposures first <= m < last, one after another; returns their unweighted sum of squares."""
    total = 0.0
    n_arcs = 0
    for m in range(first, last):
        s0, s1 = star_start[m], star_start[m + 1]
        a0, a1 = 2 * s0 - 3 * m, 2 * s1 - 3 * (m + 1)
        total += _exposure_residuals(
            model, x, pitch, row_px[s0:s1], col_px[s0:s1], phi[a0:a1], band[a0:a1], w, e[n_arcs:]
        )
        n_arcs += a1 - a0
    return total


@_jit
def _largest_frame(frame_start, star_start):
    """Return the number of arcs in the fullest frame, for scratch space."""
    most = 0
    for k in range(frame_start.shape[0] - 1):
        k0, k1 = frame_start[k], frame_start[k + 1]
        most = max(most, 2 * (star_start[k1] - star_start[k0]) - 3 * (k1 - k0))
    return most


@_jit
def square_root_filter(
    x, z, S, q, widening, model, pitch, frame_start, star_start, row_px, col_px, phi, band, free, scale, linearisations, rest,
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
    n_free = free.shape[0]
    n_frames = frame_start.shape[0] - 1
    most_arcs = _largest_frame(frame_start, star_start)
    w, h = np.empty((_largest_exposure(star_start), _STAR)), np.empty(N_PARAMETERS)
    e, H, post = np.empty(most_arcs), np.zeros((most_arcs, N_PARAMETERS)), np.empty(most_arcs)
    z_prior, z_at, S_prior = np.empty(N_PARAMETERS), np.empty(N_PARAMETERS), np.empty((N_PARAMETERS, N_PARAMETERS)).T
    f, gain, M, x0 = (
        np.empty(N_PARAMETERS),
        np.empty(N_PARAMETERS),
        np.empty((N_PARAMETERS, N_PARAMETERS)),
        np.empty(n_free),
    )
    for p in range(n_free):
        x0[p] = x[free[p]] - scale[p] * z[p]
    for k in range(n_frames):
        _between_frames(S, q, widening, M)
        z_prior[:] = z
        S_prior[:] = S
        n_arcs = 0
        total = 0.0
        frame_nis = 0.0
        done = 0
        for turn in range(linearisations):
            z_at[:] = z
            n_arcs = 0
            for m in range(frame_start[k], frame_start[k + 1]):
                s0, s1 = star_start[m], star_start[m + 1]
                a0, a1 = 2 * s0 - 3 * m, 2 * s1 - 3 * (m + 1)
                _exposure_rows(
                    model, x, pitch, row_px[s0:s1], col_px[s0:s1], phi[a0:a1], band[a0:a1], free, scale, w, h,
                    e[n_arcs:], H[n_arcs:],
                )  # fmt: skip
                n_arcs += a1 - a0
            z[:] = z_prior
            S[:] = S_prior
            frame_nis = 0.0
            for a in range(n_arcs):
                innovation = e[a]
                for p in range(N_PARAMETERS):
                    innovation += H[a, p] * (z[p] - z_at[p])  # it moves inside the frame (erratum to E Eq 83)
                frame_nis += carlson_update(z, S, H[a], innovation, f, gain)
            for p in range(n_free):
                x[free[p]] = x0[p] + scale[p] * z[p]
            before = _prior_cost(S_prior, z_at, z_prior, n_free, f)
            for a in range(n_arcs):
                before += e[a] * e[a]
            for _ in range(_HALVINGS):
                total = _frame_residuals(
                    model, x, pitch, frame_start[k], frame_start[k + 1], star_start, row_px, col_px, phi, band, w, post
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
                for p in range(N_PARAMETERS):
                    predicted += H[a, p] * (z[p] - z_at[p])
                worst = max(worst, abs(post[a] - predicted))
            if worst < rest:
                break
        states[k] = x
        for p in range(n_free):
            variance = 0.0
            for j in range(p, n_free):
                variance += S[p, j] * S[p, j]
            sigmas[k, p] = math.sqrt(variance)
        nis[k], dof[k], squares[k], passes[k] = frame_nis, n_arcs, total, done
        if not math.isfinite(total):
            return k
    return n_frames


@_jit
def unscented_filter(
    x, z, S, q, widening, model, pitch, frame_start, star_start, row_px, col_px, phi, band, free, scale, linearisations, rest,
    shrunk, straight, states, sigmas, nis, dof, squares, passes,
):  # fmt: skip
    """Run the square-root unscented filter over frames; arguments and result as in `square_root_filter`.

    Called by `estimation.filters.unscented`, which derives it. A frame is regressed again about its own posterior until that
    moves by less than `rest` of its sigmas and no sigma shrinks by more than the share `shrunk`; or only once, where the residuals
    are `straight` (trace of C C^T) over a spread that the posterior stays inside.
    """
    n_free = free.shape[0]
    n_frames = frame_start.shape[0] - 1
    most = _largest_frame(frame_start, star_start)
    w = np.empty((_largest_exposure(star_start), _STAR))
    e, H, C = np.empty(most), np.zeros((most, N_PARAMETERS)), np.empty((most, N_PARAMETERS))
    plus, minus = np.empty((N_PARAMETERS, most)), np.empty((N_PARAMETERS, most))
    z_prior, z_at, point = np.empty(N_PARAMETERS), np.empty(N_PARAMETERS), np.empty(x.shape[0])
    S_prior, S_at = np.empty((N_PARAMETERS, N_PARAMETERS)).T, np.empty((N_PARAMETERS, N_PARAMETERS)).T
    f, gain, M, x0 = (
        np.empty(N_PARAMETERS),
        np.empty(N_PARAMETERS),
        np.empty((N_PARAMETERS, N_PARAMETERS)),
        np.empty(n_free),
    )
    gamma = math.sqrt(n_free)
    for p in range(n_free):
        x0[p] = x[free[p]] - scale[p] * z[p]
    for k in range(n_frames):
        _between_frames(S, q, widening, M)
        z_prior[:] = z
        S_prior[:] = S
        k0, k1 = frame_start[k], frame_start[k + 1]
        n_arcs = 2 * (star_start[k1] - star_start[k0]) - 3 * (k1 - k0)
        frame_nis = 0.0
        done = 0
        for turn in range(linearisations):
            z_at[:] = z
            S_at[:] = S
            for i in range(n_free):
                for side in range(2):
                    reach = gamma if side == 0 else -gamma
                    point[:] = x
                    for p in range(n_free):
                        point[free[p]] = x0[p] + scale[p] * (z_at[p] + reach * S_at[p, i])
                    _frame_residuals(
                        model, point, pitch, k0, k1, star_start, row_px, col_px, phi, band, w,
                        plus[i] if side == 0 else minus[i],
                    )  # fmt: skip
            _regress(plus, minus, S_at, n_free, n_arcs, e, H, C)
            bent = _whiten_spread(C, n_free, n_arcs, e, H)
            z[:] = z_prior
            S[:] = S_prior
            frame_nis = 0.0
            for a in range(n_arcs):
                innovation = e[a]
                for p in range(N_PARAMETERS):
                    innovation += H[a, p] * (z[p] - z_at[p])
                frame_nis += carlson_update(z, S, H[a], innovation, f, gain)
            for p in range(n_free):
                x[free[p]] = x0[p] + scale[p] * z[p]
            done = turn + 1
            if bent < straight and _prior_cost(S_at, z, z_at, n_free, f) < 1.0:
                break
            if math.sqrt(_prior_cost(S, z, z_at, n_free, f)) < rest and _narrowing(S_at, S, n_free) < shrunk:
                break
        states[k] = x
        for p in range(n_free):
            variance = 0.0
            for j in range(p, n_free):
                variance += S[p, j] * S[p, j]
            sigmas[k, p] = math.sqrt(variance)
        total = _frame_residuals(model, x, pitch, k0, k1, star_start, row_px, col_px, phi, band, w, e)
        nis[k], dof[k], squares[k], passes[k] = frame_nis, n_arcs, total, done
        if not math.isfinite(total):
            return k
    return n_frames


@_jit
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


@_jit
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


@_jit
def _narrowing(before, after, n_free):
    """Largest share by which a conditional sigma, a diagonal entry of S, shrank."""
    worst = 0.0
    for p in range(n_free):
        worst = max(worst, 1.0 - abs(after[p, p] / before[p, p]))
    return worst


@_jit
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


@_jit
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


@_jit
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


@_jit
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


@_jit
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


@_jit
def _greedy(x, y, pool, window, order):
    """Order the stars of `pool` so that each new triangle is fat, looking `window` candidates ahead; return the thinnest."""
    n = pool.shape[0]
    order[0], order[1] = pool[0], pool[1]
    left = n - 2
    pool[:left] = pool[2:]
    thinnest = 1.0
    for place in range(2, n):
        best, best_fatness = 0, -1.0
        for c in range(min(window, left)):
            fat = _fatness(x, y, order[place - 2], order[place - 1], pool[c])
            if fat > best_fatness:
                best, best_fatness = c, fat
            if fat > 0.5:  # 30 degrees is fat enough: leave the rest for later triangles
                break
        order[place] = pool[best]
        for c in range(best, 0, -1):
            pool[c] = pool[c - 1]
        left -= 1
        pool[:left] = pool[1 : left + 1]
        thinnest = min(thinnest, best_fatness)
    return thinnest


@_jit
def _thinnest(x, y, order, first, last):
    """Return the thinnest of the triangles that begin at places first <= place < last of an order, and where it begins."""
    worst, place = 2.0, -1
    for p in range(max(first, 0), min(last, order.shape[0] - 2)):
        fat = _fatness(x, y, order[p], order[p + 1], order[p + 2])
        if fat < worst:
            worst, place = fat, p
    return worst, place


@_jit
def _mend(x, y, order, wanted):
    """Swap stars of the thinnest triangle with others while that makes all it touches fatter; return the thinnest left.

    A greedy order leaves its last stars no choice: two lines of stars end with three on one line. Each swap looks at six
    triangles, and ends with none as thin as the one it was made for, so at most as many swaps are made as there are thin triangles.
    """
    n = order.shape[0]
    for _ in range(n):
        worst, place = _thinnest(x, y, order, 0, n - 2)
        if worst > wanted:
            return worst
        best, best_a, best_b = worst, 0, 0
        for a in range(place, place + 3):
            for b in range(n):
                order[a], order[b] = order[b], order[a]
                fat = min(_thinnest(x, y, order, a - 2, a + 1)[0], _thinnest(x, y, order, b - 2, b + 1)[0])
                order[a], order[b] = order[b], order[a]
                if fat > best:
                    best, best_a, best_b = fat, a, b
        if best <= worst:
            return worst
        order[best_a], order[best_b] = order[best_b], order[best_a]
    return _thinnest(x, y, order, 0, n - 2)[0]


@_jit
def _exhaustive(x, y, n, order):
    """Try every order of at most seven stars, cutting branches that are already worse; return the best thinnest triangle."""
    trial = np.zeros(n, np.int64)
    choice = np.full(n, -1, np.int64)
    used = np.zeros(n, np.bool_)
    limit = np.ones(n + 1)
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
        if limit[depth + 1] <= best:
            continue
        if depth == n - 1:
            best = limit[n]
            order[:] = trial
            continue
        depth += 1
    return best


@_jit
def order_stars(star_start, s, order, fatness):
    """Order the stars of each exposure so that no three in a row are near collinear. Called by `estimation.arcs`.

    Fills `order` (n_stars,) with the place of each star in the input and `fatness` (n_exposures,) with the sine of the
    smallest angle among the triangles of consecutive stars.
    """
    most = _largest_exposure(star_start)
    x, y, azimuth = np.empty(most), np.empty(most), np.empty(most)
    pool, trial = np.empty(most, np.int64), np.empty(most, np.int64)
    for k in range(star_start.shape[0] - 1):
        s0, n = star_start[k], star_start[k + 1] - star_start[k]
        _flatten(s[s0 : s0 + n], x, y, azimuth)
        if n <= 7:
            fatness[k] = _exhaustive(x, y, n, trial[:n])
            order[s0 : s0 + n] = s0 + trial[:n]
            continue
        ranked = np.argsort(azimuth[:n])
        fatness[k] = -1.0
        for attempt in range(24 if n <= 20 else 6):
            _interleave(ranked, attempt, pool[:n])
            thinnest = _greedy(x, y, pool[:n], 12, trial[:n])
            if thinnest < _THIN:
                thinnest = _mend(x, y, trial[:n], _THIN)
            if thinnest > fatness[k]:
                fatness[k] = thinnest
                order[s0 : s0 + n] = s0 + trial[:n]
            if thinnest > 0.25:
                break


@_jit
def _flatten(s, x, y, azimuth):
    """Project directions onto the tangent plane of their mean; azimuth is about that mean."""
    n = s.shape[0]
    cx, cy, cz = s[:, 0].sum(), s[:, 1].sum(), s[:, 2].sum()
    norm = math.sqrt(cx * cx + cy * cy + cz * cz)
    cx, cy, cz = cx / norm, cy / norm, cz / norm
    ax, ay, az = (0.0, -cz, cy) if abs(cx) < 0.7 else (cz, 0.0, -cx)
    norm = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / norm, ay / norm, az / norm
    bx, by, bz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    for i in range(n):
        x[i] = s[i, 0] * ax + s[i, 1] * ay + s[i, 2] * az
        y[i] = s[i, 0] * bx + s[i, 1] * by + s[i, 2] * bz
        azimuth[i] = math.atan2(y[i], x[i])


@_jit
def _interleave(ranked, turn, pool):
    """Take stars in turn from three sectors of azimuth, so that neighbours in `pool` lie about 120 degrees apart."""
    n = ranked.shape[0]
    third = (n + 2) // 3
    place = 0
    for i in range(third):
        for sector in range(3):
            rank = sector * third + i
            if rank < n and place < n:
                pool[place] = ranked[(rank + turn) % n]
                place += 1
