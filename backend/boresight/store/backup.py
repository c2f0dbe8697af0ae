"""A backup: the database and the blobs in one ZIP, taken while servers and workers go on.

The database is copied first, by SQLite's own backup, which gives one state of it whatever is written meanwhile. A blob
is put before the row that names it is committed and never changes, so every blob that the copy names is in the folder
when that is copied after it; a few that it does not name may come along. Each file carries its SHA-256: a blob as its
name, the database in MANIFEST.json. Left out are what can be made again, the star catalogue and compiled kernels, and
the key of the log-in cookies: after a restore everybody logs in anew.
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


def database_file(url: str) -> Path:
    """Return the file of a SQLite database at an address, without opening it.

    Raises
    ------
    RefusedInputError
        When it is another engine, which has its own way.
    """
    address = sa.make_url(url)
    if address.get_backend_name() != "sqlite" or not address.database:
        raise RefusedInputError(
            "This database is not a SQLite file: back it up with pg_dump, and the folder of blobs after it."
        )
    return Path(address.database).expanduser()


def write_backup(source: Path, blobs: BlobStore, head: str, archive: Path) -> Taken:
    """Write a backup; the file appears complete or not at all.

    Parameters
    ----------
    source
        The database's file.
    head
        Of the audit chain, taken before: the restored chain must still hold it.
    """
    with tempfile.TemporaryDirectory(prefix=".backup-", dir=archive.absolute().parent) as folder:
        copy, written = Path(folder) / DATABASE, Path(folder) / "backup.zip"
        with closing(sqlite3.connect(source)) as live, closing(sqlite3.connect(copy)) as target:
            live.backup(target)
        count = 0
        with zipfile.ZipFile(written, "w", zipfile.ZIP_STORED) as backup:
            backup.write(copy, DATABASE, zipfile.ZIP_DEFLATED)
            for path in sorted(blobs.folder.glob("[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/*")):
                backup.write(path, f"blobs/{path.name}")  # compressed already, most of them
                count += 1
            manifest = {
                "schema": FORM,
                "taken_utc": utc_now(),
                "database_sha256": _sha256(copy),
                "blobs": count,
                "audit_head": head,
            }
            backup.writestr(MANIFEST, json.dumps(manifest, indent=2) + "\n")
        written.chmod(0o600)  # it holds password hashes and secrets of webhooks
        written.replace(archive)
    return Taken(count, archive.stat().st_size, head)


def read_backup(archive: Path, database: Path, blobs: BlobStore) -> Taken:
    """Lay a backup down where nothing is yet; the database appears last, when all else is there.

    Raises
    ------
    ConflictError
        When there is a database already, or a file is not as it was backed up.
    RefusedInputError
        When the file is no backup.
    """
    if database.exists():
        raise ConflictError(f"There is a database at {database} already; restore into an empty data folder.")
    try:
        with zipfile.ZipFile(archive) as backup:
            manifest = _manifest(backup)
            for name in backup.namelist():
                if (found := BLOB.fullmatch(name)) is not None:
                    _lay_down_blob(backup, name, found[1], blobs)
            _lay_down_database(backup, str(manifest["database_sha256"]), database)
    except (zipfile.BadZipFile, EOFError, OSError) as error:
        raise RefusedInputError(f"{archive} cannot be read as a backup: {error}.") from error
    return Taken(int(manifest["blobs"]), archive.stat().st_size, str(manifest["audit_head"]))


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


def _lay_down_database(backup: zipfile.ZipFile, sha256: str, database: Path) -> None:
    """Give the database its name once it is known to be whole."""
    database.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".restore-", dir=database.parent) as folder:
        written = _extracted(backup, DATABASE, Path(folder) / DATABASE)
        if _sha256(written) != sha256:
            raise ConflictError("The database in the backup is not as it was backed up; use another backup.")
        written.chmod(0o600)
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
