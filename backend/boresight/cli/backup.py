"""`boresight backup` and `boresight restore`: database and blobs in one file, and back into an empty installation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from boresight.cli.output import check_writable, refuse_standard_output
from boresight.errors import ConflictError, CorruptFileError, RefusedInputError
from boresight.settings import read_settings

if TYPE_CHECKING:
    from boresight.store.backup import Taken

MB = 1e6


@click.command()
@click.option("--out", "file", metavar="FILE", required=True, help="The ZIP to write; an existing one is kept.")
@click.option(
    "--keep-going",
    is_flag=True,
    help="Leave corrupt and missing files out and name them; the exit code is 1 all the same.",
)
def backup(file: str, *, keep_going: bool) -> None:
    """Write database and blobs to FILE, while servers and workers go on; refuse where a stored file is corrupt or missing.

    The file holds password hashes: keep it as the data folder is kept. The secrets of webhooks are in it encrypted; keep
    their key, webhooks.key in the data folder, in another place.
    """
    refuse_standard_output(file, "A backup")
    check_writable(file, "ZIP")
    if Path(file).exists():
        raise RefusedInputError(f"{file} exists already; name another file, a backup is never written over.")
    from boresight.services import audit
    from boresight.services.webhook_secrets import encrypt_all
    from boresight.store import backup as backups
    from boresight.store.blobs import open_blobs
    from boresight.store.sessions import opened, reading

    settings = read_settings()
    with opened(settings.database_url) as engine:
        encrypt_all(engine, settings.secret_box)  # the archive holds no secret that can be read
        with reading(engine) as session:
            head = audit.head(session)
    blobs = open_blobs(settings.blob_place)
    taken = backups.write_backup(settings.database_url, blobs, head, Path(file), keep_going=keep_going)
    click.echo(f"{file}: the database and {taken.blobs} files, {taken.size_bytes / MB:.1f} MB\naudit head {head}")
    if taken.blobs_at is not None:
        click.echo(
            f"The stored files are not in it: they stay in {taken.blobs_at}, which was asked for each and its size. Let the store "
            "keep versions or a copy of that bucket; `boresight audit verify` reads them all."
        )
    _refuse_absent(taken, "were left out of the backup", "were not there to be backed up")


def _refuse_absent(taken: Taken, left_out: str, missing: str) -> None:
    """Name every file that is not in the archive, and end with exit code 1."""
    for sha256 in (*taken.left_out, *taken.missing):
        click.echo(f"  {sha256}", err=True)
    parts = [
        f"{len(ones)} {kind} files {what}: {', '.join(sha256[:12] for sha256 in ones[:5])}"
        for ones, kind, what in ((taken.left_out, "corrupt", left_out), (taken.missing, "missing", missing))
        if ones
    ]
    if parts:
        raise CorruptFileError(f"{'; '.join(parts)}.")


@click.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
def restore(file: Path) -> None:
    """Lay the backup FILE down in an empty data folder or PostgreSQL database, and verify its audit log and stored files.

    The settings may name the other engine than that of the backup: so an installation moves from one to the other.
    """
    from boresight.services import audit
    from boresight.services.webhook_secrets import encrypt_all
    from boresight.store import backup as backups
    from boresight.store.blobs import open_blobs
    from boresight.store.sessions import opened, reading

    settings = read_settings()
    blobs = open_blobs(settings.blob_place)
    taken = backups.read_backup(file, settings.database_url, blobs)
    with opened(settings.database_url) as engine:
        with reading(engine) as session:
            known = taken.blobs_at in {None, blobs.kept_at}  # else they are where this installation does not look yet
            found = audit.verify(session, taken.head, blobs if known else None, again=False)
        kept = encrypt_all(engine, settings.secret_box)  # a backup of an older version holds them plain
    click.echo(f"{engine.url.render_as_string()}: restored, with {taken.blobs} files. Everybody logs in anew.")
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
            f"All that is in the backup was restored, but not all is as it was written: {found.sentence}"
        )
    click.echo(found.sentence)
