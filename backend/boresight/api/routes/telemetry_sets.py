"""Telemetry sets: upload, read, download, archive."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Reading, SeenTag, Who, Writing, require_tag, tag_of
from boresight.api.keeping import Known, whole_tag
from boresight.api.media import StoredFile
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.api.ready import knows
from boresight.api.uploads import Uploaded, UploadedOnce
from boresight.services import sensors, telemetry_sets
from boresight.services.actors import require_role
from boresight.store.sessions import reading

router = APIRouter(prefix="/telemetry-sets", tags=["telemetry sets"])

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
                    "file": {"type": "string", "format": "binary", "description": "CSV, JSON Lines or Parquet."},
                },
            }
        }
    },
}


def _prepare(request: Request, actor: Who, upload: Uploaded) -> Iterator[telemetry_sets.Prepared]:
    """Read and check the file before the transaction: a large one takes seconds, and there is one writer."""
    require_role(actor, "analyst")
    state = request.app.state
    with reading(state.engine) as session:
        document = sensors.get_sensor(session, upload.number("sensor_id")).document
    limits = state.settings.telemetry_limits
    with telemetry_sets.prepared(document, state.catalogue(), upload.file(), upload.file_name, limits) as ready:
        state.blobs.send_ahead(ready.original, ready.table)
        yield ready


Ready = Annotated[telemetry_sets.Prepared, Depends(_prepare, scope="function")]


def _tagged(row: Any, status: int = 200, **headers: str) -> Answer:
    return Answer(_shown(row), status, {"ETag": _tag(row), **headers})


def _tag(row: Any) -> str:
    return tag_of(row.id, row.archived_utc)


def _shown(row: Any) -> schemas.Document:
    return schemas.written(schemas.TelemetrySet, row)


@router.get("", name="list_telemetry_sets", summary="List telemetry sets", response_model=Page[schemas.TelemetrySet])
def list_telemetry_sets(
    known: Known,  # noqa: ARG001 - asked for what it refuses
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    purpose: Literal["calibration", "validation"] | None = None,
    archived: Annotated[bool, Query(description="Show the archived ones too.")] = False,
) -> Response:
    """List telemetry sets, newest first."""
    found = telemetry_sets.list_telemetry_sets(
        session,
        sensor_id=sensor_id,
        purpose=purpose,
        archived=archived,
        before_id=page.last_id,
        limit=page.limit + 1,
    )
    return json_response(page.cut(found, _shown))


@router.post(
    "",
    name="upload_telemetry_set",
    summary="Upload telemetry",
    status_code=201,
    response_model=schemas.TelemetrySet,
    responses=refusals(404, 413),
    openapi_extra={"requestBody": FORM},
)
def upload_telemetry_set(
    actor: Who, upload: Uploaded, ready: Ready, once: UploadedOnce, session: Writing, request: Request
) -> Response:
    """Store a file with its quality report; a refused one leaves nothing behind and says row and column.

    The same bytes again for the same sensor are the set that is there already.
    """

    def act() -> Answer:
        purpose = upload.fields.get("purpose", "calibration")
        blobs, sensor_id = request.app.state.blobs, upload.number("sensor_id")
        row = telemetry_sets.store_prepared(session, actor, blobs, sensor_id, ready, purpose)
        return _tagged(row, 201, Location=f"/api/v1/telemetry-sets/{row.id}")

    return once.answer(session, actor, act)


@router.get(
    "/{telemetry_set_id}",
    name="get_telemetry_set",
    summary="Read a telemetry set",
    response_model=schemas.TelemetrySet,
    responses=refusals(404),
)
def get_telemetry_set(
    telemetry_set_id: Id,
    known: Known,  # noqa: ARG001 - asked for what it refuses
    session: Reading,
    request: Request,
) -> Response:
    """Read a telemetry set with its quality report."""
    whole_tag(request)
    return _tagged(telemetry_sets.get_telemetry_set(session, telemetry_set_id)).response()


@router.get(
    "/{telemetry_set_id}/file",
    name="get_telemetry_file",
    summary="Download the original file",
    response_class=StoredFile,
    responses=refusals(404, 409),
)
def get_telemetry_file(
    telemetry_set_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    request: Request,
) -> Response:
    """Download the bytes as they were uploaded; their address is the tag, so a copy never goes out of date."""
    row = telemetry_sets.get_telemetry_set(session, telemetry_set_id)
    headers = {"ETag": f'"{row.original_sha256}"'}
    if knows(request.headers.get("if-none-match", "").encode(), headers["ETag"].encode()):
        return Response(status_code=304, headers=headers)
    path = request.app.state.blobs.path(row.original_sha256)
    return StoredFile(path, filename=row.name, headers=headers)


@router.post(
    "/{telemetry_set_id}:archive",
    name="archive_telemetry_set",
    summary="Archive a telemetry set",
    response_model=schemas.TelemetrySet,
    responses=refusals(404, 412, 428),
)
def archive_telemetry_set(
    telemetry_set_id: Id, actor: Who, seen: SeenTag, once: Idempotent, session: Writing
) -> Response:
    """Put a set out of sight; nothing is deleted. Uploading the same bytes brings it back."""

    def act() -> Answer:
        row = telemetry_sets.get_telemetry_set(session, telemetry_set_id)
        require_tag(seen, _tag(row), row.name)
        return _tagged(telemetry_sets.archive_telemetry_set(session, actor, telemetry_set_id))

    return once.answer(session, actor, act)
