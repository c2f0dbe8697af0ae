"""Queries on the audit log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import AuditRecord


def last_record(session: Session) -> AuditRecord | None:
    """Return the newest record, whose hash is the head of the chain."""
    return session.scalar(sa.select(AuditRecord).order_by(AuditRecord.id.desc()).limit(1))


def last_change(session: Session, subject: str) -> AuditRecord | None:
    """Return the newest record about an object, such as `parameter-sets/3`."""
    query = sa.select(AuditRecord).where(AuditRecord.object == subject)
    return session.scalar(query.order_by(AuditRecord.id.desc()).limit(1))


def records(session: Session, *, before_id: int | None, subject: str | None, limit: int) -> Sequence[AuditRecord]:
    """Return records, newest first, older than a cursor and about one object where asked."""
    query = sa.select(AuditRecord).order_by(AuditRecord.id.desc()).limit(limit)
    if before_id is not None:
        query = query.where(AuditRecord.id < before_id)
    if subject is not None:
        query = query.where(AuditRecord.object == subject)
    return session.scalars(query).all()


def walk(session: Session) -> Iterator[AuditRecord]:
    """Yield every record in the order it was written, without holding them all."""
    query = sa.select(AuditRecord).order_by(AuditRecord.id).execution_options(yield_per=500, populate_existing=True)
    yield from session.scalars(query)
