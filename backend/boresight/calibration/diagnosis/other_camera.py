"""Whose camera a telemetry set is of: that of the sensor it came for, or of another one that is registered.

**What tells.** Where its centroids lie, and the angles between its stars. With theta_d the angle between two centroids as a camera
has them, theta_i that between their stars, and sigma the error of a direction, over pairs of an exposure

    scale  r = median theta_d / theta_i        scatter  s = 1.4826 median |theta_d / theta_i - r|
    error  e = 1.4826 median |theta_d - theta_i| / (2^(1/2) sigma)

A camera is a set's where at most `MOST_OFF` of the centroids lie off its detector, where the part of it that they span would come
about by chance, where |r - 1| is at most `MOST_SCALE`, more than any launch puts a focal length off, and where s is at most
`MOST_SCATTER`. n centroids spread evenly along a side span at most the share f of it with the probability of their range,

    P(f) = f^(n-1) (n - (n-1) f)

(David and Nagaraja, Order Statistics, 2.3). Centroids of one place, `CELL_PX` wide, count once, for a held field shows the same
stars again and again. Both sides must have log10 P_rows + log10 P_columns > `TOO_LIKELY`. At each edge a `BORDER` of the side may
be empty: the window of a centroid and masked pixels keep stars out of it. A detector that is merely spanned too little may also be
masked, or its field have few stars: that is no certain sign. Medians bear that some stars are named wrongly. Mirrored and turned
images keep their angles: they are left to `diagnose`.

**Cameras of one design** differ by less than that. Two of them are told apart where stars have measured both in orbit: the set is
the other's if its own e is over `CLEARLY` times that of the other, which is no more than `AT_NOISE`.

**Stars.** Named ones are taken by their names. Else exposures are recognised and matched under the sensor's own camera, under one
whose focal length is as recognised, or under any other for which the time is enough. No table of star patterns is made for another:
what a set without names was never diagnosed for is looked up in the sensor's own.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.calibration.diagnosis.diagnose import FEWEST, SHARE, find_consensus
from boresight.calibration.diagnosis.trials import Bench, Hypothesis
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import star_directions
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

MOST_EXPOSURES, BUDGET_S = 20, 4.0
MOST_OFF, TOO_LIKELY = 0.01, -9.0
#: Size of the places that count once, pixels.
CELL_PX = 4.0
#: Share of a side along each edge where a detector may have no centroids.
BORDER = 0.02
#: How far past the edge the centroid of a star cut by it may be fitted, pixels.
EDGE_PX = 2.0
MOST_SCALE, MOST_SCATTER = 0.02, 0.02
CLEAR_SCALE = 0.1  # no camera of that sensor, whatever the launch did to it
CLEARLY, AT_NOISE = 4.0, 2.0
#: Pairs of stars of an exposure that are looked at, each star with so many of those after it, and pairs that tell anything.
NEIGHBOURS, FEWEST_PAIRS = 4, 20


@dataclass(frozen=True)
class KnownCamera:
    """A registered sensor; `measured`: (n_parameters,) of its camera as stars showed them in orbit, None before."""

    sensor_id: int
    sensor: Sensor
    measured: FloatArray | None = None


@dataclass(frozen=True)
class CameraFit:
    """How a set fits a camera.

    `off`: share of centroids off the detector. `filled`: share of it that they fill, and `likely`, whether that comes about by
    chance. `scale`, `scatter`, `error`: r, s and e as above. `error_measured`: e of what was measured, NaN before.
    """

    off: float
    filled: float
    likely: bool
    scale: float
    scatter: float
    error: float
    error_measured: float

    @property
    def is_on(self) -> bool:
        """Whether the detector is as the centroids want it."""
        return self.off <= MOST_OFF and self.likely

    @property
    def holds(self) -> bool:
        """Whether the stars stand as this camera sees them."""
        return abs(self.scale - 1) <= MOST_SCALE and self.scatter <= MOST_SCATTER


@dataclass(frozen=True)
class OtherCameras:
    """The cameras that a set is of, best first, none where it is of none that is known; and why not of the one it came for.

    `is_certain`: not where its own detector is merely spanned too little.
    """

    cameras: tuple[KnownCamera, ...]
    why: str
    is_certain: bool = True


@dataclass(frozen=True)
class _Stars:
    """Centroids of a sample with the pairs of identified ones: rows (n_pairs,) and the angles between their stars."""

    row_px: FloatArray
    col_px: FloatArray
    first: IntArray
    second: IntArray
    theta_i: FloatArray


def find_other_cameras(
    sample: Telemetry,
    own: KnownCamera,
    others: Sequence[KnownCamera],
    catalogue: Catalogue,
    cache_folder: Path | None = None,
    budget_s: float = BUDGET_S,
) -> OtherCameras | None:
    """Return the other cameras that the set of a sample is of; None where it may be of its own.

    No camera at all where it clearly is of none that is registered: its stars stand as in a camera of another focal length.

    `sample`: whole exposures, `MOST_EXPOSURES` about, with whatever names they have. `budget_s`: seconds, in which a table of star
    patterns that is made is not counted.
    """
    others = [one for one in others if not _are_alike(own, one)]
    if not others and sample.star_id is None:
        return None  # without names, stars are only looked for in the cameras that may be meant
    stars = _find_stars(sample, own, others, catalogue, cache_folder, budget_s)
    if stars is None:
        return None
    ends = time.perf_counter() + budget_s
    mine = _fit(own, stars)
    if mine.is_on and mine.holds:
        return _tell_apart_by_noise(own, mine, others, stars, ends)
    found = [(fit, one) for one, fit in _fits(others, stars, ends) if fit.is_on and fit.holds]
    cameras = tuple(one for _, one in sorted(found, key=lambda pair: pair[0].error))
    is_of_none = abs(mine.scale - 1) > CLEAR_SCALE and mine.scatter <= MOST_SCATTER
    is_certain = not (mine.holds and mine.off <= MOST_OFF)
    return OtherCameras(cameras, _why_not(own, mine), is_certain) if cameras or is_of_none else None


def _are_alike(own: KnownCamera, other: KnownCamera) -> bool:
    """Whether no set could tell two cameras apart: their files say the same, and not both were measured."""
    one, two = own.sensor, other.sensor
    same = one.camera_model == two.camera_model and np.array_equal(one.initial, two.initial)
    same = same and (one.rows, one.columns, one.pixel_pitch_m) == (two.rows, two.columns, two.pixel_pitch_m)
    return same and (own.measured is None or other.measured is None)


def _fits(cameras: Sequence[KnownCamera], stars: _Stars, ends: float) -> Iterator[tuple[KnownCamera, CameraFit]]:
    for one in cameras:
        if time.perf_counter() > ends:
            return
        yield one, _fit(one, stars)


def _tell_apart_by_noise(
    own: KnownCamera, mine: CameraFit, others: Sequence[KnownCamera], stars: _Stars, ends: float
) -> OtherCameras | None:
    """Tell measured cameras apart where the set's own clearly does not have the noise that another has."""
    if own.measured is None:
        return None
    measured = [one for one in others if one.measured is not None]
    found = [(fit.error_measured, one) for one, fit in _fits(measured, stars, ends) if fit.is_on and fit.holds]
    found = [
        (error, one)
        for error, one in found
        if error <= AT_NOISE and min(mine.error, mine.error_measured) > CLEARLY * error
    ]
    if not found:
        return None
    best, camera = min(found, key=lambda pair: pair[0])
    why = (
        f"angles between its stars deviate from the measured camera of {own.sensor.name} by {mine.error_measured:.1f} times their "
        f"noise, and from that of {camera.sensor.name} by {best:.1f} times"
    )
    return OtherCameras((camera,), why)


def _why_not(own: KnownCamera, fit: CameraFit) -> str:
    """Say in a clause what a set has that its sensor's camera has not."""
    name, told = own.sensor.name, list[str]()
    if fit.off > MOST_OFF:
        told.append(f"{100 * fit.off:.0f} % of its centroids are outside the detector of {name}")
    if not fit.likely:
        told.append(f"its centroids fill {100 * fit.filled:.0f} % of the detector of {name}")
    if not fit.holds:
        told.append(f"angles between its stars are {fit.scale:.3g} times those of the camera of {name}")
    return " and ".join(told)


def _fit(camera: KnownCamera, stars: _Stars) -> CameraFit:
    """Return how well a set fits a camera, by the parameters of the sensor file or the measured ones, whichever fit better."""
    sensor = camera.sensor
    off = ~_near_detector(stars, sensor)
    on = np.flatnonzero(~off)
    shares = [_filled(stars.row_px[on], sensor.rows), _filled(stars.col_px[on], sensor.columns)]
    filled, places = shares[0] * shares[1], _count_places(stars, on)
    likely = sum(_log_chance(share, places) for share in shares) > TOO_LIKELY
    told = [_compare(sensor, x, stars) for x in (sensor.initial, camera.measured) if x is not None]
    scale, scatter, error = min(told, key=lambda one: one[2])
    measured = np.nan if camera.measured is None else told[-1][2]
    return CameraFit(float(off.mean()), filled, likely, scale, scatter, error, measured)


def _near_detector(stars: _Stars, sensor: Sensor) -> BoolArray:
    """Which centroids (n_rows,) lie on a detector, or so near its edge that it cuts their images."""
    on_rows = (stars.row_px > -0.5 - EDGE_PX) & (stars.row_px < sensor.rows - 0.5 + EDGE_PX)
    return np.asarray(on_rows & (stars.col_px > -0.5 - EDGE_PX) & (stars.col_px < sensor.columns - 0.5 + EDGE_PX))


def _filled(values: FloatArray, size: int) -> float:
    """Share of a side that centroids span."""
    return min(1.0, float(np.ptp(values)) / size) if len(values) else 0.0


def _count_places(stars: _Stars, on: IntArray) -> int:
    """Return how many places of a detector have centroids."""
    return len({*zip(*(np.round(px[on] / CELL_PX).tolist() for px in (stars.row_px, stars.col_px)), strict=True)})


def _log_chance(filled: float, n: int) -> float:
    """Return log10 of the probability P(f) that n centroids span no more of a side; 0 where no stars tell."""
    f = min(1.0, filled / (1.0 - 2.0 * BORDER))
    if n < 2:
        return 0.0
    return float((n - 1) * np.log10(max(f, 1e-300)) + np.log10(n - (n - 1) * f))


def _compare(sensor: Sensor, x: FloatArray, stars: _Stars) -> tuple[float, float, float]:
    """Return r, s and e of a camera with parameters x."""
    camera = CAMERA_MODELS[sensor.camera_model]
    s = camera.directions(x, stars.row_px, stars.col_px, sensor.pixel_pitch_m)
    theta_d = _angle(s[stars.first], s[stars.second])
    seen = np.isfinite(theta_d)
    if seen.sum() < FEWEST_PAIRS:
        return np.nan, np.inf, np.inf
    theta_d, theta_i = theta_d[seen], stars.theta_i[seen]
    ratio = theta_d / theta_i
    r = float(np.median(ratio))
    sigma = sensor.centroid_sigma_px / camera.focal_px(x, sensor.pixel_pitch_m)
    error = 1.4826 * float(np.median(np.abs(theta_d - theta_i))) / (np.sqrt(2.0) * sigma)
    return r, 1.4826 * float(np.median(np.abs(ratio - r))), error


def _angle(one: FloatArray, other: FloatArray) -> FloatArray:
    """Angles (n,) between unit vectors (n, 3), rad."""
    return np.asarray(2.0 * np.arcsin(np.clip(np.linalg.norm(one - other, axis=1) / 2.0, 0.0, 1.0)))


# Which star is which.


def _find_stars(
    sample: Telemetry,
    own: KnownCamera,
    others: Sequence[KnownCamera],
    catalogue: Catalogue,
    cache_folder: Path | None,
    budget_s: float,
) -> _Stars | None:
    bench = Bench(sample, own.sensor, catalogue, CalibrationSettings(), cache_folder)
    if (named := _by_names(bench)) is not None:
        return named
    bench.prepare()  # making the table is not counted
    bench.ends = time.perf_counter() + budget_s
    recognised = bench.recognise(Hypothesis())
    telemetry, sensor = bench.read(Hypothesis())
    if (stars := _by_matching(bench, telemetry, sensor, recognised)) is not None:
        return stars
    consensus = find_consensus(recognised)
    for one in _by_scale(own, others, None if consensus is None else consensus.focal_ratio):
        if bench.late:
            return None
        trial = Bench(sample, one.sensor, catalogue, CalibrationSettings(), cache_folder)
        trial.looks_up_deg = None if trial.is_prepared else bench.field_deg
        trial.ends = bench.ends
        telemetry, sensor = trial.read(Hypothesis())
        if (stars := _by_matching(trial, telemetry, sensor, trial.recognise(Hypothesis()))) is not None:
            return stars
    return None


def _by_scale(own: KnownCamera, others: Sequence[KnownCamera], ratio: float | None) -> list[KnownCamera]:
    """Return one camera of each kind, those whose focal length was recognised before the others."""
    wanted = np.nan if ratio is None else ratio * _focal_px(own.sensor)
    kinds = {_kind(one.sensor): one for one in reversed(others)}
    return sorted(kinds.values(), key=lambda one: float(np.nan_to_num(abs(_focal_px(one.sensor) / wanted - 1))))


def _kind(sensor: Sensor) -> tuple[int, int, int, int]:
    """Return what cameras of one design share: detector, parity and, to 2 %, focal length."""
    return sensor.rows, sensor.columns, sensor.parity, round(50 * np.log(_focal_px(sensor)))


def _focal_px(sensor: Sensor) -> float:
    return float(CAMERA_MODELS[sensor.camera_model].focal_px(sensor.initial, sensor.pixel_pitch_m))


def _by_names(bench: Bench) -> _Stars | None:
    """Take stars by the names and directions that the file gives."""
    telemetry, sensor = bench.read(Hypothesis())
    given = (telemetry.star_id, telemetry.ra_rad, telemetry.dec_rad, telemetry.time_utc, telemetry.velocity_m_s)
    try:
        s_i = star_directions(*given, bench.catalogue, sensor.site)
    except RefusedInputError:
        return None
    return _pairs(telemetry, s_i, bench.exposures.of_entry)


def _by_matching(bench: Bench, telemetry: Telemetry, sensor: Sensor, recognised: Sequence[object]) -> _Stars | None:
    """Take the stars that match under a camera, where enough of the exposures do."""
    matches = bench.match(telemetry, sensor, recognised)  # type: ignore[arg-type]  # what recognise returned
    if matches.valid.sum() < max(min(FEWEST, len(matches.valid)), SHARE * len(matches.valid)):
        return None
    known = (matches.star_id > 0) & matches.valid[bench.exposures.of_entry]
    return _pairs(telemetry, np.where(known[:, None], matches.s_i, np.nan), bench.exposures.of_entry)


def _pairs(telemetry: Telemetry, s_i: FloatArray, of_entry: IntArray) -> _Stars | None:
    """Pair each identified star with those after it in its exposure; None of too few pairs."""
    rows = np.flatnonzero(np.isfinite(s_i[:, 0]))
    firsts, seconds = list[IntArray](), list[IntArray]()
    for step in range(1, NEIGHBOURS + 1):
        one, other = rows[:-step], rows[step:]
        alike = of_entry[one] == of_entry[other]
        firsts.append(one[alike])
        seconds.append(other[alike])
    first, second = np.concatenate(firsts), np.concatenate(seconds)
    theta_i = _angle(s_i[first], s_i[second])
    apart = theta_i > 0.0
    if apart.sum() < FEWEST_PAIRS:
        return None
    return _Stars(telemetry.row_px, telemetry.col_px, first[apart], second[apart], theta_i[apart])
