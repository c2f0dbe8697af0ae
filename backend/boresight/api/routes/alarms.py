"""Alarms: read them, acknowledge, shelve, assign, comment. Only people handle alarms."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Reading, SeenVersion, Who, Writing, etag
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import alarms
from boresight.store.tables import Alarm

router = APIRouter(prefix="/alarms", tags=["alarms"])

TRANSITION = refusals(404, 409, 412, 428)


class Comment(BaseModel):
    """What is said with it."""

    model_config = ConfigDict(extra="forbid")
    text: str = Field("", examples=["Seen; a pass for calibration is asked for."])


class Shelf(BaseModel):
    """Until when an alarm may wait, and why."""

    model_config = ConfigDict(extra="forbid")
    until_utc: str = Field(examples=["2026-12-01T08:00:00Z"], description="30 days from now at most.")
    reason: str


class Assignee(BaseModel):
    """Who is asked to take care of it."""

    model_config = ConfigDict(extra="forbid")
    user_id: Id | None = Field(description="Null: nobody in particular.")


def _shown(row: Alarm) -> schemas.Document:
    return {**schemas.written(schemas.Alarm, row), "state": alarms.state_of(row)}


def _answer(row: Alarm) -> Answer:
    return Answer(_shown(row), headers={"ETag": etag(row.version)})


@router.get("", name="list_alarms", summary="List alarms", response_model=Page[schemas.Alarm])
def list_alarms(
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
    state: Annotated[
        str | None, Query(description=f"One of {', '.join(alarms.STATES)}; open ones when left out.")
    ] = None,
    sensor_id: Id | None = None,
    kind: Annotated[str | None, Query(examples=["DRIFT"])] = None,
) -> Response:
    """List the alarms that are open, newest first, or those of a state."""
    sought = alarms.Sought(sensor_id=sensor_id, kind=kind, state=state)
    found = alarms.list_alarms(session, sought, before_id=page.last_id, limit=page.limit + 1)
    return json_response(page.cut(found, _shown))


@router.get(
    "/{alarm_id}", name="get_alarm", summary="Read an alarm", response_model=schemas.Alarm, responses=refusals(404)
)
def get_alarm(alarm_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read an alarm with the figures behind it; the ETag is for handling it."""
    return _answer(alarms.get_alarm(session, alarm_id)).response()


@router.get(
    "/{alarm_id}/events",
    name="list_alarm_events",
    summary="Read what became of it",
    response_model=Page[schemas.AlarmEvent],
    responses=refusals(404),
)
def list_alarm_events(alarm_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read every step of an alarm, in order."""
    items = [schemas.written(schemas.AlarmEvent, row) for row in alarms.events_of(session, alarm_id)]
    return json_response({"items": items, "next": None})


@router.post(
    "/{alarm_id}:acknowledge",
    name="acknowledge_alarm",
    summary="Say that you have seen it",
    response_model=schemas.Alarm,
    responses=TRANSITION,
)
def acknowledge_alarm(
    alarm_id: Id, comment: Comment, actor: Who, seen: SeenVersion, once: Idempotent, session: Writing
) -> Response:
    """Acknowledge an alarm; one that has returned to normal is closed by it."""
    return once.answer(
        session, actor, lambda: _answer(alarms.acknowledge(session, actor, alarm_id, comment.text, seen))
    )


@router.post(
    "/{alarm_id}:shelve",
    name="shelve_alarm",
    summary="Let it wait until a time",
    response_model=schemas.Alarm,
    responses=TRANSITION,
)
def shelve_alarm(
    alarm_id: Id, shelf: Shelf, actor: Who, seen: SeenVersion, once: Idempotent, session: Writing
) -> Response:
    """Take an alarm out of the count until a time, with the reason."""
    return once.answer(
        session,
        actor,
        lambda: _answer(alarms.shelve(session, actor, alarm_id, shelf.until_utc, shelf.reason, seen)),
    )


@router.post(
    "/{alarm_id}:unshelve",
    name="unshelve_alarm",
    summary="Take it from the shelf",
    response_model=schemas.Alarm,
    responses=TRANSITION,
)
def unshelve_alarm(alarm_id: Id, actor: Who, seen: SeenVersion, once: Idempotent, session: Writing) -> Response:
    """Take an alarm from the shelf before its time."""
    return once.answer(session, actor, lambda: _answer(alarms.unshelve(session, actor, alarm_id, seen)))


@router.post(
    "/{alarm_id}:assign",
    name="assign_alarm",
    summary="Ask a person to take care of it",
    response_model=schemas.Alarm,
    responses=TRANSITION,
)
def assign_alarm(
    alarm_id: Id, assignee: Assignee, actor: Who, seen: SeenVersion, once: Idempotent, session: Writing
) -> Response:
    """Assign an alarm to a person, or to nobody in particular again."""
    return once.answer(session, actor, lambda: _answer(alarms.assign(session, actor, alarm_id, assignee.user_id, seen)))


@router.post(
    "/{alarm_id}:comment",
    name="comment_on_alarm",
    summary="Say something about it",
    response_model=schemas.Alarm,
    responses=TRANSITION,
)
def comment_on_alarm(
    alarm_id: Id, comment: Comment, actor: Who, seen: SeenVersion, once: Idempotent, session: Writing
) -> Response:
    """Add a comment to an open alarm; it is never edited."""
    return once.answer(session, actor, lambda: _answer(alarms.comment(session, actor, alarm_id, comment.text, seen)))
