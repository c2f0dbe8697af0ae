"""What to observe next: the pointings and rolls that shrink what is known least, by the minute, under Sun, Moon and Earth.

Information of one exposure
---------------------------
A star of direction s in D is measured at pixels m. The camera's tangent slope and the attitude move it,

    d s = S_x dx + S_m dm,        d s = dtheta x s = -[s x] dtheta        so with E (3, 2) normal to s

    dm = (E^T S_m)^-1 (-E^T [s x] dtheta - E^T S_x dx) = J_theta dtheta - J_x dx.

Every camera knows a place only by its distance from the principal point, so S_m = -S_x of the principal point's row and column
(`cameras.model`). The attitude of each exposure is unknown and eliminated by its Schur complement, with z = x / typical sigma,

    A_1 = (J_x^T J_x - J_x^T J_t (J_t^T J_t)^-1 J_t^T J_x) / sigma_px^2.

That is what arclengths with their full covariance know of a set; fewer than `MINIMUM_STARS` stars tell nothing here.

Choice
------
A plan is a sequence of pointings, each held for a dwell, with the slew from the one before in between. With A_0 of what is known
before and n exposures in a dwell, it maximises

    D:  log det(A_0 + sum n A_i)            A:  -trace (A_0 + sum n A_i)^-1

(D is blind to units; A is the sum of variances in typical sigmas, and so looks at the weakest). Greedy: the pointing that gains
most per second of slew and dwell comes next, while there is time. Both measures have diminishing returns, for which greedy choice
is good and exchange mends most of what is left: each pointing in turn is replaced by whatever serves the whole better, if the plan
still keeps its time and its distances from Sun, Moon and Earth, until none is (Fedorov's exchange). The choice depends on nothing
but its input.

Where A is taken matters as little as the camera is known well: parameters ten typical sigmas off move the forecast by some percent.

References
----------
Fedorov, "Theory of Optimal Experiments", 1972. Atkinson, Donev, Tobias, "Optimum Experimental Designs", 2007, sections 10 and 12.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import erfa
import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from boresight.arrays import BoolArray, FloatArray, IntArray, TimeArray
from boresight.cameras import CAMERA_MODELS
from boresight.estimation import MINIMUM_STARS
from boresight.simulation.orbits import (
    EARTH_RADIUS_M,
    GOLDEN_ANGLE_RAD,
    J2000,
    Orbit,
    look_at,
    state,
    sun_direction,
)
from boresight.simulation.scenes import is_on_detector
from boresight.sky.catalogue import Catalogue, unit_vectors
from boresight.telemetry.sensors import Sensor

Criterion = Literal["D", "A"]
#: Replacements that are tried at each place of a plan, best first, and rounds over all places.
TRIED, ROUNDS = 12, 6
#: Attitudes whose stars are looked at together.
CHUNK = 500
#: Turn below which an attitude is held.
SAME_DEG = 1e-3
#: Gain below which a replacement is none.
LEAST_GAIN = 1e-9
#: Times of a dwell at which distances from Sun, Moon and Earth are looked at, as shares of it.
LOOKS = np.array([0.0, 0.5, 1.0])


@dataclass(frozen=True, kw_only=True)
class Constraints:
    """What a plan has to keep.

    `start_utc`, `minutes`: when, and how long in all. `dwell_s`: how long a pointing is held; one exposure each `exposure_s` of
    it. `slew_deg_s`, `settle_s`: rate of a turn, and the wait after it. `sun_deg`, `moon_deg`: least angles from the boresight.
    `earth_deg`: least angle from the Earth's limb, where an orbit says where that is. `visits`: how often one pointing may be held:
    errors that stay with a place on the detector or with a star do not average.
    """

    start_utc: np.datetime64
    minutes: float
    dwell_s: float = 60.0
    exposure_s: float = 10.0
    slew_deg_s: float = 0.5
    settle_s: float = 10.0
    sun_deg: float = 40.0
    moon_deg: float = 15.0
    earth_deg: float = 20.0
    visits: int = 3
    orbit: Orbit | None = None

    @property
    def exposures(self) -> int:
        """Exposures in a dwell."""
        return int(self.dwell_s // self.exposure_s)

    def slew_s(self, C_before: FloatArray, C: FloatArray) -> FloatArray:
        """Seconds of a turn from one attitude (3, 3) to others (n, 3, 3), with the wait after it."""
        cosine = (np.einsum("ij,nij->n", C_before, C) - 1.0) / 2.0
        angle_deg = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        return np.asarray(np.where(angle_deg > SAME_DEG, angle_deg / self.slew_deg_s + self.settle_s, 0.0))

    def allow(self, boresight: FloatArray, t_s: FloatArray) -> BoolArray:
        """Tell (n,) which boresights (n, 3) are clear of Sun, Moon and Earth for a whole dwell from t_s (n,) on."""
        clear = np.ones(len(boresight), np.bool_)
        for share in LOOKS:
            t = t_s + share * self.dwell_s
            time_utc = self.start_utc.astype("datetime64[us]") + np.round(t * 1e6).astype("timedelta64[us]")
            clear &= _angle_deg(boresight, sun_direction(time_utc)) >= self.sun_deg
            clear &= _angle_deg(boresight, moon_direction(time_utc)) >= self.moon_deg
            if self.orbit is not None:
                position, _, _ = state(self.orbit, t + self._since_orbit_s)
                limb_deg = np.degrees(np.arcsin(EARTH_RADIUS_M / self.orbit.radius_m))
                clear &= _angle_deg(boresight, -position) - limb_deg >= self.earth_deg
        return clear

    @property
    def _since_orbit_s(self) -> float:
        return (
            0.0
            if self.orbit is None
            else float((self.start_utc - self.orbit.start_utc) / np.timedelta64(1, "us")) * 1e-6
        )


def _angle_deg(a: FloatArray, b: FloatArray) -> FloatArray:
    cosine = np.einsum("ni,ni->n", a, b) / np.linalg.norm(b, axis=-1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def moon_direction(time_utc: TimeArray) -> FloatArray:
    """Return the Moon's direction (n, 3), GCRS, from the Earth's centre: a low orbit sees it up to 1 deg off. By erfa's moon98."""
    days = (time_utc - J2000) / np.timedelta64(1, "us") * 1e-6 / 86_400.0
    position = erfa.moon98(erfa.DJ00, days)["p"]
    return np.asarray(position / np.linalg.norm(position, axis=-1, keepdims=True))


@dataclass(frozen=True)
class Candidates:
    """Attitudes that may be chosen.

    `ra_rad`, `dec_rad`: (n,) boresight. `roll_rad`: (n,) angle from celestial north to the axis of rows, positive towards east.
    """

    ra_rad: FloatArray
    dec_rad: FloatArray
    roll_rad: FloatArray

    def __len__(self) -> int:
        return len(self.ra_rad)

    @property
    def boresight(self) -> FloatArray:
        """(n, 3) unit vectors, ICRS."""
        return unit_vectors(self.ra_rad, self.dec_rad)

    @property
    def attitude(self) -> FloatArray:
        """C (n, 3, 3), ICRS to the right-handed triad (rows, columns, boresight)."""
        east = np.stack([-np.sin(self.ra_rad), np.cos(self.ra_rad), np.zeros(len(self))], axis=-1)
        north = np.cross(self.boresight, east)
        rows = np.cos(self.roll_rad)[:, None] * north + np.sin(self.roll_rad)[:, None] * east
        return look_at(self.boresight, rows)

    @property
    def quaternion(self) -> FloatArray:
        """(n, 4) x, y, z, w, ICRS to the triad."""
        return np.asarray(Rotation.from_matrix(self.attitude).inv().as_quat(canonical=True))


def spread_over_sky(pointings: int, rolls: int) -> Candidates:
    """Spread pointings evenly over the sky, on Fibonacci's spiral, each with as many rolls over a half turn and back."""
    place = np.arange(pointings) + 0.5
    dec = np.arcsin(1.0 - 2.0 * place / pointings)
    ra = np.mod(place * GOLDEN_ANGLE_RAD, 2.0 * np.pi)
    roll = np.arange(rolls) * 2.0 * np.pi / rolls
    return Candidates(np.repeat(ra, rolls), np.repeat(dec, rolls), np.tile(roll, pointings))


def exposure_information(
    candidates: Candidates, sensor: Sensor, x: FloatArray, free: IntArray, scale: FloatArray, catalogue: Catalogue
) -> tuple[FloatArray, IntArray]:
    """Information of one exposure at each attitude.

    Parameters
    ----------
    candidates
        Attitudes (n,).
    sensor
        Detector, parity, centroid noise and faintest star.
    x
        (n_parameters,) state where the information is taken, SI.
    free, scale
        (n_free,) places of the free parameters, and typical sigmas, SI.
    catalogue
        Stars; those brighter than the sensor's limit are seen.

    Returns
    -------
    A
        (n, n_free, n_free) in typical sigmas, the attitude eliminated.
    stars
        (n,) on the detector.
    """
    limit = np.inf if sensor.magnitude_limit is None else sensor.magnitude_limit
    bright = np.flatnonzero(catalogue.magnitude < limit)
    s_i = unit_vectors(catalogue.ra_rad[bright], catalogue.dec_rad[bright])
    cone = CAMERA_MODELS[sensor.camera_model].cone_rad(x, sensor.rows, sensor.columns, sensor.pixel_pitch_m)
    sky = KDTree(s_i)
    parts = []
    for start in range(0, len(candidates), CHUNK):
        C = candidates.attitude[start : start + CHUNK]
        near = sky.query_ball_point(C[:, 2], 2.0 * np.sin(cone / 2.0))
        exposure = np.repeat(np.arange(len(C)), [len(index) for index in near])
        star = np.concatenate([np.asarray(index, np.int64) for index in near])
        parts.append(_inform(sensor, x, free, scale, exposure, np.einsum("nij,nj->ni", C[exposure], s_i[star]), len(C)))
    A, stars = (np.concatenate(column) for column in zip(*parts, strict=True))
    return A, stars


def _inform(
    sensor: Sensor, x: FloatArray, free: IntArray, scale: FloatArray, exposure: IntArray, s_d: FloatArray, n: int
) -> tuple[FloatArray, IntArray]:
    """Information (n, n_free, n_free) and stars (n,) of exposures, by directions (n_stars, 3) in the right-handed triad."""
    s_d = s_d * np.array([1.0, sensor.parity, 1.0])
    row, col = CAMERA_MODELS[sensor.camera_model].project(x, s_d, sensor.pixel_pitch_m)
    on = is_on_detector(sensor, row, col)
    stars = np.bincount(exposure[on], minlength=n)
    J = _slopes(sensor, x, row[on], col[on], free, scale) / sensor.centroid_sigma_px
    whole = np.zeros((n, J.shape[2], J.shape[2]))
    np.add.at(whole, exposure[on], np.einsum("nij,nik->njk", J, J))
    A = np.zeros((n, len(free), len(free)))
    kept = stars >= MINIMUM_STARS
    p, q = np.split(np.arange(J.shape[2]), [len(free)])
    xx, xt, tt = (whole[kept][:, one][:, :, other] for one, other in ((p, p), (p, q), (q, q)))
    A[kept] = xx - xt @ np.linalg.solve(tt, xt.transpose(0, 2, 1))
    return A, stars


def _slopes(
    sensor: Sensor, x: FloatArray, row: FloatArray, col: FloatArray, free: IntArray, scale: FloatArray
) -> FloatArray:
    """J_x and J_theta side by side, (n, 2, n_free + 3) pixels, of stars (n,)."""
    camera = CAMERA_MODELS[sensor.camera_model]
    s, S_x = camera.directions_and_jacobian(x, row, col, sensor.pixel_pitch_m)
    first = np.stack([s[:, 2], np.zeros(len(s)), -s[:, 0]], axis=-1) / np.hypot(s[:, 0], s[:, 2])[:, None]
    E = np.stack([first, np.cross(s, first)], axis=-1)
    turn = np.cross(np.eye(3)[None], s[:, None, :]).transpose(0, 2, 1)  # column k is e_k x s
    S_m = -S_x[:, :, list(camera.principal_places)]
    moved = np.concatenate([-S_x[:, :, free] * scale, turn], axis=2)
    return np.asarray(np.linalg.solve(E.transpose(0, 2, 1) @ S_m, E.transpose(0, 2, 1) @ moved))


@dataclass(frozen=True)
class Plan:
    """Chosen pointings in order.

    `place`: (k,) of each among the candidates. `start_s`, `slew_s`: (k,) when its dwell begins, and the turn before it.
    `A`: (k + 1, n_free, n_free) information before the first, and after each.
    """

    place: IntArray
    start_s: FloatArray
    slew_s: FloatArray
    A: FloatArray

    @property
    def sigma(self) -> FloatArray:
        """(k + 1, n_free) one sigma of each parameter before the first pointing, and after each, in typical sigmas."""
        return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(self.A), axis1=1, axis2=2)))

    @property
    def weakest(self) -> FloatArray:
        """(k + 1,) one sigma of the weakest direction, in typical sigmas."""
        return np.asarray(np.linalg.eigvalsh(self.A)[:, 0] ** -0.5)


@dataclass(frozen=True)
class _Planner:
    constraints: Constraints
    C: FloatArray
    boresight: FloatArray
    A: FloatArray
    A_0: FloatArray
    measure: Callable[[FloatArray], FloatArray]

    def follow(self, places: Sequence[int]) -> tuple[FloatArray, FloatArray] | None:
        """Starts and slews (k,) of a sequence; None where it takes too long, or comes too near to Sun, Moon or Earth."""
        at = np.array(places, np.int64)
        slew = np.zeros(len(at))
        for k in range(1, len(at)):
            slew[k] = self.constraints.slew_s(self.C[at[k - 1]], self.C[at[k : k + 1]])[0]
        start = np.cumsum(slew) + np.arange(len(at)) * self.constraints.dwell_s
        if len(at) and start[-1] + self.constraints.dwell_s > 60.0 * self.constraints.minutes:
            return None
        return (start, slew) if self.constraints.allow(self.boresight[at], start).all() else None

    def spent(self, places: Sequence[int]) -> BoolArray:
        """Tell (n,) which candidates are held as often as they may."""
        return np.bincount(np.asarray(places, np.int64), minlength=len(self.C)) >= self.constraints.visits

    def extend(self, places: list[int]) -> None:
        """Add the pointings that gain most per second, while there is time."""
        whole = self.A_0 + self.A[places].sum(axis=0)
        done = self.follow(places)
        now = 0.0 if done is None or not places else float(done[0][-1]) + self.constraints.dwell_s
        while True:
            slew = self.constraints.slew_s(self.C[places[-1]], self.C) if places else np.zeros(len(self.C))
            start = now + slew
            fits = start + self.constraints.dwell_s <= 60.0 * self.constraints.minutes
            fits[fits] = self.constraints.allow(self.boresight[fits], start[fits])
            gain = (self.measure(whole + self.A) - self.measure(whole[None])) / (slew + self.constraints.dwell_s)
            gain[~fits | self.spent(places)] = -np.inf
            best = int(np.argmax(gain))
            if not gain[best] > 0.0:
                return
            places.append(best)
            whole = whole + self.A[best]
            now = float(start[best]) + self.constraints.dwell_s

    def exchange(self, places: list[int]) -> bool:
        """Replace each pointing in turn by what serves the whole better; returns whether any was."""
        changed = False
        for k, present in enumerate(places):
            rest = self.A_0 + self.A[[place for j, place in enumerate(places) if j != k]].sum(axis=0)
            value = self.measure(rest + self.A)
            value[self.spent(places)] = -np.inf
            value[present] = self.measure(rest[None] + self.A[present])[0]
            for other in np.argsort(-value)[:TRIED]:
                if value[other] - value[present] <= LEAST_GAIN * max(1.0, abs(value[present])):
                    break
                trial = [*places[:k], int(other), *places[k + 1 :]]
                if self.follow(trial) is not None:
                    places[k] = int(other)
                    changed = True
                    break
        return changed


def _measure_d(A: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.slogdet(A)[1])


def _measure_a(A: FloatArray) -> FloatArray:
    return np.asarray(-np.trace(np.linalg.inv(A), axis1=1, axis2=2))


MEASURES: dict[str, Callable[[FloatArray], FloatArray]] = {"D": _measure_d, "A": _measure_a}


def plan_pointings(
    candidates: Candidates, A_1: FloatArray, A_0: FloatArray, constraints: Constraints, criterion: Criterion = "A"
) -> Plan:
    """Choose pointings by greedy gain per second and exchange.

    Parameters
    ----------
    candidates
        Attitudes (n,).
    A_1
        (n, n_free, n_free) information of one exposure at each.
    A_0
        (n_free, n_free) what is known before, not singular.
    constraints
        Time, turns, and distances to keep.
    criterion
        `D` or `A`.
    """
    planner = _Planner(
        constraints, candidates.attitude, candidates.boresight, constraints.exposures * A_1, A_0, MEASURES[criterion]
    )
    places: list[int] = []
    planner.extend(places)
    for _ in range(ROUNDS):
        if not planner.exchange(places):
            break
        planner.extend(places)
    return _lay_out(planner, places)


def draw_pointings(
    candidates: Candidates, A_1: FloatArray, A_0: FloatArray, constraints: Constraints, rng: np.random.Generator
) -> Plan:
    """Choose pointings by chance among those that are allowed, as what a plan is compared with."""
    planner = _Planner(
        constraints, candidates.attitude, candidates.boresight, constraints.exposures * A_1, A_0, MEASURES["D"]
    )
    places: list[int] = []
    while True:
        order = rng.permutation(len(candidates))
        following = next((one for one in order[:TRIED] if planner.follow([*places, int(one)]) is not None), None)
        if following is None:
            return _lay_out(planner, places)
        places.append(int(following))


def _lay_out(planner: _Planner, places: list[int]) -> Plan:
    start, slew = planner.follow(places) or (np.empty(0), np.empty(0))
    A = planner.A_0 + np.concatenate([np.zeros((1, *planner.A_0.shape)), np.cumsum(planner.A[places], axis=0)])
    return Plan(np.array(places, np.int64), start, slew, A)
