"""What a sensor's policy would ask of people over three years, and how much of it is false (part `requests`).

The missions are those of the part `mission`, by another seed, and each again with a camera in which nothing changes. Each pass is
calibrated by itself; then the policy walks over them by its usual rules, as its dry run does.

A request is false where nothing happened that it tells: a jump where the step is neither at that pass nor at the one before it; a
drift where what lasts, without what the temperature does, changed by less than `WRONG` of the reference's sigmas since then; and
before there are enough passes for a forecast, where the whole change is below `WRONG` sigmas of the two. How many are to be
expected follows from the policy alone: its false-alarm rate times the passes. A mission in which nothing changes is held to that,
as the number that a Poisson distribution of this mean exceeds once in a hundred times.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks import Report, held
from benchmarks.mission import Mission, Seen, displaced, draw_mission, free_of, observe
from boresight.console.fleet.trend import Trend, TrendPoint
from boresight.console.ingest.change_tests import PolicyFinding, walk_over
from boresight.console.ingest.rules import PolicyRules
from boresight.settings import read_settings
from boresight.sky.catalogue import load_catalogue

#: Sigmas of a change below which a request was false, and the chance of more requests than are allowed where nothing changes.
WRONG, BEYOND = 3.0, 0.01
RULES = PolicyRules(least_stars=4)


@dataclass(frozen=True)
class _Request:
    """One request: of which pass, of what kind, against which pass, and whether it is false."""

    k: int
    kind: str
    reference: int
    is_false: bool


def measure(
    report: Report, *, sensors: Sequence[int] = (1, 2, 3, 4, 5, 6), passes: int = 400, years: float = 3.0, frames: int = 30,
    seed: int = 20261128,
) -> dict[str, Any]:  # fmt: skip
    """Fly each mission, with change and without, and let the policy walk over its passes."""
    catalogue = load_catalogue(read_settings().catalogue_folder)
    told: dict[str, list[dict[str, Any]]] = {"mission": [], "nothing changes": []}
    for s, number in enumerate(sensors):
        for name, changes in (("mission", True), ("nothing changes", False)):
            report((s + 0.5 * (not changes)) / len(sensors), f"ST16-{number}, {name}: {passes} passes")
            mission = draw_mission(number, passes, years, seed, changes=changes)
            told[name].append(ask(mission, observe(mission, frames, seed, catalogue)))
    return summarise(told, years)


def ask(mission: Mission, seen: Seen) -> dict[str, Any]:
    """Let the policy walk over the passes of a sensor."""
    points = [_point(mission, seen, k) for k in range(len(mission.days))]
    trend = Trend(mission.scenario.sensor, None, mission.scenario.sensor.camera_model, points, (), (), (), {})  # type: ignore[arg-type]
    walked = walk_over(points, trend, RULES)
    requests = [_request(mission, seen, point.run_id, found) for point, found in walked if found.state == "ASKED"]
    stepped = int(np.searchsorted(mission.days, mission.step[1]))
    return {
        "states": dict(Counter(found.state for _, found in walked)),
        "forecasts": sum(found.forecast is not None for _, found in walked),
        "kinds": dict(Counter(one.kind for one in requests)),
        "false": sum(one.is_false for one in requests),
        "false_jumps": sum(one.is_false for one in requests if one.kind == "JUMP"),
        "step_told": any(one.kind == "JUMP" and one.k == stepped for one in requests),
        "displaced_px": [
            displaced(seen.alone[one.reference].x, mission.x[one.k], mission.scenario) for one in requests
        ],
    }


def _request(mission: Mission, seen: Seen, k: int, found: PolicyFinding) -> _Request:
    """Say what a request is of, and whether the truth bears it."""
    reference = 0 if found.reference is None or found.reference.run_id is None else found.reference.run_id
    B, P = (np.linalg.inv(seen.alone[one].A) for one in (reference, k))
    if found.forecast is not None and found.forecast.rejects:
        stepped = int(np.searchsorted(mission.days, mission.step[1]))
        moved = bool((mission.x[k] != mission.x[0]).any())
        return _Request(k, "JUMP", reference, not (moved and k - 1 <= stepped <= k))
    if found.forecast is None:
        return _Request(
            k, "NO FORECAST", reference, _size(mission, seen, mission.x[k] - mission.x[reference], B + P) < WRONG
        )
    return _Request(
        k, "DRIFT", reference, _size(mission, seen, mission.lasting[k] - mission.lasting[reference], B) < WRONG
    )


def _size(mission: Mission, seen: Seen, change: Any, C: Any) -> float:
    """Size of a true change, SI, in sigmas of a covariance in typical sigmas."""
    z = (change / mission.scenario.sensor.typical_sigma)[free_of(seen.problem)[0]]
    return float(np.sqrt(z @ np.linalg.solve(C, z)))


def _point(mission: Mission, seen: Seen, k: int) -> TrendPoint:
    """A pass as the trend of its sensor has it."""
    sensor, one, at = mission.scenario.sensor, seen.alone[k], seen.passes[k]
    free, scale = free_of(seen.problem)
    names = seen.problem.camera.parameter_names
    begins, ends = str(at.start_utc), str(at.end_utc)
    return TrendPoint(
        run_id=k, label="", method="batch", telemetry_set_id=k, telemetry=at.name, begins_utc=begins, at_utc=begins,
        ends_utc=ends, timed=True, temperature_c=at.temperature_c, camera_model=sensor.camera_model,
        names=tuple(names[p] for p in free), parameters=dict(zip(names, one.x.tolist(), strict=True)),
        covariance=np.linalg.inv(one.A) * np.outer(scale, scale), stars=at.detections, rms_arc_rad=None,
        left_out="" if one.status == "converged" else one.status, said="",
    )  # fmt: skip


def summarise(told: dict[str, list[dict[str, Any]]], years: float) -> dict[str, Any]:
    """Put the sensors together, and hold them against what follows from the policy."""
    sensor_years = years * len(told["mission"])
    policy = {name: _policy(of, sensor_years) for name, of in told.items()}
    quiet = policy["nothing changes"]
    return {
        "years": years,
        "false_alarm_rate": RULES.false_alarm_rate,
        "steps": len(told["mission"]),
        "steps_told": sum(one["step_told"] for one in told["mission"]),
        "policy": policy,
        "limits": {
            "false requests a sensor and year in a mission": held(1.0, policy["mission"]["false_a_year"]),
            "requests a sensor and year where nothing changes": held(
                _most(quiet["expected_a_year"] * sensor_years) / sensor_years, quiet["requests_a_year"]
            ),
        },
    }


def _most(mean: float) -> int:
    """The number that a Poisson distribution of a mean exceeds with the chance `BEYOND`."""
    n, term = 0, float(np.exp(-mean))
    total = term
    while total < 1.0 - BEYOND:
        n += 1
        term *= mean / n
        total += term
    return n


def _policy(of: list[dict[str, Any]], sensor_years: float) -> dict[str, Any]:
    """What a policy would have asked for, a sensor and year."""
    states, kinds, px = Counter[str](), Counter[str](), [px for one in of for px in one["displaced_px"]]
    for one in of:
        states.update(one["states"])
        kinds.update(one["kinds"])
    return {
        "states": dict(states), "kinds": dict(kinds), "requests_a_year": states["ASKED"] / sensor_years,
        "expected_a_year": RULES.false_alarm_rate * states.total() / sensor_years,
        "false_a_year": sum(one["false"] for one in of) / sensor_years,
        "false_jumps_a_year": sum(one["false_jumps"] for one in of) / sensor_years,
        "displaced_px": float(np.median(px)) if px else None,
    }  # fmt: skip
