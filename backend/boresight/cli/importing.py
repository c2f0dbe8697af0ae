"""`boresight import`: what other programs write, by a mapping profile, as telemetry; and profiles for the other commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

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
from boresight.library import functions as library
from boresight.library.text import aligned

if TYPE_CHECKING:
    from boresight.library.inputs import TelemetrySource
    from boresight.library.references import ProfileSource
    from boresight.telemetry.imports.mapping import Imported
    from boresight.telemetry.imports.profile import Profile

SUFFIXES = (".csv", ".jsonl", ".ndjson", ".parquet")


def _complete_profile(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer the built-in profiles, and files beside them."""
    from boresight.telemetry.imports.builtin import BUILT_IN

    named = [CompletionItem(name) for name in BUILT_IN if name.startswith(incomplete)]
    return named or [CompletionItem(incomplete, type="file")]


def profile_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option that reads telemetry by a mapping profile."""
    return click.option(
        "--profile",
        metavar="NAME|FILE",
        shell_complete=_complete_profile,
        help="Read TELEMETRY by a mapping profile, as `boresight import` does.",
    )(command)


def read_by_profile(telemetry: Path, profile: str | None, sensor: Path | None = None) -> TelemetrySource:
    """Return telemetry as a command was given it, imported where a profile is named."""
    if profile is None:
        return telemetry
    return library.import_telemetry(telemetry, profile, sensor=sensor)


@click.command("import")
@click.argument("files", nargs=-1, metavar="FILE...", type=INPUT_FILE)
@click.option(
    "--profile",
    metavar="NAME|FILE",
    shell_complete=_complete_profile,
    help="Built-in mapping profile, or the JSON file of one.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Telemetry to write: .csv, .jsonl or .parquet; - is standard output, CSV.",
)
@click.option(
    "--sensor",
    "sensor_file",
    type=INPUT_FILE,
    help="Sensor file, for its detector's size and pixel pitch.",
)
@click.option("--orbit", type=INPUT_FILE, help="Two-line elements or OEM for velocities.")
@click.option("--attitude", type=INPUT_FILE, help="AEM, or table of quaternions, for attitudes.")
@click.option("--time", metavar="UTC", help="When the files were taken, if they do not contain it (ISO 8601).")
@click.option("--preview", is_flag=True, help="Show ten rows and their meaning; write nothing.")
@click.option("--print-profile", is_flag=True, help="Print the profile as JSON, to copy and change it.")
@click.option("--list-profiles", is_flag=True, help="List the built-in profiles.")
@json_option
def import_telemetry(
    files: tuple[Path, ...],
    profile: str | None,
    out: Path | None,
    json_file: str | None,
    *,
    preview: bool,
    print_profile: bool,
    list_profiles: bool,
    **given: Any,
) -> None:
    """Convert FILE, which another program wrote, to telemetry by a mapping profile.

    FILE is CSV, JSON Lines, Parquet, FITS, a VOTable, a text table or JSON; several files are one set, in this order. Without
    --profile, the matching built-in profile is suggested. --preview then uses it, or a draft made from the column names, and
    --print-profile prints it with a list of what is missing. --json writes the import record: hashes of files and profile,
    column meanings, notes; with --preview also the rows.
    """
    if list_profiles:
        click.echo(aligned(list(_profile_rows()), left=(0, 1)))
        return
    named: ProfileSource | None = profile
    if profile is None:
        if not files:
            raise click.UsageError(
                "Missing option '--profile': use --list-profiles to list the built-in profiles, or give FILE to have it examined."
            )
        named = _propose(files[0], told_only=not (print_profile or preview))
        if print_profile:
            write_json(named.to_dict(), json_file or STANDARD_OUTPUT)
            return
    elif print_profile:
        from boresight.library.references import read_any_profile

        write_json(read_any_profile(profile).to_dict(), json_file or STANDARD_OUTPUT)
        return
    if not files:
        raise click.UsageError("Missing argument 'FILE...'.")
    if out is None and not preview:
        raise click.UsageError("Missing option '--out', or --preview to see what would be written.")
    inputs = (*files, *(given[name] for name in ("sensor_file", "orbit", "attitude") if given[name] is not None))
    _check_out(None if preview else out, json_file, inputs)
    made = library.import_telemetry(
        files,
        named or "",
        sensor=given["sensor_file"],
        orbit=given["orbit"],
        attitude=given["attitude"],
        time=given["time"],
    )
    if out is not None and not preview:
        with opened_for_writing(out) as stream:
            made.write(stream, out.suffix.lower())
    write_json(made.to_preview() if preview else made.record(), json_file)
    if json_file != STANDARD_OUTPUT:
        tell("\n".join(_preview_lines(made) if preview else _lines(made)), out or "")


def _propose(path: Path, *, told_only: bool) -> Profile:
    """Return the profile that reads a file, and tell what is still to be told of it; refuses where nothing more was asked."""
    from boresight.telemetry.imports.recognition import draft_profile, recognise_for_import

    found = recognise_for_import(path, path.name)
    draft = draft_profile(found)
    if told_only:
        remedy = found.say()
        raise RefusedInputError(f"{found.name} cannot be imported without --profile: {remedy}.")
    if found.profile is not None:
        click.echo(f"boresight: the built-in profile {draft.profile.name} fits: {found.command}", err=True)
    for sentence in draft.still:
        click.echo(f"boresight: still needed: {sentence}", err=True)
    return draft.profile


def _check_out(out: Path | None, json_file: str | None, inputs: tuple[Path, ...]) -> None:
    """Refuse places that cannot be written, are inputs, or say no format."""
    check_writable(json_file)
    check_one_stream(out, json_file)
    for place in (out, json_file):
        if place is not None and str(place) != STANDARD_OUTPUT and Path(place).exists():
            for path in inputs:
                if path.exists() and path.samefile(place):
                    raise RefusedInputError(
                        f"{place} is an input file and will not be overwritten: choose another name.",
                        code="would-overwrite",
                    )
    if out is None or str(out) == STANDARD_OUTPUT:
        return
    check_writable(out, FORMATS.get(out.suffix.lower(), ""))
    if out.suffix.lower() not in SUFFIXES:
        raise RefusedInputError(f"{out.name} has no known format: end the name with .csv, .jsonl or .parquet.")


def _profile_rows() -> Iterator[tuple[str, str]]:
    from boresight.telemetry.imports.builtin import BUILT_IN

    yield "profile", "reads"
    for name, profile in BUILT_IN.items():
        yield name, profile.description


def _lines(made: Imported) -> Iterator[str]:
    """Return the record of an import as lines."""
    record = made.record()
    profile = record["profile"]
    yield f"{record['frames']:,} frames, {record['exposures']:,} exposures, {record['stars']:,} stars"
    yield f"profile {profile['name']}, version {profile['version']}, {profile['sha256'][:12]}"
    for source in record["sources"][:3]:
        yield f"{source['name']}: SHA-256 {source['sha256']}"
    yield ""
    yield aligned(
        [("column", "from", "how"), *((it.column, it.source or "-", it.sentence) for it in made.meanings)],
        left=(0, 1, 2),
    )
    if made.unused:
        yield f"\nnot used: {', '.join(made.unused)}"
    for note in made.notes:
        yield f"\n- {note}"


def _preview_lines(made: Imported) -> Iterator[str]:
    """Return the record, and the first rows beside the cells that they were made of."""
    yield from _lines(made)
    columns = list(made.preview[0].telemetry)
    yield "\nas telemetry:"
    yield aligned(
        [("row", *columns), *((str(it.row), *(_cell(it.telemetry[name]) for name in columns)) for it in made.preview)],
        left=(),
    )
    named = list(made.preview[0].source)
    yield "\nfrom:"
    yield aligned([("row", *named), *((str(it.row), *it.source.values()) for it in made.preview)], left=())


def _cell(value: Any) -> str:
    return "-" if value is None else f"{value:.6f}" if isinstance(value, float) else str(value)
