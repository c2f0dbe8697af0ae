"""Residuals in pixels: each centroid minus the projection of its catalogue direction under the best attitude of its exposure.

The attitude comes from directions (`estimation.attitude`); one Gauss-Newton step on the pixels makes it the best one there,

    w = N sum K^T r / sigma         r <- r - sigma K w         (letters of estimation.cramer_rao)

The stars of an exposure decide its attitude and, a little, the parameters, so a residual is smaller than the error it came
from: its covariance is sigma^2 M with M = I - K N K^T - J' P J'^T, and z = r / (sigma sqrt(M)) has variance one. At eleven
stars that is 7 %.

A star may be left out (`kept`), as one whose catalogue place is wrong: then no attitude rests on it, and the residuals of its
neighbours are freed from it. Beyond `MOST_FRAMES` only frames spaced evenly over the set are looked at.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.calibration.estimate import covariance
from boresight.calibration.trust.ground import Ground, Unavailable, nested
from boresight.estimation.arcs import ArcSet, angular_sigma
from boresight.estimation.attitude import attitudes, triad
from boresight.estimation.cramer_rao import CentroidRows, centroid_rows, each, sums

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MOST_FRAMES = 1500
MOST_SHOWN = 2000
#: Residuals so many times what the arcs foresee mean that no rotation takes the sky to the detector: the wrong parity.
MIRRORED = 10.0
#: Least share of its own error that a star's residual is taken to hold; below, the exposure is the star's own.
LEAST_SHARE = 1e-6


@dataclass(frozen=True)
class Sightings:
    """Residuals of the stars of a set.

    Parameters
    ----------
    arcs
        The frames looked at.
    frame
        (n_stars,) frame number.
    r
        (n_stars, 2) residual, row and column, pixels; NaN where an exposure has no attitude.
    M
        (n_stars, 2, 2) share of a star's own error in its residual.
    from_sky
        (n_stars, 2, 2) pixels a radian by which a star would move if its place went east and north.
    """

    arcs: ArcSet
    frame: NDArray[np.int64]
    r: FloatArray
    M: FloatArray
    from_sky: FloatArray

    @property
    def known(self) -> BoolArray:
        """(n_stars,) which stars have a residual."""
        return np.isfinite(self.r[:, 0])

    @property
    def z(self) -> FloatArray:
        """(n_stars, 2) residuals over their own sigmas."""
        share = np.maximum(np.diagonal(self.M, axis1=1, axis2=2), LEAST_SHARE)
        return np.asarray(self.r / (self.arcs.sigma_px[:, None] * np.sqrt(share)))

    @property
    def spread(self) -> float:
        """How many times the stated centroid noise the residuals scatter, from the median, which wrong matches hardly move."""
        return float(np.median(np.abs(self.z[self.known])) / 0.67449)


def sightings(ground: Ground, kept: BoolArray | None = None) -> Sightings:
    """Residuals at the estimate.

    Parameters
    ----------
    kept
        (n_stars of the frames looked at,) stars that attitudes rest on; all when None.
    """
    arcs, camera, x = ground.thinned(MOST_FRAMES), ground.problem.camera, ground.x
    kept = np.ones(arcs.n_stars, np.bool_) if kept is None else kept
    rows = centroid_rows(camera, x, arcs, ground.parameters.free, ground.parameters.scale, kept)
    sigma = np.where(kept, angular_sigma(camera, x, arcs), np.inf)
    C = attitudes(arcs.star_start, rows.s_d, arcs.s_i, sigma, ground.problem.sensor.parity).C
    C_of = each(C, arcs.star_start)
    s = triad(np.einsum("nij,nj->ni", C_of, arcs.s_i), ground.problem.sensor.parity)
    row, col = camera.project(x, s, arcs.pitch)
    r = _settled(np.stack([arcs.row_px - row, arcs.col_px - col], axis=-1), rows, arcs, kept)
    toward = triad((C_of @ _east_and_north(arcs.s_i)).transpose(0, 2, 1), ground.problem.sensor.parity)
    found = Sightings(
        arcs=arcs,
        frame=np.repeat(arcs.frame, np.diff(arcs.star_start[arcs.frame_start])),
        r=r,
        M=_own_share(rows, arcs, covariance(ground.A)),
        from_sky=rows.inverse @ toward.transpose(0, 2, 1),
    )
    _check_parity(ground, found)
    return found


def _settled(r: FloatArray, rows: CentroidRows, arcs: ArcSet, kept: BoolArray) -> FloatArray:
    """Residuals (n_stars, 2) after the step that makes each attitude the best one for the pixels."""
    whitened = r / arcs.sigma_px[:, None]
    score = np.einsum("nki,nk->ni", rows.K, np.where(kept[:, None] & np.isfinite(whitened), whitened, 0.0))
    w = np.einsum("eij,ej->ei", rows.N, sums(score, arcs.star_start))
    return np.asarray(r - arcs.sigma_px[:, None] * np.einsum("nki,ni->nk", rows.K, each(w, arcs.star_start)))


def _own_share(rows: CentroidRows, arcs: ArcSet, P: FloatArray) -> FloatArray:
    """M of each star, (n_stars, 2, 2)."""
    of_attitude = rows.K @ each(rows.N, arcs.star_start) @ rows.K.transpose(0, 2, 1)
    return np.asarray(np.eye(2) - of_attitude - (rows.J @ P) @ rows.J.transpose(0, 2, 1))


def _east_and_north(s_i: FloatArray) -> FloatArray:
    """Unit tangents to the east and to the north at directions (n, 3), as columns (n, 3, 2)."""
    reach = np.hypot(s_i[:, 0], s_i[:, 1])
    safe = np.where(reach > 0, reach, 1.0)
    cos_ra, sin_ra = np.where(reach > 0, s_i[:, 0] / safe, 1.0), s_i[:, 1] / safe
    east = np.stack([-sin_ra, cos_ra, np.zeros_like(reach)], axis=-1)
    return np.stack([east, np.cross(s_i, east)], axis=-1)


def _check_parity(ground: Ground, found: Sightings) -> None:
    """Refuse residuals that no rotation can make small though the arcs fit."""
    per_arc = float(np.sqrt(np.median(ground.e**2)) / 0.67449)
    if not found.known.any() or found.spread > MIRRORED * max(per_arc, 1.0):
        raise Unavailable(
            "The arcs fit, yet no rotation takes the catalogue to the detector: the sensor's parity is probably wrong; "
            f"try {-ground.problem.sensor.parity:+d}."
        )


def residuals(ground: Ground, found: Sightings) -> dict[str, Any]:
    """At most `MOST_SHOWN` residuals, evenly thinned, for drawing."""
    places = np.flatnonzero(found.known)
    shown = places[np.unique(np.linspace(0, len(places) - 1, min(len(places), MOST_SHOWN)).round().astype(int))]
    arcs, star_id = found.arcs, ground.telemetry.star_id
    rms = float(np.sqrt(np.mean(found.r[places] ** 2)))
    return {
        "row_px": nested(arcs.row_px[shown]),
        "col_px": nested(arcs.col_px[shown]),
        "d_row_px": nested(found.r[shown, 0]),
        "d_col_px": nested(found.r[shown, 1]),
        "star_id": None if star_id is None else star_id[arcs.source_row[shown]].tolist(),
        "frame": found.frame[shown].tolist(),
        "rms_px": rms,
        "spread": found.spread,
        "stars_in_all": len(places),
        "frames_used": arcs.n_frames,
        "sentence": (
            f"Centroids lie {rms:.3g} px (rms an axis) from their stars under the best attitude "
            f"of each exposure, {found.spread:.2f} times the stated noise."
        ),
    }
