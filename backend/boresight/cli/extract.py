"""`boresight extract`: images in, telemetry out; and images in the place of telemetry for the other commands."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from boresight.cli.importing import SUFFIXES, read_by_profile
from boresight.cli.input import INPUT_FILE
from boresight.cli.output import (
    FORMATS,
    STANDARD_OUTPUT,
    check_one_stream,
    check_writable,
    json_option,
    opened_for_writing,
    tell,
    write_json,
)
from boresight.errors import RefusedInputError
from boresight.images.limits import is_image
from boresight.library import functions as library
from boresight.library.progress import Report, progress

if TYPE_CHECKING:
    from boresight.library.inputs import TelemetrySource
    from boresight.library.results import Extraction

FILE = click.Path(path_type=Path)
#: The choices of an extraction, for every command that takes images.
_CHOICES: Sequence[Callable[..., Any]] = (
    click.option(
        "--threshold", type=click.FloatRange(3.0, 1000.0), default=8.0, show_default=True,
        help="For images: signal-to-noise ratio of the faintest star.",
    ),
    click.option(
        "--most-stars", type=click.IntRange(4, 5000), default=200, show_default=True,
        help="For images: number of brightest stars kept from each.",
    ),
    click.option("--times", type=FILE, help="For images: CSV with image and time_utc, mid-exposure."),
    click.option(
        "--gain", "gain_e_per_dn", type=click.FloatRange(1e-3, 1e4),
        help="For images: electrons per DN; from EGAIN, the sensor file or the images if omitted.",
    ),
    click.option(
        "--saturation", "saturation_dn", type=click.FloatRange(1.0, 1e9), help="For images: DN from which a pixel is saturated.",
    ),
    click.option("--raw-bits", type=click.IntRange(8, 16), help="For raw images: bits per number."),
    click.option("--raw-order", type=click.Choice(["little", "big"]), help="For raw images: byte order."),
    click.option("--raw-header", type=click.IntRange(0, 1 << 20), help="For raw images: bytes before the first number."),
    click.option(
        "--processes", type=click.IntRange(1, 64), help="For images: number of processes; one per core if omitted."
    ),
)  # fmt: skip


def extraction_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of an extraction to a command."""
    for option in reversed(_CHOICES):
        command = option(command)
    return command


pictures_option = click.option(
    "--pictures", type=FILE, help="For images: folder for SVG drawings of each image with its stars and residuals."
)


def take_extraction_choices(choices: dict[str, Any]) -> dict[str, Any]:
    """Take the choices of an extraction out of a command's, as the library's function wants them."""
    names = ("threshold", "most_stars", "times", "gain_e_per_dn", "saturation_dn", "processes")
    taken = {name: choices.pop(name) for name in names}
    raw = {"bits": choices.pop("raw_bits"), "byte_order": choices.pop("raw_order")}
    raw["header_bytes"] = choices.pop("raw_header")
    given = {name: value for name, value in raw.items() if value is not None}
    return {**taken, "raw": given or None}


@contextmanager
def open_source(
    paths: Sequence[Path], profile: str | None, sensor: Path, choices: dict[str, Any], report: Report
) -> Iterator[TelemetrySource]:
    """Yield the telemetry that was named, by its profile where it has one, or what is extracted from images that were named."""
    with open_sources(paths, profile, sensor, choices, report) as sources:
        if len(sources) > 1:
            raise RefusedInputError(
                f"{len(paths)} files were named, but only images can be several: name one telemetry file, such as {paths[0].name}."
            )
        yield sources[0]


@contextmanager
def open_sources(
    paths: Sequence[Path], profile: str | None, sensor: Path, choices: dict[str, Any], report: Report
) -> Iterator[list[TelemetrySource]]:
    """Yield the same of a command that takes several telemetry sets; images are one."""
    if not any(is_image(path) for path in paths):
        yield [path if profile is None else read_by_profile(path, profile, sensor) for path in paths]
        return
    if profile is not None and len(paths) == 1:
        yield [read_by_profile(paths[0], profile, sensor)]
        return
    if others := [path for path in paths if not is_image(path)]:
        raise RefusedInputError(f"{others[0].name} is not an image, but others are: name images, or telemetry.")
    with tempfile.TemporaryDirectory() as folder:
        found = library.extract(paths, sensor, progress=report, **choices)
        place = Path(folder) / "images.parquet"
        found.save(place)
        for sentence in found.sentences:
            click.echo(f"boresight: {sentence}", err=True)
        yield [place]


@click.command()
@click.argument("images", type=INPUT_FILE, nargs=-1, required=True)
@click.option("--sensor", "sensor_file", type=INPUT_FILE, required=True, help="Sensor file, JSON.")
@click.option(
    "--out", type=FILE, required=True, help="Telemetry to write: .csv, .jsonl or .parquet; - is standard output, CSV."
)
@extraction_options
@pictures_option
@json_option
def extract(
    images: tuple[Path, ...], sensor_file: Path, out: Path, pictures: Path | None, json_file: str | None, **choices: Any
) -> None:
    """Extract the stars of IMAGES (FITS, PNG, TIFF or raw numbers) into telemetry.

    Each image is a frame. Its rows contain centroid, sigma_px, instrumental magnitude, flux, peak, background, covariance,
    whether the star is saturated, and the image's name and SHA-256. Hot and dead pixels are detected from the set itself; trails
    and blended or distorted objects are excluded and counted.
    """
    check_writable(json_file)
    check_one_stream(out, json_file)
    if str(out) != STANDARD_OUTPUT:
        check_writable(out, FORMATS.get(out.suffix.lower(), ""))
        if out.suffix.lower() not in SUFFIXES:
            raise RefusedInputError(f"{out.name} has no known format: end the name with .csv, .jsonl or .parquet.")
    from boresight.telemetry.writing import contract_table, write_table

    with progress("reading the images") as report:
        taken = take_extraction_choices(choices)
        found = library.extract(images, sensor_file, progress=report, **taken)
        with opened_for_writing(out) as stream:
            write_table(contract_table(found.telemetry), stream, out.suffix.lower())
        if pictures is not None:
            library.draw_images(images, sensor_file, found, pictures, raw=taken["raw"])
    write_json(found.to_dict(), json_file)
    if json_file != STANDARD_OUTPUT:
        _tell(found, out)


def _tell(found: Extraction, out: Path) -> None:
    for sentence in found.sentences:
        tell(sentence, out)
    tell(f"Wrote {out}", out)
