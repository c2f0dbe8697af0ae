"""Queries on what POSTs answered under an Idempotency-Key."""

from __future__ import annotations

import sqlalchemy as sa

from boresight.platform.audit.tables import IdempotentResponse
from boresight.platform.db.sessions import Session


def response_under(session: Session, key: str, actor: str) -> IdempotentResponse | None:
    """Return what an actor was answered under a key."""
    return session.get(IdempotentResponse, (key, actor))


def forget_responses(session: Session, *, before_utc: str) -> None:
    """Remove the answers of before a time."""
    session.execute(sa.delete(IdempotentResponse).where(IdempotentResponse.created_utc < before_utc))
