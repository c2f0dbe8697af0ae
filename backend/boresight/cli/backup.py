"""`boresight backup` and `boresight restore`: database and blobs in one file, and back into an empty data folder."""

from __future__ import annotations

from pathlib import Path

import click

from boresight.cli.output import check_writable
from boresight.errors import ConflictError, RefusedInputError
from boresight.settings import read_settings

MB = 1e6


@click.command()
@click.option("--out", "file", metavar="FILE", required=True, help="The ZIP to write; an existing one is kept.")
def backup(file: str) -> None:
    """Write database and blobs to FILE, while servers and workers go on.

    The file holds password hashes: keep it as the data folder is kept.
    """
    check_writable(file)
    if Path(file).exists():
        raise RefusedInputError(f"{file} exists already; name another file, a backup is never written over.")
    from boresight.services import audit
    from boresight.store import backup as backups
    from boresight.store.blobs import BlobStore
    from boresight.store.sessions import migrate, open_engine, reading

    settings = read_settings()
    database = backups.database_file(settings.database_url)
    engine = open_engine(settings.database_url)
    migrate(engine)
    with reading(engine) as session:
        head = audit.head(session)
    taken = backups.write_backup(database, BlobStore(settings.blob_folder), head, Path(file))
    click.echo(f"{file}: the database and {taken.blobs} files, {taken.size_bytes / MB:.1f} MB\naudit head {head}")


@click.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
def restore(file: Path) -> None:
    """Lay the backup FILE down in an empty data folder, and verify its audit log."""
    from boresight.services import audit
    from boresight.store import backup as backups
    from boresight.store.blobs import BlobStore
    from boresight.store.sessions import migrate, open_engine, reading

    settings = read_settings()
    database = backups.database_file(settings.database_url)
    taken = backups.read_backup(file, database, BlobStore(settings.blob_folder))
    engine = open_engine(settings.database_url)
    migrate(engine)
    with reading(engine) as session:
        found = audit.verify(session, taken.head)
    click.echo(f"{database}: restored, with {taken.blobs} files. Everybody logs in anew.")
    if not found.ok:
        raise ConflictError(f"The backup is whole, but its audit log does not hold: {found.sentence}")
    click.echo(found.sentence)
