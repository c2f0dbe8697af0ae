"""What a tracker detected, ready to be matched with the sky."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Detections:
    """Detections of a set in the right-handed triad of D, exposure after exposure.

    Parameters
    ----------
    frame_start
        (n_frames + 1,) first exposure of each frame.
    row_start
        (n_exposures + 1,) first detection of each exposure.
    s
        (n_rows, 3) measured directions under the parameters matched with.
    G
        (n_rows, 3, p) their derivative times the square root of the parameters' covariance, ds/dx P^(1/2).
    sigma_rad
        (n_rows,) isotropic direction error.
    star_id
        (n_rows,) given Hipparcos numbers, 0 = none.
    given_s
        (n_rows, 3) apparent directions of the given stars, ICRS, NaN where there is none.
    own
        (n_rows,) True where that direction is the file's own and not the catalogue's.
    quaternion
        (n_exposures, 4) attitude given in the file, x y z w, ICRS to the triad; NaN where there is none.
    time_s
        (n_frames,) time of each frame, seconds from any epoch; NaN where unknown.
    """

    frame_start: IntArray
    row_start: IntArray
    s: FloatArray
    G: FloatArray
    sigma_rad: FloatArray
    star_id: IntArray
    given_s: FloatArray
    own: NDArray[np.bool_]
    quaternion: FloatArray
    time_s: FloatArray

    @property
    def n_exposures(self) -> int:
        """Number of exposures."""
        return len(self.row_start) - 1

    def frames(self, chosen: IntArray) -> tuple[Detections, IntArray, IntArray]:
        """Return some frames as a set of their own, with the places of its rows and exposures in this one."""
        if len(chosen) == len(self.frame_start) - 1:
            return self, np.arange(len(self.star_id)), np.arange(self.n_exposures)
        exposures = _ranges(self.frame_start, chosen)
        rows = _ranges(self.row_start, exposures)
        part = Detections(
            frame_start=np.append(0, np.cumsum(np.diff(self.frame_start)[chosen])),
            row_start=np.append(0, np.cumsum(np.diff(self.row_start)[exposures])),
            s=self.s[rows],
            G=self.G[rows],
            sigma_rad=self.sigma_rad[rows],
            star_id=self.star_id[rows],
            given_s=self.given_s[rows],
            own=self.own[rows],
            quaternion=self.quaternion[exposures],
            time_s=self.time_s[chosen],
        )
        return part, rows, exposures


def _ranges(start: IntArray, chosen: IntArray) -> IntArray:
    """All places start[k] to start[k + 1] of the chosen k, one after another."""
    counts = np.diff(start)[chosen]
    offsets = np.repeat(start[chosen] - np.append(0, np.cumsum(counts))[:-1], counts)
    return np.asarray(np.arange(counts.sum()) + offsets, np.int64)
