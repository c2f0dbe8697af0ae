"""How soon planned pointings pass the gate of observability, beside chance and the paper's sets (part `pointings`).

For each of the paper's six sensors (E Table I) everything starts from ten typical sigmas of each free parameter. An hour is
planned from 600 pointings over the sky in eight rolls under the same Sun, Moon and Earth; by chance the same pointings are drawn,
one after the other, whatever is allowed. The paper's set is its own frames, as its tracker saw them. Told are minutes and
exposures until the weakest direction is known to the gate's half typical sigma, and that sigma at the end of the hour. Exposures
are told beside minutes because a plan's dwell exposes every ten seconds, while the paper's sets have two exposures in each of
their periods.

A plan is a forecast of sigmas. So the stars of a half hour's plan are simulated with noise and calibrated, `sets` times a sensor:
told are the sigmas that these calibrations claim and their errors, root mean square over sets and parameters, over the forecast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import boresight as bs
from benchmarks import Report, held
from boresight.arrays import FloatArray
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.statistics.observability import WEAK
from boresight.settings import read_settings
from boresight.simulation.pointings import (
    Candidates,
    Constraints,
    Plan,
    draw_pointings,
    exposure_information,
    plan_pointings,
    spread_over_sky,
)
from boresight.simulation.scenes import calibration_scenario, expose, is_on_detector
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

MINUTES, FORECAST_MINUTES = 60.0, 30.0


def measure(
    report: Report, *, sensors: Sequence[int] = (1, 2, 3, 4, 5, 6), draws: int = 20, sets: int = 40
) -> dict[str, Any]:
    """Plan an hour for each sensor, draw as many by chance, and take the frames of the paper's set in their order."""
    catalogue = load_catalogue(read_settings().catalogue_folder)
    rows = []
    for k, number in enumerate(sensors):
        report(k / len(sensors), f"ST16-{number}")
        rows.append(_compared(number, draws, catalogue) | {"forecast": _forecast(number, sets, catalogue)})
    claimed = [one for row in rows for one in row["forecast"]["claimed"]]
    errors = float(np.sqrt(np.mean([row["forecast"]["errors"] ** 2 for row in rows])))
    limits = {
        "minutes to the gate, a plan over chance, the worst sensor": held(
            0.5, max(row["plan"]["minutes"] / row["chance"]["minutes"] for row in rows)
        ),
        "minutes to the gate, a plan over the paper's set, the worst sensor": held(
            0.5, max(row["plan"]["minutes"] / row["paper"]["minutes"] for row in rows)
        ),
        "claimed sigma of a parameter over its forecast, the furthest from 1": held(
            0.1, max(abs(one - 1.0) for one in claimed)
        ),
        "errors over their forecast, off 1": held(0.1, abs(errors - 1.0)),
    }
    return {
        "draws": draws,
        "sets": sets,
        "hour_minutes": MINUTES,
        "forecast_minutes": FORECAST_MINUTES,
        "sensors": rows,
        "limits": limits,
    }


def _forecast(number: int, sets: int, catalogue: Catalogue) -> dict[str, Any]:
    """Calibrate simulated stars of a plan, and hold what is claimed and what is wrong against what the plan forecast."""
    scenario = calibration_scenario(number)
    sensor = replace(scenario.sensor, initial=scenario.truth)
    free = np.array([CAMERA_MODELS[sensor.camera_model].parameter_names.index(name) for name in sensor.free])
    scale = sensor.typical_sigma[free]
    wanted = Constraints(start_utc=scenario.orbit.start_utc, minutes=FORECAST_MINUTES, orbit=scenario.orbit)
    sky = spread_over_sky(200, 4)
    A_1, _ = exposure_information(sky, sensor, scenario.truth, free, scale, catalogue)
    plan = plan_pointings(sky, A_1, np.eye(len(free)) / 100.0, wanted)
    attitude = sky.attitude[np.repeat(plan.place, wanted.exposures)]
    claimed, wrong = [], []
    for seed in range(sets):
        telemetry = observe(attitude, sensor, scenario.truth, catalogue, np.random.default_rng([number, seed]))
        found = bs.calibrate(telemetry, sensor, match="given", progress=False)
        claimed.append(np.array([found.sigma[name] for name in sensor.free], np.float64) / scale / plan.sigma[-1])
        x = np.array([found.parameters[name] for name in sensor.free], np.float64)
        wrong.append((x - scenario.truth[free]) / scale / plan.sigma[-1])
    squares = np.mean(np.square(wrong), axis=1)
    errors = float(np.sqrt(squares.mean()))
    return {
        "claimed": np.mean(claimed, axis=0).tolist(),
        "errors": errors,
        "errors_sigma": float(squares.std(ddof=1) / np.sqrt(sets) / (2.0 * errors)),
    }


def observe(
    attitude: FloatArray, sensor: Sensor, truth: FloatArray, catalogue: Catalogue, rng: np.random.Generator
) -> Telemetry:
    """Telemetry of exposures at attitudes (n, 3, 3), their stars named and where the catalogue has them, with noise."""
    s_i = np.stack(
        [
            np.cos(catalogue.dec_rad) * np.cos(catalogue.ra_rad),
            np.cos(catalogue.dec_rad) * np.sin(catalogue.ra_rad),
            np.sin(catalogue.dec_rad),
        ],
        axis=-1,
    )
    limit = np.inf if sensor.magnitude_limit is None else sensor.magnitude_limit
    bright, camera = np.flatnonzero(catalogue.magnitude < limit), CAMERA_MODELS[sensor.camera_model]
    columns = []
    for k, C in enumerate(attitude):
        s_d = s_i[bright] @ C.T * np.array([1.0, sensor.parity, 1.0])
        ahead = np.flatnonzero(s_d[:, 2] > 0.5)
        row, col = camera.project(truth, s_d[ahead], sensor.pixel_pitch_m)
        on = is_on_detector(sensor, row, col)
        noise = sensor.centroid_sigma_px * rng.standard_normal((2, on.sum()))
        columns.append((np.full(on.sum(), k), bright[ahead[on]], row[on] + noise[0], col[on] + noise[1]))
    frame, star, row, col = (np.concatenate(one) for one in zip(*columns, strict=True))
    return Telemetry(
        frame=frame, exposure=np.zeros_like(frame), row_px=row, col_px=col, star_id=catalogue.hip[star],
        ra_rad=catalogue.ra_rad[star], dec_rad=catalogue.dec_rad[star],
    )  # fmt: skip


def _compared(number: int, draws: int, catalogue: Catalogue) -> dict[str, Any]:
    scenario = calibration_scenario(number)
    sensor, camera = scenario.sensor, CAMERA_MODELS[scenario.sensor.camera_model]
    free = np.array([camera.parameter_names.index(name) for name in sensor.free])
    scale, known = sensor.typical_sigma[free], np.eye(len(free)) / 100.0
    wanted = Constraints(start_utc=scenario.orbit.start_utc, minutes=MINUTES, orbit=scenario.orbit)
    sky = spread_over_sky(600, 8)
    A_1, _ = exposure_information(sky, sensor, scenario.truth, free, scale, catalogue)
    planned = _told(plan_pointings(sky, A_1, known, wanted), wanted)
    drawn = [
        _told(draw_pointings(sky, A_1, known, wanted, np.random.default_rng([number, k])), wanted) for k in range(draws)
    ]
    return {
        "sensor": sensor.name,
        "plan": planned,
        "chance": {key: float(np.median([one[key] for one in drawn])) for key in planned},
        "chance_best": {key: min(one[key] for one in drawn) for key in planned},
        "paper": _paper(number, free, scale, known, catalogue),
    }


def _told(plan: Plan, wanted: Constraints) -> dict[str, float]:
    good = np.flatnonzero(plan.weakest[1:] <= WEAK)
    first = int(good[0]) if len(good) else None
    return {
        "minutes": np.inf if first is None else float(plan.start_s[first] + wanted.dwell_s) / 60.0,
        "exposures": np.inf if first is None else float((first + 1) * wanted.exposures),
        "weakest_sigma": float(plan.weakest[-1]),
    }


def _paper(number: int, free: Any, scale: FloatArray, known: FloatArray, catalogue: Catalogue) -> dict[str, float]:
    scenario = calibration_scenario(number)
    seen = expose(scenario)
    z = seen.attitude[:, 2]
    east = np.stack([-z[:, 1], z[:, 0], 0.0 * z[:, 0]], axis=-1) / np.hypot(z[:, 0], z[:, 1])[:, None]
    north = np.cross(z, east)
    x = seen.attitude[:, 0]
    roll = np.arctan2(np.einsum("ni,ni->n", x, east), np.einsum("ni,ni->n", x, north))
    own = Candidates(np.arctan2(z[:, 1], z[:, 0]), np.arcsin(z[:, 2]), roll)
    A_1, _ = exposure_information(own, scenario.sensor, scenario.truth, free, scale, catalogue)
    weakest = np.linalg.eigvalsh(known + np.cumsum(A_1, axis=0))[:, 0] ** -0.5
    good = np.flatnonzero(weakest <= WEAK)
    within = np.flatnonzero(seen.t_s <= 60.0 * MINUTES)
    return {
        "minutes": float(seen.t_s[good[0]]) / 60.0 if len(good) else np.inf,
        "exposures": float(good[0] + 1) if len(good) else np.inf,
        "weakest_sigma": float(weakest[within[-1]]),
    }
