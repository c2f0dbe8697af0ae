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
@click.option(
    "--parameters-a", type=INPUT_FILE, help="Calibration JSON of A; the sensor file's parameters if left out."
)
@click.option("--parameters-b", type=INPUT_FILE, help="The same of B.")
@click.option(
    "--reference", type=INPUT_FILE, help="Attitudes in place of B: an AEM, or a table of times and quaternions."
)
@click.option(
    "--reference-profile", metavar="NAME|FILE", help="Mapping profile of that table's columns and conventions."
)
@click.option("--reference-sigma-arcsec", type=float, help="One sigma of its attitudes where it does not say it; 10.")
@click.option("--reference-bias-arcsec", type=float, default=0.0, help="One sigma of an error that they all share; 0.")
@click.option(
    "--tolerance-s", type=float, help="How far an attitude is carried beyond its neighbours; 0.5 if left out."
)
@click.option("--longest-gap-s", type=float, help="Between attitudes that are interpolated; 10 if left out.")
@click.option("--rate-deg-s", type=float, help="One sigma of a rate that no neighbour tells; 0.1 if left out.")
@click.option(
    "--temperature-of", type=click.Choice(["a", "b", "difference"]), help="Whose temperature counts; A's, else B's."
)
@click.option("--reference-temperature-c", type=float, help="Where the rotation is told; the mean if left out.")
@click.option("--temperature", type=int, help="Highest power of the temperature, 0 to 3; by evidence if left out.")
@click.option("--drift/--no-drift", default=None, help="A change a day; by evidence if left out.")
@click.option("--robust/--not-robust", default=None, help="Leave out pairs that are too far off, as by default.")
@json_option
def align(a: Path, b: Path | None, sensor_a: Path, json_file: str | None, **choices: Any) -> None:
    """Estimate the rotation from tracker A to tracker B, or to a reference (C_SD), with covariance, temperature and drift.

    A and B are telemetry of the same hours. Attitudes at the same times are paired, interpolated where their times differ; those
    that are too far off are left out and listed. The gates answer PASS, MARGINAL, NO-DATA or FAIL; the exit code is 0 whatever.
    """
    check_writable(json_file)
    given = {name: value for name, value in choices.items() if value is not None}
    with progress("reading the telemetry") as report:
        found = library.align(a, b, sensor_a=sensor_a, progress=report, **given)
    write_json(found.to_dict(), json_file)
    if json_file != STANDARD_OUTPUT:
        click.echo(str(found))
