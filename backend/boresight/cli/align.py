"""`boresight align`: the rotation between two trackers, or from a tracker to a reference."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from boresight.cli.input import INPUT_FILE
from boresight.cli.output import STANDARD_OUTPUT, check_writable, json_option, write_json
from boresight.library import functions as library
from boresight.library.progress import progress


@click.command()
@click.argument("a", type=INPUT_FILE)
@click.argument("b", type=INPUT_FILE, required=False)
@click.option("--sensor-a", type=INPUT_FILE, required=True, help="Sensor file of A, JSON.")
@click.option("--sensor-b", type=INPUT_FILE, help="Sensor file of B, JSON.")
@click.option("--parameters-a", type=INPUT_FILE, help="Calibration JSON of A; the sensor file's parameters if omitted.")
@click.option("--parameters-b", type=INPUT_FILE, help="Calibration JSON of B; the sensor file's parameters if omitted.")
@click.option(
    "--reference", type=INPUT_FILE, help="Attitudes in place of B: an AEM, or a table of times and quaternions."
)
@click.option(
    "--reference-profile", metavar="NAME|FILE", help="Mapping profile of that table's columns and conventions."
)
@click.option(
    "--reference-sigma-arcsec",
    type=float,
    help="One-sigma uncertainty of its attitudes if the file does not give it; 10 if omitted.",
)
@click.option(
    "--reference-bias-arcsec",
    type=float,
    default=0.0,
    help="One sigma of an error common to all of them; 0 if omitted.",
)
@click.option("--tolerance-s", type=float, help="Maximum extrapolation beyond an attitude; 0.5 if omitted.")
@click.option("--longest-gap-s", type=float, help="Maximum interval for interpolation; 10 if omitted.")
@click.option(
    "--rate-deg-s",
    type=float,
    help="One-sigma uncertainty of a rate that cannot be derived from neighbouring attitudes; 0.1 if omitted.",
)
@click.option(
    "--temperature-of",
    type=click.Choice(["a", "b", "difference"]),
    help="Which temperature to use; A's if available, otherwise B's.",
)
@click.option(
    "--reference-temperature-c",
    type=float,
    help="Temperature at which the rotation is given; the mean if omitted.",
)
@click.option(
    "--temperature",
    type=int,
    help="Highest power of the temperature, 0 to 3; chosen from the data if omitted.",
)
@click.option("--drift/--no-drift", default=None, help="Linear change per day; chosen from the data if omitted.")
@click.option("--robust/--not-robust", default=None, help="Leave out pairs that are too far off, as by default.")
@json_option
def align(a: Path, b: Path | None, sensor_a: Path, json_file: str | None, **choices: Any) -> None:
    """Estimate the rotation from tracker A to tracker B, or to a reference (C_SD), with covariance, temperature and drift.

    A and B are telemetry of the same hours. Attitudes at the same times are paired, interpolated where their times differ; those
    that are too far off are left out and listed. Gates report PASS, MARGINAL, NO-DATA or FAIL; the exit code is always 0.
    """
    check_writable(json_file)
    given = {name: value for name, value in choices.items() if value is not None}
    with progress("reading the telemetry") as report:
        found = library.align(a, b, sensor_a=sensor_a, progress=report, **given)
    write_json(found.to_dict(), json_file)
    if json_file != STANDARD_OUTPUT:
        click.echo(str(found))
