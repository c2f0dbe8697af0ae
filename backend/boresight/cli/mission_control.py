"""`boresight yamcs pull` and `boresight openc3 pull`: telemetry out of a mission control system's archive, by a mapping profile."""

from __future__ import annotations

import tempfile
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import click

from boresight.cli.importing import SUFFIXES
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
from boresight.errors import NotFoundError, RefusedInputError
from boresight.library import functions as library


def _read_time(_: click.Context, option: click.Parameter, text: str) -> datetime:
    try:
        at = datetime.fromisoformat(text)
    except ValueError as error:
        raise RefusedInputError(
            f"--{option.name} {text[:40]!r} is not a valid time; write UTC as 2026-11-20T01:00:00Z."
        ) from error
    return at if at.tzinfo else at.replace(tzinfo=UTC)


def _make_pull(system: str, title: str, part: str) -> click.Command:
    """Make the command that pulls from one system."""

    @click.command(
        "pull", help=f"Pull the parameters that a mapping profile names out of {title}'s archive, as telemetry."
    )
    @click.option("--start", required=True, callback=_read_time, metavar="UTC", help="First time of the range.")
    @click.option("--stop", required=True, callback=_read_time, metavar="UTC", help="End of the range (exclusive).")
    @click.option("--profile", required=True, metavar="FILE", help="Mapping profile with the parameters' full names.")
    @click.option(
        "--sensor",
        "sensor_file",
        type=INPUT_FILE,
        help="Sensor file, needed to convert lengths and coordinates counted from the detector centre.",
    )
    @click.option(
        "--out", type=click.Path(path_type=Path), help="Telemetry to write: .csv, .jsonl or .parquet; - is CSV."
    )
    @click.option(
        "--export", "export_file", type=click.Path(path_type=Path), help="Also save the raw export of the archive."
    )
    @json_option
    def pull(
        start: datetime,
        stop: datetime,
        profile: str,
        sensor_file: Path | None,
        out: Path | None,
        export_file: Path | None,
        json_file: str | None,
    ) -> None:
        if out is None and export_file is None:
            raise click.UsageError("Missing option '--out', or --export to save only the raw export.")
        check_writable(json_file)
        check_one_stream(out, json_file)
        check_writable(
            out, "" if out is None else FORMATS.get(out.suffix.lower(), ""), forms=SUFFIXES, title="telemetry"
        )
        content, suffix, rows = _export(system, title, part, start, stop, profile)
        if export_file is not None:
            export_file.write_bytes(content)
        tell(f"{rows:,} rows from {title}", out or "")
        if out is None:
            return
        with tempfile.TemporaryDirectory() as folder:
            export = Path(folder) / f"{system}{suffix}"
            export.write_bytes(content)
            made = library.import_telemetry(export, profile, sensor=sensor_file)
            with opened_for_writing(out) as stream:
                made.write(stream, out.suffix.lower())
            record = made.record()
        write_json(record, json_file)
        if json_file != STANDARD_OUTPUT:
            tell(f"{record['frames']:,} frames, {record['exposures']:,} exposures, {record['stars']:,} stars", out)

    return pull


def _export(
    system: str, title: str, part: str, start: datetime, stop: datetime, profile: str
) -> tuple[bytes, str, int]:
    """Return what the archive exported, the ending of its file, and how many rows it has."""
    from boresight.library.references import read_any_profile
    from boresight.mission_control.archive import count_us
    from boresight.settings import read_settings

    link = read_settings().mission_control.get(system)
    if link is None:
        raise NotFoundError(
            f"{title} is not configured: set BORESIGHT_{system.upper()}_URL and BORESIGHT_{system.upper()}_{part}."
        )
    if stop <= start:
        raise RefusedInputError("--stop is not after --start: correct the range.")
    with closing(link.open()) as archive:
        rows = archive.export(read_any_profile(profile), count_us(start), count_us(stop))
    if not rows.lines:
        raise NotFoundError(
            f"{title} has no values of these parameters from {start:%FT%TZ} to {stop:%FT%TZ}; check the range."
        )
    return rows.to_bytes(), archive.suffix, len(rows.lines)


yamcs = click.Group("yamcs", help="Work with the Yamcs server configured by the BORESIGHT_YAMCS_* settings.")
yamcs.add_command(_make_pull("yamcs", "Yamcs", "INSTANCE"))
openc3 = click.Group("openc3", help="Work with the OpenC3 COSMOS server configured by the BORESIGHT_OPENC3_* settings.")
openc3.add_command(_make_pull("openc3", "OpenC3", "SCOPE"))
