"""Circular sun-synchronous orbits and the three motions of E Table I.

Orbit
-----
A circle of radius a about the Earth, in a plane with normal h. With P the direction of the ascending node and
W = h x P, at the argument of latitude u = u_0 + n t, n = sqrt(mu / a^3):

    position = a (cos u P + sin u W)          velocity = a n (-sin u P + cos u W)

The node follows the mean Sun at its local hour and drifts by the second zonal harmonic,

    dOmega/dt = -(3/2) J_2 (R_E / a)^2 n cos i,

360 deg a year for a sun-synchronous orbit. Altitudes count from the equatorial radius, as the paper says. The axes are
taken as GCRS: precession since J2000 (0.4 deg) moves the orbit a little and the simulated sky not at all.

Motions
-------
Each gives the boresight z and a reference direction; the detector's rows x lie along the reference, made normal to z,
and y = z x x closes the right-handed triad. `usable` marks what the paper's sets keep: no eclipse, and neither the Sun
nor the Earth's limb near the field of view.

=============  =====================================================================================================
nadir          the satellite faces the Earth, so the sky sweeps by at the orbital rate; z looks away from the Earth,
               `pointing` from the zenith towards the shadow side of the orbit plane; x along the velocity
slew           z runs along a great circle at 0.1 deg/s; its axis is `pointing` away from the Sun; x along the axis
hold_and_slew  z is held for 300 s, wandering by about 1 deg, and moves to the next target in 150 s; targets are spread
               over a cap opposite the Sun, turned about its centre by `pointing`; x towards the Sun
=============  =====================================================================================================

Not modelled: the smear of stars. A rolling shutter is simulated of a sensor that declares one in its centroids (`scenes`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, TimeArray

Pointing = Callable[["Orbit", FloatArray, float], tuple[FloatArray, FloatArray]]

MU_M3_S2 = 3.986004418e14
EARTH_RADIUS_M = 6_378_137.0
J2 = 1.08262668e-3

J2000 = np.datetime64("2000-01-01T12:00:00", "us")
DAY_S = 86_400.0

SUN_EXCLUSION_RAD = np.radians(45.0)
LIMB_EXCLUSION_RAD = np.radians(20.0)

SLEW_RATE_RAD_S = np.radians(0.1)
HOLD_S, MOVE_S = 300.0, 150.0
WANDER_RAD = np.radians(1.0)
WANDER_PERIODS_S = (173.0, 229.0)
CAP_RAD = np.radians(70.0)
GOLDEN_ANGLE_RAD = np.pi * (3.0 - np.sqrt(5.0))
CAP_TARGETS = 16


@dataclass(frozen=True)
class Orbit:
    """A circular orbit fixed at a start time.

    `altitude_m`: over the equatorial radius. `inclination_rad`: sun-synchronous ones are a little over 90 deg. `node_hour`:
    local solar time of the ascending node, hours. `start_utc`: the instant of t = 0 and argument of latitude 0.
    """

    altitude_m: float
    inclination_rad: float
    node_hour: float
    start_utc: np.datetime64

    @property
    def radius_m(self) -> float:
        """Distance from the centre of the Earth."""
        return EARTH_RADIUS_M + self.altitude_m

    @property
    def mean_motion_rad_s(self) -> float:
        """Orbital rate n."""
        return float(np.sqrt(MU_M3_S2 / self.radius_m**3))

    @property
    def node_drift_rad_s(self) -> float:
        """Drift of the ascending node by J2."""
        ratio = EARTH_RADIUS_M / self.radius_m
        return float(-1.5 * J2 * ratio**2 * self.mean_motion_rad_s * np.cos(self.inclination_rad))

    def times_utc(self, t_s: FloatArray) -> TimeArray:
        """Return the instants (n,) of seconds after the start, rounded to microseconds."""
        instants: TimeArray = self.start_utc.astype("datetime64[us]") + np.round(t_s * 1e6).astype("timedelta64[us]")
        return instants


def sun_direction(time_utc: TimeArray) -> FloatArray:
    """Return the Sun's direction (n, 3), ICRS, to 0.01 deg (the Astronomical Almanac's low-precision series)."""
    days = (time_utc - J2000) / np.timedelta64(1, "us") / 1e6 / DAY_S
    anomaly = np.radians(357.528 + 0.9856003 * days)
    longitude = np.radians(280.460 + 0.9856474 * days + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2.0 * anomaly))
    obliquity = np.radians(23.439)
    return np.stack(
        [np.cos(longitude), np.cos(obliquity) * np.sin(longitude), np.sin(obliquity) * np.sin(longitude)], axis=-1
    )


def state(orbit: Orbit, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position (m), velocity (m/s) and orbit normal, each (n, 3), GCRS, at t_s (n,) seconds after the start."""
    sun = sun_direction(orbit.times_utc(np.zeros(1)))[0]
    node = np.arctan2(sun[1], sun[0]) + np.radians(15.0 * (orbit.node_hour - 12.0)) + orbit.node_drift_rad_s * t_s
    cos_i, sin_i = np.cos(orbit.inclination_rad), np.sin(orbit.inclination_rad)
    P = np.stack([np.cos(node), np.sin(node), np.zeros_like(node)], axis=-1)
    W = np.stack([-cos_i * np.sin(node), cos_i * np.cos(node), np.full_like(node, sin_i)], axis=-1)
    u = (orbit.mean_motion_rad_s * t_s)[:, None]
    position = orbit.radius_m * (np.cos(u) * P + np.sin(u) * W)
    velocity = orbit.radius_m * orbit.mean_motion_rad_s * (np.cos(u) * W - np.sin(u) * P)
    return position, velocity, np.cross(P, W)


def nadir(orbit: Orbit, t_s: FloatArray, pointing_rad: float) -> tuple[FloatArray, FloatArray]:
    """Look at `pointing_rad` from the zenith towards the shadow side, rows along the velocity; both (n, 3)."""
    position, velocity, normal = state(orbit, t_s)
    sun = sun_direction(orbit.times_utc(t_s))
    side = -np.sign(_dot(normal[:1], sun[:1]))[:, None] * normal
    return np.cos(pointing_rad) * _unit(position) + np.sin(pointing_rad) * side, velocity


def slew(orbit: Orbit, t_s: FloatArray, pointing_rad: float) -> tuple[FloatArray, FloatArray]:
    """Run along the great circle about an axis `pointing_rad` from the Sun, rows along the axis; both (n, 3)."""
    sun = sun_direction(orbit.times_utc(np.zeros(1)))[0]
    across, north = _normals(sun)
    axis = np.cos(pointing_rad) * sun + np.sin(pointing_rad) * north
    first, second = across, np.cross(axis, across)
    angle = (SLEW_RATE_RAD_S * t_s)[:, None]
    return np.cos(angle) * first + np.sin(angle) * second, np.broadcast_to(axis, (len(t_s), 3))


def hold_and_slew(orbit: Orbit, t_s: FloatArray, pointing_rad: float) -> tuple[FloatArray, FloatArray]:
    """Hold near one target after another, rows along the Sun's direction made normal to the boresight; both (n, 3)."""
    sun = sun_direction(orbit.times_utc(np.zeros(1)))[0]
    number, within = np.divmod(t_s, HOLD_S + MOVE_S)
    share = np.clip((within - HOLD_S) / MOVE_S, 0.0, 1.0)
    smooth = share**2 * (3.0 - 2.0 * share)
    here, there = _target(-sun, number, pointing_rad), _target(-sun, number + 1.0, pointing_rad)
    z = _along_great_circle(here, there, smooth)
    across, north = _normals(sun)
    first, second = (WANDER_RAD * np.sin(2.0 * np.pi * t_s / period)[:, None] for period in WANDER_PERIODS_S)
    return _unit(z + first * across + second * north), np.broadcast_to(sun, z.shape)


MOTIONS: dict[str, Pointing] = {"nadir": nadir, "slew": slew, "hold_and_slew": hold_and_slew}


def attitude(motion: str, orbit: Orbit, t_s: FloatArray, pointing_rad: float) -> FloatArray:
    """Return C (n, 3, 3) from ICRS to the right-handed (rows, columns, boresight) triad at t_s (n,)."""
    return look_at(*MOTIONS[motion](orbit, t_s, pointing_rad))


def look_at(boresight: FloatArray, reference: FloatArray) -> FloatArray:
    """Return C (n, 3, 3), ICRS to the triad, with z along a boresight (n, 3) and x along what a reference (n, 3) has across it."""
    z = _unit(boresight)
    x = _unit(reference - _dot(reference, z)[:, None] * z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def usable(orbit: Orbit, t_s: FloatArray, boresight: FloatArray) -> NDArray[np.bool_]:
    """Tell (n,) where the satellite is in sunlight and neither the Sun nor the Earth comes near the field of view.

    `t_s`: (n,) seconds after the orbit's start. `boresight`: (n, 3) unit vectors, ICRS.
    """
    position, _, _ = state(orbit, t_s)
    sun = sun_direction(orbit.times_utc(t_s))
    along = _dot(position, sun)
    off_axis = np.linalg.norm(position - along[:, None] * sun, axis=-1)
    eclipsed = (along < 0.0) & (off_axis < EARTH_RADIUS_M)
    limb = np.arcsin(EARTH_RADIUS_M / orbit.radius_m) + LIMB_EXCLUSION_RAD
    earth_near = _dot(boresight, _unit(-position)) > np.cos(limb)
    sun_near = _dot(boresight, sun) > np.cos(SUN_EXCLUSION_RAD)
    kept: NDArray[np.bool_] = ~(eclipsed | earth_near | sun_near)
    return kept


def _target(centre: FloatArray, number: FloatArray, pointing_rad: float) -> FloatArray:
    """Return hold targets (n, 3): a golden-angle spiral of equal-area steps over the cap about `centre`."""
    place = np.mod(number * 5.0 + 0.5, CAP_TARGETS) / CAP_TARGETS  # 5 and 16 share no factor, so every place is visited
    cos_off = 1.0 - place * (1.0 - np.cos(CAP_RAD))
    sin_off = np.sqrt(1.0 - cos_off**2)
    angle = number * GOLDEN_ANGLE_RAD + pointing_rad
    across, north = _normals(centre)
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * north
    target: FloatArray = cos_off[:, None] * centre + sin_off[:, None] * ring
    return target


def _along_great_circle(here: FloatArray, there: FloatArray, share: FloatArray) -> FloatArray:
    """Return the point (n, 3) at `share` (n,) of the arc from `here` to `there`, both (n, 3) and not opposite."""
    arc = np.arctan2(np.linalg.norm(np.cross(here, there), axis=-1), _dot(here, there))
    weight_here, weight_there = np.sin((1.0 - share) * arc), np.sin(share * arc)
    point: FloatArray = (weight_here[:, None] * here + weight_there[:, None] * there) / np.sin(arc)[:, None]
    return point


def _normals(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (3,) normal to `direction` and to each other, the first in the equator."""
    across = _unit(np.cross([0.0, 0.0, 1.0], direction))
    return across, np.cross(direction, across)


def _unit(vectors: FloatArray) -> FloatArray:
    unit: FloatArray = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = np.einsum("ij,ij->i", a, b)
    return product
