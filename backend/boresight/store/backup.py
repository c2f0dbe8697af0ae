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

import hashlib
import json
import os
import re
import sqlite3
import tempfile
import zipfile
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from boresight.errors import ConflictError, RefusedInputError
from boresight.store.blobs import CHUNK_BYTES, BlobStore
from boresight.store.rows_across import copy_rows
from boresight.store.sessions import open_engine
from boresight.store.times import utc_now

FORM = "boresight.backup/1"
DATABASE, MANIFEST = "boresight.sqlite3", "MANIFEST.json"
BLOB = re.compile(r"blobs/([0-9a-f]{64})")


@dataclass(frozen=True)
class Taken:
    """What a backup holds."""

    blobs: int
    size_bytes: int
    head: str
    blobs_at: str | None = None  # the object store that keeps them


def _file_of(url: str) -> Path | None:
    """Return the file of a SQLite database at an address, without opening it; None of another engine."""
    address = sa.make_url(url)
    sqlite = address.get_backend_name() == "sqlite" and address.database
    return Path(str(address.database)).expanduser() if sqlite else None


def write_backup(url: str, blobs: BlobStore, head: str, archive: Path) -> Taken:
    """Write a backup; the file appears complete or not at all.

    Parameters
    ----------
    url
        The database's address.
    head
        Of the audit chain, taken before: the restored chain must still hold it.
    """
    with tempfile.TemporaryDirectory(prefix=".backup-", dir=archive.absolute().parent) as folder:
        copy, written = Path(folder) / DATABASE, Path(folder) / "backup.zip"
        _copy_database(url, copy)
        count = 0
        with zipfile.ZipFile(written, "w", zipfile.ZIP_STORED) as backup:
            backup.write(copy, DATABASE, zipfile.ZIP_DEFLATED)
            for path in (
                sorted(blobs.folder.glob("[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/*")) if blobs.kept_at is None else ()
            ):
                backup.write(path, f"blobs/{path.name}")  # compressed already, most of them
                count += 1
            manifest = {
                "schema": FORM,
                "taken_utc": utc_now(),
                "database_sha256": _sha256(copy),
                "blobs": count,
                "blobs_at": blobs.kept_at,
                "audit_head": head,
            }
            backup.writestr(MANIFEST, json.dumps(manifest, indent=2) + "\n")
        written.chmod(0o600)  # it holds password hashes
        written.replace(archive)
    return Taken(count, archive.stat().st_size, head, blobs.kept_at)


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
        When there is a database already, or a file is not as it was backed up.
    RefusedInputError
        When the file is no backup.
    """
    database = _file_of(url)
    if database is not None and database.exists():
        raise ConflictError(f"There is a database at {database} already; restore into an empty data folder.")
    try:
        with zipfile.ZipFile(archive) as backup:
            manifest = _manifest(backup)
            for name in backup.namelist():
                if (found := BLOB.fullmatch(name)) is not None:
                    _lay_down_blob(backup, name, found[1], blobs)
            _lay_down_database(backup, str(manifest["database_sha256"]), database, url)
    except (zipfile.BadZipFile, EOFError, OSError) as error:
        raise RefusedInputError(f"{archive} cannot be read as a backup: {error}.") from error
    return Taken(int(manifest["blobs"]), archive.stat().st_size, str(manifest["audit_head"]), manifest.get("blobs_at"))


def _manifest(backup: zipfile.ZipFile) -> dict[str, Any]:
    """Read what the backup says of itself."""
    try:
        manifest = json.loads(backup.read(MANIFEST))
    except (KeyError, ValueError) as error:
        raise RefusedInputError("This file is no backup of Boresight: it has no manifest that can be read.") from error
    if not isinstance(manifest, dict) or manifest.get("schema") != FORM:
        raise RefusedInputError(f"This file is no backup in the form {FORM}; use the version that wrote it.")
    return manifest


def _lay_down_blob(backup: zipfile.ZipFile, name: str, sha256: str, blobs: BlobStore) -> None:
    """Put one blob under the address of its bytes."""
    blobs.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".restore-", dir=blobs.folder) as folder:
        if blobs.put(_extracted(backup, name, Path(folder) / "blob")) != sha256:
            raise ConflictError(f"The file {sha256[:12]} in the backup is not as it was backed up; use another backup.")


def _lay_down_database(backup: zipfile.ZipFile, sha256: str, database: Path | None, url: str) -> None:
    """Give the database its name once it is known to be whole, or copy its rows to where the address says."""
    if database is not None:
        database.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".restore-", dir=database and database.parent) as folder:
        written = _extracted(backup, DATABASE, Path(folder) / DATABASE)
        if _sha256(written) != sha256:
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


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
