"""Telemetry sets: downlinked files, stored as uploaded and as working tables.

A file is checked whole before anything is stored. That takes seconds and there is one writer, so `hold_prepared` comes
before the transaction and `store_prepared` inside it.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

from boresight.console import list_queries as lists
from boresight.console.fleet.tables import Sensor as SensorRow
from boresight.console.telemetry import queries as rows
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import RefusedInputError, UnavailableError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.blobs import files
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import normal_name
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.imports.mapping import Imported, SourceFile, import_files
from boresight.telemetry.imports.profile import Profile
from boresight.telemetry.quality.report import QualityParts
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.read.readers import read_chunks
from boresight.telemetry.sensors import Sensor, parse_sensor
from boresight.telemetry.working_table import MEDIA_TYPE, WorkingTableParts

PURPOSES = ("calibration", "validation")
MEDIA_TYPES = {".csv": "text/csv", ".jsonl": "application/x-ndjson", ".ndjson": "application/x-ndjson"}
MOST_OF_NAME = 200
PARQUET = "application/vnd.apache.parquet"


@dataclass(frozen=True)
class PreparedUpload:
    """An uploaded file that was checked and converted to a working table; nothing is stored yet."""

    original: Path
    table: Path
    name: str
    media_type: str
    original_sha256: str
    frames: int
    stars: int
    quality: dict[str, Any]
    source: Path | None = None
    imported: Imported | None = None


@dataclass(frozen=True)
class ImportRequest:
    """By which profile a file is to be imported, and what it does not say itself."""

    profile: Profile
    time: str | None = None
    elements: str | None = None


@contextmanager
def hold_imported(
    sensor_document: Mapping[str, Any],
    catalogue: Catalogue | None,
    path: Path,
    file_name: str,
    wanted: ImportRequest,
    limits: Limits = LIMITS,
) -> Iterator[PreparedUpload]:
    """Make telemetry of what another program wrote, and check it as telemetry is checked."""
    name = _base_name(file_name)
    with tempfile.TemporaryDirectory() as folder:
        orbit = None
        if wanted.elements:
            orbit = SourceFile(Path(folder) / "elements", "The two-line elements")
            orbit.path.write_text(wanted.elements)
        imported = import_files(
            [SourceFile(path, name)],
            wanted.profile,
            sensor=parse_sensor(sensor_document),
            orbit=orbit,
            time=wanted.time or None,
            limits=limits,
        )
        made = Path(folder) / "telemetry"
        with made.open("wb") as stream:
            imported.write(stream, ".parquet")
        with hold_prepared(sensor_document, catalogue, made, f"{name[:MOST_OF_NAME]}.parquet", limits) as prepared:
            yield replace(prepared, source=path, imported=imported)


@contextmanager
def hold_prepared(
    sensor_document: Mapping[str, Any],
    catalogue: Catalogue | None,
    path: Path,
    file_name: str,
    limits: Limits = LIMITS,
) -> Iterator[PreparedUpload]:
    """Read and check an uploaded file, without the database."""
    sensor, name = parse_sensor(sensor_document), _base_name(file_name)
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "table"
        quality = _checked(path, name, sensor, catalogue, table, limits)
        yield PreparedUpload(
            original=path,
            table=table,
            name=name,
            media_type=MEDIA_TYPES.get(PurePath(name).suffix.lower(), PARQUET),
            original_sha256=_sha256_of_file(path),
            frames=quality["frames"],
            stars=quality["stars"],
            quality=quality,
        )


def _checked(
    path: Path, name: str, sensor: Sensor, catalogue: Catalogue | None, table: Path, limits: Limits
) -> dict[str, Any]:
    """Read a file in chunks into its working table, never whole in memory; returns its quality report."""
    quality = QualityParts(sensor, catalogue)
    with WorkingTableParts(table) as parts:
        for chunk in read_chunks(path, name, limits=limits):
            parts.write(chunk)
            quality.add(chunk)
    quality.off_detector.refuse()
    return quality.report()


def add_telemetry_set(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    catalogue: Catalogue | None,
    sensor_id: int,
    path: Path,
    file_name: str,
    purpose: str = "calibration",
) -> TelemetrySet:
    """Read, check and store an uploaded file of a sensor; see `hold_prepared` and `store_prepared`."""
    _refuse_upload(actor, purpose)
    sensor = session.get_known(SensorRow, sensor_id)
    if (existing := rows.find_set_with_bytes(session, sensor_id, _sha256_of_file(path))) is not None:
        return _use_again(session, actor, existing)
    with hold_prepared(sensor.document, catalogue, path, file_name) as upload:
        return store_prepared(session, actor, blobs, sensor_id, upload, purpose)


def _put_both(session: Session, blobs: BlobStore, upload: PreparedUpload) -> tuple[str, str]:
    """Store both the file and its table, or neither if the disk is full."""
    original = blobs.put(upload.original)
    try:
        return original, blobs.put(upload.table)
    except UnavailableError:
        if not files.list_sizes(session, [original]):
            blobs.discard(original)
        raise


def store_prepared(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    sensor_id: int,
    upload: PreparedUpload,
    purpose: str = "calibration",
) -> TelemetrySet:
    """Store a prepared upload; the same bytes again return the existing set."""
    _refuse_upload(actor, purpose)
    sensor_id = session.get_known(SensorRow, sensor_id).id
    if (existing := rows.find_set_with_bytes(session, sensor_id, upload.original_sha256)) is not None:
        return _use_again(session, actor, existing)
    original, table = _put_both(session, blobs, upload)
    source = None if upload.source is None else blobs.put(upload.source)
    if source is not None:
        register_blob(session, blobs, source, "application/octet-stream")
    register_blob(session, blobs, original, upload.media_type)
    register_blob(session, blobs, table, MEDIA_TYPE)
    row = TelemetrySet(
        sensor_id=sensor_id,
        name=upload.name,
        purpose=purpose,
        original_sha256=original,
        table_sha256=table,
        frames=upload.frames,
        stars=upload.stars,
        quality=upload.quality,
        uploaded_utc=utc_now(),
        uploaded_by=actor.user_id,
        import_record=None if upload.imported is None else upload.imported.record(),
        source_sha256=source,
    )
    session.put(row)
    after: dict[str, Any] = {"name": row.name, "sensor_id": sensor_id, "purpose": purpose, "original_sha256": original}
    if upload.imported is not None:
        after |= {"source_sha256": source, "profile": upload.imported.record()["profile"]}
    audit.append(session, actor, "uploaded", _subject(row), None, after)
    return row


def _refuse_upload(actor: Actor, purpose: str) -> None:
    """Refuse who may not upload, and a purpose that does not exist."""
    require_role(actor, "analyst")
    require_scope(actor, "telemetry-sets")
    if purpose not in PURPOSES:
        raise RefusedInputError(f"The purpose is calibration or validation, not {purpose!r}.")


def _sha256_of_file(path: Path) -> str:
    """Return the address that a file's bytes would have."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _use_again(session: Session, actor: Actor, row: TelemetrySet) -> TelemetrySet:
    """Restore a set if it is archived."""
    if row.archived_utc is not None:
        row.archived_utc = None
        audit.append(session, actor, "took out of the archive", _subject(row))
    return row


def _base_name(file_name: str) -> str:
    """Return a sender's file name in its normal form, without the folders of either kind of path."""
    name = normal_name("file name", _without_folders(file_name))
    return _without_folders(name) or "telemetry"  # split again, because other characters have slashes as normal forms


def _without_folders(path: str) -> str:
    return path.replace("\\", "/").rsplit("/", 1)[-1]


def list_telemetry_sets(
    session: Session,
    *,
    sensor_id: int | None = None,
    purpose: str | None = None,
    archived: bool = False,
    before_id: int | None = None,
    limit: int | None = None,
) -> Sequence[TelemetrySet]:
    """Return a page of sets, newest first, with the archived ones where asked; the next starts before the last id."""
    in_use = None if archived else True
    return lists.list_newest(
        session, TelemetrySet, before_id=before_id, limit=limit, sensor=sensor_id, purpose=purpose, in_use=in_use
    )


def archive_telemetry_set(session: Session, actor: Actor, set_id: int) -> TelemetrySet:
    """Archive a set; nothing is deleted, and runs that used it keep it."""
    require_role(actor, "analyst")
    require_scope(actor, "telemetry-sets")
    row = session.get_known(TelemetrySet, set_id)
    if row.archived_utc is None:
        row.archived_utc = utc_now()
        audit.append(session, actor, "archived", _subject(row))
    return row


def _subject(row: TelemetrySet) -> str:
    return f"telemetry-sets/{row.id}"
