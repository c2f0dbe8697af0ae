"""A backup: the database and the blobs in one ZIP, taken while servers and workers go on.

The database lies in it as a SQLite file, whichever engine it is on, so a backup of one is restored into the other and an
installation moves that way. It is copied first, in one state whatever is written meanwhile: by SQLite's own backup, or row
by row inside one transaction of PostgreSQL. A blob is put before the row that names it is committed and never changes, so
every blob that the copy names is in the folder when that is copied after it; a few that it does not name may come along.
Blobs in an object store stay there: they are as safe as the bucket, and the manifest says where they are. Each file carries
its SHA-256: a blob as its name, the database in MANIFEST.json. Left out are what can be made again, the star catalogue and
compiled kernels, the key of the log-in cookies, so that after a restore everybody logs in anew, and the key of the
secrets of webhooks, which are encrypted.
"""

from __future__ import annotations

import json
import os
import re
import sqlite3
import tempfile
import zipfile
import zlib
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from boresight.errors import ConflictError, CorruptFileError, RefusedInputError
from boresight.integrity import digest_of, is_intact
from boresight.store import journals
from boresight.store.blobs import CHUNK_BYTES, BlobStore
from boresight.store.rows_across import copy_rows
from boresight.store.sessions import Engine, open_engine
from boresight.store.times import utc_now

FORM = "boresight.backup/1"
DATABASE, MANIFEST = "boresight.sqlite3", "MANIFEST.json"
NAMED = 5
BLOB = re.compile(r"blobs/([0-9a-f]{64})")


@dataclass(frozen=True)
class Taken:
    """What a backup holds."""

    blobs: int
    size_bytes: int
    head: str
    left_out: tuple[str, ...] = ()  # files that were corrupt
    blobs_at: str | None = None  # the object store that keeps them


def _file_of(url: str) -> Path | None:
    """Return the file of a SQLite database at an address, without opening it; None of another engine."""
    address = sa.make_url(url)
    sqlite = address.get_backend_name() == "sqlite" and address.database
    return Path(str(address.database)).expanduser() if sqlite else None


def write_backup(url: str, blobs: BlobStore, head: str, archive: Path, *, keep_going: bool = False) -> Taken:
    """Write a backup; the file appears complete or not at all.

    Every stored file is read and held against its address first: a backup of a corrupt one would be found out when it is needed.

    Parameters
    ----------
    url
        The database's address.
    head
        Of the audit chain, taken before: the restored chain must still hold it.
    keep_going
        Leave corrupt files out, and name them, instead of refusing.

    Raises
    ------
    CorruptFileError
        When stored files are corrupt; all of them are named.
    """
    stored = sorted(blobs.folder.glob("[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/*")) if blobs.kept_at is None else []
    corrupt = tuple(path.name for path in stored if not is_intact(path, path.name, again=True))
    if corrupt and not keep_going:
        raise CorruptFileError(
            f"Nothing was backed up, for {len(corrupt)} of {len(stored)} stored files are corrupt: {named(corrupt)}. Bring them "
            "back from an older backup, or save what there is with --keep-going.",
            corrupt[0],
        )
    with tempfile.TemporaryDirectory(prefix=".backup-", dir=archive.absolute().parent) as folder:
        copy, written = Path(folder) / DATABASE, Path(folder) / "backup.zip"
        _copy_database(url, copy)
        count = 0
        with zipfile.ZipFile(written, "w", zipfile.ZIP_STORED) as backup:
            backup.write(copy, DATABASE, zipfile.ZIP_DEFLATED)
            for path in stored:
                if path.name in corrupt:
                    continue
                backup.write(path, f"blobs/{path.name}")  # compressed already, most of them
                count += 1
            manifest = {
                "schema": FORM,
                "taken_utc": utc_now(),
                "database_sha256": digest_of(copy),
                "blobs": count,
                "blobs_at": blobs.kept_at,
                "left_out": list(corrupt),
                "audit_head": head,
            }
            backup.writestr(MANIFEST, json.dumps(manifest, indent=2) + "\n")
        written.chmod(0o600)  # it holds password hashes
        written.replace(archive)
    return Taken(count, archive.stat().st_size, head, corrupt, blobs.kept_at)


def _copy_database(url: str, copy: Path) -> None:
    """Write one state of a database to a SQLite file."""
    source = _file_of(url)
    if source is not None:
        with closing(sqlite3.connect(source)) as live, closing(sqlite3.connect(copy)) as target:
            live.backup(target)
        return
    _copy_rows(url, f"sqlite:///{copy}")


def _copy_rows(source: str, target: str) -> None:
    """Copy rows from one address to another, and close both."""
    engines = [open_engine(url) for url in (source, target)]
    try:
        copy_rows(*engines)
    finally:
        for engine in engines:
            engine.dispose()  # the last connection folds SQLite's write-ahead log into the file


def read_backup(archive: Path, url: str, blobs: BlobStore) -> Taken:
    """Lay a backup down where nothing is yet; the database appears last, when all else is there.

    The database at the address may be on the other engine than that of the backup; of PostgreSQL it must exist, empty.

    Raises
    ------
    ConflictError
        When there is a database already, or files are not as they were backed up; all of them are named.
    RefusedInputError
        When the file is no backup.
    """
    database = _file_of(url)
    if database is not None and database.exists():
        raise ConflictError(f"There is a database at {database} already; restore into an empty data folder.")
    try:
        with zipfile.ZipFile(archive) as backup:
            manifest = _manifest(backup)
            found = [(name, match[1]) for name in backup.namelist() if (match := BLOB.fullmatch(name)) is not None]
            bad = [sha256 for name, sha256 in found if not _lay_down_blob(backup, name, sha256, blobs)]
            if bad:
                what = "is not as it was" if len(bad) == 1 else "are not as they were"
                raise ConflictError(
                    f"{len(bad)} of {len(found)} files in the backup {what} backed up, so no database was made: {named(bad)}. Use "
                    "another backup."
                )
            _lay_down_database(backup, str(manifest["database_sha256"]), database, url)
    except (zipfile.BadZipFile, EOFError, OSError) as error:
        raise RefusedInputError(f"{archive} cannot be read as a backup: {error}.") from error
    left_out = tuple(manifest.get("left_out", ()))
    return Taken(
        int(manifest["blobs"]), archive.stat().st_size, str(manifest["audit_head"]), left_out, manifest.get("blobs_at")
    )


def is_of_now(archive: Path, engine: Engine) -> bool:
    """Whether an archive holds, whole, the database as it is: the audit log and the journals end alike.

    Raises
    ------
    RefusedInputError
        When the file is no backup, or cannot be read.
    """
    try:
        with zipfile.ZipFile(archive) as backup, tempfile.TemporaryDirectory(prefix="boresight-") as folder:
            manifest = _manifest(backup)
            copy = _extracted(backup, DATABASE, Path(folder) / DATABASE)
            if digest_of(copy) != manifest["database_sha256"]:
                return False
            kept = open_engine(f"sqlite:///{copy}")
            try:
                return _ends(kept) == _ends(engine)
            finally:
                kept.dispose()
    except (zipfile.BadZipFile, EOFError, OSError) as error:
        raise RefusedInputError(f"{archive} cannot be read as a backup: {error}.") from error


def _ends(engine: Engine) -> list[tuple[object, ...] | None]:
    """Return where the audit log and the journals end, as far as the schema has them."""
    tables = ("audit", *journals.JOURNALS)
    with engine.connect() as connection:
        there = sa.inspect(connection)
        found: list[tuple[object, ...] | None] = []
        for name in tables:
            columns = {column["name"] for column in there.get_columns(name)} if there.has_table(name) else set()
            table = sa.table(name, *(sa.column(column) for column in sorted(columns & {"id", "hash"})))
            if table.columns:
                row = connection.execute(sa.select(table).order_by(table.c.id.desc()).limit(1)).one_or_none()
                found.append(None if row is None else tuple(row))
        return found


def named(addresses: Sequence[str]) -> str:
    """Name files, the first of many."""
    more = f" and {len(addresses) - NAMED} more" if len(addresses) > NAMED else ""
    return ", ".join(sha256[:12] for sha256 in addresses[:NAMED]) + more


def _manifest(backup: zipfile.ZipFile) -> dict[str, Any]:
    """Read what the backup says of itself."""
    try:
        manifest = json.loads(backup.read(MANIFEST))
    except (KeyError, ValueError) as error:
        raise RefusedInputError("This file is no backup of Boresight: it has no manifest that can be read.") from error
    if not isinstance(manifest, dict) or manifest.get("schema") != FORM:
        raise RefusedInputError(f"This file is no backup in the form {FORM}; use the version that wrote it.")
    return manifest


def _lay_down_blob(backup: zipfile.ZipFile, name: str, sha256: str, blobs: BlobStore) -> bool:
    """Put one blob under the address of its bytes; False where they are not those."""
    blobs.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".restore-", dir=blobs.folder) as folder:
        try:
            written = _extracted(backup, name, Path(folder) / "blob")
        except (zipfile.BadZipFile, zlib.error):
            return False
        return digest_of(written) == sha256 and blobs.put(written) == sha256


def _lay_down_database(backup: zipfile.ZipFile, sha256: str, database: Path | None, url: str) -> None:
    """Give the database its name once it is known to be whole, or copy its rows to where the address says."""
    if database is not None:
        database.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".restore-", dir=database and database.parent) as folder:
        written = _extracted(backup, DATABASE, Path(folder) / DATABASE)
        if digest_of(written) != sha256:
            raise ConflictError("The database in the backup is not as it was backed up; use another backup.")
        written.chmod(0o600)
        if database is None:
            _copy_rows(f"sqlite:///{written}", url)
        else:
            os.link(written, database)  # unlike a rename, never over one that came meanwhile


def _extracted(backup: zipfile.ZipFile, name: str, place: Path) -> Path:
    """Write a file of the backup to the disk, piece by piece."""
    with backup.open(name) as packed, place.open("wb") as file:
        while chunk := packed.read(CHUNK_BYTES):
            file.write(chunk)
        file.flush()
        os.fsync(file.fileno())
    return place
