"""Queries on the audit log."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from typing import Any

import sqlalchemy as sa

from boresight.platform.audit import chain
from boresight.platform.audit.tables import AuditAnchor, AuditRecord, IdempotentResponse
from boresight.platform.db.lists import List, equals
from boresight.platform.db.sessions import Session

RAW_AT_A_TIME = 1000
LATELY = 2000


RECORDS = List(
    AuditRecord,
    {"number": AuditRecord.id, "who": sa.func.lower(AuditRecord.actor), "did": AuditRecord.action},
    {
        "object": equals(AuditRecord.object),
        "actor": equals(AuditRecord.actor),
        "action": equals(AuditRecord.action),
        "since_utc": lambda time_utc: AuditRecord.at_utc >= time_utc,
        "until_utc": lambda time_utc: AuditRecord.at_utc < time_utc,
    },
)

ANCHORS = List(AuditAnchor, {}, {})
ANCHORS_AT_A_TIME = 100


def find_last_change(session: Session, subject: str) -> AuditRecord | None:
    """Return the newest record about an object, such as `parameter-sets/3`, written or waiting."""
    waiting = (record for record in reversed(chain.pending(session)) if record.object == subject)
    if (newest := next(waiting, None)) is not None:
        return newest
    query = sa.select(AuditRecord).where(AuditRecord.object == subject)
    return session.scalar(query.order_by(AuditRecord.id.desc()).limit(1))


def find_newest(
    session: Session, subject: str, actions: Sequence[str], *, not_by: int | None = None
) -> AuditRecord | None:
    """Return the newest record of one of these actions on an object, optionally only those not by a person."""
    query = sa.select(AuditRecord).where(AuditRecord.object == subject, AuditRecord.action.in_(actions))
    if not_by is not None:
        query = query.where(AuditRecord.actor_id.is_distinct_from(not_by))
    return session.scalar(query.order_by(AuditRecord.id.desc()).limit(1))


def read_newest_id(session: Session) -> int:
    """Return the number of the newest record."""
    return session.scalar(sa.select(sa.func.max(AuditRecord.id))) or 0


def list_heads_after(session: Session, after_id: int, limit: int) -> Sequence[Mapping[str, Any]]:
    """Return number, time, actor, action and object of the records after a number, oldest first."""
    columns = (AuditRecord.id, AuditRecord.at_utc, AuditRecord.actor, AuditRecord.action, AuditRecord.object)
    query = sa.select(*columns).where(AuditRecord.id > after_id).order_by(AuditRecord.id).limit(limit)
    return session.execute(query).mappings().all()  # type: ignore[return-value]  # SQLAlchemy's keys are its own type


def record(session: Session, record_id: int) -> AuditRecord | None:
    """Return the record with a number."""
    return session.get(AuditRecord, record_id)


def read_words(session: Session) -> tuple[Sequence[str], Sequence[str]]:
    """Return the actors and actions of recent records, without reading a long log in full."""
    newest = sa.select(AuditRecord.actor, AuditRecord.action).order_by(AuditRecord.id.desc()).limit(LATELY).subquery()
    actors = session.scalars(sa.select(newest.c.actor).distinct().order_by(newest.c.actor)).all()
    return actors, session.scalars(sa.select(newest.c.action).distinct().order_by(newest.c.action)).all()


def walk(session: Session) -> Generator[dict[str, Any], None, None]:
    """Yield every record in the order it was written, documents as their text, without holding them all."""
    chain.write_out(session)
    columns = [
        sa.type_coerce(column, sa.Text) if column.key in chain.DOCUMENTS else column
        for column in (AuditRecord.__table__.columns[name] for name in chain.COLUMNS)
    ]
    query = sa.select(*columns).order_by(AuditRecord.id)
    with closing(session.execute(query, execution_options={"yield_per": RAW_AT_A_TIME})) as found:
        for row in found:
            yield dict(zip(chain.COLUMNS, row, strict=True))


def find_newest_anchor(session: Session) -> AuditAnchor | None:
    """Return the newest anchor."""
    return session.scalar(sa.select(AuditAnchor).order_by(AuditAnchor.id.desc()).limit(1))


def find_first_after(session: Session, record_id: int) -> AuditRecord | None:
    """Return the first record after a number."""
    return session.scalar(sa.select(AuditRecord).where(AuditRecord.id > record_id).order_by(AuditRecord.id).limit(1))


def find_first_unstamped(session: Session) -> AuditAnchor | None:
    """Return the oldest anchor after the newest one with a time-stamp."""
    stamped = sa.select(sa.func.max(AuditAnchor.id)).where(AuditAnchor.time_stamp.is_not(None)).scalar_subquery()
    query = sa.select(AuditAnchor).where(AuditAnchor.id > sa.func.coalesce(stamped, 0))
    return session.scalar(query.order_by(AuditAnchor.id).limit(1))


def iterate_anchors(session: Session, newest: int | None = None) -> Iterator[tuple[AuditAnchor, str | None]]:
    """Yield every anchor, or the newest ones, in their order, each with the hash that its record has now."""
    first = 0 if newest is None else (session.scalar(sa.select(sa.func.max(AuditAnchor.id))) or 0) - newest
    query = sa.select(AuditAnchor, AuditRecord.hash).outerjoin(AuditRecord, AuditRecord.id == AuditAnchor.record_id)
    query = query.where(AuditAnchor.id > first).order_by(AuditAnchor.id)
    with closing(session.execute(query, execution_options={"yield_per": ANCHORS_AT_A_TIME})) as found:
        yield from found


def find_response(session: Session, key: str, actor: str) -> IdempotentResponse | None:
    """Return the stored response of an actor under an idempotency key."""
    return session.get(IdempotentResponse, (key, actor))


def forget_responses(session: Session, *, before_utc: str) -> None:
    """Remove the responses from before a time."""
    session.execute(sa.delete(IdempotentResponse).where(IdempotentResponse.created_utc < before_utc))
