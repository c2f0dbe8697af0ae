"""The sequential estimators side by side: EKF, square-root and unscented, with process noise and without, far off and near.

    python benchmarks/filters.py --seeds 30

Each seed is a new simulated calibration set of the sensor, as in `accuracy.py`, whose bound is taken. `far` starts at the ground
calibration of E Table III; `near` within about one typical sigma of the truth, and knows it. One pass a frame is the filter as
textbooks print it. Per estimator the tables show the root mean square error over the Cramer-Rao bound (geometric mean over the
eight parameters, and the worst), the mean and median NEES with the 95 % bounds that the mean should lie in, the ratio of the sigma
it predicts to the one it has, and its time a frame.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.estimation.consistency import chi_square
from boresight.estimation.filters import FILTERS
from boresight.measurements.bound import cramer_rao
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.sky.catalogue import load_catalogue

SINGLE_PASS = ("sqrf", "ukf")  # the EKF's single pass is the square-root filter's
ESTIMATORS = {
    **{
        f"{method} {variant}": {"method": method, "variant": variant} for method in FILTERS for variant in ("no-q", "q")
    },
    **{f"{method} one pass": {"method": method, "linearisations": 1} for method in SINGLE_PASS},
}
NEAR_SIGMA = 1.0


def trial(number, seed, catalogue):
    """Simulate one set and run every estimator from both starts; returns the bound and {(start, estimator): figures}."""
    rng = np.random.default_rng([number, seed])
    telemetry = simulate(calibration_scenario(number), rng, catalogue)
    sensor, truth = st16_sensor(number), st16_truth(number)
    bound = cramer_rao(build_problem(telemetry, sensor, catalogue).arcs, sensor, truth)
    near = replace(sensor, initial=truth + NEAR_SIGMA * sensor.typical_sigma * rng.normal(size=len(truth)))
    found = {}
    for start, of_sensor, sigma in (("far", sensor, 10.0), ("near", near, NEAR_SIGMA)):
        for estimator, chosen in ESTIMATORS.items():
            settings = CalibrationSettings(**chosen, initial_sigma_scale=sigma)
            document = calibrate(telemetry, of_sensor, catalogue, settings)
            found[start, estimator] = figures(document, truth, sensor.typical_sigma)
    return bound, found


def figures(document, truth, scale):
    """Error, sigma, NEES and microseconds a frame of one calibration."""
    names = document["covariance"]["names"]
    error = np.array([document["parameters"][name] for name in names]) - truth
    sigma = np.array([document["sigma"][name] for name in names])
    P = np.array(document["covariance"]["matrix"]) / np.outer(scale, scale)
    nees = (error / scale) @ np.linalg.solve(P, error / scale)
    return error, sigma, nees, document["timing_s"]["fit"] / document["frames"] * 1e6


def main(arguments=None):
    """Run the trials and print one table a sensor and start, and both over all sensors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--sensors", default="1,2,3,4,5,6", help="numbers of E Table III")
    options = parser.parse_args(arguments)
    catalogue, console, pooled = load_catalogue(None), Console(), []
    for number in map(int, options.sensors.split(",")):
        progress = track(range(options.seeds), f"sensor {number}", console=Console(stderr=True))
        trials = [trial(number, seed, catalogue) for seed in progress]
        for start in ("far", "near"):
            console.print(summary(f"ST16-{number}", start, trials))
        pooled += trials
    for start in ("far", "near"):
        console.print(summary("all sensors", start, pooled))
    return 0


def summary(name, start, trials):
    """One table: a row an estimator."""
    expected = chi_square(8.0 * len(trials), 8 * len(trials))
    bounds = f"{8 * expected.lower:.2f} to {8 * expected.upper:.2f}"
    table = Table(title=f"{name}, {start} start, {len(trials)} sets; mean NEES should lie in {bounds}")
    for column in (
        "estimator",
        "RMSE / bound",
        "worst parameter",
        "mean NEES",
        "median NEES",
        "sigma predicted / empirical",
        "us a frame",
    ):
        table.add_column(column, justify="left" if column == "estimator" else "right")
    for estimator in ESTIMATORS:
        of_all = [(bound, *found[start, estimator]) for bound, found in trials]
        ratios = np.sqrt(np.mean([(error / bound) ** 2 for bound, error, *_ in of_all], axis=0))
        whitened = np.sqrt(np.mean([(error / sigma) ** 2 for _, error, sigma, *_ in of_all], axis=0))
        nees = [row[3] for row in of_all]
        table.add_row(
            estimator,
            f"{np.exp(np.mean(np.log(ratios))):.3f}",
            f"{ratios.max():.3f}",
            f"{np.mean(nees):.2f}",
            f"{np.median(nees):.2f}",
            f"{np.exp(-np.mean(np.log(whitened))):.3f}",
            f"{np.median([row[4] for row in of_all]):.0f}",
        )
    return table


if __name__ == "__main__":
    sys.exit(main())
