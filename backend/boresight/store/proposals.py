"""Queries on changes that wait for a second person."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import ChangeProposal


def proposals(
    session: Session,
    *,
    sensor_id: int | None = None,
    kind: str | None = None,
    state: str | None = None,
    before_id: int | None = None,
    limit: int | None = None,
) -> Sequence[ChangeProposal]:
    """Return proposals, newest first: a page of them, or all."""
    query = sa.select(ChangeProposal).order_by(ChangeProposal.id.desc()).limit(limit)
    narrowed = {"sensor_id": sensor_id, "kind": kind, "state": state}
    query = query.filter_by(**{name: value for name, value in narrowed.items() if value is not None})
    return session.scalars(query if before_id is None else query.where(ChangeProposal.id < before_id)).all()


def due(session: Session, now_utc: str) -> Sequence[ChangeProposal]:
    """Return the open proposals whose time is over, oldest first."""
    is_due = (ChangeProposal.state == "OPEN", ChangeProposal.expires_utc <= now_utc)
    return session.scalars(sa.select(ChangeProposal).where(*is_due).order_by(ChangeProposal.id)).all()
