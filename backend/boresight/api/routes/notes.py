"""Notes on runs, sensors and parameter sets: read them, add one. Nothing edits a note."""

from __future__ import annotations

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Reading, Who, Writing
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page
from boresight.services import notes
from boresight.services.actors import Actor
from boresight.store.sessions import Session

router = APIRouter(tags=["notes"])


class NewNote(BaseModel):
    """What is to be kept."""

    model_config = ConfigDict(extra="forbid")
    text: str = Field(examples=["Taken through the South Atlantic Anomaly; expect more spurious centroids."])


def _listed(session: Session, actor: Actor, kind: str, subject_id: int) -> Response:
    items = [schemas.written(schemas.Note, row) for row in notes.list_notes(session, actor, kind, subject_id)]
    return json_response({"items": items, "next": None})


def _added(session: Session, actor: Actor, once: Idempotent, kind: str, subject_id: int, new: NewNote) -> Response:
    def act() -> Answer:
        return Answer(schemas.written(schemas.Note, notes.add_note(session, actor, kind, subject_id, new.text)), 201)

    return once.answer(session, actor, act)


@router.get(
    "/runs/{run_id}/notes",
    name="list_run_notes",
    summary="Read the notes on a run",
    response_model=Page[schemas.Note],
    responses=refusals(404),
)
def list_run_notes(run_id: Id, actor: Who, session: Reading) -> Response:
    """Read the notes on a run, in order."""
    return _listed(session, actor, "runs", run_id)


@router.post(
    "/runs/{run_id}/notes",
    name="add_run_note",
    summary="Write a note on a run",
    status_code=201,
    response_model=schemas.Note,
    responses=refusals(404),
)
def add_run_note(run_id: Id, new: NewNote, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Add a note to a run; it is never edited."""
    return _added(session, actor, once, "runs", run_id, new)


@router.get(
    "/sensors/{sensor_id}/notes",
    name="list_sensor_notes",
    summary="Read the notes on a sensor",
    response_model=Page[schemas.Note],
    responses=refusals(404),
)
def list_sensor_notes(sensor_id: Id, actor: Who, session: Reading) -> Response:
    """Read the notes on a sensor, in order."""
    return _listed(session, actor, "sensors", sensor_id)


@router.post(
    "/sensors/{sensor_id}/notes",
    name="add_sensor_note",
    summary="Write a note on a sensor",
    status_code=201,
    response_model=schemas.Note,
    responses=refusals(404),
)
def add_sensor_note(sensor_id: Id, new: NewNote, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Add a note to a sensor; it is never edited."""
    return _added(session, actor, once, "sensors", sensor_id, new)


@router.get(
    "/parameter-sets/{parameter_set_id}/notes",
    name="list_parameter_set_notes",
    summary="Read the notes on a parameter set",
    response_model=Page[schemas.Note],
    responses=refusals(404),
)
def list_parameter_set_notes(parameter_set_id: Id, actor: Who, session: Reading) -> Response:
    """Read the notes on a parameter set, in order."""
    return _listed(session, actor, "parameter-sets", parameter_set_id)


@router.post(
    "/parameter-sets/{parameter_set_id}/notes",
    name="add_parameter_set_note",
    summary="Write a note on a parameter set",
    status_code=201,
    response_model=schemas.Note,
    responses=refusals(404),
)
def add_parameter_set_note(
    parameter_set_id: Id, new: NewNote, actor: Who, once: Idempotent, session: Writing
) -> Response:
    """Add a note to a parameter set; it is never edited."""
    return _added(session, actor, once, "parameter-sets", parameter_set_id, new)
