"""What singular values and all pairs cost a frame, in every form, beside the arcs: W Table 4 in one run, as ratios.

    python benchmarks/singular.py

The forms, fields and ratios are those of `boresight reproduce wu` (`studies.wu.timing` says how they are taken); the update alone,
compiled and in NumPy, is that of `boresight bench` (`studies.singular_speed`). So the three say the same.
"""

from __future__ import annotations

import sys

from rich.console import Console
from rich.table import Table

from boresight.studies.processes import run_on_one_thread
from boresight.studies.singular_speed import measure
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


def main():
    """Measure and print."""
    console = Console()
    console.print(forms(run_on_one_thread(timing, None)))
    console.print(updates(run_on_one_thread(measure, None)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
