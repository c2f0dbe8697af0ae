"""Queries on presets."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import Preset


def newest_of_name(session: Session, name: str) -> Preset | None:
    """Return the newest version of a name, archived or not."""
    return session.scalar(sa.select(Preset).where(Preset.name == name).order_by(Preset.number.desc()).limit(1))


def presets(session: Session, *, archived: bool, before_id: int | None, limit: int | None) -> Sequence[Preset]:
    """Return versions of presets, newest first; with the archived ones where asked."""
    query = sa.select(Preset).order_by(Preset.id.desc()).limit(limit)
    if not archived:
        query = query.where(Preset.archived_utc.is_(None))
    return session.scalars(query if before_id is None else query.where(Preset.id < before_id)).all()


def newest_in_use(session: Session) -> Sequence[Preset]:
    """Return the newest version of every name that is not archived, by name."""
    newest = sa.select(sa.func.max(Preset.id)).where(Preset.archived_utc.is_(None)).group_by(Preset.name)
    return session.scalars(sa.select(Preset).where(Preset.id.in_(newest)).order_by(Preset.name)).all()
