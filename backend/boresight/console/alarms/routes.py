"""Alarms: read them, acknowledge, shelve, assign, comment. Only people handle alarms."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Query
from pydantic import Field

from boresight.console.access.dependencies import Reading, SeenVersion, Who, Writing
from boresight.console.alarms import service as alarms
from boresight.console.alarms import tables
from boresight.console.operation import RowWithFields, operations
from boresight.console.schemas import Document, Row, Shape
from boresight.platform.web.paging import Id, Listing, Page, Paged


class Alarm(Row):
    """A condition that needs a person, until it is acknowledged and over."""

    versioned_by = ("version",)

    id: int
    source: str = Field(
        description="What it is about; only one alarm per source is open at a time.", examples=["sensors/3/DRIFT"]
    )
    sensor_id: int | None
    kind: Literal["DRIFT", "AGE", "MISMATCH", "CHAIN", "FILES", "HEAD", "CLOCK", "INGEST", "LINK"]
    level: Literal["critical", "serious", "caution"]
    sentence: str
    state: str = Field(
        "", description="ISA-18.2: unacknowledged or acknowledged, active or returned to normal, shelved."
    )
    active: bool
    acknowledged: bool
    evidence: Document = Field(description="The evidence behind the sentence.")
    raised_utc: str
    returned_utc: str | None
    shelved_until_utc: str | None
    assigned_to: int | None
    version: int = Field(description='Counts its changes; the ETag is `"v<version>"`.')
    closed_utc: str | None


class AlarmEvent(Row):
    """A step in an alarm's life; never edited."""

    id: int
    alarm_id: int
    event: str
    user_id: int | None
    printed_name: str
    text: str
    at_utc: str


router = operations("/alarms", tags=["alarms"])


class Comment(Shape):
    """A comment on an alarm."""

    text: str = Field("", examples=["Seen; a pass for calibration is requested."])


class Shelf(Shape):
    """Until when an alarm is shelved, and why."""

    until_utc: str = Field(examples=["2026-12-01T08:00:00Z"], description="30 days from now at most.")
    reason: str


class Assignee(Shape):
    """The person whom an alarm is assigned to."""

    user_id: Id | None = Field(description="Null: nobody.")


def make_row(row: tables.Alarm) -> RowWithFields:
    """Return an alarm with its state."""
    return RowWithFields(row, state=alarms.get_alarm_state(row))


@router.get("", summary="List alarms", response_model=Page[Alarm])
def list_alarms(
    session: Reading,
    page: Paged,
    state: Annotated[str | None, Query(description=f"One of {', '.join(alarms.STATES)}; open ones if omitted.")] = None,
    sensor_id: Id | None = None,
    kind: Annotated[str | None, Query(examples=["DRIFT"])] = None,
) -> Listing[tables.Alarm]:
    """List the alarms that are open, newest first, or those of a state."""
    sought = alarms.AlarmFilter(sensor_id=sensor_id, kind=kind, state=state)
    return page.cut(alarms.list_alarms(session, sought, **page.rows), make_row)


@router.get("/{alarm_id}", summary="Read an alarm", response_model=Alarm)
def get_alarm(alarm_id: Id, session: Reading) -> RowWithFields:
    """Read an alarm with its evidence; the ETag is needed to handle it."""
    return make_row(session.get_known(tables.Alarm, alarm_id))


@router.get("/{alarm_id}/events", summary="Read its steps", response_model=Page[AlarmEvent])
def list_alarm_events(alarm_id: Id, session: Reading) -> Listing[tables.AlarmEvent]:
    """Read every step of an alarm, in order."""
    return Listing(alarms.list_alarm_events(session, alarm_id))


@router.post("/{alarm_id}:acknowledge", summary="Acknowledge an alarm", response_model=Alarm)
def acknowledge_alarm(alarm_id: Id, comment: Comment, actor: Who, seen: SeenVersion, session: Writing) -> RowWithFields:
    """Acknowledge an alarm; if it has returned to normal, this closes it."""
    return make_row(alarms.acknowledge(session, actor, alarm_id, comment.text, seen))


@router.post("/{alarm_id}:shelve", summary="Shelve an alarm", response_model=Alarm)
def shelve_alarm(alarm_id: Id, shelf: Shelf, actor: Who, seen: SeenVersion, session: Writing) -> RowWithFields:
    """Shelve an alarm until a time, with the reason; it is not counted meanwhile."""
    return make_row(alarms.shelve(session, actor, alarm_id, shelf.until_utc, shelf.reason, seen))


@router.post("/{alarm_id}:unshelve", summary="Unshelve an alarm", response_model=Alarm)
def unshelve_alarm(alarm_id: Id, actor: Who, seen: SeenVersion, session: Writing) -> RowWithFields:
    """Unshelve an alarm before its time."""
    return make_row(alarms.unshelve(session, actor, alarm_id, seen))


@router.post("/{alarm_id}:assign", summary="Assign an alarm", response_model=Alarm)
def assign_alarm(alarm_id: Id, assignee: Assignee, actor: Who, seen: SeenVersion, session: Writing) -> RowWithFields:
    """Assign an alarm to a person, or remove its assignee."""
    return make_row(alarms.assign(session, actor, alarm_id, assignee.user_id, seen))


@router.post("/{alarm_id}:comment", summary="Comment on an alarm", response_model=Alarm)
def comment_on_alarm(alarm_id: Id, comment: Comment, actor: Who, seen: SeenVersion, session: Writing) -> RowWithFields:
    """Add a comment to an open alarm; comments cannot be edited."""
    return make_row(alarms.comment(session, actor, alarm_id, comment.text, seen))
