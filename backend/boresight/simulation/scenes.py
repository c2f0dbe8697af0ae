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

What is simulated, as a value: sensor, truth, orbit, motion, stars and noise; and its JSON form.

A scenario file needs only `sensor`: a number 1 to 6 takes that ST-16 with its orbit and motion from E Table I and its
truth from Table III; a sensor document takes its own `initial` as truth unless `truth` is given. Every other key
replaces one default::

    {
      "sensor": 1,
      "truth": {"f_m": 0.01602668, "m0_px": 1012.2},
      "orbit": {"altitude_km": 570, "inclination_deg": 97.8, "node_hour": 10.5},
      "motion": "nadir",
      "pointing_deg": 45,
      "start_utc": "2026-10-01T00:00:00Z",
      "frames": 200,
      "sample_period_s": 40,
      "exposures": 2,
      "exposure_interval_s": 0.25,
      "magnitude_limit": 4.9,
      "centroid_sigma_px": 0.437,
      "sigma_dex_per_mag": 0.0,
      "false_stars": 0.5,
      "blanked_share": 0.05,
      "focal_drift_m_per_c": 0.0,
      "slew_rate_deg_s": 0.0,
      "elevation_span_deg": 0.0,
      "seed": 1
    }

A sensor document with a `site` stands on the ground: its motion is `ground`, and `orbit` has no meaning. Stars are seen through the
site's air; frame k looks at azimuth k times the golden angle, at elevations from `pointing_deg` to `elevation_span_deg` above it,
upright: rows run down to the horizon. Daylight and clouds are left out, and the telemetry has no velocity.

The readout that the sensor document declares is simulated where it says that the centroids are not corrected for it: each star is
seen at the attitude of its own line, found by repeating projection and attitude, and `slew_rate_deg_s` says how fast it moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from boresight.arrays import FloatArray, IntArray
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import Role
from boresight.errors import RefusedInputError
from boresight.simulation.orbits import GOLDEN_ANGLE_RAD, MOTIONS, Orbit, attitude, look_at, state, usable
from boresight.simulation.sensors import SENSOR_NUMBERS, st16_sensor, st16_truth
from boresight.site import Site
from boresight.sky.catalogue import Catalogue, directions_at_epoch
from boresight.sky.ground import observed_directions, view_from
from boresight.telemetry.schema import UNMATCHED, Telemetry
from boresight.telemetry.sensors import Sensor, parse_sensor, sensor_document


@dataclass(frozen=True)
class Scenario:
    """One telemetry set to simulate.

    Parameters
    ----------
    sensor
        What the ground believes; its detector and parity are also the truth's.
    truth
        (n_parameters,) the parameters the stars are imaged with, SI, in state order.
    orbit
        Orbit and start time.
    motion
        A name in `boresight.simulation.orbits.MOTIONS`.
    pointing_rad
        Where that motion looks; each says what it means.
    frames, sample_period_s
        Number of telemetry frames and their spacing; unusable instants are passed over.
    exposures, exposure_interval_s
        Images a frame and their spacing.
    magnitude_limit
        Hp at which half the stars are detected.
    centroid_sigma_px
        One-axis standard deviation of a centroid of a star at the magnitude limit.
    sigma_dex_per_mag
        Growth of that deviation, decades a magnitude: 0 = all stars alike, 0.2 = photon noise, 0.4 = background noise.
    false_stars
        Mean number of false detections an exposure.
    blanked_share
        Share of the true stars whose identification is missing.
    focal_drift_m_per_c
        Change of the true focal length with temperature, about the value at the mean temperature.
    slew_rate_deg_s
        Turn about the detector's column axis beside the motion, by which stars move along the rows.
    elevation_span_deg
        On the ground: how far above `pointing_rad` the highest frame looks.
    seed
        Seed of the random generator that a door makes for this scenario.
    """

    sensor: Sensor
    truth: FloatArray
    orbit: Orbit
    motion: str
    pointing_rad: float
    frames: int = 200
    sample_period_s: float = 40.0
    exposures: int = 2
    exposure_interval_s: float = 0.25
    magnitude_limit: float = 4.9
    centroid_sigma_px: float = 0.437
    sigma_dex_per_mag: float = 0.0
    false_stars: float = 0.5
    blanked_share: float = 0.05
    focal_drift_m_per_c: float = 0.0
    slew_rate_deg_s: float = 0.0
    elevation_span_deg: float = 0.0
    seed: int = 0


# whole numbers and measures of a scenario file, each with its lowest and highest sensible value
WHOLE_NUMBERS = {"frames": (1, 100_000), "exposures": (1, 10), "seed": (0, 2**63 - 1)}
MEASURES = {
    "sample_period_s": (0.1, 86_400.0),
    "exposure_interval_s": (1e-3, 60.0),
    "magnitude_limit": (0.0, 7.0),
    "centroid_sigma_px": (1e-6, 20.0),
    "sigma_dex_per_mag": (0.0, 1.0),
    "false_stars": (0.0, 100.0),
    "blanked_share": (0.0, 1.0),
    "focal_drift_m_per_c": (-1e-4, 1e-4),
    "slew_rate_deg_s": (-10.0, 10.0),
    "elevation_span_deg": (0.0, 85.0),
}
ORBIT_MEASURES = {"altitude_km": (200.0, 2_000.0), "inclination_deg": (0.0, 180.0), "node_hour": (0.0, 24.0)}
OTHER_KEYS = ("sensor", "truth", "orbit", "motion", "pointing_deg", "start_utc")

#: The motion of a sensor on the ground, and how low it may look: the formula of refraction ends near the horizon.
GROUND, LOWEST_ELEVATION_DEG = "ground", 5.0

# E Table I by sensor: altitude km, inclination deg, motion, sample period s; then ours: node hour, and the pointings of
# the calibration and of the validation set in deg, which put the two on different parts of the sky
_TABLE_I = {
    1: (570.0, 97.8, "nadir", 40.0, 10.5, 45.0, 20.0),
    2: (570.0, 97.8, "nadir", 40.0, 10.5, 60.0, 30.0),
    3: (620.0, 98.4, "nadir", 40.0, 14.0, 45.0, 20.0),
    4: (620.0, 98.4, "nadir", 40.0, 14.0, 60.0, 30.0),
    5: (730.0, 97.7, "slew", 10.0, 6.0, 10.0, 40.0),
    6: (670.0, 98.0, "hold_and_slew", 10.0, 18.0, 0.0, 60.0),
}
_CALIBRATION_START = np.datetime64("2026-10-01T00:00:00", "us")
_VALIDATION_DELAY = np.timedelta64(6, "h")


def calibration_scenario(number: int, frames: int = 200) -> Scenario:
    """Return the calibration set of ST-16 number 1 to 6, on the orbit and motion of E Table I."""
    return _table_scenario(number, frames, validation=False)


def validation_scenario(number: int, frames: int = 80) -> Scenario:
    """Return the validation set of ST-16 number 1 to 6: six hours later, another part of the sky, shorter."""
    return _table_scenario(number, frames, validation=True)


def _table_scenario(number: int, frames: int, *, validation: bool) -> Scenario:
    sensor, truth = st16_sensor(number), st16_truth(number)
    altitude_km, inclination_deg, motion, period_s, node_hour, calibration_deg, validation_deg = _TABLE_I[number]
    start = _CALIBRATION_START + (_VALIDATION_DELAY if validation else np.timedelta64(0, "h"))
    return Scenario(
        sensor=sensor,
        truth=truth,
        orbit=Orbit(altitude_km * 1e3, float(np.radians(inclination_deg)), node_hour, start),
        motion=motion,
        pointing_rad=float(np.radians(validation_deg if validation else calibration_deg)),
        frames=frames,
        sample_period_s=period_s,
        centroid_sigma_px=sensor.centroid_sigma_px,
        seed=100 * number + validation,
    )


def parse_scenario(document: Mapping[str, Any]) -> Scenario:
    """Read a scenario document; the module's page shows one.

    Raises
    ------
    RefusedInputError
        When a key is unknown, missing or has a value that makes no sense; names the key.
    """
    if not isinstance(document, Mapping):
        raise RefusedInputError("A scenario must be a JSON object; give at least its `sensor`.")
    known = {*OTHER_KEYS, *WHOLE_NUMBERS, *MEASURES}
    if unknown := sorted(set(document) - known):
        raise RefusedInputError(f"A scenario has no key `{unknown[0]}`; remove it or use one of {sorted(known)}.")
    base = _parse_sensor(document)
    changes: dict[str, Any] = {"truth": _parse_truth(document.get("truth", {}), base)}
    changes |= {key: int(_measure(document, key, WHOLE_NUMBERS)) for key in WHOLE_NUMBERS if key in document}
    changes |= {key: _measure(document, key, MEASURES) for key in MEASURES if key in document}
    start = parse_start(document["start_utc"]) if "start_utc" in document else base.orbit.start_utc
    changes["orbit"] = parse_orbit(document.get("orbit", {}), start, base.orbit)
    if "pointing_deg" in document:
        changes["pointing_rad"] = float(np.radians(_measure(document, "pointing_deg", {"pointing_deg": (-360, 360)})))
    if "motion" in document:
        changes["motion"] = _parse_motion(document["motion"])
    scenario = replace(base, **changes)
    _check_ground(scenario)
    return scenario


def scenario_document(scenario: Scenario) -> dict[str, Any]:
    """Return the JSON form of a scenario with every key written out; `parse_scenario` is its inverse."""
    names = CAMERA_MODELS[scenario.sensor.camera_model].parameter_names
    orbit = scenario.orbit
    return {
        "sensor": sensor_document(scenario.sensor),
        "truth": dict(zip(names, scenario.truth.tolist(), strict=True)),
        "orbit": {
            "altitude_km": orbit.altitude_m / 1e3,
            "inclination_deg": float(np.degrees(orbit.inclination_rad)),
            "node_hour": orbit.node_hour,
        },
        "motion": scenario.motion,
        "pointing_deg": float(np.degrees(scenario.pointing_rad)),
        "start_utc": f"{orbit.start_utc.astype('datetime64[us]')}Z",
        **{key: getattr(scenario, key) for key in (*WHOLE_NUMBERS, *MEASURES)},
    }


def _parse_sensor(document: Mapping[str, Any]) -> Scenario:
    sensor = document.get("sensor")
    if isinstance(sensor, int) and not isinstance(sensor, bool) and sensor in SENSOR_NUMBERS:
        return calibration_scenario(sensor)
    if isinstance(sensor, Mapping):
        parsed = parse_sensor(sensor)
        base = calibration_scenario(1)
        motion = base.motion if parsed.site is None else GROUND
        return replace(
            base, sensor=parsed, truth=parsed.initial, motion=motion, centroid_sigma_px=parsed.centroid_sigma_px
        )
    raise RefusedInputError("A scenario's `sensor` must be a number from 1 to 6 or a sensor document.")


def _parse_truth(truth: Any, base: Scenario) -> FloatArray:
    """Return the true parameters: the default ones with those named in `truth` replaced."""
    names = CAMERA_MODELS[base.sensor.camera_model].parameter_names
    if not isinstance(truth, Mapping) or set(truth) - set(names):
        raise RefusedInputError(f"A scenario's `truth` must be an object of parameters out of {', '.join(names)}.")
    plausible = dict(zip(names, CAMERA_MODELS[base.sensor.camera_model].plausible, strict=True))
    x = np.array(
        [
            _measure(truth, name, plausible) if name in truth else default
            for name, default in zip(names, base.truth.tolist(), strict=True)
        ]
    )
    sensor = base.sensor
    if (
        CAMERA_MODELS[sensor.camera_model].blind_corner(x, sensor.rows, sensor.columns, sensor.pixel_pitch_m)
        is not None
    ):
        raise RefusedInputError(
            "A scenario's `truth` must give all of the detector a direction: correct its distortion, which folds back before "
            "a corner.",
            code="distortion-turns-back",
        )
    return x


def parse_orbit(orbit: Any, start_utc: np.datetime64, base: Orbit | None = None) -> Orbit:
    """Return a circular orbit: the base one with the given measures, or of all three where there is none."""
    names = set(orbit) if isinstance(orbit, Mapping) else {""}
    if not names <= set(ORBIT_MEASURES) or (base is None and len(names) < len(ORBIT_MEASURES)):
        raise RefusedInputError(f"An orbit must be an object of {', '.join(ORBIT_MEASURES)}.")
    measures: dict[str, Any] = {key: _measure(orbit, key, ORBIT_MEASURES) for key in orbit}
    if "altitude_km" in measures:
        measures["altitude_m"] = measures.pop("altitude_km") * 1e3
    if "inclination_deg" in measures:
        measures["inclination_rad"] = float(np.radians(measures.pop("inclination_deg")))
    return Orbit(**measures, start_utc=start_utc) if base is None else replace(base, **measures, start_utc=start_utc)


def _parse_motion(motion: Any) -> str:
    known = (*MOTIONS, GROUND)
    if not isinstance(motion, str) or motion not in known:
        raise RefusedInputError(f"A scenario's `motion` must be one of {', '.join(known)}.")
    return motion


def _check_ground(scenario: Scenario) -> None:
    """Refuse a sensor that is both in orbit and on the ground, and one that looks at the horizon or beyond the zenith."""
    site, low = scenario.sensor.site, float(np.degrees(scenario.pointing_rad))
    if (site is None) == (scenario.motion == GROUND):
        raise RefusedInputError(
            "A scenario's `motion` is ground where its sensor has a `site`, and only there: give both, or neither."
        )
    if site is not None and not (low >= LOWEST_ELEVATION_DEG and low + scenario.elevation_span_deg <= 90.0):
        raise RefusedInputError(
            f"A scenario on the ground must look at elevations from {LOWEST_ELEVATION_DEG:g} to 90 degrees: change "
            "`pointing_deg` or `elevation_span_deg`."
        )


def parse_start(text: Any) -> np.datetime64:
    """Return an instant between 1980 and 2100, where the stars' linear motions hold."""
    refusal = RefusedInputError(
        "`start_utc` must be an ISO 8601 time in UTC from 1980 to 2100, as 2026-10-01T00:00:00Z."
    )
    if not str(text)[:1].isdecimal():  # NumPy also takes "now" and "today"
        raise refusal
    try:
        instant = np.datetime64(str(text).removesuffix("Z"), "us")
    except ValueError as error:
        raise refusal from error
    if not np.datetime64("1980-01-01") <= instant <= np.datetime64("2100-01-01"):  # NaT also compares false
        raise refusal
    return instant


def parse_whole(key: str, value: Any) -> int:
    """Return a whole number of a scenario, or refuse what is none or outside its limits."""
    if isinstance(value, np.integer):
        value = int(value)
    return int(_measure({key: value}, key, WHOLE_NUMBERS))


def _measure(document: Mapping[str, Any], key: str, limits: Mapping[str, tuple[float, float]]) -> float:
    """Return the number under `key`, or refuse one that is no number or outside its limits."""
    value, (low, high) = document[key], limits[key]
    whole = limits is WHOLE_NUMBERS
    kinds = int if whole else (int, float)
    if isinstance(value, bool) or not isinstance(value, kinds) or not low <= value <= high:
        kind = "a whole number" if whole else "a number"
        raise RefusedInputError(f"`{key}` must be {kind} from {low:g} to {high:g}; it is {value!r}.")
    return value


DETECTION_WIDTH_MAG = 0.1
FAINTEST_BEYOND_LIMIT_MAG = 0.6  # where a detection has become a one in 400 chance
MAGNITUDE_SIGMA = 0.1
BLEND_PX = 5.0
CONE_MARGIN_RAD = np.radians(0.3)  # aberration, and a century of the fastest star's proper motion
CHUNK_EXPOSURES = 512

MEAN_TEMPERATURE_C, TEMPERATURE_SWING_C = 20.0, 5.0

#: Share of the span of elevations from one frame to the next.
GOLDEN_RATIO = (np.sqrt(5.0) - 1.0) / 2.0

READOUT_ROUNDS = 3  # a round leaves the displacement times line time times speed: below 1e-2 each

# instants tried for one usable frame: half of a low orbit is dark, and a slew meets Earth and Sun
INSTANTS_PER_FRAME = 6


@dataclass(frozen=True)
class SimulatedExposures:
    """Every exposure of a scenario; arrays of leading dimension n_exposures."""

    frame: IntArray
    exposure: IntArray
    t_s: FloatArray
    time_utc: NDArray[np.datetime64]
    attitude: FloatArray  # (n, 3, 3), ICRS to the right-handed triad
    velocity_m_s: FloatArray | None  # (n, 3); None on the ground, where the site tells it
    temperature_c: FloatArray


@dataclass(frozen=True)
class _Stars:
    """Detections; arrays of leading dimension n_detections. `index` is the exposure."""

    index: IntArray
    row_px: FloatArray
    col_px: FloatArray
    magnitude: FloatArray
    star_id: IntArray


def simulate(
    scenario: Scenario, rng: np.random.Generator, catalogue: Catalogue, exposures: SimulatedExposures | None = None
) -> Telemetry:
    """Simulate one telemetry set.

    Parameters
    ----------
    scenario
        What to simulate.
    rng
        Source of all randomness; for the scenario's own set give `np.random.default_rng(scenario.seed)`.
    catalogue
        Stars at least 0.6 mag fainter than the scenario's limit.
    exposures
        What is exposed instead of the motion's own, as by a second tracker on the same body.

    Returns
    -------
    Telemetry
        Rows by frame, exposure and brightness, with every optional column but the apparent directions.

    Raises
    ------
    RefusedInputError
        When the motion shows too little usable sky for so many frames, or no star at all.
    """
    exposures = expose(scenario) if exposures is None else exposures
    true = _true_stars(scenario, exposures, catalogue, rng)
    false = _false_stars(scenario, len(exposures.frame), rng)
    if len(true.index) + len(false.index) == 0:
        raise RefusedInputError("The scenario shows no star at all; raise its `magnitude_limit`.")
    return _telemetry(scenario, exposures, _joined(true, false), rng)


def expose(scenario: Scenario) -> SimulatedExposures:
    """Choose the usable instants of the motion and expose at each of them."""
    orbit = scenario.orbit
    t_frame = _usable_instants(scenario)
    t = (t_frame[:, None] + np.arange(scenario.exposures) * scenario.exposure_interval_s).ravel()
    in_space = scenario.sensor.site is None
    return SimulatedExposures(
        frame=np.repeat(np.arange(scenario.frames, dtype=np.int64), scenario.exposures),
        exposure=np.tile(np.arange(scenario.exposures, dtype=np.int64), scenario.frames),
        t_s=t,
        time_utc=orbit.times_utc(t),
        attitude=_attitude(scenario, t),
        velocity_m_s=state(orbit, t)[1] if in_space else None,
        temperature_c=MEAN_TEMPERATURE_C + TEMPERATURE_SWING_C * np.sin(orbit.mean_motion_rad_s * t),
    )


def _usable_instants(scenario: Scenario) -> FloatArray:
    """Seconds after the start at which frames are taken, (frames,): on the ground all of them."""
    if scenario.sensor.site is not None:
        return np.arange(scenario.frames, dtype=np.float64) * scenario.sample_period_s
    t_frame = np.arange(INSTANTS_PER_FRAME * scenario.frames + 1000, dtype=np.float64) * scenario.sample_period_s
    boresight = _attitude(scenario, t_frame)[:, 2]
    t_frame = t_frame[usable(scenario.orbit, t_frame, boresight)][: scenario.frames]
    if len(t_frame) < scenario.frames:
        raise RefusedInputError(
            f"The motion shows usable sky for {len(t_frame)} of {scenario.frames} frames; "
            "change `pointing_deg` or `orbit`, or ask for fewer `frames`."
        )
    return t_frame


def _attitude(scenario: Scenario, t_s: FloatArray) -> FloatArray:
    """Return C (n, 3, 3), ICRS to the right-handed triad, at t_s (n,): the motion, and the slew beside it."""
    if scenario.sensor.site is None:
        C = attitude(scenario.motion, scenario.orbit, t_s, scenario.pointing_rad)
    else:
        C = _attitude_on_the_ground(scenario, scenario.sensor.site, t_s)
    if scenario.slew_rate_deg_s == 0.0:
        return C
    turn = np.radians(scenario.slew_rate_deg_s) * t_s[:, None] * np.array([0.0, 1.0, 0.0])
    return np.asarray(Rotation.from_rotvec(turn).as_matrix() @ C)


def _attitude_on_the_ground(scenario: Scenario, site: Site, t_s: FloatArray) -> FloatArray:
    """The same of a camera that stands on the ground: upright, one azimuth and elevation a frame."""
    view = view_from(site, scenario.orbit.times_utc(t_s))
    frame = np.floor(t_s / scenario.sample_period_s + 1e-6)
    elevation = scenario.pointing_rad + np.radians(scenario.elevation_span_deg) * np.mod(frame * GOLDEN_RATIO, 1.0)
    boresight = view.direction(np.mod(frame * GOLDEN_ANGLE_RAD, 2 * np.pi), elevation)
    return look_at(boresight, -view.zenith)


def _true_stars(
    scenario: Scenario, exposures: SimulatedExposures, catalogue: Catalogue, rng: np.random.Generator
) -> _Stars:
    """Image the catalogue: candidates, apparent place, camera, detection, noise."""
    bright = np.flatnonzero(catalogue.magnitude < scenario.magnitude_limit + FAINTEST_BEYOND_LIMIT_MAG)
    bright = bright[_resolved(scenario, directions_at_epoch(catalogue, bright), catalogue.magnitude[bright])]
    index, star = _candidates(scenario, exposures, catalogue, bright)
    velocity = None if exposures.velocity_m_s is None else exposures.velocity_m_s[index]
    s_i = observed_directions(catalogue, star, exposures.time_utc[index], velocity, scenario.sensor.site)
    row_px, col_px = read_out(scenario, exposures, index, s_i)
    magnitude = catalogue.magnitude[star]
    chance = 1.0 / (1.0 + np.exp((magnitude - scenario.magnitude_limit) / DETECTION_WIDTH_MAG))
    seen = is_on_detector(scenario.sensor, row_px, col_px) & (rng.random(len(star)) < chance)
    index, star, magnitude = index[seen], star[seen], magnitude[seen]
    sigma_px = _sigma_px(scenario, magnitude)
    row_px = row_px[seen] + sigma_px * rng.standard_normal(len(star))
    col_px = col_px[seen] + sigma_px * rng.standard_normal(len(star))
    kept = is_on_detector(scenario.sensor, row_px, col_px)  # noise may push a star over the edge
    blanked = rng.random(len(star)) < scenario.blanked_share
    star_id = np.where(blanked, UNMATCHED, catalogue.hip[star])
    return _Stars(index[kept], row_px[kept], col_px[kept], magnitude[kept], star_id[kept])


def visible_stars(
    scenario: Scenario, exposures: SimulatedExposures, catalogue: Catalogue, faintest: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return every star down to a magnitude in the cone that holds the detector, without noise, misses or blends.

    Returns the exposure (n,), ascending, the place in the catalogue (n,), and the apparent direction (n, 3), ICRS axes.
    """
    index, star = _candidates(scenario, exposures, catalogue, np.flatnonzero(catalogue.magnitude < faintest))
    velocity = None if exposures.velocity_m_s is None else exposures.velocity_m_s[index]
    s_i = observed_directions(catalogue, star, exposures.time_utc[index], velocity, scenario.sensor.site)
    order = np.argsort(index, kind="stable")
    return index[order], star[order], s_i[order]


def _candidates(
    scenario: Scenario, exposures: SimulatedExposures, catalogue: Catalogue, bright: IntArray
) -> tuple[IntArray, IntArray]:
    """Pair exposures with those bright stars that lie in their cone: exposure (n_pairs,) and catalogue index (n_pairs,)."""
    s_i = directions_at_epoch(catalogue, bright)
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
    sensor = scenario.sensor
    focal_px = CAMERA_MODELS[sensor.camera_model].focal_px(scenario.truth, sensor.pixel_pitch_m)
    pairs = KDTree(s_i).query_pairs(BLEND_PX / focal_px, output_type="ndarray")
    fainter = np.where(magnitude[pairs[:, 0]] > magnitude[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
    resolved = np.ones(len(s_i), dtype=np.bool_)
    resolved[fainter] = False
    return resolved


def _cone_rad(scenario: Scenario) -> float:
    """Return the angle between the boresight and the farthest corner of the detector under the truth."""
    sensor = scenario.sensor
    camera = CAMERA_MODELS[sensor.camera_model]
    return camera.cone_rad(scenario.truth, sensor.rows, sensor.columns, sensor.pixel_pitch_m)


def read_out(
    scenario: Scenario, exposures: SimulatedExposures, index: IntArray, s_i: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where stars (n,) are when their own line is read, row and column."""
    row_px, col_px = _project(scenario, exposures, index, s_i)
    readout = scenario.sensor.readout
    if readout is None or not readout.is_in_centroids or readout.line_time_s is None:
        return row_px, col_px
    near = np.isfinite(row_px) & np.isfinite(col_px)
    for _ in range(READOUT_ROUNDS):
        line = np.where(near, row_px if readout.axis == "rows" else col_px, 0.0)
        of_line = replace(exposures, attitude=_attitude(scenario, exposures.t_s[index] + line * readout.line_time_s))
        row_px, col_px = _project(scenario, of_line, np.arange(len(index)), s_i)
    return row_px, col_px


def _project(
    scenario: Scenario, exposures: SimulatedExposures, index: IntArray, s_i: FloatArray
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
    x, camera, pitch = scenario.truth.copy(), CAMERA_MODELS[scenario.sensor.camera_model], scenario.sensor.pixel_pitch_m
    drift_px = scenario.focal_drift_m_per_c * (temperature_c - MEAN_TEMPERATURE_C) / pitch
    x[camera.place(Role.FOCAL)] += drift_px * camera.focal_unit(pitch)
    return x


def is_on_detector(sensor: Sensor, row_px: FloatArray, col_px: FloatArray) -> NDArray[np.bool_]:
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


def _telemetry(scenario: Scenario, exposures: SimulatedExposures, stars: _Stars, rng: np.random.Generator) -> Telemetry:
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
        velocity_m_s=None if exposures.velocity_m_s is None else exposures.velocity_m_s[index],
        temperature_c=exposures.temperature_c[index],
    )
