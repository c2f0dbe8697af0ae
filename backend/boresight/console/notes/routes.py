"""Notes on runs, sensors and parameter sets: read them, add one. Nothing edits a note."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator
from typing import Annotated, Literal

from fastapi import Depends
from fastapi.concurrency import contextmanager_in_threadpool
from pydantic import Field
from starlette.datastructures import UploadFile
from starlette.requests import Request

from boresight.console.access.dependencies import Blobs, Database, IsDryRun, Reading, Who, Writing
from boresight.console.notes import attachments, tables
from boresight.console.notes import service as notes
from boresight.console.operation import FORM_CONTENT, operations
from boresight.console.schemas import Row, Shape, file_field, multipart
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.blobs import files
from boresight.platform.web.media import StoredFile
from boresight.platform.web.paging import Id, Listing, Page


class NoteAttachment(Row):
    """A file that the author of a note added to it."""

    id: int
    note_id: int
    name: str
    sha256: str
    size_bytes: int
    made_utc: str


class Note(Row):
    """What a person wrote down about a run, a sensor or a parameter set; never edited."""

    id: int
    subject_kind: Literal["runs", "sensors", "parameter-sets"]
    subject_id: int
    user_id: int
    printed_name: str
    text: str
    made_utc: str
    attachments: list[NoteAttachment]


class Annotation(Row):
    """What a person says of a time of a sensor's mission, drawn on its trend; never edited."""

    id: int
    sensor_id: int
    at_utc: str
    user_id: int
    printed_name: str
    text: str
    made_utc: str


router = operations(tags=["notes"])


class NewNote(Shape):
    """The text of a note."""

    text: str = Field(examples=["Taken through the South Atlantic Anomaly; expect more spurious centroids."])


@router.get("/runs/{run_id}/notes", summary="Read the notes on a run", response_model=Page[Note])
def list_run_notes(run_id: Id, session: Reading) -> Listing[tables.Note]:
    """Read the notes on a run, in order."""
    return Listing(notes.list_notes(session, "runs", run_id))


@router.post("/runs/{run_id}/notes", summary="Write a note on a run", status_code=201, response_model=Note)
def add_run_note(run_id: Id, new: NewNote, actor: Who, session: Writing) -> tables.Note:
    """Add a note to a run; notes cannot be edited."""
    return notes.add_note(session, actor, "runs", run_id, new.text)


@router.get("/sensors/{sensor_id}/notes", summary="Read the notes on a sensor", response_model=Page[Note])
def list_sensor_notes(sensor_id: Id, session: Reading) -> Listing[tables.Note]:
    """Read the notes on a sensor, in order."""
    return Listing(notes.list_notes(session, "sensors", sensor_id))


@router.post("/sensors/{sensor_id}/notes", summary="Write a note on a sensor", status_code=201, response_model=Note)
def add_sensor_note(sensor_id: Id, new: NewNote, actor: Who, session: Writing) -> tables.Note:
    """Add a note to a sensor; notes cannot be edited."""
    return notes.add_note(session, actor, "sensors", sensor_id, new.text)


class NewAnnotation(Shape):
    """A time of the mission and what is said of it."""

    at_utc: str = Field(examples=["2026-11-21T03:04:05Z"])
    text: str = Field(examples=["Safe mode; heaters off for six hours."])


@router.get(
    "/sensors/{sensor_id}/annotations",
    summary="Read the annotations of a trend",
    response_model=Page[Annotation],
)
def list_annotations(sensor_id: Id, session: Reading) -> Listing[tables.Annotation]:
    """Read what is said of times of a sensor's mission, by these times."""
    return Listing(notes.list_annotations(session, sensor_id))


@router.post(
    "/sensors/{sensor_id}/annotations",
    summary="Annotate a trend",
    status_code=201,
    response_model=Annotation,
)
def annotate(sensor_id: Id, new: NewAnnotation, actor: Who, session: Writing) -> tables.Annotation:
    """Say something of a time of a sensor's mission; it is drawn on the trend and never edited."""
    return notes.annotate(session, actor, sensor_id, new.at_utc, new.text)


@router.get(
    "/parameter-sets/{parameter_set_id}/notes",
    summary="Read the notes on a parameter set",
    response_model=Page[Note],
)
def list_parameter_set_notes(parameter_set_id: Id, session: Reading) -> Listing[tables.Note]:
    """Read the notes on a parameter set, in order."""
    return Listing(notes.list_notes(session, "parameter-sets", parameter_set_id))


@router.post(
    "/parameter-sets/{parameter_set_id}/notes",
    summary="Write a note on a parameter set",
    status_code=201,
    response_model=Note,
)
def add_parameter_set_note(parameter_set_id: Id, new: NewNote, actor: Who, session: Writing) -> tables.Note:
    """Add a note to a parameter set; notes cannot be edited."""
    return notes.add_note(session, actor, "parameter-sets", parameter_set_id, new.text)


FORM = multipart(("file",), file=file_field("At most 5 MB."))


async def read_file(request: Request) -> attachments.AttachedFile:
    """Read the one file of the form."""
    async with request.form(max_files=1, max_fields=1) as form:
        file = form.get("file")
        if not isinstance(file, UploadFile):
            raise RefusedInputError("There is no file in the request; send multipart/form-data with the field file.")
        came = attachments.check_file(file.filename or "", await file.read())
    digest = f"{came.name}\n{hashlib.sha256(came.content).hexdigest()}".encode()
    setattr(request.state, FORM_CONTENT, lambda: digest)
    return came


async def stored_file(
    actor: Who,
    came: Annotated[attachments.AttachedFile, Depends(read_file)],
    engine: Database,
    blobs: Blobs,
    is_dry_run: IsDryRun,
) -> AsyncIterator[attachments.AttachedFile]:
    """Store the file before the transaction begins."""
    attachments.require_attacher(actor)
    contents = () if is_dry_run else (came.content,)
    async with contextmanager_in_threadpool(files.stored_ahead(engine, blobs, *contents)):
        yield came


@router.post(
    "/notes/{note_id}/attachments",
    summary="Attach a file to a note",
    status_code=201,
    response_model=NoteAttachment,
    openapi_extra=FORM,
)
def attach(
    note_id: Id,
    actor: Who,
    came: Annotated[attachments.AttachedFile, Depends(stored_file, scope="function")],
    session: Writing,
    blobs: Blobs,
) -> tables.NoteAttachment:
    """Add a file to a note of your own; it is never removed."""
    return attachments.attach(session, actor, blobs, note_id, came)


@router.get("/notes/{note_id}/attachments/{attachment_id}", summary="Download an attachment", response_class=StoredFile)
def get_attachment(note_id: Id, attachment_id: Id, session: Reading, blobs: Blobs) -> StoredFile:
    """Download the bytes as they were attached, checked against their SHA-256."""
    session.get_known(tables.Note, note_id)
    row = session.get_known(tables.NoteAttachment, attachment_id)
    if row.note_id != note_id:
        raise NotFoundError(f"The note {note_id} has no attachment {attachment_id}; choose one of the list.")
    return StoredFile(blobs.path(row.sha256), filename=row.name, headers={"ETag": f'"{row.sha256}"'})
