"""`boresight backup` and `restore`: an installation saved, by hand or by a schedule, and put back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import click

from boresight.cli.output import check_writable, refuse_standard_output
from boresight.errors import ConflictError, CorruptFileError, RefusedInputError
from boresight.settings import Settings, read_settings

if TYPE_CHECKING:
    from boresight.platform.backups.encryption import KeyFile
    from boresight.platform.db.backup import BackupSummary

MB = 1e6
OFF = "off"


@click.group(invoke_without_command=True)
@click.option("--out", "file", metavar="FILE", help="The ZIP to write; an existing file is never overwritten.")
@click.option("--encrypt", is_flag=True, help="Encrypt FILE with the first key of the key file.")
@click.option(
    "--keep-going",
    is_flag=True,
    help="Leave corrupt and missing files out and name them; the exit code is then 1.",
)
@click.option("--schedule", metavar="HH:MM|off", help="Time of the first backup of each day, UTC, or off.")
@click.option("--to", "place", metavar="PLACE", help="A folder, or a bucket such as s3://backups/boresight.")
@click.option(
    "--every-hours",
    type=click.Choice(["1", "2", "3", "4", "6", "8", "12", "24"]),
    default="24",
    show_default=True,
    help="Hours between scheduled backups.",
)
@click.option(
    "--keep-daily", type=int, default=7, show_default=True, help="Number of days for which a daily backup is kept."
)
@click.option(
    "--keep-weekly", type=int, default=5, show_default=True, help="Number of weeks for which a weekly backup is kept."
)
@click.option(
    "--keep-monthly",
    type=int,
    default=12,
    show_default=True,
    help="Number of months for which a monthly backup is kept.",
)
@click.pass_context
def backup(  # noqa: PLR0913 - the options of a command
    context: click.Context,
    file: str | None,
    schedule: str | None,
    place: str | None,
    every_hours: str,
    keep_daily: int,
    keep_weekly: int,
    keep_monthly: int,
    *,
    encrypt: bool,
    keep_going: bool,
) -> None:
    """Write the database and the stored files to FILE while servers and workers keep running, or schedule backups by the servers.

    A backup is refused if a stored file is corrupt or missing. The file contains password hashes: protect it like the data
    folder. It contains the secrets of webhooks in encrypted form; keep their key, webhooks.key in the data folder, in another
    place.

    With --schedule, one of the running servers writes an encrypted backup to PLACE at each scheduled time and restores it into a
    temporary store to verify it. Only verified backups count. Old backups are removed: the newest of each recent day, week and
    month is kept. The keys are in backup.key in the data folder, or in BORESIGHT_BACKUP_KEY: without them no backup can be read,
    so keep a copy elsewhere.
    """
    if context.invoked_subcommand is not None:
        return
    if (file is None) == (schedule is None):
        raise click.UsageError("Give --out FILE to write a backup now, or --schedule HH:MM --to PLACE.")
    if file is not None:
        _write_now(file, encrypt=encrypt, keep_going=keep_going)
    elif schedule is not None:
        _set_schedule(schedule, place, int(every_hours), (keep_daily, keep_weekly, keep_monthly))


def _set_schedule(schedule: str, place: str | None, every_hours: int, kept: tuple[int, int, int]) -> None:
    """Put a schedule in force, with a key where there is none yet."""
    import boresight.console  # noqa: F401 - the tables of all nouns, whose rows the log seals
    from boresight.console.backups import service
    from boresight.platform.actors import COMMAND_LINE
    from boresight.platform.backups.destinations import open_destination
    from boresight.platform.backups.generations import Generations
    from boresight.platform.db.sessions import open_store, open_writing

    settings = read_settings()
    address, minute, keys = "", 0, settings.backup_keys
    if schedule != OFF:
        if place is None:
            raise click.UsageError("Give --to PLACE: a folder, or a bucket such as s3://backups/boresight.")
        minute = _read_minute(schedule)
        destination = open_destination(place, settings.data_folder)
        destination.refuse_unusable()
        address = destination.address
        if not keys.list_keys():
            keys.add()
            click.echo(
                f"Made the key file {keys.file}: without it no backup can be read. Copy it to another place now.",
                err=True,
            )
    with open_store(settings.database_url) as engine, open_writing(engine) as session:
        service.set_schedule(session, COMMAND_LINE, address, minute, every_hours, Generations(*kept))
    if not address:
        click.echo("No more backups are scheduled; existing ones are kept.")
        return
    daily, weekly, monthly = kept
    click.echo(
        f"A running server backs up to {address} every {every_hours} h, starting at {schedule} UTC, encrypted with key "
        f"{keys.first().id}. The first backup starts now. Kept: {daily} daily, {weekly} weekly and {monthly} monthly backups."
    )


def _read_minute(text: str) -> int:
    hours, _, minutes = text.partition(":")
    if not (hours.isdecimal() and minutes.isdecimal() and int(hours) < 24 and int(minutes) < 60):
        raise click.UsageError("Give --schedule as a time of the day in UTC, such as 02:30, or off.")
    return 60 * int(hours) + int(minutes)


def _write_now(file: str, *, encrypt: bool, keep_going: bool) -> None:
    """Write a backup to a file."""
    refuse_standard_output(file, "A backup")
    if not encrypt:
        check_writable(file, "ZIP")
    if Path(file).exists():
        raise RefusedInputError(
            f"{file} already exists and backups are never overwritten: name another file.", code="backup-exists"
        )
    from boresight.console.webhooks.secrets import encrypt_all
    from boresight.platform.audit import log as audit
    from boresight.platform.blobs.opening import open_blobs
    from boresight.platform.db import backup as backups
    from boresight.platform.db.sessions import open_reading, open_store

    settings = read_settings()
    key = settings.backup_keys.first() if encrypt else None
    with open_store(settings.database_url) as engine:
        encrypt_all(engine, settings.secret_box)  # the archive must hold no plain secret
        with open_reading(engine) as session:
            head = audit.head(session)
    blobs = open_blobs(settings.blob_location)
    scratch = settings.data_folder if encrypt else None
    taken = backups.write_backup(
        settings.database_url, blobs, head, Path(file), keep_going=keep_going, key=key, scratch=scratch
    )
    sealed = "" if key is None else f", encrypted with the key {key.id}"
    click.echo(
        f"{file}: the database and {taken.blobs} files, {taken.size_bytes / MB:.1f} MB{sealed}\naudit head {head}"
    )
    if taken.blobs_at is not None:
        click.echo(
            f"The stored files are not included: they stay in {taken.blobs_at}, where each was found with its size. Have the store "
            "keep versions or a copy of that bucket; `boresight audit verify` reads them all."
        )
    _refuse_absent(taken, "were left out of the backup", "were missing and not backed up")


def _refuse_absent(taken: BackupSummary, left_out: str, missing: str) -> None:
    """List every file that is not in the archive, and exit with code 1."""
    for sha256 in (*taken.left_out, *taken.missing):
        click.echo(f"  {sha256}", err=True)
    parts = [
        f"{len(ones)} {kind} files {what}: {', '.join(sha256[:12] for sha256 in ones[:5])}"
        for ones, kind, what in ((taken.left_out, "corrupt", left_out), (taken.missing, "missing", missing))
        if ones
    ]
    if parts:
        raise CorruptFileError(f"{'; '.join(parts)}: restore them from an older backup.")


@backup.command(name="list")
def list_taken() -> None:
    """List the scheduled backups, newest first, each with its restore test."""
    import boresight.console  # noqa: F401 - the tables of all nouns, whose rows the log seals
    from boresight.console.backups import service
    from boresight.platform.db.sessions import open_reading, open_store

    settings = read_settings()
    with open_store(settings.database_url) as engine, open_reading(engine) as session:
        schedule = service.find_schedule(session)
        rows = service.list_backups(session)
    click.echo("No backups are scheduled." if schedule is None else f"Backups go to {schedule.destination}.", err=True)
    for row in rows:
        size = "" if row.size_bytes is None else f"{row.size_bytes / MB:.1f} MB"
        gone = "removed" if row.removed_utc else size
        click.echo(f"{row.name}  {row.started_utc[:19]}Z  {row.state:9}  {gone:>10}  {row.sentence or ''}".rstrip())


@backup.command()
@click.argument("name", metavar="NAME|FILE")
@click.option(
    "--key-file",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Key file, if not the default.",
)
def verify(name: str, key_file: Path | None) -> None:
    """Restore a backup into a temporary store and verify it: a scheduled one by its NAME, which is recorded, or a FILE.

    Schema, audit log, the rows that it seals, and every byte of the stored files are verified; exit code 1 if any of them was
    altered.
    """
    import boresight.console  # noqa: F401 - the tables of all nouns, whose rows the log seals
    from boresight.console.backups import service
    from boresight.platform.actors import COMMAND_LINE
    from boresight.platform.backups.destinations import open_destination
    from boresight.platform.db.backup import try_restore
    from boresight.platform.db.sessions import open_reading, open_store, open_writing

    settings = read_settings()
    settings.data_folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    keys = _keys(settings, key_file)
    if Path(name).is_file():
        found = try_restore(Path(name), settings.data_folder, keys)
    else:
        with open_store(settings.database_url) as engine:
            with open_reading(engine) as session:
                row = service.get_by_name(session, name)
                address = service.get_destination(session, row)
            with open_destination(address, settings.data_folder).open(row.name) as file:
                found = try_restore(file, settings.data_folder, keys)
            with open_writing(engine) as session:
                service.record_retest(session, COMMAND_LINE, name, found)
    if not found.is_ok:
        raise CorruptFileError(found.sentence)
    click.echo(found.sentence)


@backup.command(name="rotate-key")
def rotate_key() -> None:
    """Create a new key, or the first one; previous keys stay in the file, and what they encrypted can still be read."""
    keys = read_settings().backup_keys
    made = keys.add()
    click.echo(
        f"{keys.file}: from now on, key {made.id} encrypts. Copy the file to another place, and to every server."
    )


def _keys(settings: Settings, file: Path | None) -> KeyFile:
    from boresight.platform.backups.encryption import KeyFile

    return settings.backup_keys if file is None else KeyFile(file)


@contextmanager
def _opened(name: str, scratch: Path) -> Iterator[Path | BinaryIO]:
    """Open a backup: a file, or an object of a bucket by its address."""
    from boresight.platform.backups.destinations import open_destination

    if "://" not in name:
        if not Path(name).is_file():
            raise RefusedInputError(f"There is no file {name}; name the backup to restore.")
        yield Path(name)
        return
    bucket, _, last = name.rpartition("/")
    with open_destination(bucket, scratch).open(last) as file:
        yield file


@click.command()
@click.argument("file", metavar="FILE|ADDRESS")
@click.option(
    "--key-file",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="The key file of an encrypted backup.",
)
def restore(file: str, key_file: Path | None) -> None:
    """Restore a backup into an empty data folder or PostgreSQL database, and verify its audit log and stored files.

    ADDRESS is that of an object in a bucket, such as s3://backups/boresight/NAME.

    The settings may name another database engine than that of the backup, to move an installation from one to the other.
    """
    from boresight.console.webhooks.secrets import encrypt_all
    from boresight.platform.audit import log as audit
    from boresight.platform.blobs.opening import open_blobs
    from boresight.platform.db import backup as backups
    from boresight.platform.db.sessions import open_reading, open_store

    settings = read_settings()
    blobs = open_blobs(settings.blob_location)
    with _opened(file, settings.data_folder) as archive:
        taken = backups.read_backup(archive, settings.database_url, blobs, _keys(settings, key_file))
    with open_store(settings.database_url) as engine:
        with open_reading(engine) as session:
            known = taken.blobs_at in {
                None,
                blobs.kept_at,
            }  # otherwise they are not where this installation expects them
            found = audit.verify(session, taken.head, blobs if known else None, again=False)
        kept = encrypt_all(engine, settings.secret_box)  # secrets are plain in a backup of an older version
    click.echo(f"{engine.url.render_as_string()}: restored, with {taken.blobs} files. Everybody must log in again.")
    if not known:
        click.echo(
            f"Its stored files are in {taken.blobs_at}: set BORESIGHT_BLOBS to that, or copy them from there, and run "
            "`boresight audit verify`."
        )
    if kept.sentence is not None:
        click.echo(kept.sentence, err=True)
    for bad in found.bad_files:
        click.echo(f"  {bad}", err=True)
    if not found.ok and (taken.left_out or taken.missing):
        click.echo(found.sentence, err=True)
    _refuse_absent(taken, "were left out when the backup was taken", "were missing when the backup was taken")
    if not found.ok:
        raise ConflictError(
            f"The backup was restored, but its contents are not intact: {found.sentence} Use another backup."
        )
    click.echo(found.sentence)
