"""Whether the first advice names what is wrong: sets that depart from the model in a known way (part `causes`).

Each cause of `CAUSES` spoils simulated sets of an ST-16 with real stars: centroids are displaced, identities or directions are
changed, noise is another than stated. Its strength is the largest displacement, pixels, at which it matters: the parameters or the
directions are then off by some of their sigmas. The command's own calibration is run on every set, and the table says which cause
was named first, how often; `none` is a set in which no test noticed anything. Clean sets count false alarms of the whole family of
tests, which is to be at most 1 %.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import binom

from benchmarks import Report, held
from boresight.arrays import FloatArray, IntArray
from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import Calibration
from boresight.calibration.matching.verification import MANY_REMOVED
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.attitude import conjugate, product, rotation_vector, to_matrix
from boresight.simulation.scenes import Scenario, calibration_scenario, simulate
from boresight.sky.apparent import C_AU_DAY, days_since_j2000, earth_state
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

NOISE_PX = 0.1
#: Share of sets whose first advice is to be right, and of clean sets that may be called into question.
GOAL, FALSE = 0.9, 0.01


@dataclass(frozen=True)
class Set:
    """A simulated set, what it was simulated from, and the randomness of what spoils it."""

    scenario: Scenario
    telemetry: Telemetry
    catalogue: Catalogue
    rng: np.random.Generator

    @property
    def places(self) -> tuple[FloatArray, FloatArray]:
        """Places from the middle of the detector, in units of half its diagonal, (n_rows,) each."""
        sensor = self.scenario.sensor
        unit = np.hypot(sensor.rows, sensor.columns) / 2
        return (
            (self.telemetry.row_px - (sensor.rows - 1) / 2) / unit,
            (self.telemetry.col_px - (sensor.columns - 1) / 2) / unit,
        )

    @property
    def seconds(self) -> FloatArray:
        """(n_rows,) seconds since the first exposure."""
        assert self.telemetry.time_utc is not None
        return np.asarray((self.telemetry.time_utc - self.telemetry.time_utc[0]) / np.timedelta64(1, "s"))

    @property
    def star(self) -> IntArray:
        """(n_rows,) place of each star in the catalogue, -1 where it is not named."""
        assert self.telemetry.star_id is not None
        return self.catalogue.find_index(self.telemetry.star_id)

    def moved(self, down: FloatArray | float, right: FloatArray | float) -> Telemetry:
        """The telemetry with centroids displaced, pixels."""
        return replace(self.telemetry, row_px=self.telemetry.row_px + down, col_px=self.telemetry.col_px + right)


Spoil = Callable[[Set, float], Telemetry]


def tangential(one: Set, px: float) -> Telemetry:
    """A decentred lens."""
    x, y = one.places
    return one.moved(px / 3 * 2 * x * y, px / 3 * (x**2 + 3 * y**2))


def radial(one: Set, px: float) -> Telemetry:
    """A seventh and a ninth radial order, of which the fifth takes some up."""
    x, y = one.places
    r2 = x**2 + y**2
    along = px * (4 * r2**4 - 3 * r2**3)
    return one.moved(along * x, along * y)


def lens(one: Set, px: float) -> Telemetry:
    """A wave over the detector, as of a window that is not flat."""
    x, y = one.places
    return one.moved(px * np.sin(3.0 * y + 0.4), px * np.cos(3.0 * x - 0.7))


def affine(one: Set, px: float) -> Telemetry:
    """Lines read out while the image moves steadily along them."""
    x, _ = one.places
    return one.moved(0.0, px * x)


def readout(one: Set, px: float) -> Telemetry:
    """Lines read out while the image moves as the attitude tells: px a line time in units of the fastest image."""
    velocity = _image_velocity(one)
    x, _ = one.places
    line = px / np.abs(velocity * x[:, None]).max()
    return one.moved(*(line * velocity * x[:, None]).T)


def _image_velocity(one: Set) -> FloatArray:
    """(n_rows, 2) pixels a second, from the attitudes of the two exposures of each frame."""
    told, scenario = one.telemetry, one.scenario
    assert told.quaternion is not None
    q, camera = told.quaternion, CAMERA_MODELS[scenario.sensor.camera_model]
    pitch = scenario.sensor.pixel_pitch_m
    first = np.unique(told.frame * 10 + told.exposure, return_index=True)[1]
    frame = told.frame[first]
    w = np.zeros((len(first), 3))
    for a, b in zip(range(len(first) - 1), range(1, len(first)), strict=True):
        if frame[a] == frame[b]:
            w[a] = w[b] = rotation_vector(product(q[first[b]], conjugate(q[first[a]]))) / scenario.exposure_interval_s
    of = np.repeat(w, np.diff([*first, len(q)]), axis=0)
    s = camera.directions(scenario.truth, told.row_px, told.col_px, pitch)
    step = 1e-3
    after = camera.project(scenario.truth, s - step * np.cross(of, s), pitch)
    return np.stack([after[0] - told.row_px, after[1] - told.col_px], axis=1) / step


def focal(one: Set, change: FloatArray, px: float) -> Telemetry:
    """A scale of the image that changes from row to row of the telemetry."""
    x, y = one.places
    return one.moved(px * change * x, px * change * y)


def temperature(one: Set, px: float) -> Telemetry:
    """A focal length that goes with the sine of the temperature."""
    assert one.telemetry.temperature_c is not None
    return focal(one, np.sin((one.telemetry.temperature_c - 19.0) / 2.5), px)


def step(one: Set, px: float) -> Telemetry:
    """A focal length that jumps once."""
    return focal(one, (one.telemetry.frame > 0.6 * one.telemetry.frame.max()).astype(float), px)


def drift(one: Set, px: float) -> Telemetry:
    """A focal length that grows steadily."""
    return focal(one, one.seconds / one.seconds.max() - 0.5, px)


def magnitude(one: Set, px: float) -> Telemetry:
    """Charge that lags behind along the columns, the fainter the star the more."""
    assert one.telemetry.magnitude is not None
    given = np.nan_to_num(one.telemetry.magnitude, nan=float(np.nanmean(one.telemetry.magnitude)))
    return one.moved(0.0, px * (given - given.mean()) / np.ptp(given) * 2)


def colour(one: Set, px: float) -> Telemetry:
    """A lens that is larger for red stars."""
    x, y = one.places
    bv = np.where(one.star >= 0, one.catalogue.colour_bv[one.star], 0.6) - 0.6
    return one.moved(px * bv * x, px * bv * y)


def phase(one: Set, px: float) -> Telemetry:
    """Centroids drawn to pixel centres."""
    told = one.telemetry
    return one.moved(px * np.sin(2 * np.pi * told.row_px), px * np.sin(2 * np.pi * told.col_px))


def aberration(one: Set, px: float) -> Telemetry:
    """Directions without the Earth's aberration, px times over."""
    told = one.telemetry
    assert told.time_utc is not None
    assert told.quaternion is not None
    camera, sensor = CAMERA_MODELS[one.scenario.sensor.camera_model], one.scenario.sensor
    v = earth_state(days_since_j2000(told.time_utc))[1] / C_AU_DAY * px
    s_d = camera.directions(one.scenario.truth, told.row_px, told.col_px, sensor.pixel_pitch_m)
    s_d[:, 1] *= sensor.parity
    C = to_matrix(told.quaternion)
    away = np.einsum("nij,nj->ni", C, v)
    moved = s_d + away - np.sum(away * s_d, axis=1, keepdims=True) * s_d
    moved[:, 1] *= sensor.parity
    row, col = camera.project(one.scenario.truth, moved, sensor.pixel_pitch_m)
    return one.moved(row - told.row_px, col - told.col_px)


def identities(one: Set, share: float) -> Telemetry:
    """A share of the stars named as another of their exposure."""
    assert one.telemetry.star_id is not None
    named = np.flatnonzero(one.telemetry.star_id > 0)
    wrong = one.rng.choice(named, max(1, round(share * len(named))), replace=False)
    ids = one.telemetry.star_id.copy()
    key = one.telemetry.frame * 10 + one.telemetry.exposure
    for row in wrong:
        others = named[(key[named] == key[row]) & (named != row)]
        if len(others):
            other = one.rng.choice(others)
            ids[row], ids[other] = one.telemetry.star_id[other], one.telemetry.star_id[row]
    return replace(one.telemetry, star_id=ids)


def places(one: Set, px: float) -> Telemetry:
    """Three stars seen often that are off their places, each its own way across the sky."""
    ids = one.telemetry.star_id
    assert ids is not None
    assert one.telemetry.quaternion is not None
    stars, count = np.unique(ids[ids > 0], return_counts=True)
    down, right = np.zeros(len(ids)), np.zeros(len(ids))
    C, scenario = to_matrix(one.telemetry.quaternion), one.scenario
    camera, sensor = CAMERA_MODELS[scenario.sensor.camera_model], scenario.sensor
    focal_px = camera.focal_px(scenario.truth, sensor.pixel_pitch_m)
    for star in one.rng.choice(stars[np.argsort(-count)[:20]], 3, replace=False):
        rows = ids == star
        way = one.rng.normal(size=3)
        seen = C[rows] @ (way / np.linalg.norm(way))
        s = camera.directions(
            scenario.truth, one.telemetry.row_px[rows], one.telemetry.col_px[rows], sensor.pixel_pitch_m
        )
        seen[:, 1] *= sensor.parity
        row, col = camera.project(scenario.truth, s + px / focal_px * seen, sensor.pixel_pitch_m)
        down[rows], right[rows] = row - one.telemetry.row_px[rows], col - one.telemetry.col_px[rows]
    return one.moved(down, right)


def noise(one: Set, times: float) -> Telemetry:
    """Noise so many times the stated one, or a stated one that is larger."""
    if times < 1:
        assert one.telemetry.sigma_px is not None
        return replace(one.telemetry, sigma_px=one.telemetry.sigma_px / times)
    more = NOISE_PX * np.sqrt(times**2 - 1)
    return one.moved(*(more * one.rng.normal(size=(2, len(one.telemetry)))))


def tails(one: Set, degrees: float) -> Telemetry:
    """Noise of Student's distribution beside the normal one."""
    return one.moved(*(NOISE_PX * one.rng.standard_t(degrees, size=(2, len(one.telemetry)))))


@dataclass(frozen=True)
class Case:
    """A cause: what spoils the set, how much, which sensor's motion it needs, and the names of causes that are right."""

    spoil: Spoil
    strength: float
    right: tuple[str, ...]
    sensor: int = 1


CASES: dict[str, Case] = {
    "tangential": Case(tangential, 0.5, ("tangential",)),
    "radial": Case(radial, 0.5, ("radial",)),
    "lens": Case(lens, 0.15, ("lens",)),
    "affine": Case(affine, 0.1, ("affine", "readout")),
    "readout": Case(readout, 0.5, ("readout",), sensor=6),
    "temperature": Case(temperature, 0.1, ("temperature",)),
    "step": Case(step, 0.15, ("time", "trend")),
    "drift": Case(drift, 0.15, ("trend", "time", "drift")),
    "magnitude": Case(magnitude, 0.06, ("magnitude",)),
    "colour": Case(colour, 0.1, ("colour",)),
    "phase": Case(phase, 0.06, ("phase",)),
    "aberration": Case(aberration, 1.0, ("aberration",)),
    "identities": Case(identities, 0.005, ("identities",)),
    "places": Case(places, 0.5, ("places",)),
    "noise_above": Case(noise, 1.3, ("noise",)),
    "noise_below": Case(noise, 0.75, ("noise",)),
    "tails": Case(tails, 3.0, ("tails",)),
}


def make_set(case: Case | None, seed: int, frames: int, catalogue: Catalogue, strength: float = 1.0) -> Set:
    """Simulate a set, and spoil it by so many times a case's strength; none leaves it clean."""
    number = 1 if case is None else case.sensor
    base = calibration_scenario(number, frames)
    sensor = replace(base.sensor, centroid_sigma_px=NOISE_PX)
    scenario = replace(base, sensor=sensor, centroid_sigma_px=NOISE_PX, false_stars=0.0, blanked_share=0.0)
    telemetry = simulate(scenario, np.random.default_rng([number, seed]), catalogue)
    one = Set(scenario, telemetry, catalogue, np.random.default_rng([seed, 7]))
    return (
        one if case is None else replace(one, telemetry=_on_detector(sensor, case.spoil(one, strength * case.strength)))
    )


def _on_detector(sensor: Sensor, telemetry: Telemetry) -> Telemetry:
    """Leave out what was displaced beyond the detector."""
    inside = (np.abs(telemetry.row_px - (sensor.rows - 1) / 2) < sensor.rows / 2) & (
        np.abs(telemetry.col_px - (sensor.columns - 1) / 2) < sensor.columns / 2
    )
    arrays: dict[str, Any] = {
        name: value[inside] for name, value in vars(telemetry).items() if isinstance(value, np.ndarray)
    }
    return replace(telemetry, **arrays)


def judge(one: Set) -> Calibration:
    """Calibrate a set as its file says."""
    return calibrate(one.telemetry, one.scenario.sensor, one.catalogue, CalibrationSettings(match="given"))


def name_first(found: Calibration) -> str:
    """The cause that is told first; stars that were removed before the fit are named as such, and come before any other."""
    if found.removed_of is not None and found.removed_of.removed > MANY_REMOVED * found.removed_of.proposed:
        return "identities"
    return found.causes[0].name if found.causes else "none"


def measure(report: Report, *, sets: int = 20, clean: int = 100, frames: int = 150) -> dict[str, Any]:
    """Measure the confusion matrix, and false alarms over clean sets."""
    catalogue = load_catalogue(None, 6.0)
    named: dict[str, Counter[str]] = {}
    for place, (name, case) in enumerate(CASES.items()):
        report(0.5 * place / len(CASES), name)
        sets_of = (make_set(case, 1000 + seed, frames, catalogue) for seed in range(sets))
        named[name] = Counter(name_first(judge(one)) for one in sets_of)
    right = {name: sum(named[name][cause] for cause in case.right) / sets for name, case in CASES.items()}
    alarms = 0
    for seed in range(clean):
        report(0.5 + 0.5 * seed / clean, "clean sets")
        alarms += name_first(judge(make_set(None, seed, frames, catalogue))) != "none"
    share = float(np.mean(list(right.values())))
    return {
        "sets": sets,
        "named": {name: dict(counts.most_common()) for name, counts in named.items()},
        "right": right,
        "right_share": share,
        "clean": clean,
        "false_alarms": alarms,
        "limits": {
            "right_share": held(GOAL, share, at_least=True),
            "false_alarms": held(float(binom.ppf(0.999, clean, FALSE)), alarms),
        },
    }
