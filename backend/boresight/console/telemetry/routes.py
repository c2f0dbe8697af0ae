"""Telemetry sets: upload, read, download, diagnose, archive."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from fastapi import Depends, Query
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
from boresight.console.operation import operations
from boresight.console.telemetry import schemas
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.telemetry.dependencies import Uploaded
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.actors import require_role
from boresight.platform.db.sessions import open_reading
from boresight.platform.web.media import StoredFile
from boresight.platform.web.paging import Id, Listing, Page, Paged
from boresight.platform.web.response_cache import cover_with_tag, matches_tag

router = operations("/telemetry-sets", tags=["telemetry sets"])

FORM = {
    "required": True,
    "content": {
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["sensor_id", "file"],
                "properties": {
                    "sensor_id": {"type": "integer", "description": "Whose telemetry it is."},
                    "purpose": {"type": "string", "enum": ["calibration", "validation"], "default": "calibration"},
                    "file": {
                        "type": "string",
                        "format": "binary",
                        "description": "CSV, JSON Lines or Parquet; or images, one file each (FITS, PNG, TIFF, raw) "
                        "or packed as ZIP.",
                    },
                },
            }
        }
    },
}


def _prepare(
    actor: Who, upload: Uploaded, forecast_sources: DryRunSources, settings: ServerSettings, engine: Database
) -> Iterator[telemetry_sets.PreparedUpload]:
    """Read and check the file before the writing transaction, because a large one takes seconds and there is one writer."""
    require_role(actor, "analyst")
    with open_reading(engine) as session:
        document = session.get_known(Sensor, upload.number("sensor_id")).document
    limits = settings.telemetry_limits
    images = telemetry_sets.ImageUpload(upload.images, settings.image_limits, settings.image_seconds)
    with telemetry_sets.hold_prepared(
        document,
        forecast_sources.catalogue(),
        upload.file(),
        upload.file_name,
        limits,
        forecast_sources.catalogue_folder,
        images,
    ) as prepared:
        forecast_sources.blobs.send_ahead(prepared.original, prepared.table)
        yield prepared


Prepared = Annotated[telemetry_sets.PreparedUpload, Depends(_prepare, scope="function")]


@router.get("", summary="List telemetry sets", response_model=Page[schemas.TelemetrySet], dependencies=[SAME_FOR_ALL])
def list_telemetry_sets(
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    purpose: Literal["calibration", "validation"] | None = None,
    archived: Annotated[bool, Query(description="Show the archived ones too.")] = False,
) -> Listing[TelemetrySet]:
    """List telemetry sets, newest first."""
    found = telemetry_sets.list_telemetry_sets(
        session, sensor_id=sensor_id, purpose=purpose, archived=archived, **page.rows
    )
    return page.cut(found)


@router.post(
    "",
    summary="Upload telemetry",
    status_code=201,
    response_model=schemas.TelemetrySet,
    openapi_extra={"requestBody": FORM},
)
def upload_telemetry_set(
    actor: Who, upload: Uploaded, prepared: Prepared, session: Writing, blobs: Blobs
) -> TelemetrySet:
    """Store a file with its quality report; a refused one leaves nothing behind and says row and column.

    The same bytes again for the same sensor are the set that is there already.
    """
    purpose = upload.fields.get("purpose", "calibration")
    return telemetry_sets.store_prepared(session, actor, blobs, upload.number("sensor_id"), prepared, purpose)


@router.get(
    "/{telemetry_set_id}",
    summary="Read a telemetry set",
    response_model=schemas.TelemetrySet,
    dependencies=[SAME_FOR_ALL],
)
def get_telemetry_set(telemetry_set_id: Id, session: Reading, request: Request) -> TelemetrySet:
    """Read a telemetry set with its quality report."""
    cover_with_tag(request)
    return session.get_known(TelemetrySet, telemetry_set_id)


@router.get("/{telemetry_set_id}/file", summary="Download the original file", response_class=StoredFile)
def get_telemetry_file(telemetry_set_id: Id, session: Reading, blobs: Blobs, request: Request) -> Response:
    """Download the bytes as they were uploaded; their address is the tag, so a copy never goes out of date."""
    row = session.get_known(TelemetrySet, telemetry_set_id)
    headers = {"ETag": f'"{row.original_sha256}"'}
    if matches_tag(request.headers.get("if-none-match", "").encode(), headers["ETag"].encode()):
        return Response(status_code=304, headers=headers)
    return StoredFile(blobs.path(row.original_sha256), filename=row.name, headers=headers)


def _diagnose(telemetry_set_id: Id, actor: Who, forecast_sources: DryRunSources, engine: Database) -> Diagnosis:
    """Search before the writing transaction, because it takes seconds and there is one writer."""
    require_role(actor, "analyst")
    with open_reading(engine) as session:
        row = session.get_known(TelemetrySet, telemetry_set_id)
        document = session.get_known(Sensor, row.sensor_id).document
    return telemetry_sets.diagnose_stored(document, row, forecast_sources)


Diagnosed = Annotated[Diagnosis, Depends(_diagnose, scope="function")]


@router.post("/{telemetry_set_id}:diagnose", summary="Diagnose a telemetry set", response_model=schemas.TelemetrySet)
def diagnose_telemetry_set(telemetry_set_id: Id, actor: Who, found: Diagnosed, session: Writing) -> TelemetrySet:
    """Find why a set does not match its sensor file, on up to 40 exposures; the answer is `diagnosis` of its `quality`.

    `causes` are named best first, each with how many exposures match once it is mended; `sensor_document` is the mended sensor
    file and `mapping` how the telemetry is to be read. Nothing but the quality report is changed.
    """
    return telemetry_sets.record_diagnosis(session, actor, telemetry_set_id, found)


@router.post("/{telemetry_set_id}:archive", summary="Archive a telemetry set", response_model=schemas.TelemetrySet)
def archive_telemetry_set(telemetry_set_id: Id, actor: Who, seen: SeenTag, session: Writing) -> TelemetrySet:
    """Put a set out of sight; nothing is deleted. Uploading the same bytes brings it back."""
    row = session.get_known(TelemetrySet, telemetry_set_id)
    seen.require(schemas.TelemetrySet, row, row.name)
    return telemetry_sets.archive_telemetry_set(session, actor, telemetry_set_id)
