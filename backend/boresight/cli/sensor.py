"""`boresight sensor new`, which writes a whole sensor file from a few numbers, and `--site`, which puts a sensor on the ground."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from boresight.cli.extract import extraction_options, take_extraction_choices
from boresight.cli.input import INPUT_FILE
from boresight.cli.output import STANDARD_OUTPUT, check_writable, tell, write_json
from boresight.errors import RefusedInputError
from boresight.images.limits import is_image
from boresight.library import functions as library
from boresight.site import SITE_FIELDS
from boresight.telemetry.data_sheets import ASKED, DATA_SHEETS

if TYPE_CHECKING:
    from boresight.library.results import NewSensor
    from boresight.site import Site
    from boresight.telemetry.sensors import Sensor


def _complete_sheet(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer the data sheets."""
    return [CompletionItem(name) for name in DATA_SHEETS if name.casefold().startswith(incomplete.casefold())]


site_option = click.option(
    "--site",
    "site",
    metavar="NUMBERS",
    help="Position on the ground, such as latitude_deg=52.2,longitude_deg=4.4; from " + ", ".join(SITE_FIELDS) + ".",
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
    site = parse_site(split_site(text), faults)
    faults.refuse()
    return site


def split_site(text: str) -> dict[str, float | str]:
    """Split `name=number,...`; raises RefusedInputError with every part that is not of that form."""
    from boresight.telemetry.read.checks import Faults

    faults = Faults("--site")
    given: dict[str, float | str] = {}
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if not equals:
            faults.add(f"{part!r} is not name=number: write latitude_deg=52.2,longitude_deg=4.4")
            continue
        try:
            given[name.strip()] = float(value)
        except ValueError:
            given[name.strip()] = value.strip()
    faults.refuse()
    return given


def refuse_site_on_server(site: str | None, server_url: str | None) -> None:
    """Refuse --site with --server, whose sensors have their own."""
    if site is not None and server_url is not None:
        raise RefusedInputError(
            "--site cannot be combined with --server: give `site` in the sensor file of that server's sensor."
        )


@click.group()
def sensor() -> None:
    """Describe a sensor."""


def _number(text: str) -> float | str:
    """Read a number; what is none stays as it was typed, and is refused with every other fault of the sensor."""
    try:
        number = float(text)
    except ValueError:
        return text
    return int(number) if number.is_integer() else number


def asked_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option of every number that a sensor file is made from."""
    for name, one in reversed(ASKED.items()):
        flag = "--" + name.replace("_", "-")
        command = click.option(
            flag, name, type=_number, metavar="N" if one.whole else "X", help=f"{one.label}, {one.unit}. {one.sentence}"
        )(command)
    return command


FILE = click.Path(path_type=Path)


@sensor.command()
@click.option(
    "--images",
    multiple=True,
    type=FILE,
    metavar="IMAGE...",
    help="Images of the night sky, from which the remaining values are determined.",
)
@click.argument("further_images", nargs=-1, type=FILE, metavar="")
@click.option(
    "--telemetry",
    type=INPUT_FILE,
    metavar="FILE",
    help="Centroids without star numbers instead of images: CSV, JSON Lines, Parquet.",
)
@asked_options
@click.option(
    "--sheet",
    metavar="NAME",
    shell_complete=_complete_sheet,
    help="Data sheet that supplies the remaining values: " + ", ".join(DATA_SHEETS) + ".",
)
@click.option(
    "--model",
    "camera_model",
    metavar="NAME",
    help="Camera model; by default OpenCV's, or a fisheye model for a wide field.",
)
@click.option(
    "--parity",
    type=_number,
    metavar="N",
    help="-1 for an upright image, as on a screen (usual); 1 for a mirrored image.",
)
@click.option("--name", default="New sensor", help="Name of the sensor.")
@site_option
@click.option("--out", "out_file", required=True, metavar="FILE", help="Sensor file to write; - is standard output.")
@extraction_options
def new(
    images: tuple[Path, ...],
    further_images: tuple[Path, ...],
    telemetry: Path | None,
    out_file: str,
    site: str | None,
    **choices: Any,
) -> None:
    """Write a complete sensor file from detector, pixel and lens, from a data sheet's name, or from stars alone.

    Every other number is derived, and printed with its reason. Missing or impossible values are reported together. With --images
    night/*.fits, or --telemetry, neither a focal length nor a field of view is needed: the star fields are recognised,
    upright or mirrored, from 2.8 to 108 degrees across, and parity, focal length, centroid noise and faintest magnitude are
    proposed as measured. A pixel pitch is only the scale of lengths; without one a pixel is assumed to be 5 micrometres.
    """
    check_writable(out_file)
    if out_file != STANDARD_OUTPUT and Path(out_file).suffix.lower() != ".json":
        raise RefusedInputError(f"{Path(out_file).name} is not a name for a sensor file: end it with .json.")
    extraction = take_extraction_choices(choices)
    known = {name: value for name, value in choices.items() if value is not None}
    if site is not None:
        known["site"] = split_site(site)
    if out_file != STANDARD_OUTPUT and Path(out_file).exists():
        raise RefusedInputError(
            f"{out_file} already exists and will not be overwritten: choose another name, or remove it first.",
            code="would-overwrite",
        )
    pictures = [*images, *further_images]
    if others := [path.name for path in pictures if not is_image(path)]:
        raise RefusedInputError(
            f"{others[0]} is not an image: name FITS, PNG, TIFF or raw files, or --telemetry of a table."
        )
    made = library.new_sensor(pictures or None, telemetry, extraction=extraction, **known)
    write_json(made.to_dict(), out_file)
    tell("\n".join(_lines(made, out_file, pictures, telemetry)), out_file)


def _lines(made: NewSensor, out_file: str, images: Sequence[Path], telemetry: Path | None) -> Iterator[str]:
    yield str(made)
    if out_file != STANDARD_OUTPUT:
        named = "TELEMETRY" if telemetry is None else str(telemetry)
        named = named if not images else " ".join(str(one) for one in images[:2]) + (" ..." if len(images) > 2 else "")
        yield f"\nWrote {out_file}; next: boresight calibrate {named} --sensor {out_file}"
