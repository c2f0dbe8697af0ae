"""`boresight report`: one self-contained HTML file of a stored run or of a calibration JSON."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import orjson

from boresight.cli.input import keep_standard_input
from boresight.cli.output import STANDARD_OUTPUT, check_writable, write_bytes
from boresight.cli.remote import open_client, server_option
from boresight.errors import RefusedInputError
from boresight.settings import read_settings

if TYPE_CHECKING:
    from boresight.calibration.calibration import Calibration


@click.command()
@click.argument("source", metavar="RUN|JSON")
@click.option(
    "--out", "out_file", required=True, metavar="FILE.html", help="The report to write; - is standard output."
)
@server_option
def report(source: str, out_file: str, server_url: str | None) -> None:
    """Write the report of a stored run, by its number, or of a calibration JSON file.

    A number is taken as a run unless a file of that name exists. The report of a stored run says if one person can sign alone
    here.
    """
    from boresight.figures.report import render_report

    _check_out(out_file)
    if source == STANDARD_OUTPUT:
        source = str(keep_standard_input(None))
    if server_url is not None:
        _write(_fetch(server_url, source), out_file)
        return
    stored = source.isdecimal() and not Path(source).exists()
    found = _stored(int(source)) if stored else _read(source)
    text = render_report(found, four_eyes=not stored or read_settings().policy.four_eyes)
    _write(text, out_file)


def _write(text: str, out_file: str) -> None:
    write_bytes(text.encode(), out_file)
    if out_file != STANDARD_OUTPUT:
        click.echo(f"Wrote {out_file}")


def _fetch(server_url: str, source: str) -> str:
    """Read the report of a run from a server."""
    if not source.isdecimal():
        raise RefusedInputError(f"A server has runs, not files: give the number of a run instead of {source}.")
    with open_client(server_url) as server:
        return server.report(int(source))


def _check_out(out_file: str) -> None:
    """Refuse a place that cannot be written, and a name with another extension than HTML's."""
    ending = Path(out_file).suffix.lower()
    if ending == ".pdf":
        raise RefusedInputError(
            f"{Path(out_file).name}: a report is written as HTML; end the name with .html, open it in a browser and "
            "print it to PDF."
        )
    if ending not in {"", ".html", ".htm"}:
        raise RefusedInputError(f"{Path(out_file).name}: a report is HTML; end the name with .html.")
    check_writable(out_file, "HTML")


def _read(source: str) -> Calibration:
    from boresight.calibration.calibration import parse_foreign_calibration

    try:
        document: dict[str, Any] = orjson.loads(Path(source).read_bytes())
    except FileNotFoundError as error:
        raise RefusedInputError(f"{source} does not exist: give a run's number or a calibration JSON.") from error
    except orjson.JSONDecodeError as error:
        raise RefusedInputError(
            f"{source} is not JSON ({error}): give the file that `calibrate --json` wrote."
        ) from error
    except OSError as error:
        raise RefusedInputError(
            f"{source} cannot be read ({error.strerror}): check the name and its permissions."
        ) from error
    return parse_foreign_calibration(document, Path(source).name)


def _stored(run_id: int) -> Calibration:
    from boresight.console.runs import service as runs
    from boresight.platform.blobs.opening import open_blobs
    from boresight.platform.db.sessions import open_reading, open_store

    settings = read_settings()
    with open_store(settings.database_url) as engine, open_reading(engine) as session:
        return runs.get_final_calibration(session, open_blobs(settings.blob_location), run_id)
