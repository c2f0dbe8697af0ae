"""Queries on API keys."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import ApiKey, AuditRecord


def key_with_prefix(session: Session, prefix: str) -> ApiKey | None:
    """Return the key whose secret begins so."""
    return session.scalar(sa.select(ApiKey).where(ApiKey.prefix == prefix))


def keys(session: Session, user_id: int | None) -> Sequence[ApiKey]:
    """Return a person's keys, or everyone's, newest first."""
    query = sa.select(ApiKey).order_by(ApiKey.id.desc())
    if user_id is not None:
        query = query.where(ApiKey.user_id == user_id)
    return session.scalars(query).all()


def last_changes(session: Session) -> dict[str, str]:
    """Return when each key last changed something, by its prefix, as the audit log knows it."""
    query = sa.select(AuditRecord.credential, sa.func.max(AuditRecord.at_utc))
    query = query.where(AuditRecord.credential.like("key:%")).group_by(AuditRecord.credential)
    return {credential.removeprefix("key:"): at_utc for credential, at_utc in session.execute(query)}
