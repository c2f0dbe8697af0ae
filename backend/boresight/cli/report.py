"""`boresight report`: one self-contained HTML file of a stored run or of a calibration JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import orjson

from boresight.cli.output import check_writable
from boresight.errors import RefusedInputError
from boresight.settings import read_settings


@click.command()
@click.argument("source", metavar="RUN|JSON")
@click.option("--out", "out_file", required=True, metavar="FILE.html", help="The report to write.")
def report(source: str, out_file: str) -> None:
    """Write the report of a stored run, by its number, or of a calibration JSON file.

    A number is a file only where there is one of that name. Of a stored run the report says when one person may sign alone here.
    """
    from boresight.figures.report import write_report

    check_writable(out_file)
    stored = source.isdecimal() and not Path(source).exists()
    document = _stored(int(source)) if stored else _read(source)
    write_report(document, Path(out_file), four_eyes=not stored or read_settings().policy.four_eyes)
    click.echo(f"Wrote {out_file}")


def _read(source: str) -> dict[str, Any]:
    """Read a calibration from a file."""
    try:
        document: dict[str, Any] = orjson.loads(Path(source).read_bytes())
    except FileNotFoundError as error:
        raise RefusedInputError(f"{source} does not exist: give a run's number or a calibration JSON.") from error
    except orjson.JSONDecodeError as error:
        raise RefusedInputError(
            f"{source} is no JSON ({error}): give the file that `calibrate --json` wrote."
        ) from error
    except OSError as error:
        raise RefusedInputError(f"{source} cannot be read: {error.strerror}.") from error
    return document


def _stored(run_id: int) -> dict[str, Any]:
    """Read a run's calibration from the store."""
    from boresight.services import runs
    from boresight.store.blobs import open_blobs
    from boresight.store.sessions import opened, reading

    settings = read_settings()
    with opened(settings.database_url) as engine, reading(engine) as session:
        return runs.final_result(session, open_blobs(settings.blob_place), run_id)
