"""`boresight diagnose`: why a telemetry set does not match its sensor file, and the files mended."""

from __future__ import annotations

from pathlib import Path

import click

from boresight.cli.output import (
    STANDARD_OUTPUT,
    check_one_stream,
    check_writable,
    json_option,
    refuse_standard_output,
    write_json,
)
from boresight.cli.remote import first_message, open_client, server_option
from boresight.errors import RefusedInputError
from boresight.library import functions as library
from boresight.library.progress import progress


@click.command()
@click.argument("telemetry", type=click.Path(path_type=Path))
@click.option("--sensor", "sensor_file", type=click.Path(path_type=Path), required=True, help="Sensor file, JSON.")
@click.option("--out", "out_file", metavar="FILE", help="Write the corrected sensor file.")
@click.option(
    "--out-telemetry",
    "telemetry_out",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write the corrected telemetry: .csv or .parquet.",
)
@server_option
@json_option
def diagnose(
    telemetry: Path,
    sensor_file: Path,
    out_file: str | None,
    telemetry_out: Path | None,
    server_url: str | None,
    json_file: str | None,
) -> None:
    """Find why TELEMETRY does not match its sensor file.

    Tests parity, swapped and flipped axes, pixel origin, focal length, kind of directions, order and sense of quaternions, time,
    epoch and magnitude limit, and verifies the result by matching. Prints the cause in a sentence and what was tested. The exit
    code is 0 whatever the cause; with --out or --out-telemetry it is 1 if nothing can be corrected.

    With --server the telemetry is uploaded and diagnosed there; --sensor may be the name of a sensor of that server.
    """
    check_one_stream(out_file, json_file)
    for place in (out_file, json_file):
        check_writable(place)
    _check_kept(out_file, sensor_file)
    if telemetry_out is not None:
        refuse_standard_output(telemetry_out, "The corrected telemetry")
        if telemetry_out.suffix.lower() not in {".csv", ".parquet"}:
            raise RefusedInputError(f"{telemetry_out.name} has no known format: end the name with .csv or .parquet.")
        check_writable(telemetry_out, "CSV" if telemetry_out.suffix.lower() == ".csv" else "Parquet")
        _check_kept(telemetry_out, telemetry)
    with progress(first_message(server_url)) as report:
        if server_url is None:
            found = library.diagnose(telemetry, sensor_file, progress=report)
        else:
            with open_client(server_url) as server:
                found = server.diagnose(telemetry, str(sensor_file), progress=report)
        write_json(found.to_dict(), json_file)
        if out_file is not None:
            write_json(found.mended_sensor(), out_file)
        if telemetry_out is not None:
            from boresight.library.results import save_telemetry

            found.mended_sensor()  # refuses where nothing is known
            save_telemetry(found.mend(library.read_telemetry(telemetry)), telemetry_out)
    if STANDARD_OUTPUT not in {json_file, out_file}:
        click.echo(str(found))


def _check_kept(place: str | Path | None, read: Path) -> None:
    """Refuse to write over a file that is read."""
    if place is None or str(place) == STANDARD_OUTPUT:
        return
    if read.exists() and Path(place).exists() and read.samefile(place):
        raise RefusedInputError(
            f"{place} is an input file and will not be overwritten: choose another name.", code="would-overwrite"
        )
