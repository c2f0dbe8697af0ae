"""Three years of six sensors: the newest pass alone beside all passes together (part `mission`).

Each ST-16 has a truth that nobody sees: a season, f(T), with a square for the focal length; an ageing that slows down; a slow walk
of every parameter; a step of one at a date; and outages without a pass. Distortion changes by a tenth of that, in typical sigmas:
it is ground into the lens, and the others are how it sits. Each pass is simulated with real stars under the truth of
its day, and has its matches. At checkpoints only the passes so far are there, and two ways tell the camera as it is then:

- `alone`: the newest pass by itself, by the batch, as where nothing remembers the mission; a fit that ends in another minimum is
  done by the library, which looks for these;
- `joint`: all passes, every parameter varying by its evidence (`--vary-as evidence`), at the newest.

Told are errors against the truth of that day: of each parameter in typical sigmas, and of stars on the detector after the best
rotation. The NEES of the joint answer is summed over the sensors of a checkpoint and held against chi-square at 99 %: at 95 % one
window in twenty of a perfect answer is outside, which is the share that is promised. Of the step: whether it was found, its date's
interval, and how many steps are none.

What the policy for new telemetry asks of the same missions is the part `requests`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

import boresight as bs
from benchmarks import Report, held
from benchmarks.accuracy import detector_errors
from boresight.arrays import FloatArray, parse_times, to_days
from boresight.calibration.calibration import InputPass, PassVariation
from boresight.calibration.estimate import Parameters, never
from boresight.calibration.joint.passes import NamedTelemetry, join_sets
from boresight.calibration.joint.passes_fit import list_places
from boresight.calibration.joint.variation import fit_variation
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem, build_problem
from boresight.cameras import CAMERA_MODELS
from boresight.estimation import batch
from boresight.estimation.statistics.consistency import nees
from boresight.estimation.statistics.special import chdtri
from boresight.settings import read_settings
from boresight.simulation.scenes import Scenario, calibration_scenario, expose, simulate
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

YEAR_D = 365.25
START = np.datetime64("2026-01-01T00:00:00", "us")
#: Truth, typical sigmas: walk a root of a day, ageing and its days, season a degree, its square of the focal length, the step.
WALK, AGEING, AGEING_D, SEASON, SQUARE, STEP = 0.004, 0.4, 500.0, 0.03, 0.001, 0.6
#: What is of the glass, and its share of all that: distortion is ground into the lens, the rest is how it sits.
GLASS, OF_GLASS = ("b4_per_m4", "b2_per_m2"), 0.1
#: Temperature, degrees: season, orbit's plane and its days, and from pass to pass.
SWINGS, PLANE_D, SCATTER = (8.0, 3.0), 58.0, 1.5
OUTAGES = 3
#: Chance of a chi-square beyond which a fit is taken to be in another minimum.
OTHER_MINIMUM = 1e-6
#: Share of the windows that the bounds should hold.
BOUNDS = 0.99


@dataclass(frozen=True)
class Mission:
    """What nobody sees of a sensor: its state at each pass, x (n_passes, n_parameters), and the step, (parameter, day).

    `lasting`: x at 15 °C, so without what comes and goes with the temperature.
    """

    scenario: Scenario
    days: FloatArray
    temperature_c: FloatArray
    x: FloatArray
    lasting: FloatArray
    step: tuple[str, float]


@dataclass(frozen=True)
class Seen:
    """What is there of a mission: its passes as one problem, and each by itself, x and covariance in typical sigmas."""

    problem: Problem
    passes: Sequence[InputPass]
    alone: Sequence[batch.BatchFit]


def draw_mission(number: int, passes: int, years: float, seed: int, *, changes: bool = True) -> Mission:
    """Draw days, temperatures and truth of a sensor."""
    rng, span = np.random.default_rng([seed, number]), years * YEAR_D
    scenario = calibration_scenario(number)
    begins, lengths = rng.uniform(0.1, 0.9, OUTAGES) * span, rng.uniform(0.01, 0.04, OUTAGES) * span
    days = np.sort(rng.uniform(0.0, span, 2 * passes))
    out = np.any((days[:, None] >= begins) & (days[:, None] < begins + lengths), axis=1)
    days = np.sort(rng.permutation(days[~out])[:passes])
    turns = 2.0 * np.pi * (days[:, None] / [YEAR_D, PLANE_D] + rng.uniform(0.0, 1.0, 2))
    T = 15.0 + np.sin(turns) @ SWINGS + rng.normal(0.0, SCATTER, passes)
    names, n = CAMERA_MODELS[scenario.sensor.camera_model].parameter_names, len(scenario.truth)
    walk = np.cumsum(rng.normal(size=(passes, n)) * WALK * np.sqrt(np.diff(days, prepend=0.0))[:, None], axis=0)
    z = walk + rng.normal(0.0, AGEING, n) * (1.0 - np.exp(-days / AGEING_D))[:, None]
    warm = rng.normal(0.0, SEASON, n) * (T - 15.0)[:, None]
    warm[:, names.index("f_m")] += SQUARE * (T - 15.0) ** 2
    for change in (z, warm):
        change[:, [name in GLASS for name in names]] *= OF_GLASS
    stepped = int(rng.choice([k for k, name in enumerate(names) if name not in GLASS]))
    day = float(rng.uniform(0.3, 0.8) * span)
    z[days > day, stepped] += rng.choice([-STEP, STEP])
    x, lasting = (scenario.truth + scenario.sensor.typical_sigma * all_ * changes for all_ in (z + warm, z))
    return Mission(scenario, days, T, x, lasting, (names[stepped], day))


def observe(mission: Mission, frames: int, seed: int, catalogue: Catalogue) -> Seen:
    """Simulate the telemetry of every pass, make it one problem, and calibrate each by itself."""
    problem, passes = simulate_passes(mission, frames, seed, catalogue)
    alone = [fit(problem, *end) for end in list_places(problem, passes)]
    for k, (found, (first, last)) in enumerate(zip(alone, list_places(problem, passes), strict=True)):
        arcs = problem.arcs.frames(first, last)
        if found.chi2 > chdtri(2 * arcs.n_stars - 3 * arcs.n_exposures - len(found.A), OTHER_MINIMUM):
            alone[k] = _search(_pass(mission, k, frames, seed, catalogue), mission.scenario.sensor, found)
    return Seen(problem, passes, alone)


def _search(telemetry: Telemetry, sensor: Sensor, found: batch.BatchFit) -> batch.BatchFit:
    """Calibrate a pass by the library, which looks for other minima; `found` is in one of them."""
    best = bs.calibrate(telemetry, sensor, match="given", progress=False)
    scale = np.array([sensor.typical_sigma[list(best.parameters).index(name)] for name in best.covariance.names])
    P = np.array(best.covariance.matrix, np.float64) / np.outer(scale, scale)
    return replace(found, x=np.array(list(best.parameters.values())), A=np.asarray(np.linalg.inv(P)))


def simulate_passes(
    mission: Mission, frames: int, seed: int, catalogue: Catalogue
) -> tuple[Problem, Sequence[InputPass]]:
    """Simulate the telemetry of every pass, and make it one problem."""
    sets = [NamedTelemetry(_pass(mission, k, frames, seed, catalogue), f"pass {k}") for k in range(len(mission.days))]
    joint, sensor = join_sets(sets), mission.scenario.sensor
    return build_problem(joint.read(), sensor, catalogue), joint.passes


def _pass(mission: Mission, k: int, frames: int, seed: int, catalogue: Catalogue) -> Telemetry:
    base, begins = mission.scenario, START + np.timedelta64(round(mission.days[k] * 86_400), "s")
    scenario = replace(base, truth=mission.x[k], frames=frames, orbit=replace(base.orbit, start_utc=begins))
    exposures = expose(scenario)
    exposures = replace(exposures, temperature_c=np.full(len(exposures.frame), mission.temperature_c[k]))
    return simulate(scenario, np.random.default_rng([seed, k, base.seed]), catalogue, exposures)


def fit(problem: Problem, first: int, last: int) -> batch.BatchFit:
    """Fit some frames by themselves, as one camera, from the ground calibration."""
    part = replace(problem, arcs=problem.arcs.frames(first, last))
    free, scale = free_of(problem)
    found = batch.fit(part.whitened(problem.sensor.initial), problem.sensor.initial, free, scale)
    return batch.fit(part.whitened(found.x), found.x, free, scale)


def free_of(problem: Problem) -> tuple[Any, FloatArray]:
    """Places of the free parameters, and their typical sigmas."""
    free = np.array([problem.camera.parameter_names.index(name) for name in problem.sensor.free])
    return free, problem.sensor.typical_sigma[free]


def remember(seen: Seen, passes: int) -> tuple[FloatArray, FloatArray, PassVariation]:
    """Fit the first passes together: the last one's state, SI, its covariance in typical sigmas, and what changed."""
    free, scale = free_of(seen.problem)
    last = list_places(seen.problem, seen.passes)[passes - 1][1]
    problem = replace(seen.problem, arcs=seen.problem.arcs.frames(0, last))
    settings = CalibrationSettings(vary=tuple(seen.problem.sensor.free), vary_as="evidence")
    alike = fit(problem, 0, last).x
    fitted, found = fit_variation(problem, seen.passes[:passes], Parameters(free, scale), alike, settings, never)
    return fitted.states[-1], fitted.solution.P[-1], found


def measure(
    report: Report, *, sensors: Sequence[int] = (1, 2, 3, 4, 5, 6), passes: int = 400, years: float = 3.0, frames: int = 30,
    checkpoints: int = 18, seed: int = 1,
) -> dict[str, Any]:  # fmt: skip
    """Fly the mission of each sensor, and judge both ways."""
    catalogue = load_catalogue(read_settings().catalogue_folder)
    places = np.unique(np.linspace(passes / checkpoints, passes, checkpoints).round().astype(int)).tolist()
    rows, steps = [], []
    for s, number in enumerate(sensors):
        report(s / len(sensors), f"ST16-{number}: {passes} passes")
        mission = draw_mission(number, passes, years, seed)
        seen = observe(mission, frames, seed, catalogue)
        told = None
        for c, place in enumerate(places):
            report((s + (c + 1) / (len(places) + 1)) / len(sensors), f"ST16-{number} after {place} passes")
            x, P, told = remember(seen, place)
            rows.append(_checkpoint(mission, seen, place, x, P, told))
        steps.append(_step(mission, told))
    names = CAMERA_MODELS[mission.scenario.sensor.camera_model].parameter_names
    return summarise(rows, steps, years) | {"parameters": list(names)}


def _checkpoint(
    mission: Mission, seen: Seen, passes: int, x: FloatArray, P: FloatArray, told: PassVariation
) -> dict[str, Any]:
    """Errors of both ways at the last of so many passes."""
    truth, scale = mission.x[passes - 1], mission.scenario.sensor.typical_sigma
    alone, free = seen.alone[passes - 1], free_of(seen.problem)[0]
    return {
        "sensor": mission.scenario.sensor.name,
        "passes": passes,
        "day": float(mission.days[passes - 1]),
        "alone": ((alone.x - truth) / scale).tolist(),
        "joint": ((x - truth) / scale).tolist(),
        "alone_px": displaced(alone.x, truth, mission.scenario),
        "joint_px": displaced(x, truth, mission.scenario),
        "nees": nees(((x - truth) / scale)[free], P),
        "alone_nees": nees(((alone.x - truth) / scale)[free], np.asarray(np.linalg.inv(alone.A), np.float64)),
        "dof": len(free),
        "steps": len(told.steps or ()),
        "false_steps": sum(not _holds(one, mission) for one in told.steps or ()),
    }


def displaced(x: FloatArray, truth: FloatArray, scenario: Scenario) -> float:
    """How far a camera puts stars from where they fall, root mean square over the detector, pixels."""
    camera, sensor = CAMERA_MODELS[scenario.sensor.camera_model], scenario.sensor
    views: Any = SimpleNamespace(sensor=sensor, camera=camera, truth=truth)
    return detector_errors(lambda row, col: camera.directions(x, row, col, sensor.pixel_pitch_m), views)[0]


def _holds(step: Any, mission: Mission) -> bool:
    """Whether a step that was found is the true one: its parameter, and its date inside the interval."""
    begins, ends = to_days(parse_times([step.from_utc, step.to_utc])) - to_days(np.array([START]))
    return bool(step.parameter == mission.step[0] and begins <= mission.step[1] <= ends)


def _step(mission: Mission, told: PassVariation | None) -> dict[str, Any]:
    """What all passes say of the step."""
    found = () if told is None else tuple(one for one in told.steps or () if one.parameter == mission.step[0])
    near = [one for one in found if _holds(one, mission)]
    days = None
    if near:
        begins, ends = to_days(parse_times([near[0].from_utc, near[0].to_utc]))
        days = float(ends - begins)
    return {
        "sensor": mission.scenario.sensor.name,
        "parameter": mission.step[0],
        "day": mission.step[1],
        "found": bool(found),
        "date_inside": bool(near),
        "interval_d": days,
        "sentence": near[0].sentence if near else "",
    }


def summarise(rows: list[dict[str, Any]], steps: list[dict[str, Any]], years: float) -> dict[str, Any]:
    """Put sensors and checkpoints together, and hold them against what is promised."""
    windows = []
    for passes in sorted({row["passes"] for row in rows}):
        of = [row for row in rows if row["passes"] == passes]
        dof = sum(row["dof"] for row in of)
        mean, (lower, upper) = (
            sum(row["nees"] for row in of) / dof,
            chdtri(dof, [(1 + BOUNDS) / 2, (1 - BOUNDS) / 2]) / dof,
        )
        px = {way: float(np.sqrt(np.mean([row[f"{way}_px"] ** 2 for row in of]))) for way in ("alone", "joint")}
        windows.append({
            "passes": passes, "alone_px": px["alone"], "joint_px": px["joint"], "gain": px["alone"] / px["joint"],
            "nees_per_dof": mean, "lower": float(lower), "upper": float(upper), "inside": bool(lower <= mean <= upper),
        })  # fmt: skip
    error = {way: np.sqrt(np.mean([np.square(row[way]) for row in rows], axis=0)) for way in ("alone", "joint")}
    px = {way: float(np.sqrt(np.mean([row[f"{way}_px"] ** 2 for row in rows]))) for way in ("alone", "joint")}
    gain = float(np.exp(np.mean(np.log(error["alone"] / error["joint"]))))
    inside = float(np.mean([one["inside"] for one in windows]))
    limits = {
        "error of the parameters, the newest pass alone over all passes": held(3.0, gain, at_least=True),
        "windows whose NEES is inside its bounds": held(0.95, inside, at_least=True),
    }
    return {
        "years": years, "windows": windows, "alone_px": px["alone"], "joint_px": px["joint"],
        "gain_of_parameters": gain, "gain_of_stars": px["alone"] / px["joint"],
        "alone_sigma": error["alone"].tolist(), "joint_sigma": error["joint"].tolist(),
        "nees_per_dof": sum(row["nees"] for row in rows) / sum(row["dof"] for row in rows),
        "alone_nees_per_dof": sum(row["alone_nees"] for row in rows) / sum(row["dof"] for row in rows),
        "windows_inside": inside, "steps": steps,
        "false_steps_at_checkpoints": sum(row["false_steps"] for row in rows), "checkpoints": len(rows),
        "limits": limits,
    }  # fmt: skip
