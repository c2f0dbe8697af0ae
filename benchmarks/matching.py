"""Matching on simulated truth: what comes back, what is wrong, and how many frames are solved, with 95 % intervals.

    python benchmarks/matching.py --frames 400

Each sensor of E Table III gets a simulated calibration set with one false star an exposure, matched from four starts:

- *ground*: half of the identifications blanked, from the ground calibration, ten typical sigmas uncertain;
- *refined*: the same from the true parameters, a tenth of a typical sigma uncertain;
- *quaternion*: no identifications, the true attitude in the file, from the ground calibration;
- *nothing*: neither, so that lost-in-space identification starts; needs the extra.

Recovered is the share of true stars without a name that were found again; wrong the share of all matches that are not the
true star, false detections included; solved the share of frames with a valid exposure. Of 400 frames of sensor 6, 2.5 %
show fewer than four true stars in either exposure: nobody can solve these. Intervals are Wilson's for as many independent
stars as the scatter between frames leaves, for the stars of one frame succeed and fail together.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from boresight.calibration.options import CalibrationSettings
from boresight.calibration.rematch import Rematcher, ground_covariance
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.sky import identification
from boresight.sky.catalogue import load_catalogue

#: Recovered at least, wrong at most, solved at least, where something is promised.
PROMISED = {
    "ground": (0.97, 0.002, None),
    "refined": (0.99, 0.001, None),
    "quaternion": (None, None, None),
    "nothing": (None, None, 0.97),
}
NORMAL_95 = 1.96


def wilson(part, whole):
    """95 % interval of a share from its counts frame by frame, each (n_frames,)."""
    n, p = whole.sum(), part.sum() / whole.sum()
    together = np.sum((part - p * whole) ** 2) / max(n * p * (1 - p), 1e-12)
    n, z2 = n / max(1.0, together if 0 < p < 1 else 1.0), NORMAL_95**2
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = NORMAL_95 * np.sqrt(p * (1 - p) / n + z2 / (4 * n**2)) / (1 + z2 / n)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def trial(number, start, frames, catalogue, folder):
    """Match one set; returns counts (3, 2, n_frames): recovered of sought, wrong of matched, solved of all."""
    scenario = replace(calibration_scenario(number, frames), false_stars=1.0, blanked_share=0.0)
    rng = np.random.default_rng([number, 2018])
    telemetry = simulate(scenario, rng, catalogue)
    true, sensor = telemetry.star_id, st16_sensor(number)
    share = 0.5 if start in {"ground", "refined"} else 1.0
    given = np.where(rng.random(len(true)) < share, 0, true)
    seen = replace(telemetry, star_id=given, quaternion=telemetry.quaternion if start == "quaternion" else None)
    x, P = sensor.initial, ground_covariance(sensor, 10.0)
    if start == "refined":
        x, P = st16_truth(number), ground_covariance(sensor, 0.1)
    matches = Rematcher(seen, sensor, catalogue, CalibrationSettings(), folder)(x, P)
    sought, found = (true > 0) & (given == 0), matches.star_id > 0
    rows = np.unique(telemetry.frame, return_index=True)[1]
    of_rows = [sought & (matches.star_id == true), sought, found & (matches.star_id != true), found]
    counts = [np.add.reduceat(rows_, rows, dtype=int) for rows_ in of_rows]
    solved = np.logical_or.reduceat(matches.valid, np.unique(matches.frame, return_index=True)[1]).astype(int)
    return np.array([counts[:2], counts[2:], [solved, np.ones_like(solved)]])


def shown(counts, digits):
    """A share with its interval, in percent."""
    part, whole = counts
    low, high = wilson(part, whole)
    return f"{part.sum() / whole.sum():.{digits}%} ({low:.{digits}%} to {high:.{digits}%}) of {whole.sum()}"


def kept(counts, promised):
    """Whether the shares keep what is promised."""
    recovered, wrong, solved = counts[:, 0].sum(axis=-1) / counts[:, 1].sum(axis=-1)
    least, most, least_solved = promised
    checks = [
        least is None or recovered >= least, most is None or wrong <= most, least_solved is None or solved >= least_solved
    ]  # fmt: skip
    return "-" if promised == (None, None, None) else "yes" if all(checks) else "NO"


def main(arguments=None):
    """Run every start on every sensor and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--sensors", default="1,2,3,4,5,6", help="numbers of E Table III")
    options = parser.parse_args(arguments)
    numbers, catalogue = [int(number) for number in options.sensors.split(",")], load_catalogue(None)
    starts = [start for start in PROMISED if start != "nothing" or identification.available()]
    table = Table(title=f"{options.frames} frames a sensor, one false star an exposure; 95 % intervals")
    for column in ("start", "sensor", "recovered", "wrong", "frames solved", "promise kept"):
        table.add_column(column)
    with tempfile.TemporaryDirectory() as folder:
        for start in starts:
            counts = [
                trial(number, start, options.frames, catalogue, Path(folder))
                for number in track(numbers, start, console=Console(stderr=True))
            ]
            for number, of_sensor in [*zip(numbers, counts, strict=True), ("all", np.concatenate(counts, axis=-1))]:
                table.add_row(
                    start, str(number), *(shown(row, digits) for row, digits in zip(of_sensor, (2, 3, 2), strict=True)),
                    kept(of_sensor, PROMISED[start]),
                )  # fmt: skip
            table.add_section()
    Console(width=160).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
