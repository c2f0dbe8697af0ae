"""What a camera on the ground gives with the air above it and without (part `ground`).

Sets are simulated through the air of `SITE` by a camera on a tripod, upright: in each the elevation is held, and in the last kind
it runs from 20 to 80 degrees. Each is calibrated from the same telemetry, star numbers and times and nothing else: with the site in
the sensor file, with air that is not quite known, and without it. Told are

- `focal_ppm`, `aspect_ppm`: how far focal length and aspect are off, the mean over the sets;
- `focal_sigma`, `with_misfit`: root mean square error of the focal length in claimed sigmas, of noise alone and with misfit;
- `noticed`, `cause`: share of the sets whose test of refraction noticed something, and whose causes name it.

Where the elevation is held and the camera is upright, air is a scale and an aspect, which the camera takes up whole: no residual
can show it, and the assumption is named in its place. The real field (`BORESIGHT_REAL_SKY`, five images of one night) gives
directions that hold refraction: from these nothing should be found, from the catalogue refraction, and with the site nothing again.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import boresight as bs
from benchmarks import ROOT, Report, held
from boresight.settings import read_settings
from boresight.simulation.scenes import Scenario, parse_scenario, simulate
from boresight.site import Site
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.sensors import Sensor

SITE = {
    "latitude_deg": 52.22, "longitude_deg": 4.42, "height_m": 10.0, "pressure_hpa": 1013.0, "temperature_c": 15.0,
    "relative_humidity": 0.6, "wavelength_um": 0.55,
}  # fmt: skip
SENSOR = {
    "name": "Tripod", "detector": {"rows": 768, "columns": 1024, "pixel_pitch_m": 6.9e-6}, "camera_model": "pinhole_radial",
    "parity": -1, "centroid_sigma_px": 0.1, "magnitude_limit": 6.5,
    "initial": {"s": 1.0, "f_m": 0.035, "u0_px": 511.5, "v0_px": 383.5, "k1": -0.1, "k2": 0.0},
    "typical_sigma": {"s": 2e-4, "f_m": 3e-4, "u0_px": 10.0, "v0_px": 10.0, "k1": 0.01, "k2": 0.1},
    "free": ["s", "f_m", "u0_px", "v0_px", "k1"], "site": SITE,
    "readout": {"mode": "global"}, "declared": {"directions": "apparent"},
}  # fmt: skip
#: Lowest elevation and span of each kind of set, degrees.
ELEVATIONS = ((20, 0), (30, 0), (45, 0), (60, 0), (80, 0), (20, 60))
UNSURE = {"pressure_hpa": 1033.0, "temperature_c": 25.0}
MAGNITUDE_LIMIT = 6.0


def measure(report: Report, *, sets: int = 10, frames: int = 60, elevations: Any = ELEVATIONS) -> dict[str, Any]:
    """Calibrate sets of every elevation with the site and without, and the real field where it is."""
    rows: dict[str, Any] = {}
    for k, (low, span) in enumerate(elevations):
        name = f"{low} to {low + span}" if span else f"{low}"
        report(k / len(elevations), f"{sets} sets at {name} degrees")
        rows[name] = summarise([list(_calibrated(low, span, frames, seed)) for seed in range(sets)])
    real = real_field()
    wide = next((row for name, row in rows.items() if "to" in name), None)
    limits = {
        "ground mode: focal length off, mean in standard errors": held(
            4.0, max(abs(row["with site"]["focal_ppm"]) / row["with site"]["focal_ppm_error"] for row in rows.values())
        ),
        "ground mode: sets whose test of refraction noticed something": held(
            0.05, max(row["with site"]["noticed"] for row in rows.values())
        ),
    }
    if wide is not None:
        limits["without: sets over 20 to 80 degrees that say refraction"] = held(
            0.9, wide["without"]["cause"], at_least=True
        )
    if real:
        limits["real field: answers that are right"] = held(
            3, sum(one["right"] for one in real.values()), at_least=True
        )
    return {"sets": sets, "frames": frames, "elevations": rows, "real_field": real, "limits": limits}


def scene(low: float, span: float, frames: int, seed: int) -> Scenario:
    """Describe a set whose frames look at elevations from `low` on."""
    return parse_scenario(
        {
            "sensor": SENSOR, "pointing_deg": low, "elevation_span_deg": span, "frames": frames, "exposures": 1,
            "sample_period_s": 30.0, "magnitude_limit": MAGNITUDE_LIMIT, "seed": seed,
        }
    )  # fmt: skip


def _calibrated(low: float, span: float, frames: int, seed: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Calibrate one set with the site, with unsure air, and without."""
    scenario = scene(low, span, frames, seed)
    catalogue = load_catalogue(read_settings().catalogue_folder)
    telemetry = replace(simulate(scenario, np.random.default_rng(seed), catalogue), quaternion=None)
    sites = {"with site": scenario.sensor.site, "unsure air": Site(**{**SITE, **UNSURE}), "without": None}
    for name, site in sites.items():
        found = bs.calibrate(telemetry, replace(scenario.sensor, site=site), progress=False)
        yield name, _told(found, scenario.sensor, scenario.truth)


def _told(found: bs.Calibration, sensor: Sensor, truth: np.ndarray) -> dict[str, Any]:
    every = [name for name in found.parameters if name in sensor.free]
    true = dict(zip(found.parameters, truth.tolist(), strict=True))
    error = {name: found.parameters[name] - true[name] for name in every}
    wide = found.sigma_with_misfit["f_m"] if found.sigma_with_misfit else found.sigma["f_m"]
    return {
        "focal_ppm": 1e6 * error["f_m"] / true["f_m"],
        "aspect_ppm": 1e6 * error["s"],
        "focal_sigma": error["f_m"] / (found.sigma["f_m"] or np.nan),
        "with_misfit": error["f_m"] / (wide or np.nan),
        "noticed": any(test.name == "refraction" and test.noticed for test in found.tests),
        "cause": any(cause.name == "refraction" for cause in found.causes),
    }


def summarise(sets: list[list[tuple[str, dict[str, Any]]]]) -> dict[str, Any]:
    """Of each way of calibrating: means, root mean squares and shares over the sets."""
    found = {}
    for name in dict(sets[0]):
        of = [dict(one)[name] for one in sets]
        values = {key: np.array([one[key] for one in of], float) for key in of[0]}
        found[name] = {
            "focal_ppm": float(values["focal_ppm"].mean()),
            "focal_ppm_error": float(np.std(values["focal_ppm"], ddof=min(1, len(of) - 1)) / np.sqrt(len(of))) or 1.0,
            "aspect_ppm": float(values["aspect_ppm"].mean()),
            "focal_sigma": float(np.sqrt(np.mean(values["focal_sigma"] ** 2))),
            "with_misfit": float(np.sqrt(np.mean(values["with_misfit"] ** 2))),
            "noticed": float(values["noticed"].mean()),
            "cause": float(values["cause"].mean()),
        }
    return found


def real_field() -> dict[str, Any]:
    """Calibrate the real field in three ways; empty where it is not here."""
    folder = Path(os.environ.get("BORESIGHT_REAL_SKY", ROOT.parent / "shared/data/real-sky"))
    if not (folder / "esa-5-frames.csv").is_file():
        return {}
    sensor, telemetry = bs.read_sensor(folder / "esa.sensor.json"), bs.read_telemetry(folder / "esa-5-frames.csv")
    bare = replace(telemetry, ra_rad=None, dec_rad=None)
    at_site = replace(sensor, site=Site(**{name: SITE[name] for name in ("latitude_deg", "longitude_deg", "height_m")}))
    ways: Mapping[str, tuple[Any, Sensor, bool]] = {
        "directions of the file, which hold refraction": (telemetry, sensor, False),
        "directions from the catalogue": (bare, sensor, True),
        "directions from the catalogue, with the site": (bare, at_site, False),
    }
    return {name: _of_real(stars, described, expected=wanted) for name, (stars, described, wanted) in ways.items()}


def _of_real(telemetry: Any, sensor: Sensor, *, expected: bool) -> dict[str, Any]:
    found = bs.calibrate(telemetry, sensor, progress=False)
    (test,) = (one for one in found.tests if one.name == "refraction")
    return {
        "focal_mm": 1e3 * found.parameters["f_m"], "focal_sigma_mm": 1e3 * (found.sigma["f_m"] or np.nan),
        "g_y_ppm": 1e6 * (found.parameters["g_y"] - 1), "g_y_sigma_ppm": 1e6 * (found.sigma["g_y"] or np.nan),
        "chi2_per_dof": found.chi2_per_dof, "adjusted": test.adjusted, "noticed": test.noticed,
        "sentences": [cause.sentence for cause in found.causes if cause.name == "refraction"],
        "right": test.noticed == expected,
    }  # fmt: skip
