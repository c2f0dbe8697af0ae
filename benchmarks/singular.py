"""What singular values and all pairs cost a frame, in every form, beside the arcs: W Table 4 in one run, as ratios.

    python benchmarks/singular.py

The forms, fields and ratios are those of `boresight reproduce wu` (`studies.wu.timing` says how they are taken); the update alone,
compiled and in NumPy, is that of `boresight bench` (`studies.singular_speed`). So the three say the same. The last table is
no time: what the subsets of the singular values hold, as predicted sigmas over those of {2, 3}, for Model 4 and 19 stars.
"""

from __future__ import annotations

import sys

import numpy as np
from rich.console import Console
from rich.table import Table

from boresight.estimation.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation.references import View, whitened_information
from boresight.estimation.singular_values import Selection
from boresight.simulation.sensors import WU_TRUTH
from boresight.studies.processes import run_on_one_thread
from boresight.studies.singular_speed import FREE, SCALE, measure, star_field
from boresight.studies.wu.printed import SUBSETS
from boresight.studies.wu.timing import timing


def table_of(title, heads):
    """Return an empty table, its first column to the left."""
    table = Table(title=title)
    for head in heads:
        table.add_column(head, justify="right" if table.columns else "left")
    return table


def forms(times):
    """Lay out microseconds a frame, and the ratios with their quartiles."""
    heads = [f"{stars:.1f} stars" for stars in times["stars"]]
    table = table_of(f"microseconds a frame, one linearisation, median of {times['rounds']} rounds", ["form", *heads])
    for form, found in times["ms_per_frame"].items():
        table.add_row(form, *(f"{1e3 * one['median']:,.0f}" for one in found))
    table.add_section()
    for row in times["tables"][0]["rows"]:
        cells = (f"{cell['ours']:.1f} ({cell['low']:.1f} to {cell['high']:.1f})" for cell in row["cells"])
        table.add_row(row["label"], *cells)
    table.add_row("W Table 4: AD / SVD", *(f"{cell['printed']:.1f}" for cell in times["tables"][0]["rows"][0]["cells"]))
    return table


def updates(times):
    """Lay out the SVD update alone."""
    table = table_of("the SVD update alone, microseconds an exposure", ["way", *(f"{stars} stars" for stars in times)])
    for way in ("compiled", "plain", "lean"):
        table.add_row(way, *(f"{found[way]:,.0f}" for found in times.values()))
    for way in ("plain", "lean"):
        table.add_row(f"{way} / compiled", *(f"{found[way] / found['compiled']:.0f}" for found in times.values()))
    return table


def subsets(frames=100, stars=19):
    """Lay out the predicted sigmas of each subset."""
    arcs, view = star_field(stars, frames, np.random.default_rng(1)), View(PINHOLE_RADIAL, WU_TRUTH, FREE, SCALE)
    information = {values: whitened_information(view, arcs, Selection(4, values)) for values in SUBSETS}
    sigma = {values: np.sqrt(np.diag(np.linalg.inv(A))) for values, A in information.items()}
    table = table_of("sigma over that of {2,3}", ["values", *PINHOLE_RADIAL.symbols])
    for values, found in sigma.items():
        table.add_row(",".join(map(str, values)), *(f"{ratio:.3f}" for ratio in found / sigma[2, 3]))
    return table


def main():
    """Measure and print."""
    console = Console(width=110)
    console.print(forms(run_on_one_thread(timing, None)))
    console.print(updates(run_on_one_thread(measure, None)))
    console.print(subsets())
    return 0


if __name__ == "__main__":
    sys.exit(main())
