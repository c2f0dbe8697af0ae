"""What every camera model offers, and nothing more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from boresight import kernels
from boresight.arrays import FloatArray


def corners(rows: int, columns: int) -> tuple[FloatArray, FloatArray]:
    """Rows and columns of the four outer corners of a detector, (4,) each, pixels."""
    return np.array([-0.5, -0.5, rows - 0.5, rows - 0.5]), np.array([-0.5, columns - 0.5, -0.5, columns - 0.5])


@dataclass(frozen=True)
class CameraModel:
    """A camera model as data: names, units and functions.

    Parameters
    ----------
    name
        As in the sensor file.
    kernel
        Number of the model in the compiled loops, see `boresight.kernels.arclengths`.
    parameter_names, symbols, units
        (n_parameters,) in state order; symbols are the paper's letters for pages, units for tables.
    directions
        `(x, row_px, col_px, pitch) -> s_d (n, 3)`, unit vectors in D.
    directions_and_jacobian
        `(x, row_px, col_px, pitch) -> (s_d (n, 3), ds_dx (n, 3, n_parameters))`.
    project
        `(x, s_d (n, 3), pitch) -> (row_px, col_px)`, NaN where the direction meets no detector point.
    principal_point
        `(x) -> (row_px, col_px)`.
    radial_tangent
        `(x, radius_px, pitch) -> (tan theta (n,), gradient (n, n_parameters))`, the symmetric part of the model.
    default_typical_sigma
        (n_parameters,) the paper's unit-to-unit spread, SI.
    plausible
        (n_parameters, 2) lowest and highest value that is not absurd, SI.
    """

    name: str
    kernel: int
    parameter_names: tuple[str, ...]
    symbols: tuple[str, ...]
    units: tuple[str, ...]
    directions: Callable[..., FloatArray]
    directions_and_jacobian: Callable[..., tuple[FloatArray, FloatArray]]
    project: Callable[..., tuple[FloatArray, FloatArray]]
    principal_point: Callable[..., tuple[float, float]]
    radial_tangent: Callable[..., tuple[FloatArray, FloatArray]]
    default_typical_sigma: tuple[float, ...]
    plausible: tuple[tuple[float, float], ...]

    def solid_angle(self, x: FloatArray, row_px: FloatArray, col_px: FloatArray, pitch: float) -> FloatArray:
        """Solid angle of one pixel at each place, (n,) steradian: |ds/dm x ds/dn|."""
        omega = np.empty(len(row_px))
        kernels.solid_angles(self.kernel, x, pitch, row_px, col_px, omega)
        return omega

    def cone_rad(self, x: FloatArray, rows: int, columns: int, pitch: float) -> float:
        """Angle from the z axis of D to the farthest corner of the detector, rad."""
        s = self.directions(x, *corners(rows, columns), pitch)
        return float(np.arccos(np.clip(s[:, 2].min(), -1.0, 1.0)))

    def blind_corner(self, x: FloatArray, rows: int, columns: int, pitch: float) -> tuple[float, float] | None:
        """Row and column of a corner of the detector that has no direction at state x; None where all of it has.

        Distortion that turns back does so beyond a radius about the principal point, so the corners are the first to go blind.
        """
        row, col = corners(rows, columns)
        with np.errstate(all="ignore"):
            blind = np.flatnonzero(~np.isfinite(self.directions(x, row, col, pitch)).all(axis=-1))
        return (float(row[blind[0]]), float(col[blind[0]])) if len(blind) else None
