"""A backup: the database and the blobs in one ZIP, taken while servers and workers go on, and restored on either engine.

With a key the ZIP is encrypted as it is written (`boresight.platform.backups.encryption`), so that nothing of it but a temporary
copy of the database, in a folder of the server's own, is ever plain on a disk.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import sqlite3
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

import sqlalchemy as sa

from boresight.disks import compute_digest
from boresight.errors import ConflictError, CorruptFileError, RefusedInputError
from boresight.platform.audit import log as audit
from boresight.platform.audit import seals as journals
from boresight.platform.backups.encryption import DecryptedFile, EncryptingFile, FileKey, KeyFile, is_encrypted
from boresight.platform.blobs import files
from boresight.platform.blobs.store import CHUNK_BYTES, BlobStore
from boresight.platform.db.declared import Base
from boresight.platform.db.sessions import Engine, current_revision, migrate, open_engine, open_reading
from boresight.platform.db.times import utc_now

ROWS = 500  # rows copied at once


def copy_rows(source: Engine, target: Engine) -> int:
    """Copy every row; bring both schemas up to date first."""
    migrate(source)
    migrate(target)
    with _seen_in_one_state(source).connect() as origin, target.begin() as copy:
        if any(
            copy.scalar(sa.select(sa.literal(1)).select_from(table).limit(1)) for table in Base.metadata.sorted_tables
        ):
            raise ConflictError("There are rows in the database already; restore into an empty one.", code="not-empty")
        copied = sum(_copy_table(origin, copy, table) for table in Base.metadata.sorted_tables)
        if copy.dialect.name == "postgresql":
            for table in Base.metadata.sorted_tables:
                _count_on(copy, table)
    return copied


def _seen_in_one_state(engine: Engine) -> Engine:
    """Return the engine with an isolation level under which a transaction sees one state; SQLite's always do."""
    return (
        engine.execution_options(isolation_level="REPEATABLE READ") if engine.dialect.name == "postgresql" else engine
    )


def _copy_table(origin: sa.Connection, copy: sa.Connection, table: sa.Table) -> int:
    """Copy one table in portions."""
    plain = sa.table(
        table.name, *(sa.column(column.name) for column in table.columns)
    )  # no type: values as they are stored
    names = [column.name for column in table.columns]
    query = sa.select(*plain.columns).order_by(*(plain.columns[column.name] for column in table.primary_key))
    copied = 0
    with closing(origin.execution_options(yield_per=ROWS).execute(query)) as found:
        for rows in found.partitions():
            values: list[dict[str, Any]] = [dict(zip(names, row, strict=True)) for row in rows]
            copy.execute(plain.insert(), values)
            copied += len(values)
    return copied


def _count_on(copy: sa.Connection, table: sa.Table) -> None:
    """Set PostgreSQL's sequence of ids to follow the last row, where the table has one."""
    for column in table.primary_key:
        sequence = copy.scalar(sa.select(sa.func.pg_get_serial_sequence(table.name, column.name)))
        newest = copy.scalar(sa.select(sa.func.max(column))) if sequence else None
        if newest is not None:
            copy.execute(sa.select(sa.func.setval(sequence, newest)))


FORM = "boresight.backup/1"
DATABASE, MANIFEST = "boresight.sqlite3", "MANIFEST.json"
NAMED = 5
MANIFEST_BYTES = 8 << 20  # a manifest names at most what was left out
ADDRESS = re.compile(r"[0-9a-f]{64}")
BLOB = re.compile(r"blobs/([0-9a-f]{64})")


@dataclass(frozen=True)
class BackupSummary:
    """What a backup holds."""

    blobs: int
    size_bytes: int
    head: str
    left_out: tuple[str, ...] = ()  # files that were corrupt
    missing: tuple[str, ...] = ()  # files that rows name and that were not there
    blobs_at: str | None = None  # the object store that keeps them


@dataclass(frozen=True)
class BackupManifest:
    """The manifest of a backup."""

    taken_utc: str
    database_sha256: str
    blobs: int
    blobs_at: str | None
    left_out: tuple[str, ...]
    missing: tuple[str, ...]
    audit_head: str

    def to_json(self) -> str:
        """Write it as its member of the archive."""
        return json.dumps({"schema": FORM, **asdict(self)}, indent=2) + "\n"

    @classmethod
    def from_json(cls, text: bytes) -> BackupManifest:
        """Read it."""
        try:
            found = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise RefusedInputError(NO_MANIFEST, code="no-backup") from error
        if not isinstance(found, dict) or found.get("schema") != FORM:
            raise RefusedInputError(
                f"This file is not a backup in the form {FORM}; use the version that wrote it.", code="no-backup"
            )
        left_out, missing = (
            tuple(one) if isinstance(one := found.get(name, []), list) else ("",) for name in ("left_out", "missing")
        )
        manifest = cls(
            taken_utc=found.get("taken_utc", ""),
            database_sha256=found.get("database_sha256", ""),
            blobs=found.get("blobs", -1),
            blobs_at=found.get("blobs_at"),
            left_out=left_out,
            missing=missing,
            audit_head=found.get("audit_head", ""),
        )
        right = {
            "taken_utc": isinstance(manifest.taken_utc, str),
            "database_sha256": _is_address(manifest.database_sha256),
            "blobs": type(manifest.blobs) is int and manifest.blobs >= 0,
            "blobs_at": isinstance(manifest.blobs_at, str | None),
            "left_out": all(map(_is_address, manifest.left_out)),
            "missing": all(map(_is_address, manifest.missing)),
            "audit_head": _is_address(manifest.audit_head),
        }
        wrong = [name for name, good in right.items() if not good]
        if wrong:
            raise RefusedInputError(
                f"This file is not a backup of Boresight, or it was altered: its manifest has no {wrong[0]} that can be used. Use "
                "another backup.",
                code="no-backup",
            )
        return manifest


NO_MANIFEST = "This file is not a backup of Boresight: it has no manifest that can be read. Use another file."


def _is_address(value: object) -> bool:
    return isinstance(value, str) and ADDRESS.fullmatch(value) is not None


def _find_file(url: str) -> Path | None:
    """Return the file of a SQLite database at an address, without opening it; None for another engine."""
    address = sa.make_url(url)
    sqlite = address.get_backend_name() == "sqlite" and address.database
    return Path(str(address.database)).expanduser() if sqlite else None


def write_backup(
    url: str,
    blobs: BlobStore,
    head: str,
    archive: Path,
    *,
    keep_going: bool = False,
    key: FileKey | None = None,
    scratch: Path | None = None,
    proceed: Callable[[], None] = lambda: None,
) -> BackupSummary:
    """Write a backup, encrypted with a key if one is given; the file appears complete or not at all.

    `scratch` is the folder for the temporary copy of the database, by default that of the archive; `proceed` is called before each
    stored file and may raise to stop.

    The database is copied first. Then every stored file that the copy names or that is in the folder is held against its address,
    and again while it is packed: a backup of a corrupt or missing one would be found out when it is needed.
    """
    with ExitStack() as folders:
        near, own = (
            Path(folders.enter_context(tempfile.TemporaryDirectory(prefix=".backup-", dir=place)))
            for place in (archive.absolute().parent, scratch or archive.absolute().parent)
        )
        copy, written = own / DATABASE, near / "backup.zip"
        _copy_database(url, copy)
        registered = _registered(copy)
        stored = _stored(blobs)
        corrupt, missing = _bad_files(blobs, registered, stored)
        if not keep_going:
            _refuse_bad(corrupt, missing, len(registered.keys() | stored))
        count = 0
        with _packing(written, key) as backup:
            backup.write(copy, DATABASE, zipfile.ZIP_DEFLATED)
            for sha256 in sorted(stored.keys() - corrupt):
                proceed()
                try:
                    intact = _pack(backup, stored[sha256], sha256)
                except FileNotFoundError:
                    missing |= {sha256} & registered.keys()  # files that no row names may disappear meanwhile
                    continue
                count += intact
                corrupt |= set() if intact else {sha256}
            if not keep_going:
                _refuse_bad(corrupt, missing, len(registered.keys() | stored))
            left_out, absent = tuple(sorted(corrupt)), tuple(sorted(missing))
            manifest = BackupManifest(utc_now(), compute_digest(copy), count, blobs.kept_at, left_out, absent, head)
            backup.writestr(MANIFEST, manifest.to_json())
        written.replace(archive)
    return BackupSummary(count, archive.stat().st_size, head, left_out, absent, blobs.kept_at)


@contextmanager
def _packing(written: Path, key: FileKey | None) -> Iterator[zipfile.ZipFile]:
    """Open an archive to be written, encrypted with a key if one is given."""
    with os.fdopen(
        os.open(written, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb"
    ) as file:  # it holds password hashes
        target = None if key is None else EncryptingFile(file, key)
        packed: IO[bytes] = file if target is None else cast("IO[bytes]", target)
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as backup:
            yield backup
        if target is not None:
            target.finish()


def _registered(database: Path) -> dict[str, int]:
    """Return the addresses and sizes of the files that a SQLite database names, without those that were removed on purpose."""
    with closing(sqlite3.connect(database)) as connection:
        columns = {name for _, name, *_ in connection.execute("PRAGMA table_info(blobs)")}
        there = (
            " WHERE removed_utc IS NULL" if "removed_utc" in columns else ""
        )  # a backup of an older version has none
        return dict(connection.execute(f"SELECT sha256, size_bytes FROM blobs{there}"))  # noqa: S608 - our own words


def _stored(blobs: BlobStore) -> dict[str, Path]:
    """Return the files of the folder by address; none for an object store, whose files stay there."""
    if blobs.kept_at is not None:
        return {}
    found = blobs.folder.glob("[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/*")
    return {path.name: path for path in found if ADDRESS.fullmatch(path.name)}


def _bad_files(blobs: BlobStore, registered: dict[str, int], stored: dict[str, Path]) -> tuple[set[str], set[str]]:
    """Return the corrupt and the missing files; in an object store only sizes are checked."""
    corrupt, missing = set(), set()
    in_folder = blobs.kept_at is None
    for sha256 in sorted(registered.keys() | stored):
        what = files.wrong_with(blobs, sha256, registered.get(sha256, 0), again=in_folder)
        if what == files.MISSING and sha256 in registered:
            missing.add(sha256)
        elif what == files.ALTERED or (what == files.RESIZED and not in_folder):
            corrupt.add(sha256)
    return corrupt, missing


def _refuse_bad(corrupt: set[str], missing: set[str], count: int) -> None:
    """Refuse a backup with corrupt or missing files."""
    told = ((corrupt, "corrupt"), (missing, "missing"))
    parts = [f"{len(bad)} of {count} stored files are {what}: {named(sorted(bad))}" for bad, what in told if bad]
    if parts:
        raise CorruptFileError(
            f"No backup was made: {' and '.join(parts)}. Restore them from an older backup, or save the rest with "
            "--keep-going.",
            min(corrupt | missing),
        )


def _pack(backup: zipfile.ZipFile, path: Path, sha256: str) -> bool:
    """Add a file to the archive; False where its bytes do not match its address."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        member = zipfile.ZipInfo.from_file(path, f"blobs/{sha256}", strict_timestamps=False)
        with backup.open(member, "w") as packed:  # uncompressed: most are compressed already
            while chunk := file.read(CHUNK_BYTES):
                digest.update(chunk)
                packed.write(chunk)
    return digest.hexdigest() == sha256


def _copy_database(url: str, copy: Path) -> None:
    """Write one state of a database to a SQLite file."""
    source = _find_file(url)
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


Archive = Path | BinaryIO  # a file by its path, or one that is open and can be read from any place


def read_backup(archive: Archive, url: str, blobs: BlobStore, keys: KeyFile | None = None) -> BackupSummary:
    """Restore a backup into an empty location; the database appears last, when everything else is there.

    The database at the address may be on the other engine than that of the backup; of PostgreSQL it must exist, empty.
    """
    database = _find_file(url)
    if database is not None and database.exists():
        raise ConflictError(
            f"There is a database at {database} already; restore into an empty data folder.", code="not-empty"
        )
    with _opened(archive, keys) as (backup, size):
        manifest = _manifest(backup)
        found = _members(backup, manifest)
        _refuse_too_large(backup.infolist(), blobs.folder)
        bad = [sha256 for name, sha256 in found if not _lay_down_blob(backup, name, sha256, blobs)]
        if bad:
            what = "was altered" if len(bad) == 1 else "were altered"
            raise ConflictError(
                f"{len(bad)} of {len(found)} files in the backup {what}, so no database was created: {named(bad)}. Use "
                "another backup.",
                code="altered-backup",
            )
        _lay_down_database(backup, manifest.database_sha256, database, url)
    return BackupSummary(
        manifest.blobs, size, manifest.audit_head, manifest.left_out, manifest.missing, manifest.blobs_at
    )


@dataclass(frozen=True)
class RestoreFindings:
    """What a restore test found."""

    is_ok: bool
    sentence: str
    records: int
    rows: int
    files: int


def try_restore(archive: Archive, folder: Path, keys: KeyFile | None = None) -> RestoreFindings:
    """Restore a backup into a temporary store and verify it there: schema, audit log, and every byte of the stored files.

    The files are read out of the archive and held against their addresses, without a copy on the disk. A backup that cannot be
    read is a finding; a key that is missing is none, and is refused.
    """
    try:
        return _try_restore(archive, folder, keys)
    except (RefusedInputError, ConflictError) as error:
        return RestoreFindings(False, str(error), 0, 0, 0)


def _try_restore(archive: Archive, folder: Path, keys: KeyFile | None) -> RestoreFindings:
    """Restore and verify a backup that can be read."""
    with (
        _opened(archive, keys) as (backup, _),
        tempfile.TemporaryDirectory(prefix=".restore-test-", dir=folder) as scratch,
    ):
        manifest = _manifest(backup)
        found = _members(backup, manifest)
        copy = Path(scratch) / DATABASE
        _refuse_too_large([backup.getinfo(DATABASE)], copy)
        if _extracted(backup, DATABASE, copy) != manifest.database_sha256:
            raise ConflictError("The database in the backup was altered; use another backup.", code="altered-backup")
        registered = _registered(copy)
        faults = [f"the file {sha256[:12]} was altered" for name, sha256 in found if _digest(backup, name) != sha256]
        if manifest.blobs_at is None:
            there = {sha256 for _, sha256 in found} | {*manifest.left_out, *manifest.missing}
            faults += [f"the file {sha256[:12]} is not in it" for sha256 in sorted(registered.keys() - there)]
        engine = open_engine(f"sqlite:///{copy}")
        try:
            before = current_revision(engine)
            migrate(engine)
            with open_reading(engine) as session:
                report = audit.verify(session, manifest.audit_head)
            schema = (
                f"schema {before}" if before == current_revision(engine) else f"schema {before}, brought up to date"
            )
        finally:
            engine.dispose()
    faults += [] if report.ok else [report.sentence.rstrip(".")]
    faults += [
        f"{len(ones)} {what} files are not in it"
        for ones, what in ((manifest.left_out, "corrupt"), (manifest.missing, "missing"))
        if ones
    ]
    kept = "" if manifest.blobs_at is None else f" The stored files are not in it: they stay in {manifest.blobs_at}."
    sentence = (
        f"Restored and verified: {schema}, {report.records} audit records, {report.rows} sealed rows, "
        f"{len(found)} files.{kept}"
    )
    if faults:
        more = f", and {len(faults) - 1} more" if len(faults) > 1 else ""
        sentence = (
            f"The backup cannot be restored completely: {faults[0]}{more}. Use another backup, and check the disks."
        )
    return RestoreFindings(not faults, sentence, report.records, report.rows, len(found))


def _digest(backup: zipfile.ZipFile, name: str) -> str | None:
    """Return the SHA-256 of a member; None where it cannot be read."""
    digest = hashlib.sha256()
    try:
        with backup.open(name) as packed:
            while chunk := packed.read(CHUNK_BYTES):
                digest.update(chunk)
    except zipfile.BadZipFile:
        return None
    return digest.hexdigest()


@contextmanager
def _opened(archive: Archive, keys: KeyFile | None = None) -> Iterator[tuple[zipfile.ZipFile, int]]:
    """Open an archive, decrypted where it is encrypted, with its size, or refuse in one sentence one that cannot be read."""
    named = archive if isinstance(archive, Path) else "The file"
    try:
        with ExitStack() as opened:
            file = opened.enter_context(archive.open("rb")) if isinstance(archive, Path) else archive
            size = file.seek(0, os.SEEK_END)
            file.seek(0)
            plain: BinaryIO = file
            if is_encrypted(file):
                if keys is None:
                    raise RefusedInputError(f"{named} is encrypted: name the key file that decrypts it.")
                plain = cast("BinaryIO", DecryptedFile(file, keys))
            yield opened.enter_context(zipfile.ZipFile(plain)), size
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as error:
        raise RefusedInputError(
            f"{named} cannot be read as a backup ({error}); use another file.", code="unreadable-backup"
        ) from error


def is_of_now(archive: Path, engine: Engine, keys: KeyFile | None = None) -> bool:
    """Whether an archive is complete and current: its audit log and journals end like those of the database."""
    with _opened(archive, keys) as (backup, _), tempfile.TemporaryDirectory(prefix="boresight-") as folder:
        manifest = _manifest(backup)
        _refuse_too_large(backup.infolist(), Path(folder))
        copy = Path(folder) / DATABASE
        if _extracted(backup, DATABASE, copy) != manifest.database_sha256:
            return False
        kept = open_engine(f"sqlite:///{copy}")
        try:
            return _ends(kept) == _ends(engine)
        finally:
            kept.dispose()


def _ends(engine: Engine) -> list[tuple[object, ...] | None]:
    """Return the ends of the audit log and of the journals, as far as the schema has them."""
    tables = ("audit", *(journal.name for journal in journals.list_journals()))
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
    """Return a list of file names as text, shortened if there are many."""
    more = f" and {len(addresses) - NAMED} more" if len(addresses) > NAMED else ""
    return ", ".join(sha256[:12] for sha256 in addresses[:NAMED]) + more


def _manifest(backup: zipfile.ZipFile) -> BackupManifest:
    """Read the manifest, after checking that every member is of a kind that Boresight writes."""
    names = backup.namelist()
    for member in backup.infolist():
        stored = member.compress_type == zipfile.ZIP_STORED
        packed = stored or (member.compress_type == zipfile.ZIP_DEFLATED and not BLOB.fullmatch(member.filename))
        if member.flag_bits & 1 or not packed:
            raise RefusedInputError(
                f"This file is not a backup of Boresight: its member {member.filename[:80]!r} is encrypted or compressed. "
                "Use the original file.",
                code="no-backup",
            )
    if MANIFEST not in names:
        raise RefusedInputError(NO_MANIFEST, code="no-backup")
    if backup.getinfo(MANIFEST).file_size > MANIFEST_BYTES:
        raise RefusedInputError(
            f"This file is not a backup of Boresight: its manifest would be {backup.getinfo(MANIFEST).file_size / 1e6:.0f} MB, "
            f"at most {MANIFEST_BYTES / 1e6:.0f} MB are read. Use another file.",
            code="no-backup",
        )
    with backup.open(MANIFEST) as packed_manifest:
        manifest = BackupManifest.from_json(packed_manifest.read(MANIFEST_BYTES))
    if DATABASE not in names:
        raise RefusedInputError(
            "This file is not a backup of Boresight: it contains no database. Use another file.", code="no-backup"
        )
    return manifest


def _members(backup: zipfile.ZipFile, manifest: BackupManifest) -> list[tuple[str, str]]:
    """Return name and address of the stored files, as many as the manifest counts."""
    names = backup.namelist()
    matches = [(name, match[1]) for name in names if (match := BLOB.fullmatch(name)) is not None]
    unknown = [name for name in names if not BLOB.fullmatch(name) and name not in {DATABASE, MANIFEST}]
    left_out = set(manifest.left_out)
    found = [(name, sha256) for name, sha256 in matches if sha256 not in left_out]
    if unknown or len(set(names)) < len(names) or len(found) != manifest.blobs:
        raise RefusedInputError(
            f"This backup was altered: it contains {len(found)} stored files and {len(unknown)} unknown members where its manifest "
            f"counts {manifest.blobs} files, or a member twice. Use another backup."
        )
    return found


def _refuse_too_large(members: Sequence[zipfile.ZipInfo], folder: Path) -> None:
    """Refuse an archive whose members do not fit on the disk, as they state their sizes; none is read beyond that."""
    needed = sum(member.file_size for member in members)
    place = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    free = shutil.disk_usage(place).free
    if needed > free:
        raise RefusedInputError(
            f"The backup unpacks to {needed / 1e6:.0f} MB, and the disk of {folder} has {free / 1e6:.0f} MB: make room, or name "
            "folders on another disk."
        )


def _lay_down_blob(backup: zipfile.ZipFile, name: str, sha256: str, blobs: BlobStore) -> bool:
    """Restore one blob; False where its bytes do not match its address."""
    blobs.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".restore-", dir=blobs.folder) as folder:
        written = Path(folder) / "blob"
        try:
            found = _extracted(backup, name, written)
        except zipfile.BadZipFile:
            return False
        return found == sha256 and blobs.put(written) == sha256


def _lay_down_database(backup: zipfile.ZipFile, sha256: str, database: Path | None, url: str) -> None:
    """Rename the database once it is verified, or copy its rows to the other engine."""
    if database is not None:
        database.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".restore-", dir=database and database.parent) as folder:
        written = Path(folder) / DATABASE
        if _extracted(backup, DATABASE, written) != sha256:
            raise ConflictError("The database in the backup was altered; use another backup.", code="altered-backup")
        try:
            _registered(written)
        except sqlite3.Error as error:
            raise RefusedInputError(
                f"The database in the backup is not a Boresight database ({error}); use another backup."
            ) from error
        written.chmod(0o600)
        if database is None:
            _copy_rows(f"sqlite:///{written}", url)
        else:
            os.link(written, database)  # unlike a rename, never over one that came meanwhile


def _extracted(backup: zipfile.ZipFile, name: str, place: Path) -> str:
    """Extract a member in pieces, no more than its stated size, and return the SHA-256 of its bytes."""
    digest = hashlib.sha256()
    with backup.open(name) as packed, place.open("wb") as file:
        while chunk := packed.read(CHUNK_BYTES):
            digest.update(chunk)
            file.write(chunk)
        file.flush()
        os.fsync(file.fileno())
    return digest.hexdigest()
