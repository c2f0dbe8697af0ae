"""`boresight reproduce`: a paper's tables and figures made again on simulated sensors, beside the printed numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from boresight.cli.output import aligned
from boresight.cli.progress import progress
from boresight.errors import RefusedInputError
from boresight.settings import read_settings, use_kernel_folder

PAPERS = ("enright",)
#: Frames of a calibration and of a validation set, and sets a sensor, of the full and of the quick study.
FULL, QUICK = (200, 80, 12), (100, 40, 2)


@click.command()
@click.argument("paper", type=click.Choice(PAPERS))
@click.option("--quick", is_flag=True, help="Fewer frames and sets: under two minutes.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for report, JSON and CSV.")
@click.option("--sensors", metavar="LIST", help="Sensors to run, as 3,4; all when left out.")
@click.option("--frames", type=click.IntRange(10, 10_000), help="Frames of a calibration set.")
@click.option("--sets", type=click.IntRange(1, 1000), help="Sets a sensor, for NEES and the ratio to the bound.")
@click.option("--processes", type=click.IntRange(1, 64), default=2, show_default=True, help="Sets run at a time.")
def reproduce(
    paper: str, quick: bool, out: Path, sensors: str | None, frames: int | None, sets: int | None, processes: int
) -> None:
    """Make the tables and figures of PAPER again: report, JSON and CSV, each row judged with its reason."""
    settings = read_settings()
    use_kernel_folder(settings)
    with progress(f"reproducing {paper}") as report:
        from boresight.studies import enright

        sizes = QUICK if quick else FULL
        plan = enright.Plan(
            quick=quick,
            sensors=_numbers(sensors) if sensors is not None else enright.Plan.sensors,
            frames=frames or sizes[0],
            validation_frames=sizes[1],
            sets=sets or sizes[2],
            processes=processes,
        )
        document = enright.run(plan, settings.catalogue_folder, report)
        written = enright.write(document, out)
    click.echo(aligned([("table or figure", "row", "verdict"), *_verdicts(document)], left=(0, 1, 2)))
    click.echo("\n".join(f"Wrote {path}" for path in written))


def _numbers(text: str) -> tuple[int, ...]:
    """Read a list of sensor numbers."""
    try:
        return tuple(sorted({int(word) for word in text.split(",")}))
    except ValueError as error:
        raise RefusedInputError(f"--sensors {text!r} is no list of numbers: write it as 3,4.") from error


def _verdicts(document: dict[str, Any]) -> list[tuple[str, str, str]]:
    """List every verdict."""
    rows = [
        (f"Table {table['number']}", str(row["label"]), str(row["verdict"]))
        for table in document["tables"]
        for row in table["rows"]
    ]
    return rows + [(f"Figure {figure['number']}", "", str(figure["verdict"])) for figure in document["figures"]]
