"""`boresight backup` and `boresight restore`: database and blobs in one file, and back into an empty installation."""

from __future__ import annotations

from pathlib import Path

import click

from boresight.cli.output import check_writable, refuse_standard_output
from boresight.errors import ConflictError, CorruptFileError, RefusedInputError
from boresight.settings import read_settings

MB = 1e6


@click.command()
@click.option("--out", "file", metavar="FILE", required=True, help="The ZIP to write; an existing one is kept.")
@click.option(
    "--keep-going", is_flag=True, help="Leave corrupt files out and name them; the exit code is 1 all the same."
)
def backup(file: str, *, keep_going: bool) -> None:
    """Write database and blobs to FILE, while servers and workers go on; refuse where a stored file is corrupt.

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
        click.echo(f"The stored files stay in {taken.blobs_at}: let the store keep versions or a copy of that bucket.")
    _refuse_left_out(taken.left_out, "were left out of the backup")


def _refuse_left_out(left_out: tuple[str, ...], what: str) -> None:
    """Name every file that is missing, and end with exit code 1."""
    for sha256 in left_out:
        click.echo(f"  {sha256}", err=True)
    if left_out:
        raise CorruptFileError(
            f"{len(left_out)} corrupt files {what}: {', '.join(sha256[:12] for sha256 in left_out[:5])}."
        )


@click.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
def restore(file: Path) -> None:
    """Lay the backup FILE down in an empty data folder or PostgreSQL database, and verify its audit log.

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
            found = audit.verify(session, taken.head)
        kept = encrypt_all(engine, settings.secret_box)  # a backup of an older version holds them plain
    click.echo(f"{engine.url.render_as_string()}: restored, with {taken.blobs} files. Everybody logs in anew.")
    if taken.blobs_at not in {None, blobs.kept_at}:
        click.echo(f"Its stored files are in {taken.blobs_at}: set BORESIGHT_BLOBS to that, or copy them from there.")
    if kept.sentence is not None:
        click.echo(kept.sentence, err=True)
    _refuse_left_out(taken.left_out, "were left out when the backup was taken, and are missing now")
    if not found.ok:
        raise ConflictError(f"The backup is whole, but its audit log does not hold: {found.sentence}")
    click.echo(found.sentence)
