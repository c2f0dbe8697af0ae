"""What a detector in orbit reports: real stars through the true camera, with noise, misses and false stars.

With C the attitude of an exposure and V the Earth's plus the satellite's velocity, each catalogue star goes

    catalogue --pm, parallax, aberration by V--> s_i --C--> right-handed triad --parity--> s_d --x_true--> (m, n)

1. Candidates: the stars whose catalogue direction lies within the cone that holds the whole detector under the truth.
   Only these are moved to apparent place and projected.
2. A star on the detector is detected with probability 1 / (1 + exp((Hp - limit) / w)), w = 0.1 mag. Of two stars closer
   than 5 px the fainter is lost in the brighter's image; the pull on the brighter's centroid is left out.
3. Each axis of the centroid gets normal noise of sigma(Hp) = sigma_px * 10^(k (Hp - limit)), reported as `sigma_px`.
4. False stars: a Poisson number an exposure, uniform on the detector, of magnitudes near the limit, without star_id.
5. Rows of an exposure come brightest first, as a star tracker lists them; the reported `magnitude` has an error of
   0.1 mag. The quaternion is the true attitude.

With parity -1 the camera sees the left-handed triad (notation page), so y changes its sign between C and the camera.

At the default limit of Hp 4.9 the six calibration sets show 10.8 true stars an exposure on average, of which 10.2 keep
their identification, and 0.5 false ones; 1.6 % of the exposures keep fewer than the four stars a calibration needs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from boresight.arrays import FloatArray, IntArray
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.simulation.orbits import attitude, state, usable
from boresight.simulation.scenarios import (
    Scenario,
    calibration_scenario,
    parse_scenario,
    scenario_document,
    validation_scenario,
)
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import UNMATCHED, Telemetry
from boresight.telemetry.sensors import Sensor

__all__ = [
    "Scenario",
    "calibration_scenario",
    "parse_scenario",
    "scenario_document",
    "simulate",
    "validation_scenario",
]

DETECTION_WIDTH_MAG = 0.1
FAINTEST_BEYOND_LIMIT_MAG = 0.6  # where a detection has become a one in 400 chance
MAGNITUDE_SIGMA = 0.1
BLEND_PX = 5.0
CONE_MARGIN_RAD = np.radians(0.3)  # aberration, and a century of the fastest star's proper motion
CHUNK_EXPOSURES = 512

MEAN_TEMPERATURE_C, TEMPERATURE_SWING_C = 20.0, 5.0

# instants tried for one usable frame: half of a low orbit is dark, and a slew meets Earth and Sun
INSTANTS_PER_FRAME = 6


@dataclass(frozen=True)
class _Exposures:
    """Every exposure of a scenario; arrays of leading dimension n_exposures."""

    frame: IntArray
    exposure: IntArray
    time_utc: NDArray[np.datetime64]
    attitude: FloatArray  # (n, 3, 3), ICRS to the right-handed triad
    velocity_m_s: FloatArray  # (n, 3)
    temperature_c: FloatArray


@dataclass(frozen=True)
class _Stars:
    """Detections; arrays of leading dimension n_detections. `index` is the exposure."""

    index: IntArray
    row_px: FloatArray
    col_px: FloatArray
    magnitude: FloatArray
    star_id: IntArray


def simulate(scenario: Scenario, rng: np.random.Generator, catalogue: Catalogue) -> Telemetry:
    """Simulate one telemetry set.

    Parameters
    ----------
    scenario
        What to simulate.
    rng
        Source of all randomness; for the scenario's own set give `np.random.default_rng(scenario.seed)`.
    catalogue
        Stars at least 0.6 mag fainter than the scenario's limit.

    Returns
    -------
    Telemetry
        Rows by frame, exposure and brightness, with every optional column but the apparent directions.

    Raises
    ------
    RefusedInputError
        When the motion shows too little usable sky for so many frames, or no star at all.
    """
    exposures = _exposures(scenario)
    true = _true_stars(scenario, exposures, catalogue, rng)
    false = _false_stars(scenario, len(exposures.frame), rng)
    if len(true.index) + len(false.index) == 0:
        raise RefusedInputError("The scenario shows no star at all; raise its `magnitude_limit`.")
    return _telemetry(scenario, exposures, _joined(true, false), rng)


def _exposures(scenario: Scenario) -> _Exposures:
    """Choose the usable instants of the motion and expose at each of them."""
    orbit = scenario.orbit
    t_frame = np.arange(INSTANTS_PER_FRAME * scenario.frames + 1000, dtype=np.float64) * scenario.sample_period_s
    boresight = attitude(scenario.motion, orbit, t_frame, scenario.pointing_rad)[:, 2]
    t_frame = t_frame[usable(orbit, t_frame, boresight)][: scenario.frames]
    if len(t_frame) < scenario.frames:
        raise RefusedInputError(
            f"The motion shows usable sky for {len(t_frame)} of {scenario.frames} frames; "
            "change `pointing_deg` or `orbit`, or ask for fewer `frames`."
        )
    t = (t_frame[:, None] + np.arange(scenario.exposures) * scenario.exposure_interval_s).ravel()
    return _Exposures(
        frame=np.repeat(np.arange(scenario.frames, dtype=np.int64), scenario.exposures),
        exposure=np.tile(np.arange(scenario.exposures, dtype=np.int64), scenario.frames),
        time_utc=orbit.times_utc(t),
        attitude=attitude(scenario.motion, orbit, t, scenario.pointing_rad),
        velocity_m_s=state(orbit, t)[1],
        temperature_c=MEAN_TEMPERATURE_C + TEMPERATURE_SWING_C * np.sin(orbit.mean_motion_rad_s * t),
    )


def _true_stars(scenario: Scenario, exposures: _Exposures, catalogue: Catalogue, rng: np.random.Generator) -> _Stars:
    """Image the catalogue: candidates, apparent place, camera, detection, noise."""
    index, star = _candidates(scenario, exposures, catalogue)
    s_i = apparent_directions(catalogue, star, exposures.time_utc[index], exposures.velocity_m_s[index])
    row_px, col_px = _project(scenario, exposures, index, s_i)
    magnitude = catalogue.magnitude[star]
    chance = 1.0 / (1.0 + np.exp((magnitude - scenario.magnitude_limit) / DETECTION_WIDTH_MAG))
    seen = _on_detector(scenario.sensor, row_px, col_px) & (rng.random(len(star)) < chance)
    index, star, magnitude = index[seen], star[seen], magnitude[seen]
    sigma_px = _sigma_px(scenario, magnitude)
    row_px = row_px[seen] + sigma_px * rng.standard_normal(len(star))
    col_px = col_px[seen] + sigma_px * rng.standard_normal(len(star))
    kept = _on_detector(scenario.sensor, row_px, col_px)  # noise may push a star over the edge
    blanked = rng.random(len(star)) < scenario.blanked_share
    star_id = np.where(blanked, UNMATCHED, catalogue.hip[star])
    return _Stars(index[kept], row_px[kept], col_px[kept], magnitude[kept], star_id[kept])


def _candidates(scenario: Scenario, exposures: _Exposures, catalogue: Catalogue) -> tuple[IntArray, IntArray]:
    """Pair exposures with the stars of their cone: exposure (n_pairs,) and catalogue index (n_pairs,)."""
    bright = np.flatnonzero(catalogue.magnitude < scenario.magnitude_limit + FAINTEST_BEYOND_LIMIT_MAG)
    bright = bright[_resolved(scenario, _catalogue_directions(catalogue, bright), catalogue.magnitude[bright])]
    s_i = _catalogue_directions(catalogue, bright)
    nearest = np.cos(_cone_rad(scenario) + CONE_MARGIN_RAD)
    boresight = exposures.attitude[:, 2]
    pairs = [
        np.argwhere(boresight[start : start + CHUNK_EXPOSURES] @ s_i.T > nearest) + np.array([start, 0])
        for start in range(0, len(boresight), CHUNK_EXPOSURES)
    ]
    index, star = np.concatenate(pairs).T
    return index, bright[star]


def _resolved(scenario: Scenario, s_i: FloatArray, magnitude: FloatArray) -> NDArray[np.bool_]:
    """Tell (n,) which stars no brighter neighbour closer than `BLEND_PX` swallows."""
    f_m = scenario.truth[CAMERA_MODELS[scenario.sensor.camera_model].parameter_names.index("f_m")]
    pairs = KDTree(s_i).query_pairs(BLEND_PX * scenario.sensor.pixel_pitch_m / f_m, output_type="ndarray")
    fainter = np.where(magnitude[pairs[:, 0]] > magnitude[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
    resolved = np.ones(len(s_i), dtype=np.bool_)
    resolved[fainter] = False
    return resolved


def _catalogue_directions(catalogue: Catalogue, star: IntArray) -> FloatArray:
    """Return unit vectors (n, 3) at the catalogue's epoch: near enough to choose candidates."""
    ra, dec = catalogue.ra_rad[star], catalogue.dec_rad[star]
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def _cone_rad(scenario: Scenario) -> float:
    """Return the angle between the boresight and the farthest corner of the detector under the truth."""
    sensor = scenario.sensor
    camera = CAMERA_MODELS[sensor.camera_model]
    return camera.cone_rad(scenario.truth, sensor.rows, sensor.columns, sensor.pixel_pitch_m)


def _project(
    scenario: Scenario, exposures: _Exposures, index: IntArray, s_i: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where stars fall, row and column (n,), through attitude, parity and the true camera."""
    s_d = np.einsum("nij,nj->ni", exposures.attitude[index], s_i)
    s_d[:, 1] *= scenario.sensor.parity
    model, pitch = CAMERA_MODELS[scenario.sensor.camera_model], scenario.sensor.pixel_pitch_m
    if scenario.focal_drift_m_per_c == 0.0:
        return model.project(scenario.truth, s_d, pitch)
    row_px, col_px = np.empty(len(index)), np.empty(len(index))
    for exposure, rows in enumerate(np.split(np.arange(len(index)), np.searchsorted(index, range(1, index[-1] + 1)))):
        x = _drifted(scenario, exposures.temperature_c[exposure])
        row_px[rows], col_px[rows] = model.project(x, s_d[rows], pitch)
    return row_px, col_px


def _drifted(scenario: Scenario, temperature_c: float) -> FloatArray:
    """Return the true parameters at a temperature."""
    x = scenario.truth.copy()
    f = CAMERA_MODELS[scenario.sensor.camera_model].parameter_names.index("f_m")
    x[f] += scenario.focal_drift_m_per_c * (temperature_c - MEAN_TEMPERATURE_C)
    return x


def _on_detector(sensor: Sensor, row_px: FloatArray, col_px: FloatArray) -> NDArray[np.bool_]:
    """Tell (n,) which positions fall on a pixel; NaN does not."""
    inside_rows = (row_px >= -0.5) & (row_px <= sensor.rows - 0.5)
    inside_columns = (col_px >= -0.5) & (col_px <= sensor.columns - 0.5)
    on: NDArray[np.bool_] = inside_rows & inside_columns
    return on


def _sigma_px(scenario: Scenario, magnitude: FloatArray) -> FloatArray:
    """Return the one-axis centroid deviation (n,) of stars of these magnitudes."""
    growth = 10.0 ** (scenario.sigma_dex_per_mag * (magnitude - scenario.magnitude_limit))
    return np.asarray(scenario.centroid_sigma_px * growth)


def _false_stars(scenario: Scenario, n_exposures: int, rng: np.random.Generator) -> _Stars:
    """Scatter false detections over the detector."""
    index = np.repeat(np.arange(n_exposures), rng.poisson(scenario.false_stars, n_exposures))
    sensor = scenario.sensor
    return _Stars(
        index=index,
        row_px=rng.uniform(-0.5, sensor.rows - 0.5, len(index)),
        col_px=rng.uniform(-0.5, sensor.columns - 0.5, len(index)),
        magnitude=scenario.magnitude_limit - rng.exponential(0.5, len(index)),
        star_id=np.full(len(index), UNMATCHED, dtype=np.int64),
    )


def _joined(true: _Stars, false: _Stars) -> _Stars:
    """Put true and false stars together, by exposure and brightest first."""
    magnitude = np.concatenate([true.magnitude, false.magnitude])
    index = np.concatenate([true.index, false.index])
    order = np.lexsort((magnitude, index))
    return _Stars(
        index=index[order],
        row_px=np.concatenate([true.row_px, false.row_px])[order],
        col_px=np.concatenate([true.col_px, false.col_px])[order],
        magnitude=magnitude[order],
        star_id=np.concatenate([true.star_id, false.star_id])[order],
    )


def _telemetry(scenario: Scenario, exposures: _Exposures, stars: _Stars, rng: np.random.Generator) -> Telemetry:
    """Write the detections as a telemetry table, with the sensor's own magnitude estimate."""
    index = stars.index
    return Telemetry(
        frame=exposures.frame[index],
        exposure=exposures.exposure[index],
        row_px=stars.row_px,
        col_px=stars.col_px,
        time_utc=exposures.time_utc[index],
        magnitude=stars.magnitude + MAGNITUDE_SIGMA * rng.standard_normal(len(index)),
        sigma_px=_sigma_px(scenario, stars.magnitude),
        star_id=stars.star_id,
        quaternion=Rotation.from_matrix(exposures.attitude).as_quat(canonical=True)[index],
        velocity_m_s=exposures.velocity_m_s[index],
        temperature_c=exposures.temperature_c[index],
    )
