"""What the study runs on each telemetry set: the paper's estimators, their peers, and the forms the paper argues about.

All start from the ground calibration with P_0 = (10 typical sigmas)^2, which the paper leaves unstated. Stars are matched again by
the statistical rule, whose tolerance follows from the parameters' covariance; `-flight` takes in only what the flight software
would accept with its fixed tolerance, and from a ground calibration those are the arcs that agree with it. Filters take the
corrected equations (errata to E Eqs 83 to 88) and linearise a frame again while its state still moves; `printed` linearises once
a frame, as printed. The paper's own EKF is that same filter in covariance form.

One simulated set of one sensor: every estimator run on it and held against the truth. Each trial has its own process.

The set is simulated twice from one seed, with the identifications that the estimators get (5 % missing) and with all of them; the
second, whose centroids are the same bit for bit, gives the bound.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import to_plain
from boresight.calibration.evaluation.evaluate import evaluate_parameters
from boresight.calibration.matching.flight_check import ARC_SIGMAS, compute_flight_tolerance
from boresight.calibration.matching.rematch import ground_covariance
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem, build_problem
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.metrics import arc_errors
from boresight.estimation.statistics.consistency import nees
from boresight.estimation.statistics.cramer_rao import centroid_rows
from boresight.simulation.scenes import Scenario, calibration_scenario, simulate, validation_scenario
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

#: E section III-B, from Samaan et al.
REDUCED = ("f_m", "m0_px", "n0_px")
#: The UKF that gets so many times fewer frames stands for a processor without the time for full rate (E section IV).
SPARSE_EVERY = 3

_MATCHED = CalibrationSettings(match="rematch")


@dataclass(frozen=True)
class Estimator:
    """One way to calibrate."""

    key: str
    label: str
    settings: CalibrationSettings
    every: int = 1
    start: str = "ground"
    sensors: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    repeated: bool = True

    @property
    def reduced(self) -> bool:
        """Whether it leaves parameters at their ground values."""
        return self.settings.free is not None


_PAPERS = (
    Estimator("batch", "Batch", replace(_MATCHED, method="batch")),
    Estimator("q", "SQRF Q", replace(_MATCHED, method="sqrf", variant="q")),
    Estimator("no-q", "SQRF No-Q", replace(_MATCHED, method="sqrf", variant="no-q")),
    Estimator("no-refit", "SQRF No-Refit", replace(_MATCHED, method="sqrf", variant="no-refit")),
)
_PEERS = (
    Estimator("ekf", "EKF No-Q", replace(_MATCHED, method="ekf")),
    Estimator("ukf", "UKF No-Q", replace(_MATCHED, method="ukf")),
    Estimator("ukf-sparse", f"UKF, every {SPARSE_EVERY}rd frame", replace(_MATCHED, method="ukf"), SPARSE_EVERY),
    Estimator("printed", "SQRF No-Q, one linearisation", replace(_MATCHED, method="sqrf", linearisations=1)),
    Estimator("cosine", "Batch, cosine of arc", replace(_MATCHED, method="batch", error="cosine")),
)
_REDUCED = tuple(
    Estimator(f"reduced-{paper.key}", f"{paper.label}, f m₀ n₀", replace(paper.settings, free=REDUCED), repeated=False)
    for paper in _PAPERS
)
_FROM_BATCH = tuple(
    Estimator(f"{paper.key}-from-batch", f"{paper.label} from batch", paper.settings, 1, "batch", (4,), repeated=False)
    for paper in _PAPERS[1:]
)

_FLIGHT = tuple(
    Estimator(f"{paper.key}-flight", f"{paper.label}, flight rule", replace(paper.settings, match_rule="flight"))
    for paper in (_PAPERS[0], *_PAPERS[2:])
)

ESTIMATORS: dict[str, Estimator] = {
    estimator.key: estimator for estimator in (*_PAPERS, *_PEERS, *_FLIGHT, *_REDUCED, *_FROM_BATCH)
}


def estimators_for(sensor: int, *, further: bool) -> list[Estimator]:
    """Return what is run on a set of a sensor, the batch first; `further` sets leave out what needs no statistics."""
    return [
        estimator
        for estimator in ESTIMATORS.values()
        if sensor in estimator.sensors and (estimator.repeated or not further)
    ]


Record = dict[str, Any]

#: Seeds of the further sets of a sensor lie so far apart.
SEED_STEP = 1000
#: Tolerances of the flight software to try, as multiples of the one that everything else uses.
TOLERANCE_FACTORS = (1.0, 1.2, 1.5, 2.0, 3.0)
#: Step of a central difference, typical sigmas.
STEP_SIGMA = 1e-2
#: Parts of a calibration that a record keeps as they are.
KEPT = (
    "status", "parameters", "sigma", "covariance", "chi2_per_dof", "nis", "rms_arc_rad", "iterations", "frames", "stars",
)  # fmt: skip
#: Parts of the first set's calibration that only the figures need.
DRAWN = ("history", "observability", "matching")


@dataclass(frozen=True)
class Trial:
    """One set to run."""

    sensor: int
    index: int
    frames: int
    validation_frames: int


@dataclass(frozen=True)
class TrialData:
    """A trial's sets and what is known about them: the problem with every star named, and its information F."""

    sensor: Sensor
    truth: FloatArray
    calibration: Telemetry
    validation: Telemetry
    catalogue: Catalogue
    known: Problem
    F: FloatArray


def run_trial(trial: Trial, catalogue_folder: Path | None) -> list[Record]:
    """Run every estimator on one set; returns a record each, in the registry's order."""
    data = draw_trial(trial, catalogue_folder)
    records: list[Record] = []
    for estimator in estimators_for(trial.sensor, further=trial.index > 0):
        start = data.sensor.initial
        if estimator.start == "batch":
            start = _state(data.sensor, records[0]["parameters"])
        records.append(_record(trial, data, estimator, start))
    return records


@cache
def _catalogue(folder: Path | None) -> Catalogue:
    """Load the catalogue once a process."""
    return load_catalogue(folder)


def draw_trial(trial: Trial, catalogue_folder: Path | None) -> TrialData:
    """Simulate the sets of a trial."""
    catalogue = _catalogue(catalogue_folder)
    scenario = calibration_scenario(trial.sensor, trial.frames)
    validation = validation_scenario(trial.sensor, trial.validation_frames)
    named = _simulated(replace(scenario, blanked_share=0.0), trial, catalogue)
    known = build_problem(named, scenario.sensor, catalogue)
    return TrialData(
        sensor=scenario.sensor,
        truth=scenario.truth,
        calibration=_simulated(scenario, trial, catalogue),
        validation=_simulated(validation, trial, catalogue),
        catalogue=catalogue,
        known=known,
        F=_information(known, scenario.truth),
    )


def _information(known: Problem, truth: FloatArray) -> FloatArray:
    """Fisher information F (n_parameters, n_parameters) of all centroids at the truth, in typical sigmas."""
    scale = known.sensor.typical_sigma
    return centroid_rows(known.camera, truth, known.arcs.whole(), np.arange(len(scale)), scale).information


def _plain_condition(known: Problem, truth: FloatArray) -> float:
    """Condition number of the scaled Jacobian of the arcs at the truth, not whitened (E Eq 23), by central differences."""
    arcs = known.whitened(truth).whole()
    steps = np.diag(STEP_SIGMA * known.sensor.typical_sigma)
    H = np.stack([(arc_errors(arcs, truth + step) - arc_errors(arcs, truth - step)) for step in steps], axis=-1)
    return float(np.linalg.cond(H))


def _simulated(scenario: Scenario, trial: Trial, catalogue: Catalogue) -> Telemetry:
    return simulate(scenario, np.random.default_rng(scenario.seed + SEED_STEP * trial.index), catalogue)


def _record(trial: Trial, data: TrialData, estimator: Estimator, start: FloatArray) -> Record:
    """Calibrate, and hold the result against truth, bound and validation set."""
    sensor = replace(data.sensor, initial=start)
    began = time.perf_counter()
    calibration = calibrate(_thinned(data.calibration, estimator.every), sensor, data.catalogue, estimator.settings)
    found, seen = calibration.to_dict(), calibration.observability
    seconds = time.perf_counter() - began
    x = _state(sensor, found["parameters"])
    record = {
        "sensor": trial.sensor,
        "set": trial.index,
        "estimator": estimator.key,
        **{key: found[key] for key in KEPT},
        "condition_number": seen.condition_number if seen else None,
        **_against_truth(data, found, x, estimator),
        "validation": _evaluation(trial, data, data.validation, found) if trial.index == 0 else None,
        "timing_s": {"calibration": seconds, "fit": calibration.timing_s.get("fit")},
    }
    if trial.index == 0:
        record |= {key: found[key] for key in DRAWN}
        if estimator.key == "batch":
            record["calibration"] = _evaluation(trial, data, data.calibration, found)
            record["plain_condition_number"] = _plain_condition(data.known, data.truth)
            record["tolerances"] = [_at_tolerance(data, record, factor) for factor in TOLERANCE_FACTORS]
    return record


def _thinned(telemetry: Telemetry, every: int) -> Telemetry:
    kept = telemetry.frame % every == 0
    columns = {name: column for name, column in vars(telemetry).items() if isinstance(column, np.ndarray)}
    return replace(telemetry, **{name: column[kept] for name, column in columns.items()})


def _state(sensor: Sensor, parameters: Mapping[str, float]) -> FloatArray:
    return np.array([parameters[name] for name in CAMERA_MODELS[sensor.camera_model].parameter_names])


def _against_truth(data: TrialData, found: Record, x: FloatArray, estimator: Estimator) -> Record:
    """Hold the error of a converged estimate against its claimed covariance (NEES), and per degree of freedom against the bound."""
    names, scale = CAMERA_MODELS[data.sensor.camera_model].parameter_names, data.sensor.typical_sigma
    error = (x - data.truth) / scale
    places = [names.index(name) for name in found["covariance"]["names"]]
    claimed = np.array(found["covariance"]["matrix"]) / np.outer(scale[places], scale[places])
    usable = found["status"] == "converged"
    return {
        "error": dict(zip(names, (error * scale).tolist(), strict=True)),
        "nees": nees(error[places], claimed) if usable else None,
        "nees_dof": len(places),
        "squared_over_bound": float(error @ data.F @ error) / len(error) if usable and not estimator.reduced else None,
    }


def _evaluation(trial: Trial, data: TrialData, telemetry: Telemetry, found: Record) -> Record:
    """Compare ground and estimate on a set, matched again with each and accepted by the rule of the flight software."""
    settings = ESTIMATORS["batch"].settings
    P_ground = ground_covariance(data.sensor, settings.initial_sigma_scale)
    evaluation = evaluate_parameters(
        telemetry, data.sensor, data.catalogue, data.sensor.initial, _state(data.sensor, found["parameters"]), settings,
        P_ground, _covariance(data.sensor, found, P_ground), rng=np.random.default_rng([trial.sensor, trial.index]),
    )  # fmt: skip
    document: Record = to_plain(evaluation)
    return document


def _at_tolerance(data: TrialData, found: Record, factor: float) -> Record:
    """Availability and matched stars of the calibration set with another tolerance of the flight software."""
    settings, x = ESTIMATORS["batch"].settings, _state(data.sensor, found["parameters"])
    settings = replace(settings, flight_tolerance_urad=factor * compute_flight_tolerance(data.sensor, settings) * 1e6)
    seen = evaluate_parameters(data.calibration, data.sensor, data.catalogue, data.sensor.initial, x, settings)
    scores: Record = to_plain(seen)
    kept = ("availability", "matched_star_ratio", "flight_tolerance_rad")
    return {"arc_sigmas": factor * ARC_SIGMAS, **{key: scores[key] for key in kept}}


def _covariance(sensor: Sensor, found: Record, P_ground: FloatArray) -> FloatArray:
    """Covariance (n_parameters, n_parameters) SI of a result; what it held fixed keeps the ground's."""
    names = CAMERA_MODELS[sensor.camera_model].parameter_names
    places = [names.index(name) for name in found["covariance"]["names"]]
    P = P_ground.copy()
    P[np.ix_(places, places)] = found["covariance"]["matrix"]
    return P
