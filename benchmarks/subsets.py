"""Whether any two singular values hold what all three do, and know how well: sigma and NEES of every subset, on simulated sets.

    python benchmarks/subsets.py --sets 200 --frames 300

W's sensor under Model 4, from the truth with a wide start, each subset on the same sets. The table shows the rows that a frame
keeps, the sigma that a subset predicts over that of {2, 3} (the parameter that comes off worst), the mean NEES with the 95 % bounds
that it should lie in, and NIS over its degrees of freedom.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import ArcSet
from boresight.estimation.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation.consistency import chi_square, nees
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.singular_values import Selection
from boresight.simulation.sensors import WU_COLUMNS, WU_PIXEL_PITCH_M, WU_ROWS, WU_TRUTH

START_SIGMA = np.array([1e-3, 5e-4, 10.0, 10.0, 0.5, 1.0])
SUBSETS = ((2, 3), (1, 2), (1, 3), (1, 2, 3), (1,), (2,), (3,))


def star_field(rng, frames, stars, noise_px):
    """Weighed arcs of frames of about so many stars each, at random attitudes."""
    counts = np.maximum(4, rng.poisson(stars, frames))
    star_start = np.concatenate([[0], np.cumsum(counts)])
    n = int(star_start[-1])
    row, col = rng.uniform(0, WU_ROWS - 1, n), rng.uniform(0, WU_COLUMNS - 1, n)
    turns = np.linalg.qr(rng.normal(size=(frames, 3, 3)))[0]
    s = PINHOLE_RADIAL.directions(WU_TRUTH, row, col, WU_PIXEL_PITCH_M)
    s_i = np.einsum("nj,njk->nk", s, np.repeat(turns, counts, axis=0))
    places, _ = arcsets.order(star_start, s_i)
    field = ArcSet(
        model=PINHOLE_RADIAL.kernel, pitch=WU_PIXEL_PITCH_M, frame=np.arange(frames), frame_start=np.arange(frames + 1),
        star_start=star_start, row_px=(row + noise_px * rng.normal(size=n))[places],
        col_px=(col + noise_px * rng.normal(size=n))[places], sigma_px=np.full(n, noise_px),
        s_i=np.ascontiguousarray(s_i[places]), source_row=places, phi=np.empty(0), band=np.empty((0, 5)),
    )  # fmt: skip
    return arcsets.weigh(field, arcsets.angular_sigma(PINHOLE_RADIAL, WU_TRUTH, field))[0]


def run(field, values):
    """Sigmas, NEES, NIS and degrees of freedom of one subset on one set."""
    tuning = Tuning(selection=Selection(4, values))
    history = FILTERS["svd"](field, start(WU_TRUTH, 6, 1.0), np.arange(6), START_SIGMA, tuning)
    error = nees((history.last.x - WU_TRUTH) / START_SIGMA, history.last.P)
    return np.array([*history.sigmas[-1], error, history.nis.sum(), history.dof.sum()])


def main(arguments=None):
    """Run every subset on every set and print one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--stars", type=float, default=19.0)
    parser.add_argument("--noise-px", type=float, default=0.2)
    options = parser.parse_args(arguments)
    found = {values: [] for values in SUBSETS}
    for seed in track(range(options.sets), "sets", console=Console(stderr=True)):
        field = star_field(np.random.default_rng(seed), options.frames, options.stars, options.noise_px)
        for values, rows in found.items():
            rows.append(run(field, values))
    Console().print(summary(found, options))
    return 0


def summary(found, options):
    """One row a subset."""
    expected = chi_square(6.0 * options.sets, 6 * options.sets)
    table = Table(
        title=f"{options.sets} sets of {options.frames} frames, {options.stars:g} stars, {options.noise_px:g} px; "
        f"mean NEES should lie in {6 * expected.lower:.2f} to {6 * expected.upper:.2f}"
    )
    for column in ("values", "rows a frame", "sigma / sigma of {2, 3}", "mean NEES", "NIS / dof"):
        table.add_column(column, justify="left" if column == "values" else "right")
    usual = np.mean(found[2, 3], axis=0)[:6]
    for values, rows in found.items():
        mean = np.mean(rows, axis=0)
        label = ", ".join(map(str, values))
        table.add_row(
            f"{{{label}}}", f"{mean[8] / options.frames:.1f}", f"{(mean[:6] / usual).max():.3f}", f"{mean[6]:.2f}",
            f"{mean[7] / mean[8]:.4f}",
        )  # fmt: skip
    return table


if __name__ == "__main__":
    sys.exit(main())
