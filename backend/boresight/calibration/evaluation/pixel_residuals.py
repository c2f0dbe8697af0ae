"""Residuals in pixels: each centroid minus the projection of its catalogue direction under the best attitude of its exposure.

The attitude comes from directions (`estimation.attitude`); one Gauss-Newton step on the pixels makes it the best one there,

    w = N sum K^T r / sigma         r <- r - sigma K w         (letters of estimation.cramer_rao)

The stars of an exposure decide its attitude and, a little, the parameters, so a residual is smaller than the error it came
from: its covariance is sigma^2 M with M = I - K N K^T - J' P J'^T, and z = r / (sigma sqrt(M)) has variance one. At eleven
stars that is 7 %.

A star may be left out (`kept`), as one whose catalogue place is wrong: then no attitude rests on it, the residuals of its
neighbours are freed from it, and its own holds the errors of attitude and parameters beside its own: both signs in M turn.

w turns about the axes of D, and N is its covariance there. With parity -1 those axes are left-handed: with the mirror
F = diag(1, -1, 1) the same turn about the axes of the triad is -F w, its covariance F N F. The step takes w from the attitude: it
becomes C(-w) C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.cameras import CameraModel
from boresight.estimation.arcs import ArcSet, angular_sigma
from boresight.estimation.attitude import attitudes, to_matrix, vector_to_quaternion
from boresight.estimation.statistics.cramer_rao import CentroidRows, centroid_rows
from boresight.kernels.centroids import see_sky, settle


@dataclass(frozen=True)
class FreeCovariance:
    """What the parameters may still be: places and typical sigmas of the free ones (n_free,), covariance P in these units."""

    free: IntArray
    scale: FloatArray
    P: FloatArray


@dataclass(frozen=True)
class PixelResiduals:
    """Residuals of the stars of some exposures.

    `rows`: the linearised centroids that they stand on.

    `r`: (n_stars, 2) residual, row and column, pixels; NaN where an exposure has no attitude. `M`: (n_stars, 2, 2) share of a
    star's own error in its residual; of a star left out, its error with those of the others. `from_sky`: (n_stars, 2, 2) pixels
    a radian by which a star would move if its place went east and north. `inverse`: (n_stars, 2, 3) pixels a radian by which a
    star moves with its direction in D. `C`: (n_exposures, 3, 3) attitude, ICRS to the triad. `attitude_covariance`:
    (n_exposures, 3, 3) of it about the axes of the triad, rad^2, from centroid noise at known parameters.
    """

    rows: CentroidRows
    r: FloatArray
    M: FloatArray
    from_sky: FloatArray
    inverse: FloatArray
    C: FloatArray
    attitude_covariance: FloatArray


def pixel_residuals(
    camera: CameraModel,
    x: FloatArray,
    arcs: ArcSet,
    parity: int,
    freedom: FreeCovariance,
    kept: BoolArray | None = None,
) -> PixelResiduals:
    """Residuals at a state.

    `camera`, `parity`: of the sensor. `x`: (n_parameters,) SI. `arcs`: stars by exposures, directions included; each exposure
    keeps two stars or more. `freedom`: what the stars decided of the parameters; a covariance of zero takes x as known. `kept`:
    (n_stars,) stars that attitudes rest on; all when None.
    """
    kept = np.ones(arcs.n_stars, np.bool_) if kept is None else kept
    rows = centroid_rows(camera, x, arcs, freedom.free, freedom.scale, kept)
    sigma = np.where(kept, angular_sigma(camera, x, arcs), np.inf)
    C = attitudes(arcs.star_start, rows.s_d, arcs.s_i, sigma, parity).C
    s, from_sky = np.empty((arcs.n_stars, 3)), np.empty((arcs.n_stars, 2, 2))
    see_sky(arcs.star_start, C, arcs.s_i, float(parity), rows.inverse, s, from_sky)
    row, col = camera.project(x, s, arcs.pitch, near=(arcs.row_px, arcs.col_px))
    r, w, M = np.stack([arcs.row_px - row, arcs.col_px - col], axis=-1), np.empty((len(C), 3)), np.empty_like(from_sky)
    settle(arcs.star_start, r, arcs.sigma_px, kept, rows.J, rows.K, rows.N, np.ascontiguousarray(freedom.P), w, M)
    mirror = np.diag([1.0, float(parity), 1.0])
    return PixelResiduals(
        rows=rows,
        r=r,
        M=M,
        from_sky=from_sky,
        inverse=rows.inverse,
        C=to_matrix(vector_to_quaternion(-parity * w @ mirror)) @ C,
        attitude_covariance=mirror @ rows.N @ mirror,
    )
