"""Estimators and matching by Monte Carlo on simulated sets, against theory and against what is promised.

    python -m benchmarks.monte_carlo estimators --seeds 30
    python -m benchmarks.monte_carlo more-data --seeds 3
    python -m benchmarks.monte_carlo matching --frames 400
    python -m benchmarks.monte_carlo subsets --sets 200 --frames 300

**estimators**: batch, EKF, square-root, unscented and SVD filters side by side, with process noise and without, far off and near.
Each seed is a new calibration set of the sensor (200 frames, two exposures, about eleven stars each, real catalogue). `far` starts
at the ground calibration of E Table III; `near` within about one typical sigma of the truth, and knows it. One pass a frame is the
filter as textbooks print it. The tables show the root mean square error over the Cramer-Rao bound (geometric mean over the eight
parameters, and the worst), the mean and median NEES with the 95 % bounds that the mean should lie in, the ratio of the sigma an
estimator predicts to the one it has, and its time a frame.

**more-data**: of each sensor a set of 200 frames is calibrated and its sigma after further frames is predicted as
`trust.efficiency` does; then the longer set is simulated, on the same orbit from the same start, and calibrated. A cell gives
predicted over found sigma, the mean over seeds: its geometric mean over parameters, and the parameter farthest from one. The claim
to meet is 10 % for every parameter. Further frames see other fields, and on some orbits these are richer or poorer than the first
200: five times the data is where that shows. A filter with process noise has no row: its sigma follows its last few frames,
whatever came before.

**matching**: each sensor gets a set with one false star an exposure, matched from four starts: *ground*, half of the
identifications blanked, from the ground calibration, ten typical sigmas uncertain; *refined*, the same from the true parameters, a
tenth of a typical sigma uncertain; *quaternion*, no identifications, the true attitude in the file; *nothing*, neither, so that
lost-in-space identification starts. Recovered is the share of true stars without a name that were found again; wrong the share of
all matches that are not the true star, false detections included; solved the share of frames with a valid exposure. Of 400 frames
of sensor 6, 2.5 % show fewer than four true stars in either exposure: nobody can solve these. Intervals are Wilson's for as many
independent stars as the scatter between frames leaves, for the stars of one frame succeed and fail together.

**subsets**: whether any two singular values hold what all three do, and know how well. W's sensor under Model 4, from the truth
with a wide start, each subset on the same sets: the rows that a frame keeps, the sigma that a subset predicts over that of {2, 3}
(the parameter that comes off worst), the mean NEES with the 95 % bounds that it should lie in, and NIS over its degrees of
freedom.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.accuracy import cramer_rao
from benchmarks.stars import wu_field
from boresight.arrays import FloatArray, IntArray
from boresight.calibration.calibrate import calibrate
from boresight.calibration.evaluation import bootstrap
from boresight.calibration.matching.rematch import Rematcher, ground_covariance
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.singular_values import Selection
from boresight.estimation.statistics.consistency import chi_square, nees
from boresight.estimation.statistics.observability import further_covariance
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import WU_TRUTH, st16_sensor, st16_truth
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.sensors import Sensor

ESTIMATORS: dict[str, dict[str, Any]] = {
    "batch": {"method": "batch"},
    **{
        f"{method} {variant}": {"method": method, "variant": variant} for method in FILTERS for variant in ("no-q", "q")
    },
    **{
        f"{method} one pass": {"method": method, "linearisations": 1} for method in ("sqrf", "ukf")
    },  # the EKF's is the sqrf's
}
NEAR_SIGMA = 1.0
FRAMES, FURTHER = 200, (100, 200, 400, 800)
#: Recovered at least, wrong at most, solved at least, where something is promised.
PROMISED = {
    "ground": (0.97, 0.002, None),
    "refined": (0.99, 0.001, None),
    "quaternion": (None, None, None),
    "nothing": (None, None, 0.97),
}
WU_START_SIGMA = np.array([1e-3, 5e-4, 10.0, 10.0, 0.5, 1.0])
SUBSETS = ((2, 3), (1, 2), (1, 3), (1, 2, 3), (1,), (2,), (3,))
CONSOLE = Console(width=160)

sensors_option = click.option(
    "--sensors",
    default="1,2,3,4,5,6",
    help="Numbers of E Table III.",
    callback=lambda _c, _o, text: list(map(int, text.split(","))),
)


def make_table(title: str, *heads: str) -> Table:
    """Make an empty table, its first column to the left."""
    table = Table(title=title)
    for head in heads:
        table.add_column(head, justify="right" if table.columns else "left")
    return table


def tracked(numbers: Iterable[int], words: str) -> Iterable[int]:
    """Show how far a loop is."""
    return track(list(numbers), words, console=Console(stderr=True))


def nees_bounds(parameters: int, sets: int) -> str:
    """Bounds that the mean NEES should lie in, in words."""
    expected = chi_square(float(parameters * sets), parameters * sets)
    return f"mean NEES should lie in {parameters * expected.lower:.2f} to {parameters * expected.upper:.2f}"


def scaled(document: Mapping[str, Any], sensor: Sensor) -> FloatArray:
    """Covariance of a calibration in typical sigmas."""
    return np.array(document["covariance"]["matrix"]) / np.outer(sensor.typical_sigma, sensor.typical_sigma)


@click.group(help=__doc__)
def main() -> None:
    """Run one of the studies."""


Judged = dict[tuple[str, str], tuple[FloatArray, FloatArray, float, float]]


def trial(number: int, seed: int, catalogue: Catalogue) -> tuple[FloatArray, Judged]:
    """Simulate one set and run every estimator from both starts: the bound; error, sigma, NEES, microseconds a frame of each."""
    rng = np.random.default_rng([number, seed])
    telemetry = simulate(calibration_scenario(number), rng, catalogue)
    sensor, truth = st16_sensor(number), st16_truth(number)
    bound = cramer_rao(build_problem(telemetry, sensor, catalogue).arcs.whole(), sensor, truth)
    near = replace(sensor, initial=truth + NEAR_SIGMA * sensor.typical_sigma * rng.normal(size=len(truth)))
    found: Judged = {}
    for begin, of_sensor, sigma in (("far", sensor, 10.0), ("near", near, NEAR_SIGMA)):
        for estimator, chosen in ESTIMATORS.items():
            settings = CalibrationSettings(**chosen, initial_sigma_scale=sigma)
            document = calibrate(telemetry, of_sensor, catalogue, settings).to_dict()
            names = document["covariance"]["names"]
            error = np.array([document["parameters"][name] for name in names]) - truth
            sigmas = np.array([document["sigma"][name] for name in names])
            time_us = document["timing_s"]["fit"] / document["frames"] * 1e6
            found[begin, estimator] = (
                error,
                sigmas,
                nees(error / sensor.typical_sigma, scaled(document, sensor)),
                time_us,
            )
    return bound, found


@main.command()
@click.option("--seeds", default=30)
@sensors_option
def estimators(*, seeds: int, sensors: Sequence[int]) -> None:
    """Estimators against the Cramer-Rao bound and their own sigmas."""
    catalogue, pooled = load_catalogue(None), []
    for number in sensors:
        trials = [trial(number, seed, catalogue) for seed in tracked(range(seeds), f"sensor {number}")]
        pooled += trials
        _show_estimators(f"ST16-{number}", trials)
    _show_estimators("all sensors", pooled)


def _show_estimators(name: str, trials: list[tuple[FloatArray, Judged]]) -> None:
    for begin in ("far", "near"):
        table = make_table(
            f"{name}, {begin} start, {len(trials)} sets; {nees_bounds(8, len(trials))}", "estimator", "RMSE / bound",
            "worst parameter", "mean NEES", "median NEES", "sigma predicted / empirical", "us a frame",
        )  # fmt: skip
        for estimator in ESTIMATORS:
            of_all = [(bound, *found[begin, estimator]) for bound, found in trials]
            ratios, whitened = (np.sqrt(np.mean([(row[1] / row[by]) ** 2 for row in of_all], axis=0)) for by in (0, 2))
            each_nees, time_us = [row[3] for row in of_all], np.median([row[4] for row in of_all])
            table.add_row(
                estimator, f"{np.exp(np.mean(np.log(ratios))):.3f}", f"{ratios.max():.3f}", f"{np.mean(each_nees):.2f}",
                f"{np.median(each_nees):.2f}", f"{np.exp(-np.mean(np.log(whitened))):.3f}", f"{time_us:.0f}",
            )  # fmt: skip
        CONSOLE.print(table)


def fitted(
    number: int, seed: int, frames: int, method: str, catalogue: Catalogue
) -> tuple[FloatArray, FloatArray, int]:
    """Calibrate a simulated set; returns covariance (n, n) and information (n, n) in typical sigmas, and its frames."""
    scenario = replace(calibration_scenario(number), frames=frames)
    telemetry = simulate(scenario, np.random.default_rng([number, seed]), catalogue)
    document = calibrate(telemetry, st16_sensor(number), catalogue, CalibrationSettings(method=method)).to_dict()
    seen = document["observability"]
    V = np.array(seen["right_singular_vectors"]).T
    A = V @ np.diag(np.square(seen["singular_values"])) @ V.T
    return scaled(document, st16_sensor(number)), A, document["frames"]


def sigma_ratios(number: int, seed: int, method: str, catalogue: Catalogue) -> FloatArray:
    """Predicted over found sigma, (n_further, n_parameters)."""
    P, A, frames = fitted(number, seed, FRAMES, method, catalogue)
    found = []
    for further in FURTHER:
        longer_P, _, longer = fitted(number, seed, FRAMES + further, method, catalogue)
        foreseen = further_covariance(P, A / frames, longer - frames)
        found.append(np.sqrt(np.diag(foreseen) / np.diag(longer_P)))
    return np.array(found)


@main.command("more-data")
@click.option("--seeds", default=3)
@sensors_option
def more_data(*, seeds: int, sensors: Sequence[int]) -> None:
    """What more data buys: predicted sigma after further frames, checked by running them."""
    catalogue, worst = load_catalogue(None), np.zeros(len(FURTHER))
    title = f"predicted / found sigma after further frames, from {FRAMES}; {seeds} sets a sensor"
    table = make_table(title, "sensor", "estimator", *(f"+{further}: mean, worst" for further in FURTHER))
    for number in tracked(sensors, "sensors"):
        for method in ("batch", "sqrf"):
            of = np.mean([sigma_ratios(number, seed, method, catalogue) for seed in range(seeds)], axis=0)
            farthest = of[np.arange(len(of)), np.argmax(np.abs(np.log(of)), axis=1)]
            worst = np.maximum(worst, np.abs(farthest - 1))
            means = np.exp(np.log(of).mean(axis=1))
            cells = [f"{mean:.3f}, {far:.3f}" for mean, far in zip(means, farthest, strict=True)]
            table.add_row(f"ST16-{number}", method, *cells)
    CONSOLE.print(table)
    off = ", ".join(f"+{k}: {one:.1%}" for k, one in zip(FURTHER, worst, strict=True))
    CONSOLE.print(f"worst of all parameters: {off}")


def wilson(part: IntArray, whole: IntArray) -> tuple[float, float]:
    """95 % interval of a share from its counts frame by frame, each (n_frames,)."""
    n, p = float(whole.sum()), part.sum() / whole.sum()
    together = np.sum((part - p * whole) ** 2) / max(n * p * (1 - p), 1e-12)
    low, high = bootstrap.wilson(p, n / max(1.0, together if 0 < p < 1 else 1.0))
    return max(low, 0.0), min(high, 1.0)


def matched(number: int, begin: str, frames: int, catalogue: Catalogue, folder: Path) -> IntArray:
    """Match one set; returns counts (3, 2, n_frames): recovered of sought, wrong of matched, solved of all."""
    scenario = replace(calibration_scenario(number, frames), false_stars=1.0, blanked_share=0.0)
    rng = np.random.default_rng([number, 2018])
    telemetry = simulate(scenario, rng, catalogue)
    sensor, true = st16_sensor(number), np.zeros(0, np.int64) if telemetry.star_id is None else telemetry.star_id
    share = 0.5 if begin in {"ground", "refined"} else 1.0
    given = np.where(rng.random(len(true)) < share, 0, true)
    seen = replace(telemetry, star_id=given, quaternion=telemetry.quaternion if begin == "quaternion" else None)
    x, P = sensor.initial, ground_covariance(sensor, 10.0)
    if begin == "refined":
        x, P = st16_truth(number), ground_covariance(sensor, 0.1)
    matches = Rematcher(seen, sensor, catalogue, CalibrationSettings(), folder)(x, P)
    sought, found = (true > 0) & (given == 0), matches.star_id > 0
    rows = np.unique(telemetry.frame, return_index=True)[1]
    of_rows = (sought & (matches.star_id == true), sought, found & (matches.star_id != true), found)
    counts = [np.add.reduceat(each, rows, dtype=int) for each in of_rows]
    solved = np.logical_or.reduceat(matches.valid, np.unique(matches.frame, return_index=True)[1]).astype(int)
    return np.array([counts[:2], counts[2:], [solved, np.ones_like(solved)]])


@main.command()
@click.option("--frames", default=400)
@sensors_option
def matching(*, frames: int, sensors: Sequence[int]) -> None:
    """What comes back, what is wrong, and how many frames are solved, with 95 % intervals."""
    catalogue, title = load_catalogue(None), f"{frames} frames a sensor, one false star an exposure; 95 % intervals"
    table = make_table(title, "start", "sensor", "recovered", "wrong", "frames solved", "promise kept")
    with tempfile.TemporaryDirectory() as folder:
        for begin, promised in PROMISED.items():
            counts = {
                str(number): matched(number, begin, frames, catalogue, Path(folder))
                for number in tracked(sensors, begin)
            }
            for number, of_sensor in (counts | {"all": np.concatenate(list(counts.values()), axis=-1)}).items():
                recovered, wrong, solved = shares = of_sensor[:, 0].sum(axis=-1) / of_sensor[:, 1].sum(axis=-1)
                least, most, least_solved = promised
                kept = (
                    recovered >= (least or 0)
                    and wrong <= (1 if most is None else most)
                    and solved >= (least_solved or 0)
                )
                cells = []
                for row, share, digits in zip(of_sensor, shares, (2, 3, 2), strict=True):
                    low, high = wilson(*row)
                    cells.append(f"{share:.{digits}%} ({low:.{digits}%} to {high:.{digits}%}) of {row[1].sum()}")
                table.add_row(begin, number, *cells, "-" if not any(promised) else "yes" if kept else "NO")
            table.add_section()
    CONSOLE.print(table)


def subset(field: ArcSet, values: tuple[int, ...]) -> FloatArray:
    """Sigmas, NEES, NIS and degrees of freedom of one subset on one set."""
    tuning = Tuning(selection=Selection(4, values))
    history = FILTERS["svd"](field, start(WU_TRUTH, 6, 1.0), np.arange(6), WU_START_SIGMA, tuning)
    error = nees((history.last.x - WU_TRUTH) / WU_START_SIGMA, history.last.P)
    return np.array([*history.sigmas[-1], error, history.nis.sum(), history.dof.sum()])


@main.command()
@click.option("--sets", default=100)
@click.option("--frames", default=300)
@click.option("--stars", default=19.0)
@click.option("--noise-px", default=0.2)
def subsets(*, sets: int, frames: int, stars: float, noise_px: float) -> None:
    """Sigma and NEES of every subset of singular values."""
    found: dict[tuple[int, ...], list[FloatArray]] = {values: [] for values in SUBSETS}
    for seed in tracked(range(sets), "sets"):
        rng = np.random.default_rng(seed)
        field = wu_field(np.maximum(4, rng.poisson(stars, frames)), rng, noise_px)
        for values, rows in found.items():
            rows.append(subset(field, values))
    title = f"{sets} sets of {frames} frames, {stars:g} stars, {noise_px:g} px; {nees_bounds(6, sets)}"
    table = make_table(title, "values", "rows a frame", "sigma / sigma of {2, 3}", "mean NEES", "NIS / dof")
    usual = np.mean(found[2, 3], axis=0)[:6]
    for values, rows in found.items():
        mean = np.mean(rows, axis=0)
        worst = (mean[:6] / usual).max()
        cells = f"{mean[8] / frames:.1f}", f"{worst:.3f}", f"{mean[6]:.2f}", f"{mean[7] / mean[8]:.4f}"
        table.add_row(f"{{{', '.join(map(str, values))}}}", *cells)
    CONSOLE.print(table)


if __name__ == "__main__":
    main()
