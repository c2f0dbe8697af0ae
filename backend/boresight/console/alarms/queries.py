"""Queries on alarms and their events."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import sqlalchemy as sa

from boresight.console.alarms.tables import Alarm, AlarmEvent
from boresight.platform.db.documents import among
from boresight.platform.db.sessions import Session, utc_now


def _is_shelved() -> sa.ColumnElement[bool]:
    now = sa.bindparam(None, callable_=utc_now, type_=sa.Text)  # read when the query is sent: a list keeps its keys
    return sa.and_(Alarm.shelved_until_utc.is_not(None), Alarm.shelved_until_utc > now)


def needs_nobody() -> sa.ColumnElement[int]:
    """Return the expression that sorts alarms: 0 for one that waits for somebody, 1 for one acknowledged or shelved."""
    return sa.case((sa.or_(Alarm.acknowledged == 1, _is_shelved()), 1), else_=0)


def in_state(state: str) -> sa.ColumnElement[bool]:
    """Return the SQL condition for a state of alarms; `open` is every state except `closed`."""
    is_open, rests = Alarm.closed_utc.is_(None), sa.not_(_is_shelved())
    return {
        "open": is_open,
        "unacknowledged": sa.and_(is_open, Alarm.acknowledged == 0, rests),
        "acknowledged": sa.and_(is_open, Alarm.acknowledged == 1, rests),
        "shelved": sa.and_(is_open, _is_shelved()),
        "closed": Alarm.closed_utc.is_not(None),
    }[state]


def list_open_alarms(session: Session) -> dict[str, Alarm]:
    """Return the alarms that are not closed, by source."""
    return {row.source: row for row in session.scalars(sa.select(Alarm).where(Alarm.closed_utc.is_(None)))}


def list_open_of_sensors(session: Session, kind: str, sensor_ids: Collection[int]) -> Sequence[Alarm]:
    """Return the alarms of a kind about some sensors that are not closed, oldest first."""
    query = sa.select(Alarm).where(Alarm.closed_utc.is_(None), Alarm.kind == kind, among(Alarm.sensor_id, sensor_ids))
    return session.scalars(query.order_by(Alarm.id)).all()


def count_unacknowledged(session: Session) -> int:
    """Count the unacknowledged alarms that are not shelved."""
    query = sa.select(sa.func.count()).select_from(Alarm).where(in_state("unacknowledged"))
    return session.scalar(query) or 0


def list_overdue_shelves(session: Session) -> Sequence[Alarm]:
    """Return the shelved alarms whose shelf time is over."""
    query = sa.select(Alarm).where(Alarm.closed_utc.is_(None), Alarm.shelved_until_utc <= utc_now())
    return session.scalars(query.order_by(Alarm.id)).all()


def list_events(session: Session, alarm_id: int) -> Sequence[AlarmEvent]:
    """Return the events of an alarm, in order."""
    return session.scalars(sa.select(AlarmEvent).where(AlarmEvent.alarm_id == alarm_id).order_by(AlarmEvent.id)).all()
