"""Queries on API keys."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import ApiKey


def key_with_prefix(session: Session, prefix: str) -> ApiKey | None:
    """Return the key whose secret begins so."""
    return session.scalar(sa.select(ApiKey).where(ApiKey.prefix == prefix))


def keys(session: Session, user_id: int | None) -> Sequence[ApiKey]:
    """Return a person's keys, or everyone's, newest first."""
    query = sa.select(ApiKey).order_by(ApiKey.id.desc())
    if user_id is not None:
        query = query.where(ApiKey.user_id == user_id)
    return session.scalars(query).all()
