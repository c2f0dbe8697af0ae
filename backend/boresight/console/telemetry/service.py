"""Telemetry sets: downlinked files, stored as uploaded and as working tables.

A file is checked whole before anything is stored. That takes seconds and there is one writer, so `hold_prepared` comes
before the transaction and `store_prepared` inside it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from boresight.calibration.diagnosis.diagnose import ExposureSample, diagnose
from boresight.calibration.diagnosis.explain import add_to_report, explain_refusal
from boresight.calibration.diagnosis.other_camera import MOST_EXPOSURES, KnownCamera, OtherCameras, find_other_cameras
from boresight.calibration.diagnosis.result import Diagnosis
from boresight.calibration.telemetry_pieces import StoredTable
from boresight.cameras import CAMERA_MODELS
from boresight.console import list_queries as lists
from boresight.console.fleet.tables import Sensor as SensorRow
from boresight.console.telemetry import queries as rows
from boresight.console.telemetry.tables import TelemetrySet, find_diagnosis
from boresight.disks import compute_digest
from boresight.errors import ConflictError, Fault, NotFoundError, RefusedInputError, UnavailableError
from boresight.images.limits import LIMITS as IMAGE_LIMITS
from boresight.images.limits import ImageLimits, ImageSource, is_archive
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.blobs import files
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.blobs.tables import Blob
from boresight.platform.blobs.working_tables import table_path
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.web.text_validation import normal_name
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.imports.mapping import Imported, SourceFile, import_by_likeliest, import_files
from boresight.telemetry.imports.profile import Profile
from boresight.telemetry.mapping import parse_mapping
from boresight.telemetry.quality.detector import OffDetectorError
from boresight.telemetry.quality.findings import Finding
from boresight.telemetry.quality.report import QualityParts, put_finding_first
from boresight.telemetry.read.frames import frame_index
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.readers import read_chunks
from boresight.telemetry.sensors import Sensor, parse_sensor
from boresight.telemetry.working_table import MEDIA_TYPE, WorkingTableParts, find_image
from boresight.telemetry.writing import write_parquet

PURPOSES = ("calibration", "validation")
MEDIA_TYPES = {
    ".csv": "text/csv", ".jsonl": "application/x-ndjson", ".ndjson": "application/x-ndjson", ".gz": "application/gzip",
}  # fmt: skip
MOST_OF_NAME = 200
#: Seconds that an upload which is refused may look for the cause.
REFUSAL_BUDGET_S = 2.0
#: Sensors that a set of another camera is offered to.
MOST_OFFERED = 4
IMPORTED = "imported.parquet"
PARQUET, ARCHIVE = "application/vnd.apache.parquet", "application/zip"


@dataclass(frozen=True)
class ImageUpload:
    """Images in the place of a telemetry file, and how much they may hold and how long they may take."""

    sources: Sequence[ImageSource] = ()
    limits: ImageLimits = IMAGE_LIMITS
    seconds: float = 600.0


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
    """By which profile a file is imported, the likeliest of `offers` where it is None, and what it does not say itself."""

    profile: Profile | None
    time: str | None = None
    elements: str | None = None
    offers: tuple[Profile, ...] = ()


@dataclass(frozen=True)
class RegisteredCameras:
    """The sensor that an upload is said to be of, and all others; `kept`: whether it stays there whatever its stars show."""

    own: KnownCamera
    others: tuple[KnownCamera, ...] = ()
    kept: bool = False


class OtherCameraError(RefusedInputError):
    """The upload is of another sensor's camera.

    `sensors`: the numbers and names that it is offered to, best first. `keepable`: whether it can be kept where it was sent.
    """

    def __init__(self, sentence: str, sensors: Sequence[tuple[int, str]], keepable: bool) -> None:
        instead = "; ".join(f"{number} is {name}" for number, name in sensors)
        keep = ", or keep_here=1 to keep the set with this sensor" if keepable else ""
        super().__init__(sentence, (Fault(None, "sensor_id", f"send one of these instead ({instead}){keep}"),))
        self.sensors, self.keepable = tuple(sensors), keepable


def read_cameras(session: Session, sensor_id: int, *, kept: bool = False) -> RegisteredCameras:
    """Read the cameras of all sensors, as their files have them and as stars measured them, the one of an upload apart."""
    session.get_known(SensorRow, sensor_id)
    measured = rows.read_measured_baselines(session)
    cameras = [_known_camera(*row, measured) for row in rows.read_sensor_documents(session)]
    own = next(one for one in cameras if one.sensor_id == sensor_id)
    return RegisteredCameras(own, tuple(one for one in cameras if one is not own), kept)


def _known_camera(
    sensor_id: int, document: Mapping[str, Any], measured: Mapping[int, Mapping[str, Any]]
) -> KnownCamera:
    sensor, baseline = parse_sensor(document), measured.get(sensor_id)
    if baseline is None or baseline["camera_model"] != sensor.camera_model:
        return KnownCamera(sensor_id, sensor)
    values = (baseline["parameters"][name] for name in CAMERA_MODELS[sensor.camera_model].parameter_names)
    return KnownCamera(sensor_id, sensor, np.array([*values], dtype=np.float64))


@contextmanager
def hold_prepared(  # noqa: PLR0913 - a file, what it is said to be, and what it is held against
    sensor_document: Mapping[str, Any],
    catalogue: Catalogue | None,
    path: Path,
    file_name: str,
    limits: Limits = LIMITS,
    cache_folder: Path | None = None,
    images: ImageUpload | None = None,
    wanted: ImportRequest | None = None,
    *,
    cameras: RegisteredCameras | None = None,
) -> Iterator[PreparedUpload]:
    """Read and check an uploaded file without the database; one that is of another of the `cameras` is refused, unless it is kept.

    Of images telemetry is extracted first; of what another program wrote it is made by the `wanted` mapping profile.
    `cache_folder` keeps the tables of a diagnosis.
    """
    sensor, name, images = parse_sensor(sensor_document), _base_name(file_name), images or ImageUpload()
    with tempfile.TemporaryDirectory() as folder:
        table, original, read = Path(folder) / "table", path, path
        imported = None if wanted is None else _import(images, sensor, path, name, wanted, limits, Path(folder))
        found = None if imported else _extract(images, sensor, path, name, Path(folder))
        if imported is not None:
            original = read = Path(folder) / IMPORTED
            name = f"{_source_name(images, name)[:MOST_OF_NAME]}.parquet"
        elif found is not None:
            original, read = found.archive, found.telemetry
        quality = _checked(read, read.name if found else name, sensor, catalogue, table, limits, cache_folder, cameras)
        if found is not None:
            quality["findings"] += [Finding("IMAGES", "NORMAL", said, 1).document() for said in found.sentences]
        yield PreparedUpload(
            original=original,
            table=table,
            name=name,
            media_type=ARCHIVE if found else MEDIA_TYPES.get(PurePath(name).suffix.lower(), PARQUET),
            original_sha256=compute_digest(original),
            frames=quality["frames"],
            stars=quality["stars"],
            quality=quality,
            source=path if imported else None,
            imported=imported,
        )


def _source_name(images: ImageUpload, name: str) -> str:
    """What the sender calls a file: a FITS table comes as an image does, by its suffix."""
    return images.sources[0].name if images.sources else name


def _import(
    images: ImageUpload, sensor: Sensor, path: Path, name: str, wanted: ImportRequest, limits: Limits, folder: Path
) -> Imported:
    """Make telemetry of what another program wrote."""
    if len(images.sources) > 1:
        raise RefusedInputError(
            "A mapping profile imports one file; choose no profile to extract stars from several images."
        )
    orbit = None
    if wanted.elements:
        orbit = SourceFile(folder / "elements", "The two-line elements")
        orbit.path.write_text(wanted.elements)
    source = SourceFile(path, _source_name(images, name))
    beside: dict[str, Any] = {"sensor": sensor, "orbit": orbit, "time": wanted.time, "limits": limits}
    if wanted.profile is None:
        imported = import_by_likeliest(source, wanted.offers, **beside)
    else:
        imported = import_files([source], wanted.profile, **beside)
    with (folder / IMPORTED).open("wb") as stream:
        imported.write(stream, ".parquet")
    return imported


@dataclass(frozen=True)
class _Extracted:
    """Images that became telemetry: both packed together, the telemetry, and what is to be said of them."""

    archive: Path
    telemetry: Path
    sentences: list[str]


def _extract(images: ImageUpload, sensor: Sensor, path: Path, name: str, folder: Path) -> _Extracted | None:
    """Extract the stars of images, or of an archive of images; None where the upload is neither."""
    if not images.sources and not is_archive(path):
        return None
    from boresight.images import archive, extraction  # noqa: PLC0415 - of uploads that are images alone
    from boresight.images.detection import DetectionOptions  # noqa: PLC0415 - as above

    unpacked = folder / "images"
    unpacked.mkdir()
    sources = list(images.sources) or archive.unpack(path, name, unpacked, images.limits)
    found = extraction.extract_apart(sources, sensor, DetectionOptions(), seconds=images.seconds, limits=images.limits)
    telemetry, packed = folder / archive.TELEMETRY, folder / "images.zip"
    write_parquet(found.telemetry, telemetry)
    archive.pack(sources, found, packed)
    return _Extracted(packed, telemetry, found.sentences)


def _checked(
    path: Path,
    name: str,
    sensor: Sensor,
    catalogue: Catalogue | None,
    table: Path,
    limits: Limits,
    cache_folder: Path | None,
    cameras: RegisteredCameras | None,
) -> dict[str, Any]:
    """Read a file in chunks into its working table, never whole in memory; returns its quality report.

    A set that is of another sensor's camera is refused, or says so where it is kept. A set whose names do not suffice is diagnosed,
    and so is one that is refused for stars off the detector.
    """
    quality, sample = QualityParts(sensor, catalogue), ExposureSample(MOST_EXPOSURES)
    with WorkingTableParts(table) as parts:
        for chunk in read_chunks(path, name, limits=limits):
            parts.write(chunk)
            quality.add(chunk)
            sample.add(chunk)
    other = None
    if catalogue is not None and cameras is not None:
        other = find_other_cameras(sample.get(), cameras.own, cameras.others, catalogue, cache_folder)
    if other is not None and other.cameras and other.is_certain and cameras is not None and not cameras.kept:
        raise _make_refusal(other, name, sensor, keepable=not quality.off_detector.too_many)
    try:
        quality.off_detector.refuse()
    except OffDetectorError as error:
        if catalogue is None:
            raise
        raise explain_refusal(error, _stored(table), sensor, catalogue, cache_folder, REFUSAL_BUDGET_S) from error
    report = quality.report()
    if other is not None:
        said = (
            f"The stars may be those of {_named(other)} rather than of {sensor.name}: {other.why}. If they are, upload the "
            "set there."
            if other.cameras and not other.is_certain
            else f"The stars are those of {_named(other)}, but the set was kept with {sensor.name} deliberately: {other.why}."
            if other.cameras
            else f"The stars are not those of {sensor.name}, nor of another registered sensor: {other.why}. Register the sensor "
            f"that took them and upload the set there, or correct the focal length of {sensor.name}."
        )
        report = put_finding_first(report, Finding("OTHER_CAMERA", "CAUTION", said, 1), ())
    if catalogue is None or report["usable_exposures"]:
        return report
    return add_to_report(report, diagnose(_stored(table), sensor, catalogue, cache_folder=cache_folder))


def _make_refusal(other: OtherCameras, name: str, sensor: Sensor, *, keepable: bool) -> OtherCameraError:
    """Say whose set this is, and what to do; a set off the detector can be kept here by nobody."""
    offered = [(one.sensor_id, one.sensor.name) for one in other.cameras[:MOST_OFFERED]]
    keep = f", or keep it with {sensor.name} deliberately" if keepable else ""
    return OtherCameraError(
        f"The telemetry {name} appears to be from {_named(other)}, not {sensor.name}, because {other.why}. Upload it there{keep}.",
        offered,
        keepable,
    )


def _named(other: OtherCameras) -> str:
    """Name the sensors whose set it may be."""
    names, more = [one.sensor.name for one in other.cameras[:MOST_OFFERED]], len(other.cameras) - MOST_OFFERED
    if more > 0:
        return f"{', '.join(names)} or {more} more"
    return " or ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _stored(table: Path) -> StoredTable:
    """A working table that is not in the store yet."""
    return StoredTable(table, compute_digest(table))


def diagnose_stored(document: Mapping[str, Any], found: TelemetrySet, sources: ForecastSources) -> Diagnosis:
    """Find why a stored set does not match its sensor, whose document this is; seconds, and without the database."""
    if (catalogue := sources.catalogue()) is None:
        raise UnavailableError("This server has no star catalogue to diagnose with; see its log, and try again.")
    table = StoredTable(table_path(sources.blobs, found.table_sha256), found.table_sha256)
    return diagnose(table, parse_sensor(document), catalogue, cache_folder=sources.catalogue_folder)


def record_diagnosis(session: Session, actor: Actor, set_id: int, found: Diagnosis) -> TelemetrySet:
    """Put a diagnosis into a set's quality report, in place of one that is there."""
    _refuse_analysis(actor)
    row = session.get_known(TelemetrySet, set_id)
    row.quality = add_to_report(row.quality, found)
    audit.append(session, actor, "diagnosed", _subject(row), None, {"causes": list(found.names)})
    return row


def get_diagnosis(row: TelemetrySet) -> Diagnosis:
    """Return the diagnosis of a set; raises ConflictError where it has none that names a mend."""
    found = find_diagnosis(row.quality)
    if found is None or found.sensor_document is None:
        raise ConflictError(f"{row.name} has no diagnosis with a correction; diagnose it first.")
    return found


def mend_document(document: Mapping[str, Any], found: Diagnosis) -> dict[str, Any]:
    """Return a sensor document with what a diagnosis mends of it, and nothing else."""
    mended, names = found.sensor_document or {}, set(found.names)
    changed = dict(document)
    if "parity" in names:
        changed["parity"] = mended["parity"]
    if "focal_length" in names:
        changed["initial"] = mended["initial"]
    for key, name in (("magnitude_limit", "magnitude_limit"), ("declared", "j2000_directions")):
        if name in names and key in mended:
            changed[key] = mended[key]
    return changed


@contextmanager
def hold_for_new_sensor(
    document: Mapping[str, Any], row: TelemetrySet, sources: ForecastSources, name: str, limits: Limits = LIMITS
) -> Iterator[PreparedUpload]:
    """Check a set as one of a sensor under another name that is its own as the set's diagnosis mends it, without the database."""
    mended = mend_document(document, get_diagnosis(row))
    if mended == document:
        raise ConflictError(
            f"The diagnosis of {row.name} found nothing to correct in the sensor file; use the set unchanged."
        )
    mended["name"] = name
    original, catalogue = sources.blobs.path(row.original_sha256), sources.catalogue()
    with hold_prepared(mended, catalogue, original, row.name, limits, sources.catalogue_folder) as prepared:
        yield prepared


@contextmanager
def hold_mapped(
    document: Mapping[str, Any], row: TelemetrySet, sources: ForecastSources, limits: Limits = LIMITS
) -> Iterator[PreparedUpload]:
    """Read a set as its diagnosis says that it is to be read, checked like an upload, without the database."""
    found = get_diagnosis(row)
    if found.mapping is None:
        raise ConflictError(f"{row.name} can be read as it is; correct the sensor file instead.")
    table = StoredTable(table_path(sources.blobs, row.table_sha256), row.table_sha256)
    if table.large():
        raise RefusedInputError(
            f"{row.name} is too large to be rewritten here: use `boresight diagnose --out-telemetry`."
        )
    mapped = parse_mapping(found.mapping).apply(table.read(), parse_sensor(document))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mapped.parquet"
        write_parquet(mapped, path)
        name = f"{PurePath(row.name).stem}-mended.parquet"
        catalogue = sources.catalogue()
        with hold_prepared(document, catalogue, path, name, limits, sources.catalogue_folder) as prepared:
            yield prepared


def _refuse_analysis(actor: Actor) -> None:
    """Refuse who may not upload and diagnose."""
    require_role(actor, "analyst")
    require_scope(actor, "telemetry-sets")


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
    existing = rows.find_set_with_bytes(session, sensor_id, compute_digest(path))
    if existing is not None and existing.removed_utc is None:
        return _use_again(session, actor, existing)
    with hold_prepared(sensor.document, catalogue, path, file_name) as upload:
        return store_prepared(session, actor, blobs, sensor_id, upload, purpose)


def _put_all(session: Session, blobs: BlobStore, paths: Sequence[Path]) -> list[str]:
    """Store every file, or none if the disk is full."""
    stored: list[str] = []
    try:
        for path in paths:
            stored.append(blobs.put(path))  # noqa: PERF401 - what was stored before a refusal is discarded
    except UnavailableError:
        known = dict(files.list_sizes(session, stored))
        for address in stored:
            if address not in known:
                blobs.discard(address)
        raise
    return stored


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
        if existing.removed_utc is not None:
            _bring_back(session, blobs, existing, upload)
        return _use_again(session, actor, existing)
    sources = [] if upload.source is None else [upload.source]
    original, table, *kept = _put_all(session, blobs, [upload.original, upload.table, *sources])
    source = kept[0] if kept else None
    for address in kept:
        register_blob(session, blobs, address, "application/octet-stream")
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
    _refuse_analysis(actor)
    if purpose not in PURPOSES:
        raise RefusedInputError(f"There is no purpose {purpose!r}; choose calibration or validation.")


def _use_again(session: Session, actor: Actor, row: TelemetrySet) -> TelemetrySet:
    """Restore a set if it is archived."""
    if row.archived_utc is not None:
        row.archived_utc = None
        audit.append(session, actor, "restored from the archive", _subject(row))
    return row


def _bring_back(session: Session, blobs: BlobStore, row: TelemetrySet, upload: PreparedUpload) -> None:
    """Store the files of a set again that were removed."""
    sources = [] if upload.source is None else [upload.source]
    original, table, *kept = _put_all(session, blobs, [upload.original, upload.table, *sources])
    register_blob(session, blobs, original, upload.media_type)
    register_blob(session, blobs, table, MEDIA_TYPE)
    for address in kept:
        register_blob(session, blobs, address, "application/octet-stream")
    row.table_sha256, row.source_sha256, row.removed_utc = table, next(iter(kept), None), None


def _base_name(file_name: str) -> str:
    """Return a sender's file name in its normal form, without the folders of either kind of path."""
    name = normal_name("file name", _without_folders(file_name))
    return _without_folders(name) or "telemetry"  # split again, because other characters have slashes as normal forms


def _without_folders(path: str) -> str:
    return path.replace("\\", "/").rsplit("/", 1)[-1]


def has_images(session: Session, set_id: int) -> bool:
    """Whether a set keeps the images that it was extracted from."""
    blob = session.get(Blob, session.get_known(TelemetrySet, set_id).original_sha256)
    return blob is not None and blob.media_type == ARCHIVE


def draw_image(session: Session, blobs: BlobStore, set_id: int, frame: int, limits: ImageLimits) -> bytes:
    """Return the image of a frame as PNG; refuses a set that has none, and bytes that the frame was not extracted from."""
    from boresight.images import archive  # noqa: PLC0415 - of sets that are images alone

    row = session.get_known(TelemetrySet, set_id)
    if not has_images(session, set_id):
        raise NotFoundError(f"Telemetry set {set_id} was not extracted from images; choose one that was.")
    sensor = parse_sensor(session.get_known(SensorRow, row.sensor_id).document)
    index = frame_index(table_path(blobs, row.table_sha256))
    known = find_image(index.read(index.find_place(frame)), 0)
    with tempfile.TemporaryDirectory() as folder:
        return archive.draw_image(blobs.path(row.original_sha256), sensor, frame, limits, Path(folder), known)


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
