"""Lenses of other programs, and the fit of one to a camera over its detector.

The camera frame E of these programs has X along columns, Y along rows and Z along the boresight, right-handed, and pixel centres
are taken at whole numbers from 0 here; who counts otherwise shifts on writing. With x = X / Z, y = Y / Z and r^2 = x^2 + y^2, a
lens of the pinhole kind moves a star to (x', y') and the pixel

    column = f_x x' + c_x        row = f_y y' + c_y

==============  ==============================================================================================================
plumb_bob       x' = x B + 2 p1 x y + p2 (r^2 + 2 x^2), y' = y B + p1 (r^2 + 2 y^2) + 2 p2 x y,
                B = 1 + k1 r^2 + k2 r^4 + k3 r^6
rational        the same with B / (1 + k4 r^2 + k5 r^4 + k6 r^6)
thin_prism      plumb_bob with s1 r^2 + s2 r^4 on x' and s3 r^2 + s4 r^4 on y'; `thin_prism_rational` of rational
tilted          plumb_bob, then the detector tilted: the ray of (x', y', 1) meets a plane turned by tau_x about x and
                tau_y about y; `tilted_rational` the same of rational (OpenCV, Camera Calibration and 3D Reconstruction)
equidistant     (x', y') = (x, y) (rho / r), rho = theta (1 + k1 theta^2 + ... + k4 theta^8), theta = atan r
owen            (x', y') = (x, y) (1 + e2 r^2 + e4 r^4 + e5 y + e6 x) + (e1 r + e3 r^3) (-y, x)
                (Owen, Cassini ISS geometric calibration, 2003), lengths in units of the focal length
tetra3          the image's centre is the principal point; r_u = r_d (1 - k (2 r_d / width)^2) / (1 - k) on the detector's side
==============  ==============================================================================================================

Our D has x along rows and y along columns, so x = t_y and y = t_x. With parity -1 that E is a rotation of the sky. With parity +1
it would be a left-handed triad; the same detector seen in a mirror, column' = columns - 1 - column and x = -t_y, has a right-handed
one, and is what can be written.

Fit. The directions of an even grid of pixels are held; the lens's parameters p, and where a `turn` R of E is allowed its rotation
vector, minimise the squared distance, in pixels, between where the lens shows each direction and the pixel (Levenberg and
Marquardt). A camera with tilted detector is another lens without a turn and nearly the same with one. The misfit is that distance
over another, finer grid, edges included. The covariance follows by the derivative of the fit, as in `calibration.conversion`: dp
= -J^+ dr, with dr the change of the residuals by one parameter of the camera.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.conversion import EXACT_PX, undone
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import OpenCV
from boresight.estimation.attitude import to_matrix, vector_to_quaternion
from boresight.estimation.residual_spline import Surface
from boresight.telemetry.sensors import Sensor

#: Places a side of the grid that is fitted, and of the one that judges.
FITTED, JUDGED = 21, 41
#: Steps of a fit: the last of many lenses crawl along a valley, where nothing is gained.
MOST_STEPS = 40
#: Share of the misfit allowed below which no further lens is tried.
AMPLE = 0.1
#: Rotation of the right-handed triad of D (x, -y, z with parity -1) to E: the same for a detector of parity +1 that is mirrored.
E_FROM_TRIAD = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
PINHOLE = ("f_x", "f_y", "c_x", "c_y")

Distortion = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class Lens:
    """A lens of another program.

    `distort`: (x, y, coefficients) to (x', y'), tangents; None is tetra3's. `coefficients`: their names. `powers`: power of the
    tangent that each goes with. `opencv`: name of the distortion model of `cameras.model.OpenCV` that this lens is, and contains.
    """

    name: str
    coefficients: tuple[str, ...]
    powers: tuple[int, ...]
    distort: Distortion | None
    opencv: str | None = None

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the fit."""
        return (("f",) if self.distort is None else PINHOLE) + self.coefficients


@dataclass(frozen=True)
class FittedLens:
    """A lens in place of a camera.

    `p`: (n,) parameters, pixels and powers of the tangent. `sigma`: (n,) one standard deviation, or None without a covariance.
    `turn`: (3, 3) R, from E to the frame in which the lens is written. `misfit_px`, `rms_px`: largest, and root mean square, over
    the detector. `mirrored`: the image is written mirrored left to right.
    """

    lens: Lens
    p: FloatArray
    sigma: FloatArray | None
    turn: FloatArray
    misfit_px: float
    rms_px: float
    mirrored: bool

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.lens.parameters, self.p.tolist(), strict=True))

    def list_coefficients(self, names: tuple[str, ...]) -> list[float]:
        """Return coefficients in a program's own order, 0 for those that this lens has not."""
        return [self.values.get(name, 0.0) for name in names]

    @property
    def turned(self) -> bool:
        """Whether the frame is another than E."""
        return bool((self.turn != np.eye(3)).any())


def _decentred(x: FloatArray, y: FloatArray, B: FloatArray, p1: float, p2: float) -> tuple[FloatArray, FloatArray]:
    r2 = x * x + y * y
    return x * B + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * B + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


def _plumb_bob(x: FloatArray, y: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    k1, k2, p1, p2, k3 = c
    r2 = x * x + y * y
    return _decentred(x, y, 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), p1, p2)


def _rational(x: FloatArray, y: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    k1, k2, p1, p2, k3, k4, k5, k6 = c
    r2 = x * x + y * y
    B = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return _decentred(x, y, B, p1, p2)


def _with_prism(base: Distortion, count: int) -> Distortion:
    """Add s1 to s4, which follow `count` coefficients of a base."""

    def distort(x: FloatArray, y: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
        r2 = x * x + y * y
        s1, s2, s3, s4 = c[count:]
        at_x, at_y = base(x, y, c[:count])
        return at_x + r2 * (s1 + r2 * s2), at_y + r2 * (s3 + r2 * s4)

    return distort


def _tilted(x: FloatArray, y: FloatArray, tau_x: float, tau_y: float) -> tuple[FloatArray, FloatArray]:
    """OpenCV's tilt: R = R_y(tau_y) R_x(tau_x), then the projection along z that keeps the origin."""
    c_x, s_x, c_y, s_y = math.cos(tau_x), math.sin(tau_x), math.cos(tau_y), math.sin(tau_y)
    R = np.array([[c_y, 0.0, -s_y], [0.0, 1.0, 0.0], [s_y, 0.0, c_y]])
    R = R @ np.array([[1.0, 0.0, 0.0], [0.0, c_x, s_x], [0.0, -s_x, c_x]])
    onto = np.array([[R[2, 2], 0.0, -R[0, 2]], [0.0, R[2, 2], -R[1, 2]], [0.0, 0.0, 1.0]])
    seen = np.stack([x, y, np.ones_like(x)], axis=-1) @ (onto @ R).T
    return seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]


def _with_tilt(base: Distortion, count: int) -> Distortion:
    """Add tau_x and tau_y, which follow `count` coefficients of a base."""
    return lambda x, y, c: _tilted(*base(x, y, c[:count]), *c[count:].tolist())


def _equidistant(x: FloatArray, y: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    k1, k2, k3, k4 = c
    r = np.hypot(x, y)
    theta = np.arctan(r)
    t2 = theta * theta
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(r > 0, theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) / r, 1.0)
    return x * share, y * share


def _owen(x: FloatArray, y: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    e2, e4, e5, e6, e1, e3 = c
    r2 = x * x + y * y
    r = np.sqrt(r2)
    B, pinwheel = 1 + r2 * (e2 + r2 * e4) + e5 * y + e6 * x, r * (e1 + r2 * e3)
    return x * B - y * pinwheel, y * B + x * pinwheel


PLUMB_BOB = Lens("plumb_bob", ("k1", "k2", "p1", "p2", "k3"), (3, 5, 2, 2, 7), _plumb_bob, "plumb_bob")
RATIONAL = Lens(
    "rational", (*PLUMB_BOB.coefficients, "k4", "k5", "k6"), (*PLUMB_BOB.powers, 3, 5, 7), _rational, "plumb_bob"
)


def _more(base: Lens, word: str, names: tuple[str, ...], powers: tuple[int, ...], distort: Distortion) -> Lens:
    """Return a lens that has what a base has, and more."""
    name = word if base is PLUMB_BOB else f"{word}_{base.name}"
    return Lens(name, base.coefficients + names, base.powers + powers, distort, base.opencv)


def _add_prism(base: Lens, distort: Distortion) -> Lens:
    named = _with_prism(distort, len(base.coefficients))
    return _more(base, "thin_prism", ("s1", "s2", "s3", "s4"), (2, 4, 2, 4), named)


def _add_tilt(base: Lens, distort: Distortion) -> Lens:
    return _more(base, "tilted", ("tau_x", "tau_y"), (2, 2), _with_tilt(distort, len(base.coefficients)))


THIN_PRISM, THIN_PRISM_RATIONAL = _add_prism(PLUMB_BOB, _plumb_bob), _add_prism(RATIONAL, _rational)
TILTED, TILTED_RATIONAL = _add_tilt(PLUMB_BOB, _plumb_bob), _add_tilt(RATIONAL, _rational)
EQUIDISTANT = Lens("equidistant", ("k1", "k2", "k3", "k4"), (3, 5, 7, 9), _equidistant, "equidistant")
OWEN = Lens("owen", ("e2", "e4", "e5", "e6", "e1", "e3"), (3, 5, 2, 2, 2, 4), _owen)
TETRA3 = Lens("tetra3", ("k",), (3,), None)


@dataclass(frozen=True)
class _Camera:
    """What is fitted to: a sensor's camera with its residual, as directions in E of pixels."""

    sensor: Sensor
    x: FloatArray
    residual: Surface | None
    mirrored: bool

    @property
    def kind(self) -> str | None:
        """OpenCV's name of this camera's lens; None where OpenCV has no such lens."""
        seen = self.as_opencv
        return None if seen is None else seen.distortion_model

    @property
    def as_opencv(self) -> OpenCV | None:
        """The camera as OpenCV writes it; None where OpenCV has no such lens."""
        model = CAMERA_MODELS[self.sensor.camera_model]
        named = dict(zip(model.parameter_names, self.x.tolist(), strict=True))
        return None if model.opencv is None else model.opencv(named, self.sensor.pixel_pitch_m)

    def places(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Rows and columns (count^2,) of an even grid over the image that is written, edges included."""
        rows, columns = self.sensor.rows, self.sensor.columns
        row, column = np.meshgrid(
            np.linspace(-0.5, rows - 0.5, count), np.linspace(-0.5, columns - 0.5, count), indexing="ij"
        )
        return row.ravel(), column.ravel()

    def directions(self, place: tuple[FloatArray, FloatArray], x: FloatArray | None = None) -> FloatArray:
        """Return (n, 3) directions in E of places of the image that is written."""
        row, column = place[0], self.sensor.columns - 1 - place[1] if self.mirrored else place[1]
        at = (row, column) if self.residual is None else undone((row, column), self.residual)
        s = CAMERA_MODELS[self.sensor.camera_model].directions(
            self.x if x is None else x, *at, self.sensor.pixel_pitch_m
        )
        return np.stack([-s[:, 1] if self.mirrored else s[:, 1], s[:, 0], s[:, 2]], axis=-1)


def fit_lens(
    lenses: tuple[Lens, ...],
    sensor: Sensor,
    x: FloatArray,
    allowed_px: float,
    *,
    P: FloatArray | None = None,
    residual: Surface | None = None,
) -> FittedLens:
    """Fit the first of some lenses that follows a camera amply; else the one that follows best, without a turn where one will do.

    `sensor`: whose camera it is; with parity +1 its image is written mirrored. `x`: (n_parameters,) its parameters, SI.
    `allowed_px`: misfit allowed. `P`: (n_parameters, n_parameters) covariance of x, SI. `residual`: what the camera leaves over,
    to be said too.
    """
    camera = _Camera(sensor, np.asarray(x, dtype=float), residual, sensor.parity == 1)
    tried = []
    for lens in sorted(lenses, key=lambda lens: lens.opencv != camera.kind):  # its own first, which follows exactly
        # tetra3's axis is the image's centre, so its frame must turn there
        for turning in (True,) if lens.distort is None else (False, True):
            tried.append(_fitted(lens, camera, P, turning=turning))
            if tried[-1].misfit_px <= max(AMPLE * allowed_px, EXACT_PX):
                return tried[-1]
    return min(
        tried, key=lambda one: (one.misfit_px > allowed_px, one.misfit_px <= allowed_px and one.turned, one.misfit_px)
    )


def project(lens: Lens, p: FloatArray, directions: FloatArray, sensor: Sensor) -> tuple[FloatArray, FloatArray]:
    """Return rows and columns (n,) at which a lens shows directions (n, 3) of its frame, pixels; not finite where it shows none."""
    with np.errstate(all="ignore"):
        x, y = directions[:, 0] / directions[:, 2], directions[:, 1] / directions[:, 2]
        if lens.distort is None:
            return _tetra3(p, x, y, sensor)
        x, y = lens.distort(x, y, p[len(PINHOLE) :])
        return p[1] * y + p[3], p[0] * x + p[2]


def _tetra3(p: FloatArray, x: FloatArray, y: FloatArray, sensor: Sensor) -> tuple[FloatArray, FloatArray]:
    """Solve r_d (1 - k r_d^2) / (1 - k) = r_u for r_d by Newton's method, radii in units of half the width."""
    f, k = p
    half = 0.5 * sensor.columns
    r_u = np.hypot(x, y) * f / half
    r_d = r_u.copy()
    for _ in range(20):
        r_d = r_d - (r_d * (1 - k * r_d**2) / (1 - k) - r_u) * (1 - k) / (1 - 3 * k * r_d**2)
    share = np.where(r_u > 0, r_d / np.where(r_u > 0, r_u, 1.0), 1.0 - k)
    return f * y * share + 0.5 * (sensor.rows - 1), f * x * share + 0.5 * (sensor.columns - 1)


def _start(lens: Lens, camera: _Camera) -> FloatArray:
    """Return the lens's own parameters where the camera is one of its kind, else those without distortion."""
    sensor, model = camera.sensor, CAMERA_MODELS[camera.sensor.camera_model]
    focal = model.focal_px(camera.x, sensor.pixel_pitch_m)
    if lens.distort is None:
        return np.array([focal, 0.0])
    row, column = model.principal_point(camera.x)
    p = np.zeros(len(lens.parameters))
    p[:4] = focal, focal, sensor.columns - 1 - column if camera.mirrored else column, row
    seen = camera.as_opencv
    if seen is not None and seen.distortion_model == lens.opencv:
        p[:2] = seen.f_x, seen.f_y
        p[4 : 4 + len(seen.coefficients)] = seen.coefficients
        if camera.mirrored and lens.opencv == "plumb_bob":
            p[7] = -p[7]  # p2 goes with x, which the mirror turns round
    return p


def _scale(lens: Lens, camera: _Camera, start: FloatArray) -> FloatArray:
    """How much of each parameter moves a star in the corner by about a pixel."""
    rim = 0.5 * math.hypot(camera.sensor.rows, camera.sensor.columns) / start[0]
    if lens.distort is None:
        return np.array([1.0 / rim, 1.0 / (start[0] * rim)])
    coefficients = [1.0 / (start[0] * rim**power) for power in lens.powers]
    return np.array([1.0 / rim, 1.0 / rim, 1.0, 1.0, *coefficients])


def _fitted(lens: Lens, camera: _Camera, P: FloatArray | None, *, turning: bool) -> FittedLens:
    """Fit one lens."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - 0.2 s, which commands that fit no lens need not wait for

    sensor, place = camera.sensor, camera.places(FITTED)
    s, start = camera.directions(place), _start(lens, camera)
    scale = np.concatenate([_scale(lens, camera, start), np.full(3 if turning else 0, 1.0 / start[0])])

    def off(z: FloatArray, s: FloatArray, place: tuple[FloatArray, FloatArray]) -> FloatArray:
        p, turn = _state(z * scale, lens)
        seen = project(lens, p, s @ turn.T, sensor)
        away = np.concatenate([seen[0] - place[0], seen[1] - place[1]])
        return np.asarray(np.nan_to_num(away, nan=1e6, posinf=1e6, neginf=-1e6))

    z = np.concatenate([start / scale[: len(start)], np.zeros(3 if turning else 0)])
    J = None
    if np.isfinite(s).all() and np.abs(off(z, s, place)).max() > EXACT_PX:
        found = least_squares(
            lambda at: off(at, s, place), z, jac=lambda at: _slope(lambda to: off(to, s, place), at), method="lm",
            xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=MOST_STEPS,
        )  # fmt: skip
        z, J = found.x, found.jac
    p, turn = _state(z * scale, lens)
    misfit, rms = _misfit(lens, p, turn, camera)
    sigma = None
    if P is not None and math.isfinite(misfit):
        J = _slope(lambda at: off(at, s, place), z) if J is None else J
        sigma = _sigma(J, camera, P, lambda at: off(z, camera.directions(place, at), place)) * scale
        sigma = sigma[: len(p)]
    return FittedLens(lens, p, sigma, turn, misfit, rms, camera.mirrored)


def _state(values: FloatArray, lens: Lens) -> tuple[FloatArray, FloatArray]:
    """Split fitted values into the parameters and the turn (3, 3)."""
    count = len(lens.parameters)
    if len(values) == count:
        return values, np.eye(3)
    return values[:count], to_matrix(vector_to_quaternion(values[count:]))


def _misfit(lens: Lens, p: FloatArray, turn: FloatArray, camera: _Camera) -> tuple[float, float]:
    """Largest and root mean square distance over the detector, pixels; infinite where the lens shows nothing."""
    place = camera.places(JUDGED)
    row, column = project(lens, p, camera.directions(place) @ turn.T, camera.sensor)
    away = np.hypot(row - place[0], column - place[1])
    away = np.where(np.isfinite(away), away, np.inf)
    return float(away.max()), float(np.sqrt(np.mean(away**2)))


def _slope(function: Callable[[FloatArray], FloatArray], at: FloatArray, step: float = 1e-4) -> FloatArray:
    """Derivatives (n_values, n) of a function by central differences."""
    steps = step * np.eye(len(at))
    return np.stack([(function(at + one) - function(at - one)) / (2 * step) for one in steps], axis=-1)


def _sigma(J: FloatArray, camera: _Camera, P: FloatArray, off: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Standard deviations (n,) of the fitted coefficients, from the covariance of the camera's parameters."""
    deviations = np.sqrt(np.maximum(np.diag(P), 0.0))
    step = 1e-3 * np.where(deviations > 0, deviations, 1.0)
    change = np.stack(
        [(off(camera.x + one) - off(camera.x - one)) / (2 * h) for h, one in zip(step, np.diag(step), strict=True)],
        axis=-1,
    )
    D = -np.linalg.lstsq(J, np.where(deviations > 0, change, 0.0), rcond=1e-12)[0]
    return np.asarray(np.sqrt(np.maximum(np.diag(D @ P @ D.T), 0.0)))
