"""What is simulated, as a value: sensor, truth, orbit, motion, stars and noise; and its JSON form.

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
      "seed": 1
    }
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.simulation.orbits import MOTIONS, Orbit
from boresight.simulation.sensors import SENSOR_NUMBERS, st16_sensor, st16_truth
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
}
ORBIT_MEASURES = {"altitude_km": (200.0, 2_000.0), "inclination_deg": (0.0, 180.0), "node_hour": (0.0, 24.0)}
OTHER_KEYS = ("sensor", "truth", "orbit", "motion", "pointing_deg", "start_utc")

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
    """Put sensor, truth and Table I together."""
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
    changes["orbit"] = _parse_orbit(document, base.orbit)
    if "pointing_deg" in document:
        changes["pointing_rad"] = float(np.radians(_measure(document, "pointing_deg", {"pointing_deg": (-360, 360)})))
    if "motion" in document:
        changes["motion"] = _parse_motion(document["motion"])
    return replace(base, **changes)


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
    """Return the defaults for the scenario's sensor, a number or a document."""
    sensor = document.get("sensor")
    if isinstance(sensor, int) and not isinstance(sensor, bool) and sensor in SENSOR_NUMBERS:
        return calibration_scenario(sensor)
    if isinstance(sensor, Mapping):
        parsed = parse_sensor(sensor)
        base = calibration_scenario(1)
        return replace(base, sensor=parsed, truth=parsed.initial, centroid_sigma_px=parsed.centroid_sigma_px)
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
            "A scenario's `truth` must give all of the detector a direction; its distortion turns back short of a corner."
        )
    return x


def _parse_orbit(document: Mapping[str, Any], base: Orbit) -> Orbit:
    """Return the orbit: the default one with the given measures and start time."""
    orbit = document.get("orbit", {})
    if not isinstance(orbit, Mapping) or set(orbit) - set(ORBIT_MEASURES):
        raise RefusedInputError(f"A scenario's `orbit` must be an object of {', '.join(ORBIT_MEASURES)}.")
    given = {key: _measure(orbit, key, ORBIT_MEASURES) for key in orbit}
    return Orbit(
        altitude_m=given["altitude_km"] * 1e3 if "altitude_km" in given else base.altitude_m,
        inclination_rad=(
            float(np.radians(given["inclination_deg"])) if "inclination_deg" in given else base.inclination_rad
        ),
        node_hour=given.get("node_hour", base.node_hour),
        start_utc=_parse_time(document["start_utc"]) if "start_utc" in document else base.start_utc,
    )


def _parse_motion(motion: Any) -> str:
    """Return the name of a motion."""
    if not isinstance(motion, str) or motion not in MOTIONS:
        raise RefusedInputError(f"A scenario's `motion` must be one of {', '.join(MOTIONS)}.")
    return motion


def _parse_time(text: Any) -> np.datetime64:
    """Return an instant between 1980 and 2100, where the stars' linear motions hold."""
    refusal = RefusedInputError(
        "A scenario's `start_utc` must be an ISO 8601 time in UTC from 1980 to 2100, as 2026-10-01T00:00:00Z."
    )
    try:
        instant = np.datetime64(str(text).removesuffix("Z"), "us")
    except ValueError as error:
        raise refusal from error
    if not np.datetime64("1980-01-01") <= instant <= np.datetime64("2100-01-01"):  # NaT also compares false
        raise refusal
    return instant


def _measure(document: Mapping[str, Any], key: str, limits: Mapping[str, tuple[float, float]]) -> float:
    """Return the number under `key`, or refuse one that is no number or outside its limits."""
    value, (low, high) = document[key], limits[key]
    whole = limits is WHOLE_NUMBERS
    kinds = int if whole else (int, float)
    if isinstance(value, bool) or not isinstance(value, kinds) or not low <= value <= high:
        kind = "a whole number" if whole else "a number"
        raise RefusedInputError(f"A scenario's `{key}` must be {kind} from {low:g} to {high:g}; it is {value!r}.")
    return value
