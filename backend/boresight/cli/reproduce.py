"""`boresight simulate` and `reproduce`: telemetry whose truth is known, and a paper's tables and figures made again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from boresight.cli.input import keep_standard_input
from boresight.cli.output import STANDARD_OUTPUT, refuse_standard_output
from boresight.errors import RefusedInputError
from boresight.library import functions as library
from boresight.library.progress import progress
from boresight.library.text import aligned
from boresight.settings import read_settings, use_kernel_folder


@click.command()
@click.argument("scenario")
@click.option("--out", "folder", type=click.Path(path_type=Path), required=True, help="Folder for the files.")
@click.option(
    "--frames", type=click.IntRange(1, 200_000), help="Frames of the calibration set, instead of the scenario's."
)
@click.option("--seed", type=click.IntRange(0), help="Seed of the noise, instead of the scenario's.")
@click.option("--images", type=click.IntRange(1, 1000), help="Also write FITS images of this many frames, in images/.")
@click.option("--format", "suffix", type=click.Choice(["csv", "parquet"]), default="csv", show_default=True)
def simulate(
    scenario: str, folder: Path, frames: int | None, seed: int | None, images: int | None, suffix: str
) -> None:
    """Simulate SCENARIO: st16-1 to st16-6, or a scenario file (JSON).

    Writes sensor.json, the calibration and the validation set, scenario.json and truth.json; with --images, also FITS images of
    the first frames.
    """
    if scenario == STANDARD_OUTPUT:
        scenario = str(keep_standard_input(None))
    refuse_standard_output(folder, "A folder of files")
    with progress("simulating") as report:
        made = library.simulate(scenario, frames=frames, seed=seed, progress=report)
        made.save(folder, "parquet" if suffix == "parquet" else "csv")
        if images is not None:
            report(f"simulating images of {images:,} frames", None)
            library.simulate_images(scenario, images, folder / "images")
    sets = {"calibration": made.telemetry, "validation": made.validation}
    rows = [
        (str(folder / f"{purpose}.{suffix}"), f"{len(set(one.frame.tolist())):,}", f"{len(one):,}")
        for purpose, one in sets.items()
    ]
    click.echo(aligned([("file", "frames", "stars"), *rows]))


Report = Callable[[str, float], None]

PAPERS = ("enright", "wu")
#: Frames of a calibration and of a validation set, and sets (of enright: a sensor), of the full and of the quick study.
FULL = {"enright": (200, 80, 12), "wu": (2400, 100, 20)}
QUICK = {"enright": (100, 40, 2), "wu": (1200, 100, 4)}


@click.command()
@click.argument("paper", type=click.Choice(PAPERS))
@click.option("--quick", is_flag=True, help="Fewer frames and sets: under two minutes.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for report, JSON and CSV.")
@click.option("--sensors", metavar="LIST", help="For enright: sensors to run, such as 3,4; all if omitted.")
@click.option("--frames", type=click.IntRange(10, 10_000), help="Number of frames in a calibration set.")
@click.option(
    "--sets",
    type=click.IntRange(1, 1000),
    help="Number of simulated sets for the statistics (per sensor for enright).",
)
@click.option(
    "--processes",
    type=click.IntRange(1, 64),
    default=2,
    show_default=True,
    help="Number of sets to run in parallel.",
)
def reproduce(
    paper: str, quick: bool, out: Path, sensors: str | None, frames: int | None, sets: int | None, processes: int
) -> None:
    """Reproduce the tables and figures of PAPER: report, JSON and CSV, each row judged with its reason."""
    refuse_standard_output(out, "A folder of files")
    settings = read_settings()
    use_kernel_folder(settings)
    size = (QUICK if quick else FULL)[paper]
    sizes = {"quick": quick, "frames": frames or size[0], "sets": sets or size[2], "processes": processes}
    from boresight.papers.documents import head_sentences

    with progress(f"reproducing {paper}") as report:
        make = _enright if paper == "enright" else _wu
        document, written = make(sizes, size[1], sensors, settings.catalogue_folder, out, report)
    click.echo(aligned([("table or figure", "row", "verdict", "left out"), *_verdicts(document)], left=(0, 1, 2, 3)))
    said = [*head_sentences(document), *(sentence for grid in document["grids"] for sentence in grid["sentences"])]
    click.echo("\n".join([*said, *(f"Wrote {path}" for path in written)]))


def _enright(
    sizes: dict[str, Any], validation: int, sensors: str | None, catalogue: Path | None, out: Path, report: Report
) -> tuple[dict[str, Any], list[Path]]:
    """Run the study of Enright 2018 and write it down."""
    from boresight.papers import enright

    numbers = _numbers(sensors) if sensors is not None else enright.StudySize.sensors
    document = enright.run(enright.StudySize(sensors=numbers, validation_frames=validation, **sizes), catalogue, report)
    return document, enright.write(document, out)


def _wu(
    sizes: dict[str, Any], judges: int, sensors: str | None, catalogue: Path | None, out: Path, report: Report
) -> tuple[dict[str, Any], list[Path]]:
    """Run the study of Wu 2019 and write it down."""
    from boresight.papers import wu

    if sensors is not None:
        raise RefusedInputError("Wu 2019 has one sensor: omit --sensors.")
    document = wu.run(wu.StudySize(judges=judges, **sizes), catalogue, report)
    return document, wu.write(document, out)


def _numbers(text: str) -> tuple[int, ...]:
    try:
        return tuple(sorted({int(word) for word in text.split(",")}))
    except ValueError as error:
        raise RefusedInputError(f"--sensors {text!r} is not a list of numbers: write it like 3,4.") from error


def _verdicts(document: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    """List every row and figure with its verdict, and why the head leaves it out."""
    rows = [
        (f"Table {table['number']}", str(row["label"]), str(row["verdict"]), str(row["left_out"]))
        for table in (*document["tables"], *document["timing"].get("tables", ()))
        for row in table["rows"]
    ]
    return rows + [(f"Figure {figure['number']}", "", str(figure["verdict"]), "") for figure in document["figures"]]
