"""Arcs that displaced stars change, whitened: what the score tests of departures from the model stand on, as one compiled pass.

With c = s_i.s_j and J_i the derivative of the unit vector s_i by the two coordinates in which star i is displaced by u_i,

    d phi = -(s_j . J_i u_i + s_i . J_j u_j) / sin phi,

and the forward substitution with the banded factor of R (`kernels.arclengths`) whitens it. The coordinates are pixels where the
centroids are displaced, and angles to the east and north where the catalogue is. The tests hold the loop against NumPy.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.kernels.compilation import FAST, loop

_BANDWIDTH = 4


@loop("i1 f2 f3 f2 f3 f2", fastmath=FAST - {"afn"})
def displaced_rows(star_start, s, J, band, u, G):
    """Fill `G` (n_arcs, n_fields) with the whitened change of every arc by each field of displacements.

    The caller is `calibration.trust.displacements`. `s`: (n_stars, 3) unit vectors. `J`: (n_stars, 3, 2) their derivative by the
    coordinates of the displacements. `band`: (n_arcs, 5) factor of R. `u`: (n_stars, 2, n_fields).
    """
    n_fields = u.shape[2]
    g = np.empty(4)
    for k in range(star_start.shape[0] - 1):
        s0 = star_start[k]
        a0 = 2 * s0 - 3 * k
        for a in range(2 * (star_start[k + 1] - s0) - 3):
            i = s0 + a // 2
            j = i + 1 + a % 2
            x = s[i, 1] * s[j, 2] - s[i, 2] * s[j, 1]
            y = s[i, 2] * s[j, 0] - s[i, 0] * s[j, 2]
            z = s[i, 0] * s[j, 1] - s[i, 1] * s[j, 0]
            row, inverse = a0 + a, 1.0 / band[a0 + a, _BANDWIDTH]
            weight = -inverse / math.sqrt(x * x + y * y + z * z)
            for m in range(2):
                g[m] = weight * (s[j, 0] * J[i, 0, m] + s[j, 1] * J[i, 1, m] + s[j, 2] * J[i, 2, m])
                g[2 + m] = weight * (s[i, 0] * J[j, 0, m] + s[i, 1] * J[j, 1, m] + s[i, 2] * J[j, 2, m])
            for c in range(n_fields):
                G[row, c] = g[0] * u[i, 0, c] + g[1] * u[i, 1, c] + g[2] * u[j, 0, c] + g[3] * u[j, 1, c]
            for b in range(max(0, a - _BANDWIDTH), a):
                factor = inverse * band[row, _BANDWIDTH - a + b]
                for c in range(n_fields):
                    G[row, c] -= factor * G[a0 + b, c]
