"""Telemetry sets: upload, read, download, diagnose, archive."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from fastapi import Depends, Query
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response

from boresight.calibration.diagnosis.result import Diagnosis
from boresight.console.access.dependencies import (
    SAME_FOR_ALL,
    Blobs,
    Database,
    DryRunSources,
    Reading,
    SeenTag,
    ServerSettings,
    Who,
    Writing,
)
from boresight.console.fleet.tables import Sensor
from boresight.console.operation import RowWithFields, operations
from boresight.console.schemas import Document, Row, file_field, multipart
from boresight.console.telemetry import profiles, tables
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.telemetry.dependencies import Uploaded, hold_upload
from boresight.console.telemetry.profiles import OfferedProfile
from boresight.errors import NotFoundError
from boresight.platform.actors import require_role
from boresight.platform.db.sessions import open_reading
from boresight.platform.web.media import StoredFile
from boresight.platform.web.paging import Id, Listing, Page, Paged
from boresight.platform.web.response_cache import cover_with_tag, matches_tag
from boresight.telemetry.imports.builtin import BUILT_IN


class TelemetrySet(Row):
    """An uploaded telemetry file."""

    versioned_by = ("id", "archived_utc", "removed_utc", "diagnosed")
    location = "/telemetry-sets/{row.id}"

    id: int
    sensor_id: int
    name: str
    purpose: Literal["calibration", "validation"]
    frames: int
    stars: int
    quality: Document = Field(description="Quality of the file: counts, gaps, coverage, warnings.")
    original_sha256: str = Field(description="SHA-256 of the bytes that were uploaded.")
    table_sha256: str = Field(description="SHA-256 of the table that runs work on.")
    uploaded_utc: str
    uploaded_by: int | None
    archived_utc: str | None
    removed_utc: str | None = Field(description="When its files were removed by the retention of telemetry.")
    source_sha256: str | None = Field(
        description="SHA-256 of the file it was imported from; null for telemetry that was not imported."
    )
    import_record: Document | None = Field(
        description="How it was imported: sources, profile, what each column means, notes; for an upload also the first rows."
    )


class ImportProfile(Row):
    """A mapping profile."""

    versioned_by = ("id", "archived_utc")
    location = "/import-profiles/{row.id}"

    key: str = Field(description="The value of `profile` in an upload.")
    id: int | None = Field(description="Id of a saved version; null for built-in ones.")
    name: str
    number: int | None = Field(description="Version.")
    document: Document = Field(description="The profile; `docs/import-profile.schema.json` is its schema.")
    sha256: str = Field(description="Hash of the profile without its version.")
    created_utc: str | None
    created_by: int | None
    archived_utc: str | None


router = operations("/telemetry-sets", tags=["telemetry sets"])

FORM = multipart(
    ("sensor_id", "file"),
    sensor_id={"type": "integer", "description": "The sensor of the telemetry."},
    purpose={"type": "string", "enum": ["calibration", "validation"], "default": "calibration"},
    file=file_field(
        "CSV, JSON Lines or Parquet; or images, one file each (FITS, PNG, TIFF, raw) or packed as ZIP; with a profile, what that "
        "profile reads."
    ),
    profile={
        "type": "string",
        "description": "Mapping profile to import the file with: a built-in name, the key of a saved version, or a saved name. "
        "With `validate_only` the answer is the preview.",
    },
    time={"type": "string", "description": "When the file was taken, if it does not contain the time (ISO 8601)."},
    keep_here={
        "type": "string",
        "enum": ["1"],
        "description": "Keep the set with this sensor even though its stars match another sensor's camera.",
    },
    elements={"type": "string", "description": "Two-line elements to compute velocities from."},
)


def _prepare(
    actor: Who, upload: Uploaded, forecast_sources: DryRunSources, settings: ServerSettings, engine: Database
) -> Iterator[telemetry_sets.PreparedUpload]:
    """Read and check the file before the writing transaction, because a large one takes seconds and there is one writer."""
    require_role(actor, "analyst")
    with hold_upload(upload, settings, forecast_sources, engine) as prepared:
        yield prepared


Prepared = Annotated[telemetry_sets.PreparedUpload, Depends(_prepare, scope="function")]


@router.get("", summary="List telemetry sets", response_model=Page[TelemetrySet], dependencies=[SAME_FOR_ALL])
def list_telemetry_sets(
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    purpose: Literal["calibration", "validation"] | None = None,
    archived: Annotated[bool, Query(description="Show the archived ones too.")] = False,
) -> Listing[tables.TelemetrySet]:
    """List telemetry sets, newest first."""
    found = telemetry_sets.list_telemetry_sets(
        session, sensor_id=sensor_id, purpose=purpose, archived=archived, **page.rows
    )
    return page.cut(found)


@router.post(
    "",
    summary="Upload telemetry",
    status_code=201,
    response_model=TelemetrySet,
    openapi_extra=FORM,
)
def upload_telemetry_set(
    actor: Who, upload: Uploaded, prepared: Prepared, session: Writing, blobs: Blobs
) -> RowWithFields:
    """Store a file with its quality report. Nothing of a refused file is stored; the refusal names row and column.

    A set from another sensor's camera is refused with the number of that sensor; `keep_here` keeps it where it was sent.
    The same bytes for the same sensor give the existing set. With a mapping profile the file may come from
    another program; the answer shows its first rows next to the cells they were made from.
    """
    purpose = upload.fields.get("purpose", "calibration")
    row = telemetry_sets.store_prepared(session, actor, blobs, upload.number("sensor_id"), prepared, purpose)
    preview = row.import_record if prepared.imported is None else prepared.imported.to_preview()
    return RowWithFields(row, import_record=preview)


@router.get(
    "/{telemetry_set_id}",
    summary="Read a telemetry set",
    response_model=TelemetrySet,
    dependencies=[SAME_FOR_ALL],
)
def get_telemetry_set(telemetry_set_id: Id, session: Reading, request: Request) -> tables.TelemetrySet:
    """Read a telemetry set with its quality report."""
    cover_with_tag(request)
    return session.get_known(tables.TelemetrySet, telemetry_set_id)


@router.get("/{telemetry_set_id}/file", summary="Download the original file", response_class=StoredFile)
def get_telemetry_file(telemetry_set_id: Id, session: Reading, blobs: Blobs, request: Request) -> Response:
    """Download the bytes as they were uploaded; their address is the tag, so a copy never goes out of date."""
    row = session.get_known(tables.TelemetrySet, telemetry_set_id)
    headers = {"ETag": f'"{row.original_sha256}"'}
    if matches_tag(request.headers.get("if-none-match", "").encode(), headers["ETag"].encode()):
        return Response(status_code=304, headers=headers)
    return StoredFile(blobs.path(row.original_sha256), filename=row.name, headers=headers)


def _diagnose(telemetry_set_id: Id, actor: Who, forecast_sources: DryRunSources, engine: Database) -> Diagnosis:
    """Search before the writing transaction, because it takes seconds and there is one writer."""
    require_role(actor, "analyst")
    with open_reading(engine) as session:
        row = session.get_known(tables.TelemetrySet, telemetry_set_id)
        document = session.get_known(Sensor, row.sensor_id).document
    return telemetry_sets.diagnose_stored(document, row, forecast_sources)


Diagnosed = Annotated[Diagnosis, Depends(_diagnose, scope="function")]


@router.post("/{telemetry_set_id}:diagnose", summary="Diagnose a telemetry set", response_model=TelemetrySet)
def diagnose_telemetry_set(telemetry_set_id: Id, actor: Who, found: Diagnosed, session: Writing) -> tables.TelemetrySet:
    """Find why a set does not match its sensor file, on up to 40 exposures; the answer is `diagnosis` of its `quality`.

    `causes` are named best first, each with how many exposures match once corrected; `sensor_document` is the corrected sensor
    file and `mapping` how to read the telemetry. Only the quality report is changed.
    """
    return telemetry_sets.record_diagnosis(session, actor, telemetry_set_id, found)


@router.post("/{telemetry_set_id}:archive", summary="Archive a telemetry set", response_model=TelemetrySet)
def archive_telemetry_set(telemetry_set_id: Id, actor: Who, seen: SeenTag, session: Writing) -> tables.TelemetrySet:
    """Hide a set; nothing is deleted. Uploading the same bytes brings it back."""
    row = session.get_known(tables.TelemetrySet, telemetry_set_id)
    seen.require(TelemetrySet, row, row.name)
    return telemetry_sets.archive_telemetry_set(session, actor, telemetry_set_id)


@router.get("/{telemetry_set_id}/source", summary="Download the imported file", response_class=StoredFile)
def get_telemetry_source(telemetry_set_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Download the file that a set was imported from, as it came."""
    row = session.get_known(tables.TelemetrySet, telemetry_set_id)
    if row.source_sha256 is None or row.import_record is None:
        raise NotFoundError(f"{row.name} was uploaded as telemetry: download its file.")
    name = row.import_record["sources"][0]["name"]
    return StoredFile(blobs.path(row.source_sha256), filename=name, headers={"ETag": f'"{row.source_sha256}"'})


profile_router = operations("/import-profiles", tags=["telemetry sets"])


def _saved(row: tables.ImportProfile) -> RowWithFields:
    return RowWithFields(row, key=str(row.id))


def _own(offer: OfferedProfile) -> RowWithFields:
    document, sha256 = offer.profile.to_dict(), offer.profile.sha256
    absent = dict.fromkeys(("id", "number", "created_utc", "created_by", "archived_utc"))
    return RowWithFields(offer, name=offer.key, document=document, sha256=sha256, **absent)


@profile_router.get("", summary="List mapping profiles", response_model=Page[ImportProfile])
def list_import_profiles(session: Reading, page: Paged, archived: bool = False) -> Listing[RowWithFields]:
    """List saved versions, newest first, with the archived ones where asked; the first page begins with Boresight's own."""
    saved = page.cut(profiles.list_profiles(session, archived=archived, **page.rows), _saved)
    own = [_own(OfferedProfile(name, profile)) for name, profile in BUILT_IN.items()] if page.last_id is None else []
    return Listing([*own, *saved.items], saved.next)


@profile_router.post("", summary="Save a mapping profile", status_code=201, response_model=ImportProfile)
def save_import_profile(document: Document, actor: Who, session: Writing) -> RowWithFields:
    """Save a profile under its name; an existing name gets its next version."""
    return _saved(profiles.save_profile(session, actor, document))


@profile_router.get("/{profile_id}", summary="Read a mapping profile", response_model=ImportProfile)
def get_import_profile(profile_id: Id, session: Reading) -> RowWithFields:
    """Read a saved version, archived or not."""
    return _saved(profiles.get_profile(session, profile_id))


@profile_router.post("/{profile_id}:archive", summary="Archive a mapping profile", response_model=ImportProfile)
def archive_import_profile(profile_id: Id, actor: Who, seen: SeenTag, session: Writing) -> RowWithFields:
    """Stop offering a version; nothing is deleted."""
    seen.require(ImportProfile, profiles.get_profile(session, profile_id), f"Mapping profile {profile_id}")
    return _saved(profiles.archive_profile(session, actor, profile_id))
