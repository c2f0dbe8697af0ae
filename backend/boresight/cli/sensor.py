"""`boresight sensor new`, which writes a whole sensor file from a few numbers, and `--site`, which puts a sensor on the ground."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from boresight.cli.output import STANDARD_OUTPUT, check_writable, tell, write_json
from boresight.errors import RefusedInputError
from boresight.library.text import aligned
from boresight.site import SITE_FIELDS
from boresight.telemetry.data_sheets import ASKED, DATA_SHEETS, LensAndDetector

if TYPE_CHECKING:
    from boresight.site import Site
    from boresight.telemetry.new_sensor import Described
    from boresight.telemetry.sensors import Sensor

site_option = click.option(
    "--site",
    "site",
    metavar="NUMBERS",
    help="Where on the ground it stands, as latitude_deg=52.2,longitude_deg=4.4; of " + ", ".join(SITE_FIELDS) + ".",
)


def place_sensor(sensor_file: Path, site: str | None) -> Path | Sensor:
    """Return the sensor file, or where a site is given its sensor at that site."""
    if site is None:
        return sensor_file
    from boresight.telemetry.sensors import parse_sensor, read_sensor, sensor_document

    sensor = replace(read_sensor(sensor_file), site=read_site(site))
    return parse_sensor(sensor_document(sensor))  # which refuses a site beside images from space


def read_site(text: str) -> Site | None:
    """Read `name=number,...` as the `site` of a sensor file; every fault at once."""
    from boresight.telemetry.declarations import parse_site
    from boresight.telemetry.read.checks import Faults

    faults = Faults("--site")
    given: dict[str, Any] = {}
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if not equals:
            faults.add(f"{part!r} is no name=number: write latitude_deg=52.2,longitude_deg=4.4")
            continue
        try:
            given[name.strip()] = float(value)
        except ValueError:
            given[name.strip()] = value.strip()
    site = parse_site(given, faults)
    faults.refuse()
    return site


def refuse_site_on_server(site: str | None, server_url: str | None) -> None:
    """Refuse --site with --server, whose sensors have their own."""
    if site is not None and server_url is not None:
        raise RefusedInputError(
            "--site does not go with --server: give `site` in the sensor file of that server's sensor."
        )


@click.group()
def sensor() -> None:
    """Describe a sensor."""


def asked_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option of every number that a sensor file is made from."""
    for name, one in reversed(ASKED.items()):
        flag = "--" + name.replace("_", "-")
        command = click.option(
            flag, name, type=float, metavar="N" if one.whole else "X", help=f"{one.label}, {one.unit}. {one.sentence}"
        )(command)
    return command


@sensor.command()
@asked_options
@click.option("--sheet", metavar="NAME", help="A data sheet that tells the rest: " + ", ".join(DATA_SHEETS) + ".")
@click.option(
    "--model", "camera_model", metavar="NAME", help="Camera model; OpenCV's, or a fisheye's where the field is wide."
)
@click.option(
    "--parity", type=int, help="-1 for an upright image, as on a screen, which is usual; 1 for a mirrored one."
)
@click.option("--name", default="New sensor", help="What it is called.")
@site_option
@click.option("--out", "out_file", required=True, metavar="FILE", help="Sensor file to write; - is standard output.")
def new(out_file: str, site: str | None, **known: Any) -> None:
    """Write a whole sensor file from detector, pixel and lens, or from a data sheet's name.

    Every other number is derived, and printed with its reason. What is missing or makes no sense is told at once.
    """
    from boresight.telemetry.new_sensor import describe_sensor

    check_writable(out_file)
    where = None if site is None else read_site(site)
    described = describe_sensor(LensAndDetector(**known, site=where), "boresight sensor new")
    if out_file != STANDARD_OUTPUT and Path(out_file).exists():
        raise RefusedInputError(f"{out_file} exists and is kept: choose another name, or remove it first.")
    write_json(described.document, out_file)
    tell("\n".join(_lines(described, out_file)), out_file)


def _lines(described: Described, out_file: str) -> Iterator[str]:
    document = described.document
    names = document["initial"]
    yield f"{document['name']}: {document['camera_model']}, {document['detector']['rows']} x {document['detector']['columns']} px"
    yield ""
    rows = [
        (
            name,
            f"{names[name]:.6g}",
            f"{document['typical_sigma'][name]:.3g}",
            described.reasons[f"typical_sigma.{name}"],
        )
        for name in names
    ]
    yield aligned([("parameter", "start", "typical sigma", "why"), *rows], left=(0, 3))
    yield ""
    for field, reason in described.reasons.items():
        if not field.startswith("typical_sigma"):
            yield f"- {field}: {reason}"
    if out_file != STANDARD_OUTPUT:
        yield f"\nWrote {out_file}; next: boresight calibrate TELEMETRY --sensor {out_file}"
