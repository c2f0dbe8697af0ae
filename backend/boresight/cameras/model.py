"""What a camera is, and what follows from its one definition.

A camera's file has a state, a `NamedTuple` whose fields are its parameters in order, each annotated with a `Parameter`; and one
function, `star(x, pitch, row_px, col_px)`, that returns for one centroid

    t_x, t_y, (d t_x / d x_1, ..., d t_x / d x_n), (d t_y / d x_1, ..., d t_y / d x_n)

where t = (s_x / s_z, s_y / s_z) are the tangents of the star's direction in D. It is plain arithmetic on numbers, compiled into
every loop (`boresight.kernels.star`); NaN says that the camera sees nothing at that place. All else follows here.

Directions. s = (t_x, t_y, 1) / |(t_x, t_y, 1)|, and ds = (I - s s^T) (dt_x, dt_y, 0) / |(t_x, t_y, 1)|.

Places on the detector. Every camera has a principal point among its parameters, and knows a place only by its distance from it; so
moving the place is moving the principal point back, dt/d(row) = -dt/d(row of the principal point). With that slope Newton's method
finds the place whose tangents are given, from the principal point outwards: a step is halved while it leads where the camera sees
nothing, where the slope's determinant has changed its sign, or farther from the goal. It so stays on the branch that rises from the
principal point, and what lies beyond its end is NaN. A pixel covers |det dt/d(row, col)| s_z^3 of the sphere.

Radial part. Where parameters that a symmetric camera has not (tilt, decentring, aspect) take their `neutral` value, the tangent
depends on the radius alone: it is t_x along a row from the principal point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from importlib import import_module
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from boresight import kernels
from boresight.arrays import FloatArray


def corners(rows: int, columns: int) -> tuple[FloatArray, FloatArray]:
    """Rows and columns of the four outer corners of a detector, (4,) each, pixels."""
    return np.array([-0.5, -0.5, rows - 0.5, rows - 0.5]), np.array([-0.5, columns - 0.5, -0.5, columns - 0.5])


class Role(Enum):
    """What a parameter does; a camera has one focal length, and one row and one column of its principal point."""

    FOCAL = "focal length"
    ROW = "principal point's row"
    COLUMN = "principal point's column"
    RADIAL = "radial distortion"
    TILT = "tilt"
    DECENTRING = "decentring"
    ASPECT = "aspect"


#: What a parameter is at rest, by its role, for what a symmetric camera has not.
NEUTRAL = {Role.TILT: 0.0, Role.DECENTRING: 0.0, Role.ASPECT: 1.0}
#: Change in typical sigmas beyond which a parameter deserves a second look; the six sensors of E Table III moved by up to 9.8.
FAR_TYPICAL_SIGMAS = 15.0


class Parameter(NamedTuple):
    """One parameter of a camera.

    Parameters
    ----------
    role
        What it does.
    symbol, unit
        Letters for pages and the unit of files.
    typical_sigma
        Spread from unit to unit where a sensor file says nothing else.
    lowest, highest
        Beyond these a value is absurd.
    shown
        Unit of pages and figures, and how many of it one of the file's is; the file's own where None.
    """

    role: Role
    symbol: str
    unit: str
    typical_sigma: float
    lowest: float
    highest: float
    shown: tuple[str, float] | None = None

    @property
    def neutral(self) -> float | None:
        """Value at which it does nothing, for what a symmetric camera has not; None for what it has."""
        return NEUTRAL.get(self.role)

    @property
    def written_unit(self) -> str:
        """Its unit as it is written behind a number; nothing where it has none."""
        return "" if self.unit == "1" else self.unit


class Equations(NamedTuple):
    """A camera in words and formulas: which way it runs, where it is written, its steps a line each, and the way back."""

    runs: str
    source: str
    steps: tuple[str, ...]
    inverse: str


class OpenCV(NamedTuple):
    """A camera as OpenCV and ROS write it: name of the distortion model, focal lengths in pixels, coefficients."""

    distortion_model: str
    f_x: float
    f_y: float
    coefficients: tuple[float, ...]


class Usual(NamedTuple):
    """For which fields a camera is taken where nobody names one: half the field from which on, degrees, and why."""

    from_deg: float
    reason: str


@dataclass(frozen=True)
class CameraModel:
    """A camera: its definition, and all that follows from it.

    Parameters
    ----------
    name
        As in the sensor file.
    state
        Type of its states: a `NamedTuple` of floats, each annotated with its `Parameter`.
    star
        The tangents of one star and their derivatives, see above.
    equations
        The same for whoever reads the numbers without this program.
    opencv
        `(parameters by name, pitch) -> (distortion model, f_x, f_y, coefficients)`, where OpenCV has this camera exactly.
    usual
        The fields that it is taken for where nobody names a camera; None where it must be named.
    """

    name: str
    state: type[Any]
    star: Callable[..., Any]
    equations: Equations
    opencv: Callable[[Mapping[str, float], float], OpenCV] | None = None
    usual: Usual | None = None

    def __post_init__(self) -> None:
        kernels.define(self.state, self.star)

    def __reduce__(self) -> tuple[Callable[[str], CameraModel], tuple[str]]:
        return find_camera, (self.name,)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is known of each parameter, in state order."""
        hints = get_type_hints(self.state, include_extras=True)
        return tuple(hints[name].__metadata__[0] for name in self.parameter_names)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in state order."""
        return tuple(self.state._fields)

    @property
    def symbols(self) -> tuple[str, ...]:
        """Letters of the parameters."""
        return tuple(one.symbol for one in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        return tuple(one.unit for one in self.parameters)

    @property
    def default_typical_sigma(self) -> tuple[float, ...]:
        """Spread of each parameter from unit to unit, SI."""
        return tuple(one.typical_sigma for one in self.parameters)

    @property
    def plausible(self) -> tuple[tuple[float, float], ...]:
        """Lowest and highest value of each parameter that is not absurd, SI."""
        return tuple((one.lowest, one.highest) for one in self.parameters)

    def find_implausible(self, values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
        """Yield each parameter whose value is no number in its plausible range, with what is expected; all of them have one."""
        for name, (low, high) in zip(self.parameter_names, self.plausible, strict=True):
            value = values[name]
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not is_number or not low <= value <= high:  # NaN neither
                yield name, f"{value!r}, expected a number from {low:g} to {high:g}"

    @cached_property
    def kind(self) -> Any:
        """A state by whose type the compiled loops know this camera."""
        return self.state(*np.zeros(len(self.state._fields)).tolist())

    def place(self, role: Role) -> int:
        """Return the place in the state of the first parameter that does something."""
        return [one.role for one in self.parameters].index(role)

    @cached_property
    def principal_places(self) -> tuple[int, int]:
        """Places in the state of the principal point's row and column."""
        return self.place(Role.ROW), self.place(Role.COLUMN)

    def plain(self, focal_px: float, row_px: float, col_px: float, pitch: float) -> FloatArray:
        """State (n_parameters,) without tilt and distortion, with this focal length and this principal point, pixels."""
        x = np.array([one.neutral or 0.0 for one in self.parameters])
        x[[self.place(Role.FOCAL), *self.principal_places]] = focal_px * self.focal_unit(pitch), row_px, col_px
        return x

    def focal_unit(self, pitch: float) -> float:
        """Return how much of the focal length's unit one pixel is."""
        return pitch if self.units[self.place(Role.FOCAL)] == "m" else 1.0

    def focal_px(self, x: FloatArray, pitch: float) -> float:
        """Focal length of a state, pixels."""
        return float(x[self.place(Role.FOCAL)]) / self.focal_unit(pitch)

    def principal_point(self, x: FloatArray) -> tuple[float, float]:
        """Row and column of the principal point, pixels."""
        row, col = self.principal_places
        return float(x[row]), float(x[col])

    def directions(self, x: FloatArray, row_px: ArrayLike, col_px: ArrayLike, pitch: float) -> FloatArray:
        """Star directions of detector positions.

        Parameters
        ----------
        x
            (n_parameters,) parameters, SI.
        row_px, col_px
            (n,) centroids, pixels, or of any other shape.
        pitch
            Pixel pitch, metres.

        Returns
        -------
        (n, 3) unit vectors in D; NaN where the camera sees nothing.
        """
        row, col, shape = _places(row_px, col_px)
        s = np.empty((row.size, 3))
        kernels.rays(self.kind, np.asarray(x, dtype=float), pitch, row, col, s)
        return s.reshape(*shape, 3)

    def directions_of_few(self, x: FloatArray, row_px: FloatArray, col_px: FloatArray, pitch: float) -> FloatArray:
        """Return `directions` (n, 3) of a few places, in Python: to read a sensor's description nothing need be compiled."""
        with np.errstate(all="ignore"):
            t = np.array([self.star(x, pitch, row, col)[:2] for row, col in zip(row_px, col_px, strict=True)])
            s = np.column_stack((t, np.ones(len(t))))
            return np.asarray(s / np.linalg.norm(s, axis=1, keepdims=True))

    def directions_and_jacobian(
        self, x: FloatArray, row_px: ArrayLike, col_px: ArrayLike, pitch: float
    ) -> tuple[FloatArray, FloatArray]:
        """Star directions and their derivatives.

        Returns
        -------
        s
            (n, 3) unit vectors in D.
        ds_dx
            (n, 3, n_parameters) per parameter in SI.
        """
        row, col, shape = _places(row_px, col_px)
        s, D = np.empty((row.size, 3)), np.empty((row.size, 3, len(self.state._fields)))
        kernels.rays_and_jacobians(self.kind, np.asarray(x, dtype=float), pitch, row, col, s, D)
        return s.reshape(*shape, 3), D.reshape(*shape, 3, -1)

    def project(
        self, x: FloatArray, s: FloatArray, pitch: float, near: tuple[FloatArray, FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Detector positions of directions.

        Parameters
        ----------
        x
            (n_parameters,) parameters, SI.
        s
            (n, 3) directions in D, any positive length.
        pitch
            Pixel pitch, metres.
        near
            (n,) rows and columns where the search begins; None is the principal point.

        Returns
        -------
        row_px, col_px
            (n,) pixels; NaN for a direction behind the sensor or beyond what the camera sees.
        """
        s = np.asarray(s, dtype=float)
        rays = np.ascontiguousarray(s.reshape(-1, 3))
        place = np.full((len(rays), 2), np.nan) if near is None else np.stack(near, axis=-1)
        kernels.project(self.kind, np.asarray(x, dtype=float), pitch, *self.principal_places, rays, place)
        return place[:, 0].reshape(s.shape[:-1]), place[:, 1].reshape(s.shape[:-1])

    def radial_tangent(self, x: FloatArray, radius_px: ArrayLike, pitch: float) -> tuple[FloatArray, FloatArray]:
        """Tangent of the off-axis angle at a radius, by the symmetric part of the camera alone.

        Returns
        -------
        tangent
            (n,) tan theta, tilt, decentring and aspect left out.
        gradient
            (n, n_parameters) its derivatives in SI.
        """
        neutral = [one.neutral for one in self.parameters]
        at = np.where([one is None for one in neutral], x, [one or 0.0 for one in neutral])
        s, D = self.directions_and_jacobian(
            at, x[self.principal_places[0]] + np.asarray(radius_px), x[self.principal_places[1]], pitch
        )
        kept = [one.role in {Role.FOCAL, Role.RADIAL} for one in self.parameters]
        gradient = (D[..., 0, :] - (s[..., 0] / s[..., 2])[..., None] * D[..., 2, :]) / s[..., 2, None]
        return s[..., 0] / s[..., 2], np.where(kept, gradient, 0.0)

    def solid_angle(self, x: FloatArray, row_px: FloatArray, col_px: FloatArray, pitch: float) -> FloatArray:
        """Solid angle of one pixel at each place, (n,) steradian: |ds/dm x ds/dn|."""
        omega = np.empty(len(row_px))
        kernels.solid_angles(self.kind, x, pitch, *self.principal_places, row_px, col_px, omega)
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
        blind = np.flatnonzero(~np.isfinite(self.directions_of_few(x, row, col, pitch)).all(axis=-1))
        return (float(row[blind[0]]), float(col[blind[0]])) if len(blind) else None


def find_camera(name: str) -> CameraModel:
    """Return the camera of a name, for processes that are handed one."""
    cameras: dict[str, CameraModel] = import_module("boresight.cameras").CAMERA_MODELS
    return cameras[name]


def _places(row_px: ArrayLike, col_px: ArrayLike) -> tuple[FloatArray, FloatArray, tuple[int, ...]]:
    row, col = np.broadcast_arrays(np.asarray(row_px, dtype=float), np.asarray(col_px, dtype=float))
    return np.ascontiguousarray(row).ravel(), np.ascontiguousarray(col).ravel(), row.shape
