"""`boresight assess`: hold a calibration against the gates, before it goes near a store."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from boresight.cli.input import INPUT_FILE
from boresight.cli.output import check_writable, json_option, write_json
from boresight.library import functions as library
from boresight.library.progress import progress
from boresight.library.text import aligned

if TYPE_CHECKING:
    from boresight.library.results import Assessment


@click.command()
@click.argument("calibration", type=INPUT_FILE)
@click.option("--sensor", "sensor_file", type=INPUT_FILE, required=True, help="Sensor file, JSON.")
@click.option("--against", type=INPUT_FILE, help="The incumbent's parameters; the sensor file's if left out.")
@click.option("--validate", "telemetry", type=INPUT_FILE, help="Held-out telemetry; the calibration's own if left out.")
@click.option("--profile", "profile_file", type=INPUT_FILE, help="Gate profile, JSON; the default limits if left out.")
@json_option
def assess(
    calibration: Path,
    sensor_file: Path,
    against: Path | None,
    telemetry: Path | None,
    profile_file: Path | None,
    json_file: str | None,
) -> None:
    """Compare CALIBRATION, a JSON of `boresight calibrate`, with limits and with the incumbent.

    Every gate answers PASS, MARGINAL, NO-DATA or FAIL, and the worst is the verdict. The exit code is 0 whatever the
    verdict is. Scripts read `verdict` and `blocking` from --json.
    """
    check_writable(json_file)
    with progress("reading the calibration") as report:
        found = library.assess(
            calibration, sensor_file, validate=telemetry, against=against, profile=profile_file, progress=report
        )
    write_json(found.to_dict(), json_file)
    if json_file != "-":
        click.echo("\n".join(_lines(found)))


def _lines(found: Assessment) -> Iterator[str]:
    """Lay a report out for a terminal: the table, then a sentence for every gate that does not pass."""
    from boresight.verdicts.gates.judgement import gate_rows

    rows = gate_rows(found.gates, found.blocking)
    head = ("gate", "answer", "measured", "95 %", "limit", "marginal from", "incumbent", "unit")
    table = [
        (row.title, row.status, row.value, row.interval, row.limit, row.marginal, row.incumbent, row.unit)
        for row in rows
    ]
    yield aligned([head, *table], left=(0, 1, 7))
    yield ""
    failing = [row for row in rows if row.status != "PASS"]
    for sentence in dict.fromkeys(row.sentence for row in failing):
        named = [f"{row.title} {row.status}" for row in failing if row.sentence == sentence]
        yield f"{'; '.join(named)}: {sentence}"
    yield ""
    blocking = f"; it would be blocked by {', '.join(found.blocking)}" if found.blocking else ""
    yield f"{found.sensor}: {found.words}{blocking}"
