"""Accuracy by Monte Carlo: errors against the Cramer-Rao bound, NEES, and predicted against empirical sigma.

    python benchmarks/accuracy.py --seeds 60

Each seed is a new simulated calibration set of the sensor (200 frames, two exposures, about eleven stars each, real catalogue).
The bound knows nothing of arcs: it is the Fisher information of the centroids with each exposure's attitude as nuisance, at the
truth (`boresight.measurements.bound`). Per seed each parameter's error is divided by its bound; the table shows the root mean
square over seeds, whose geometric mean over the eight parameters is the figure to judge by, the mean NEES with the 95 % bounds
it should lie in, and the ratio of predicted to empirical sigma.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.estimation.consistency import chi_square
from boresight.measurements.bound import cramer_rao
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.sky.catalogue import load_catalogue

ESTIMATORS = {
    "batch": CalibrationSettings(method="batch"),
    "sqrf No-Q": CalibrationSettings(method="sqrf"),
    "sqrf Q 0.02": CalibrationSettings(method="sqrf", variant="q"),
    "sqrf as printed": CalibrationSettings(method="sqrf", linearisations=1),
}


def trial(number, seed, catalogue):
    """Simulate one set and run every estimator; returns the bound and per estimator (error, sigma, NEES)."""
    scenario = calibration_scenario(number)
    telemetry = simulate(scenario, np.random.default_rng([number, seed]), catalogue)
    sensor, truth = st16_sensor(number), st16_truth(number)
    bound = cramer_rao(build_problem(telemetry, sensor, catalogue).arcs, sensor, truth)
    found = {}
    for estimator, settings in ESTIMATORS.items():
        document = calibrate(telemetry, sensor, catalogue, settings)
        names = CAMERA_MODELS[sensor.camera_model].parameter_names
        error = np.array([document["parameters"][p] for p in names]) - truth
        P = np.array(document["covariance"]["matrix"]) / np.outer(sensor.typical_sigma, sensor.typical_sigma)
        scaled = error / sensor.typical_sigma
        sigma = np.array([document["sigma"][p] for p in names])
        found[estimator] = (error, sigma, scaled @ np.linalg.solve(P, scaled))
    return bound, found


def main(arguments=None):
    """Run the trials and print a table a sensor."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--sensors", default="1,2,3,4,5,6", help="numbers of E Table III")
    options = parser.parse_args(arguments)
    catalogue = load_catalogue(None)
    console = Console()
    pooled = []
    for number in map(int, options.sensors.split(",")):
        progress = track(range(options.seeds), f"sensor {number}", console=Console(stderr=True))
        trials = [trial(number, seed, catalogue) for seed in progress]
        console.print(summary(f"ST16-{number}", trials))
        pooled += trials
    if len(pooled) > options.seeds:
        console.print(summary("all sensors", pooled))
    return 0


def summary(name, trials):
    """One table: a row an estimator."""
    seeds = len(trials)
    expected = chi_square(8.0 * seeds, 8 * seeds)
    table = Table(
        title=f"{name}, {seeds} sets; mean NEES should lie in {8 * expected.lower:.2f} to {8 * expected.upper:.2f}"
    )
    for column in (
        "estimator",
        "RMSE / bound",
        "worst parameter",
        "mean NEES",
        "median NEES",
        "sigma predicted / empirical",
    ):
        table.add_column(column, justify="left" if column == "estimator" else "right")
    for estimator in ESTIMATORS:
        ratios = np.sqrt(np.mean([(found[estimator][0] / bound) ** 2 for bound, found in trials], axis=0))
        nees = [found[estimator][2] for _, found in trials]
        whitened = np.sqrt(np.mean([(found[estimator][0] / found[estimator][1]) ** 2 for _, found in trials], axis=0))
        table.add_row(
            estimator,
            f"{np.exp(np.mean(np.log(ratios))):.3f}",
            f"{ratios.max():.3f}",
            f"{np.mean(nees):.2f}",
            f"{np.median(nees):.2f}",
            f"{np.exp(-np.mean(np.log(whitened))):.3f}",
        )
    return table


if __name__ == "__main__":
    sys.exit(main())
