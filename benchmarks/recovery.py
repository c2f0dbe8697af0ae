"""What is put into sets of passes comes out of them: f(T) and drift, bias and coverage over many sets (part `recovery`).

Each set is a handful of short passes of an ST-16 with real stars. In one kind the focal length is quadratic in the temperature, and
both coefficients are fitted with their sigmas; in the other it walks from pass to pass, and the drift is estimated with its
intervals of 68 and 95 %.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks import Report, held
from benchmarks.mission import Mission, fit, simulate_passes
from boresight.arrays import FloatArray
from boresight.calibration.estimate import Parameters, never
from boresight.calibration.joint.passes_fit import PassesProblem, list_places, middle_days
from boresight.calibration.joint.variation import fit_variation
from boresight.calibration.options import CalibrationSettings
from boresight.estimation.block_bordered import Linked
from boresight.estimation.walk import WalkedPasses, find_walk
from boresight.settings import read_settings
from boresight.simulation.scenes import calibration_scenario
from boresight.sky.catalogue import Catalogue, load_catalogue

#: Truth of the focal length, typical sigmas: a degree and a degree squared, and a root of a day.
CURVE, DRIFT = (0.03, 0.001), 0.4
#: Half width of a normal interval, and the rise of -2 log L at the ends of one, by share.
WIDTHS = {"inside_68": (1.0, 1.0), "inside_95": (1.96, 3.841458820694124)}
NAMES = ("f(T), a degree", "f(T), a degree squared", "variance of the drift")


def measure(report: Report, *, sets: int = 200, frames: int = 8) -> dict[str, Any]:
    """Draw sets of both kinds, fit them, and count."""
    catalogue = load_catalogue(read_settings().catalogue_folder)
    curved, walked = [], []
    for number in range(sets):
        report(number / sets, f"set {number + 1} of {sets}")
        curved.append(_curved(number, frames, catalogue))
        walked.append(_walked(number, frames, catalogue))
    errors = np.array(curved)
    drifts = np.array([error for error, _ in walked])
    told = {
        name: _told(errors[:, k], {key: np.abs(errors[:, k]) < width for key, (width, _) in WIDTHS.items()})
        for k, name in enumerate(NAMES[:2])
    }
    inside = {key: np.array([hits[key] for _, hits in walked]) for key in WIDTHS}
    told[NAMES[2]] = _told(drifts / max(float(np.std(drifts)), 1e-12), inside)
    bounds = {"inside_68": 0.683, "inside_95": 0.95}
    off = max(
        abs(one[key] - share) / np.sqrt(share * (1 - share) / sets)
        for one in told.values()
        for key, share in bounds.items()
    )
    return {
        "sets": sets, "frames": frames, "recovered": told,
        "limits": {
            "bias, sigmas, the worst": held(0.2, max(abs(one["bias"]) for one in told.values())),
            "coverage of 68 and 95 %, off by standard errors, the worst": held(3.0, float(off)),
        },
    }  # fmt: skip


def _told(errors: FloatArray, inside: dict[str, Any]) -> dict[str, Any]:
    shares = {key: float(np.mean(hits)) for key, hits in inside.items()}
    return {
        "sets": len(errors),
        "bias": float(errors.mean()),
        "bias_error": float(errors.std() / np.sqrt(len(errors))),
        **shares,
    }


def _flown(change: FloatArray, days: FloatArray, warm: FloatArray) -> Mission:
    """A sensor whose focal length is off by so many typical sigmas in each pass."""
    scenario = calibration_scenario(1)
    x = np.tile(scenario.truth, (len(change), 1))
    x[:, 0] += scenario.sensor.typical_sigma[0] * change
    return Mission(scenario, days, warm, x, x, ("f_m", 0.0))


def _problem(
    mission: Mission, frames: int, seed: int, catalogue: Catalogue, settings: CalibrationSettings
) -> PassesProblem:
    problem, passes = simulate_passes(mission, frames, seed, catalogue)
    ends, scale = list_places(problem, passes), problem.sensor.typical_sigma
    alike = fit(problem, 0, ends[-1][1]).x
    return PassesProblem(problem, passes, Parameters(np.arange(len(scale)), scale), alike, settings, never, ends)


def _curved(number: int, frames: int, catalogue: Catalogue) -> FloatArray:
    """Errors of both coefficients over their sigmas, of one set."""
    warm = np.random.default_rng([11, number]).uniform(-20.0, 30.0, 6)
    mission = _flown(CURVE[0] * warm + CURVE[1] * warm**2, 10.0 * np.arange(6.0), warm)
    settings = CalibrationSettings(vary=("f_m",), vary_as="temperature", degree="2")
    of = _problem(mission, frames, number, catalogue, settings)
    _, found = fit_variation(of.problem, of.passes, of.parameters, of.x, settings, never)
    if found.coefficients is None or found.coefficient_sigma is None or found.reference_temperature_c is None:
        raise RuntimeError("A polynomial was fitted, and its coefficients are not there")
    truth = np.array([CURVE[0] + 2.0 * CURVE[1] * found.reference_temperature_c, CURVE[1]])
    found_at = np.array(found.coefficients["f_m"])
    scale = float(of.parameters.scale[0])
    return np.asarray((found_at - truth * scale) / np.array(found.coefficient_sigma["f_m"]))


def _walked(number: int, frames: int, catalogue: Catalogue) -> tuple[float, dict[str, bool]]:
    """Variance of the drift that was found over the true one, less one, and whether its intervals hold it, of one set."""
    rng = np.random.default_rng([12, number])
    days = np.cumsum(rng.integers(1, 6, 15)).astype(float)
    steps = np.cumsum(DRIFT * np.sqrt(np.diff(days, prepend=days[0])) * rng.normal(size=15))
    mission = _flown(steps, days, np.full(15, 15.0))
    settings = CalibrationSettings(vary=("f_m",), vary_as="pass")
    of = _problem(mission, frames, 1000 + number, catalogue, settings)
    fitted = of.fit(Linked(np.array([0]), np.zeros((15, 1))))
    passes = WalkedPasses(fitted.sums, of.departures(fitted), np.array([0]), np.diff(middle_days(of.passes)))
    found = {key: find_walk(passes, rise) for key, (_, rise) in WIDTHS.items()}
    inside = {key: bool(one.low[0] <= DRIFT <= one.high[0]) for key, one in found.items()}
    return float(found["inside_95"].sigma[0] ** 2 / DRIFT**2 - 1.0), inside
