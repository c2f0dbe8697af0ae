"""How far two fitted candidates put the stars apart, over the detector, with its uncertainty; no rotation counts.

Star identities and arcs see no rotation common to all directions, so it is taken out of the change: with s_a, s_b the directions
of a grid of places under both candidates, R their best common rotation (Wahba) and K the fields of small rotations,

    change = G (s_b - R s_a)        G = (D^T D)^-1 D^T, D = ds / d(row, column)

in pixels. Both estimates come from the same noise, so they are correlated: dx = -P H'^T e' for each, with whitened rows H' and
residuals e', and with F = G (I - K (K^T K)^-1 K^T) ds/dx the field of each, the covariance of the change is, over the noise's
variance,

    F_a P_a F_a^T + F_b P_b F_b^T - F_a P_a (H'_a^T H'_b) P_b F_b^T - its transpose.

For nested candidates that is Hausman's difference of the two covariances. It holds where noise alone parts them; the change that a
left out term makes comes on top, and is what is looked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight import kernels
from boresight.arrays import FloatArray
from boresight.calibration.choice.fits import Fits, FittedSubset, seen_by
from boresight.cameras.model import Role
from boresight.estimation.attitude import attitudes

#: Places along each side of the detector.
GRID = 21


@dataclass(frozen=True)
class DetectorChange:
    """A change of where stars are seen.

    `row_px`, `col_px`: (n,) places. `change_px`: (n, 2) change along rows and columns. `sigma_px`: (n,) one sigma of its size along
    its own direction.
    """

    row_px: FloatArray
    col_px: FloatArray
    change_px: FloatArray
    sigma_px: FloatArray

    @property
    def largest(self) -> tuple[float, float]:
        """Size of the largest change, and three sigma of it."""
        size = np.linalg.norm(self.change_px, axis=1)
        at = int(np.argmax(size))
        return float(size[at]), 3.0 * float(self.sigma_px[at])


@dataclass(frozen=True)
class _Side:
    """One candidate over the grid: directions s (n, 3), fields F (n, 3, n_free) per unit, P and whitened rows (n_arcs, n_free)."""

    s: FloatArray
    F: FloatArray
    P: FloatArray
    H: FloatArray


class ChangeOverDetector:
    """Changes between candidates of one set; what is computed of a candidate is kept while it is one of the two."""

    def __init__(self, fits: Fits, variance: float) -> None:
        sensor = fits.sensor
        rows, columns = np.linspace(0, sensor.rows - 1, GRID), np.linspace(0, sensor.columns - 1, GRID)
        grid = np.meshgrid(rows, columns, indexing="ij")
        self.row_px, self.col_px = grid[0].ravel(), grid[1].ravel()
        self._fits, self._variance = fits, variance
        self._kept: dict[int, tuple[FittedSubset, _Side]] = {}

    def __call__(self, before: FittedSubset, after: FittedSubset) -> DetectorChange | None:
        """Compare two candidates; None where one of them is not determined or does not see all of the detector."""
        if not (before.usable and after.usable):
            return None
        a, b = self._side(before), self._side(after)
        n = len(a.s)
        C = attitudes(np.array([0, n]), b.s, a.s, np.ones(n)).C[0]
        G = self._to_pixels(after)
        change = np.einsum("nij,nj->ni", G, b.s - a.s @ C.T)
        F_a, F_b = (np.einsum("nij,njp->nip", G, side.F) for side in (a, b))
        cross = a.P @ (a.H.T @ b.H) @ b.P
        size = np.linalg.norm(change, axis=1)
        towards = np.where(size[:, None] > 0, change / np.maximum(size, 1e-300)[:, None], np.sqrt(0.5))
        f_a, f_b = (np.einsum("ni,nip->np", towards, F) for F in (F_a, F_b))
        variance = (
            np.einsum("np,pq,nq->n", f_a, a.P, f_a)
            + np.einsum("np,pq,nq->n", f_b, b.P, f_b)
            - 2 * np.einsum("np,pq,nq->n", f_a, cross, f_b)
        )
        sigma = np.sqrt(np.maximum(variance, 0.0) * self._variance)
        return DetectorChange(self.row_px, self.col_px, change, sigma)

    def _side(self, fitted: FittedSubset) -> _Side:
        known = self._kept.get(id(fitted))
        if known is not None:
            return known[1]
        camera, free = fitted.camera, fitted.subset.free
        arcs, scale = seen_by(self._fits.arcs, camera), self._fits.scale(camera)[free]
        s, D = camera.directions_and_jacobian(fitted.x, self.row_px, self.col_px, arcs.pitch)
        K = np.stack([np.cross(axis, s) for axis in np.eye(3)], axis=-1)
        J = D[:, :, free]
        turned = np.linalg.solve(np.einsum("nka,nkb->ab", K, K), np.einsum("nka,nkp->ap", K, J))
        e, H = np.empty(arcs.n_arcs), np.empty((arcs.n_arcs, len(free)))
        kernels.whitened_rows(
            camera.kind,
            fitted.x,
            arcs.pitch,
            arcs.star_start,
            arcs.row_px,
            arcs.col_px,
            arcs.phi,
            arcs.band,
            free,
            scale,
            e,
            H,
        )
        side = _Side(s, J - K @ turned, fitted.P, H / scale)
        self._kept[id(fitted)] = fitted, side
        return side

    def _to_pixels(self, fitted: FittedSubset) -> FloatArray:
        """G (n, 2, 3): pixels of a small change of direction."""
        camera = fitted.camera
        _, D = camera.directions_and_jacobian(fitted.x, self.row_px, self.col_px, self._fits.arcs.pitch)
        moved = -D[:, :, [camera.place(Role.ROW), camera.place(Role.COLUMN)]]
        return np.asarray(np.linalg.solve(moved.transpose(0, 2, 1) @ moved, moved.transpose(0, 2, 1)))
