"""Alarms: acknowledging, shelving, assigning and commenting. States and words are those of ISA-18.2.

    active, unacknowledged  --acknowledge-->  active, acknowledged  --it is over-->  closed
            |                                                                          ^
            it is over --> returned to normal, unacknowledged  --acknowledge-----------+

If the condition comes back, or becomes graver, it is unacknowledged again. A shelved alarm is not counted until its time is over,
after `MOST_DAYS` at most. Every step is an event that is never edited, and an audit record.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.console import list_queries as lists
from boresight.console.access.tables import User
from boresight.console.alarms import queries
from boresight.console.alarms.tables import ALARM_ACTIONS, Alarm, AlarmEvent
from boresight.console.transitions import name_subject, require_seen
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_person, require_role
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, utc_after, utc_now
from boresight.platform.db.times import read_time
from boresight.platform.web.text_validation import refuse_control_characters

STATES = ("unacknowledged", "acknowledged", "shelved", "closed")
HANDLERS = ("analyst", "operator", "approver", "administrator")
MOST_DAYS = 30.0
LONGEST_TEXT = 2000
DAY_S = 86400.0


@dataclass(frozen=True)
class AlarmFilter:
    """What a list of alarms is narrowed to; None is everything, and closed ones are left out unless asked for."""

    sensor_id: int | None = None
    kind: str | None = None
    state: str | None = None
    sensor_name: str = ""


def close_if_over(session: Session, actor: Actor, row: Alarm) -> None:
    """Close an alarm that is over and was acknowledged."""
    if not row.active and row.acknowledged:
        row.closed_utc = utc_now()
        record_step(session, actor, row, "CLOSED", "It has returned to normal and was acknowledged.")


def record_step(session: Session, actor: Actor, row: Alarm, event: str, text: str, **told: Any) -> None:
    """Record a step of an alarm: increase its version, add an event and an audit record."""
    row.version += 1
    name = actor.printed_name
    session.add(
        AlarmEvent(alarm_id=row.id, event=event, user_id=actor.user_id, printed_name=name, text=text, at_utc=utc_now())
    )
    session.flush()
    after = {
        "event": event, "state": get_alarm_state(row), "version": row.version, "kind": row.kind, "level": row.level, **told
    }  # fmt: skip
    audit.append(session, actor, ALARM_ACTIONS[event], name_subject(row), None, after, text or None)


def get_alarm_state(row: Alarm) -> str:
    """Say an alarm's state in the words of ISA-18.2."""
    if row.closed_utc is not None:
        return "closed"
    condition = "active" if row.active else "returned to normal"
    seen = "acknowledged" if row.acknowledged else "unacknowledged"
    shelved = f", shelved until {row.shelved_until_utc}" if is_shelved(row) else ""
    return f"{seen}, {condition}{shelved}"


def is_shelved(row: Alarm) -> bool:
    """Whether an alarm is on the shelf now."""
    return row.shelved_until_utc is not None and row.shelved_until_utc > utc_now()


def acknowledge(session: Session, actor: Actor, alarm_id: int, text: str, seen_version: int | None) -> Alarm:
    """Acknowledge an alarm; one that has returned to normal is closed by it."""
    row = _take_to_handle(session, actor, alarm_id, seen_version, "acknowledge an alarm")
    if row.acknowledged:
        raise ConflictError(f"Alarm {row.id} is acknowledged already; comment on it, or shelve it.")
    row.acknowledged = 1
    record_step(session, actor, row, "ACKNOWLEDGED", _check_text(text))
    close_if_over(session, actor, row)
    return row


def shelve(session: Session, actor: Actor, alarm_id: int, until: str, reason: str, seen_version: int | None) -> Alarm:
    """Shelve an alarm until a time, or until another one; it is not counted meanwhile."""
    row = _take_to_handle(session, actor, alarm_id, seen_version, "shelve an alarm")
    until_utc = read_time(until)
    if not utc_now() < until_utc <= utc_after(MOST_DAYS * DAY_S):
        raise RefusedInputError(
            f"An alarm can only be shelved until a future time; give one at most {MOST_DAYS:.0f} days from now.",
            code="not-a-future-time",
        )
    row.shelved_until_utc = until_utc
    record_step(session, actor, row, "SHELVED", _check_text(reason, needed="reason for shelving"), until_utc=until_utc)
    return row


def unshelve(session: Session, actor: Actor, alarm_id: int, seen_version: int | None) -> Alarm:
    """Take an alarm from the shelf before its time."""
    row = _take_to_handle(session, actor, alarm_id, seen_version, "unshelve an alarm")
    if not is_shelved(row):
        raise ConflictError(f"Alarm {row.id} is not shelved; there is nothing to unshelve.")
    row.shelved_until_utc = None
    record_step(session, actor, row, "UNSHELVED", "")
    return row


def assign(session: Session, actor: Actor, alarm_id: int, user_id: int | None, seen_version: int | None) -> Alarm:
    """Assign an alarm to a person; None removes the assignee."""
    row = _take_to_handle(session, actor, alarm_id, seen_version, "assign an alarm")
    person = None if user_id is None else session.get(User, user_id)
    if user_id is not None and (person is None or person.disabled_utc is not None):
        raise NotFoundError(f"There is no user {user_id} who could handle it; choose a person from the list.")
    row.assigned_to = None if person is None else person.id
    record_step(session, actor, row, "ASSIGNED", "to nobody" if person is None else f"to {person.printed_name}")
    return row


def comment(session: Session, actor: Actor, alarm_id: int, text: str, seen_version: int | None) -> Alarm:
    """Add a comment to an alarm."""
    row = _take_to_handle(session, actor, alarm_id, seen_version, "comment on an alarm")
    record_step(session, actor, row, "COMMENTED", _check_text(text, needed="comment"))
    return row


def may_handle(actor: Actor, row: Alarm) -> bool:
    """Whether an actor may act on an alarm now."""
    return row.closed_utc is None and bool(actor.roles.intersection(HANDLERS))


def _take_to_handle(session: Session, actor: Actor, alarm_id: int, seen_version: int | None, what: str) -> Alarm:
    require_person(actor, what)
    require_role(actor, *HANDLERS)
    row = session.get_known(Alarm, alarm_id)
    require_seen(session, row, seen_version)
    if not may_handle(actor, row):
        raise ConflictError(f"Alarm {row.id} was closed at {row.closed_utc}; write a note on its sensor instead.")
    return row


def _check_text(text: str, needed: str = "") -> str:
    refuse_control_characters(comment=text)
    if (needed and not text.strip()) or len(text) > LONGEST_TEXT:
        raise RefusedInputError(
            f"The {needed or 'comment'} must be {int(bool(needed))} to {LONGEST_TEXT} characters long; correct its length."
        )
    return text.strip()


def list_alarms(
    session: Session, sought: AlarmFilter | None = None, *, before_id: int | None = None, limit: int | None = None
) -> Sequence[Alarm]:
    """Return a page of alarms, newest first; closed ones only when asked for."""
    sought = sought or AlarmFilter()
    if sought.state is not None and sought.state not in STATES:
        raise RefusedInputError(f"There is no alarm state {sought.state!r}; choose from {', '.join(STATES)}.")
    return lists.list_newest(
        session,
        Alarm,
        before_id=before_id,
        limit=limit,
        state=sought.state or "open",
        sensor=sought.sensor_id,
        kind=sought.kind,
        sensor_name=sought.sensor_name or None,
    )


def list_newest_open_of_sensors(session: Session, kind: str, sensor_ids: Collection[int]) -> dict[int, Alarm]:
    """Return the newest alarm of a kind that is not closed of each of some sensors that has any, by sensor."""
    return {
        row.sensor_id: row
        for row in queries.list_open_of_sensors(session, kind, sensor_ids)
        if row.sensor_id is not None
    }


def list_alarm_events(session: Session, alarm_id: int) -> Sequence[AlarmEvent]:
    """Return the events of an alarm, in order."""
    return queries.list_events(session, session.get_known(Alarm, alarm_id).id)


def count_unacknowledged(session: Session) -> int:
    """Return the number of unacknowledged alarms, without shelved ones."""
    return queries.count_unacknowledged(session)
