"""Queries on saved views."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.console.saved_views.tables import SavedView
from boresight.platform.db.sessions import Session


def list_seen_by(session: Session, user_id: int | None, limit: int) -> Sequence[SavedView]:
    """Return a person's own views, favourites first, then those that others share, each by name."""
    own = SavedView.user_id == user_id
    query = sa.select(SavedView).where(sa.or_(own, SavedView.shared == 1))
    name = sa.func.lower(SavedView.name)
    order = (own.desc(), SavedView.favourite.desc(), name, SavedView.id)
    return session.scalars(query.order_by(*order).limit(limit)).all()


def list_favourites(session: Session, user_id: int, limit: int) -> Sequence[SavedView]:
    """Return a person's favourites by name."""
    query = sa.select(SavedView).where(SavedView.user_id == user_id, SavedView.favourite == 1)
    return session.scalars(query.order_by(sa.func.lower(SavedView.name), SavedView.id).limit(limit)).all()


def find_of_path(session: Session, user_id: int, path: str) -> SavedView | None:
    """Return the view under which a person saved an address."""
    return session.scalar(sa.select(SavedView).where(SavedView.user_id == user_id, SavedView.path == path))


def count_views(session: Session, user_id: int) -> int:
    """Count a person's views."""
    return session.scalar(sa.select(sa.func.count()).select_from(SavedView).where(SavedView.user_id == user_id)) or 0
