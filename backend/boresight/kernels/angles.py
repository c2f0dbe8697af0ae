"""The angular distances of all pairs of an exposure as compiled loops: derivatives, covariance and whitened rows.

`estimation.angular` derives it: of N (N - 1) / 2 arcs only 2 N - 3 are independent, so they are whitened by the least-squares
displacement of the N stars. Pairs are numbered (0,1) (0,2) ... (1,2) ...; the exposures of one frame are taken together, `most`
the number of stars of the fullest of them, and arrays are that large for each. The tests hold every loop against plain NumPy.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.kernels.compilation import FAST, loop, part

_part = part(fastmath=FAST)


@_part
def _tangent_axes(s, axes):
    """Fill axes (n, 2, 3): two unit vectors across each direction."""
    for i in range(s.shape[0]):
        x, y, z = s[i, 0], s[i, 1], s[i, 2]
        ax, ay, az = (0.0, -z, y) if abs(x) < 0.7 else (z, 0.0, -x)
        norm = 1.0 / math.sqrt(ax * ax + ay * ay + az * az)
        ax, ay, az = ax * norm, ay * norm, az * norm
        axes[i, 0, 0], axes[i, 0, 1], axes[i, 0, 2] = ax, ay, az
        axes[i, 1, 0], axes[i, 1, 1], axes[i, 1, 2] = y * az - z * ay, z * ax - x * az, x * ay - y * ax


@_part
def _pair(s, i, j, t_i, t_j):
    """Angle of a pair; fills the unit tangents (3,) with which it leaves its ends."""
    cx = s[i, 1] * s[j, 2] - s[i, 2] * s[j, 1]
    cy = s[i, 2] * s[j, 0] - s[i, 0] * s[j, 2]
    cz = s[i, 0] * s[j, 1] - s[i, 1] * s[j, 0]
    sine = math.sqrt(cx * cx + cy * cy + cz * cz)
    cosine = s[i, 0] * s[j, 0] + s[i, 1] * s[j, 1] + s[i, 2] * s[j, 2]
    inverse = 1.0 / sine
    for axis in range(3):
        t_i[axis] = (s[j, axis] - cosine * s[i, axis]) * inverse
        t_j[axis] = (s[i, axis] - cosine * s[j, axis]) * inverse
    return math.atan2(sine, cosine)


@_part
def _add_turns(s, sigma, axes, M, turn):
    """Add K K^T to M (2 n, 2 n), the bulk rotations that no pair sees, of the size of its own entries."""
    n = s.shape[0]
    mean = 0.0
    for i in range(n):
        mean += sigma[i] / n
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        for i in range(n):
            for d in range(2):  # (e_k x s) . axis
                turn[2 * i + d] = (axes[i, d, b] * s[i, a] - axes[i, d, a] * s[i, b]) * mean / sigma[i]
        for p in range(2 * n):
            for q in range(p + 1):
                M[p, q] += turn[p] * turn[q]


@_part
def _factor(M, n):
    """Replace the lower triangle of M (n, n) by its Cholesky factor."""
    for i in range(n):
        for j in range(i + 1):
            value = M[i, j]
            for t in range(j):
                value -= M[i, t] * M[j, t]
            M[i, j] = math.sqrt(value) if i == j else value / M[j, j]


@loop("i1 f2 f1 f2 f3 f3", fastmath=FAST)
def factor_pairs(star_start, s_i, sigma, phi, G, L):
    """Take the catalogue's pairs of one frame. Called by `estimation.filters.angular`.

    `star_start` (n_exposures + 1,) begins at 0; `sigma` (n_stars,) rad. Fills per exposure `phi` (pairs of most,), the angles; `G`
    (pairs of most, 4), their derivatives by the two coordinates of each end in its sigmas; `L` (2 most, 2 most), the
    lower factor of G^T G + K K^T.
    """
    most = L.shape[1] // 2
    turn = np.empty(2 * most)
    axes, t_i, t_j, places = np.empty((most, 2, 3)), np.empty(3), np.empty(3), np.empty(4, np.int64)
    for e in range(star_start.shape[0] - 1):
        s, error = s_i[star_start[e] : star_start[e + 1]], sigma[star_start[e] : star_start[e + 1]]
        n = s.shape[0]
        _tangent_axes(s, axes)
        L[e] = 0.0
        a = 0
        for i in range(n):
            for j in range(i + 1, n):
                phi[e, a] = _pair(s, i, j, t_i, t_j)
                for d in range(2):
                    G[e, a, d], G[e, a, 2 + d] = 0.0, 0.0
                    for axis in range(3):
                        G[e, a, d] -= error[i] * axes[i, d, axis] * t_i[axis]
                        G[e, a, 2 + d] -= error[j] * axes[j, d, axis] * t_j[axis]
                places[0], places[1], places[2], places[3] = 2 * i, 2 * i + 1, 2 * j, 2 * j + 1
                for p in range(4):
                    for q in range(p + 1):
                        L[e, places[p], places[q]] += G[e, a, p] * G[e, a, q]
                a += 1
        scale = 0.0  # G is in radians: K K^T is made as large as G^T G
        for p in range(2 * n):
            scale += L[e, p, p] / (2 * n * n)
        for p in range(2 * n):
            for q in range(p + 1):
                L[e, p, q] /= scale
        _add_turns(s, error, axes, L[e], turn)
        for p in range(2 * n):
            for q in range(p + 1):
                L[e, p, q] *= scale
        _factor(L[e], 2 * n)


@loop("i1 f2 f3 i1 f1 f2 f2 f3", fastmath=FAST)
def pair_rows(star_start, s, D, free, scale, phi, e, H):
    """Fill e (n_exposures, pairs of most), measured minus catalogue angles, and H (.., n_free), in units of `scale`.

    Called by `estimation.filters.angular`; s (n_stars, 3) and D (n_stars, 3, n_parameters) are the measured directions of one
    frame and their derivatives, `phi` that of `factor_pairs`.
    """
    t_i, t_j, h = np.empty(3), np.empty(3), np.empty(D.shape[2])
    for x in range(star_start.shape[0] - 1):
        a = 0
        for i in range(star_start[x], star_start[x + 1]):
            for j in range(i + 1, star_start[x + 1]):
                e[x, a] = _pair(s, i, j, t_i, t_j) - phi[x, a]
                for p in range(D.shape[2]):
                    h[p] = 0.0
                    for axis in range(3):
                        h[p] -= t_i[axis] * D[i, axis, p] + t_j[axis] * D[j, axis, p]
                for p in range(free.shape[0]):
                    H[x, a, p] = h[free[p]] * scale[p]
                a += 1


@loop("i1 f2 f3 f3 f3 f1 f2", fastmath=FAST)
def whiten_pairs(star_start, e, H, G, L, e_white, H_white):
    """Fill the displacement of every star in its sigmas that explains the residuals best, and its derivative.

    Called by `estimation.filters.angular`: y = (G^T G + K K^T)^-1 G^T e, rows 2 star_start ... of e_white (2 n_stars,) and the same
    of H_white (2 n_stars, n_free).
    """
    n_free = H.shape[2]
    for x in range(star_start.shape[0] - 1):
        first, n = 2 * star_start[x], star_start[x + 1] - star_start[x]
        e_white[first : first + 2 * n] = 0.0
        H_white[first : first + 2 * n] = 0.0
        a = 0
        for i in range(n):
            for j in range(i + 1, n):
                for d in range(4):
                    row, g = first + (2 * i + d if d < 2 else 2 * j + d - 2), G[x, a, d]
                    e_white[row] += g * e[x, a]
                    for p in range(n_free):
                        H_white[row, p] += g * H[x, a, p]
                a += 1
        _substitute(L[x], 2 * n, e_white[first : first + 2 * n], H_white[first : first + 2 * n])


@_part
def _substitute(L, n, e, H):
    """Solve L L^T y = [e H] in place, e (n,) and H (n, n_free)."""
    for i in range(n):
        inverse = 1.0 / L[i, i]
        for j in range(i):
            e[i] -= L[i, j] * e[j]
            for p in range(H.shape[1]):
                H[i, p] -= L[i, j] * H[j, p]
        e[i] *= inverse
        for p in range(H.shape[1]):
            H[i, p] *= inverse
    for i in range(n - 1, -1, -1):
        inverse = 1.0 / L[i, i]
        e[i] *= inverse
        for p in range(H.shape[1]):
            H[i, p] *= inverse
        for j in range(i):
            e[j] -= L[i, j] * e[i]
            for p in range(H.shape[1]):
                H[j, p] -= L[i, j] * H[i, p]
