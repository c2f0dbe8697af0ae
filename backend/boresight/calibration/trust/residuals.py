"""Residuals of a set in pixels, for everything that trust says of single stars; `pixel_residuals` derives them.

Beyond `MOST_FRAMES` only frames spaced evenly over the set are looked at.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import BoolArray, FloatArray
from boresight.calibration.calibration import Residuals
from boresight.calibration.evaluation.pixel_residuals import FreeCovariance, pixel_residuals
from boresight.calibration.trust.fitted_set import FittedSet, Unavailable, nested
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import covariance

MOST_FRAMES = 1500
MOST_SHOWN = 2000
#: Residuals so many times what the arcs foresee mean that no rotation takes the sky to the detector: the wrong parity.
MIRRORED = 10.0
#: What is said then, by the parity to try.
OTHER_PARITY = {
    parity: "The arcs agree with the catalogue, but no rotation maps the catalogue to the detector: the sensor's parity is "
    "probably wrong; "
    f"try {parity:+d}."
    for parity in (-1, 1)
}
#: Least share of its own error that a star's residual is taken to hold; below, the exposure is the star's own.
LEAST_SHARE = 1e-6


@dataclass(frozen=True)
class StarResiduals:
    """Residuals of the stars of a set.

    `arcs`: the frames looked at. `frame`: (n_stars,) frame number. `r`: (n_stars, 2) residual, row and column, pixels; NaN
    where an exposure has no attitude. `M`: (n_stars, 2, 2) share of a star's own error in its residual. `from_sky`: (n_stars,
    2, 2) pixels a radian by which a star would move if its place went east and north.
    """

    arcs: ArcSet
    frame: NDArray[np.int64]
    r: FloatArray
    M: FloatArray
    from_sky: FloatArray

    @cached_property
    def known(self) -> BoolArray:
        """(n_stars,) which stars have a residual."""
        return np.isfinite(self.r[:, 0])

    @cached_property
    def z(self) -> FloatArray:
        """(n_stars, 2) residuals over their own sigmas."""
        share = np.maximum(np.diagonal(self.M, axis1=1, axis2=2), LEAST_SHARE)
        return np.asarray(self.r / (self.arcs.sigma_px[:, None] * np.sqrt(share)))

    @cached_property
    def spread(self) -> float:
        """How many times the stated centroid noise the residuals scatter, from the median, which wrong matches hardly move."""
        return float(np.median(np.abs(self.z[self.known])) / 0.67449)


def compute_star_residuals(fitted: FittedSet, kept: BoolArray | None = None) -> StarResiduals:
    """Residuals at the estimate.

    `kept`: (n_stars of the frames looked at,) stars that attitudes rest on; all when None.
    """
    arcs = fitted.thinned(MOST_FRAMES)
    freedom = FreeCovariance(fitted.parameters.free, fitted.parameters.scale, covariance(fitted.A))
    seen = pixel_residuals(fitted.problem.camera, fitted.x, arcs, fitted.problem.sensor.parity, freedom, kept)
    found = StarResiduals(
        arcs=arcs,
        frame=np.repeat(arcs.frame, np.diff(arcs.star_start[arcs.frame_start])),
        r=seen.r,
        M=seen.M,
        from_sky=seen.from_sky,
    )
    _check_parity(fitted, found)
    return found


def _check_parity(fitted: FittedSet, found: StarResiduals) -> None:
    """Refuse residuals that no rotation can make small though the arcs fit."""
    per_arc = float(np.sqrt(np.median(fitted.e**2)) / 0.67449)
    if not found.known.any() or found.spread > MIRRORED * max(per_arc, 1.0):
        raise Unavailable(OTHER_PARITY[-fitted.problem.sensor.parity])


def residuals(fitted: FittedSet, found: StarResiduals) -> Residuals:
    """At most `MOST_SHOWN` residuals, evenly thinned, for drawing."""
    places = np.flatnonzero(found.known)
    shown = places[np.unique(np.linspace(0, len(places) - 1, min(len(places), MOST_SHOWN)).round().astype(int))]
    arcs, star_id = found.arcs, fitted.telemetry.star_id
    rms = float(np.sqrt(np.mean(found.r[places] ** 2)))
    return Residuals(
        row_px=nested(arcs.row_px[shown]),
        col_px=nested(arcs.col_px[shown]),
        d_row_px=nested(found.r[shown, 0]),
        d_col_px=nested(found.r[shown, 1]),
        star_id=None if star_id is None else star_id[arcs.source_row[shown]].tolist(),
        frame=found.frame[shown].tolist(),
        rms_px=rms,
        spread=found.spread,
        stars_in_all=len(places),
        frames_used=arcs.n_frames,
        sentence=(
            f"Centroids are {rms:.3g} px (RMS per axis) from their stars under the best attitude "
            f"of each exposure, {found.spread:.2f} times the stated noise."
        ),
    )
