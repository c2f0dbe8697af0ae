"""`boresight bench`: how fast this machine calibrates, beside peers in the same run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import click

from boresight.cli.output import aligned, check_writable, json_option, write_json
from boresight.cli.progress import progress
from boresight.settings import read_settings, use_kernel_folder

LEGEND = """
match_us_per_frame: real stars, half of them unnamed, matched from a ground calibration.
match_per_batch_evaluation: that, over one batch evaluation of the same frames; at most 20 is promised.
ratios: how many times longer each peer takes than the loop that does its work; the matching peer does less (one
exposure at a time, one fixed tolerance, no doubt between two stars).
svd_update: singular values of one exposure of so many stars taken in, from given rays on, on one thread. numpy decomposes
one combination at a time by numpy.linalg.svd; numpy_lean all at once, by eigh of prefix sums and LAPACK's pivoted Cholesky."""


@click.command()
@click.option("--frames", type=click.IntRange(10, 200_000), default=2000, show_default=True, help="Synthetic frames.")
@json_option
def bench(frames: int, json_file: str | None) -> None:
    """Time the estimators and the matching on synthetic frames of 12 stars in two exposures."""
    check_writable(json_file)
    use_kernel_folder(read_settings())
    with progress("compiling") as report:
        from boresight.studies.speed import measure

        measured = measure(frames, lambda fraction, message: report(message, fraction))
    write_json(measured, json_file)
    if json_file != "-":
        click.echo(aligned(list(_rows(measured))))
        click.echo(LEGEND)


def _rows(measured: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in measured.items():
        if isinstance(value, Mapping):
            yield from _rows(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", f"{value:,.4g}" if isinstance(value, float) else str(value)
