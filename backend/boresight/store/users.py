"""Queries on people."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import User


def user_named(session: Session, name: str, key: str) -> User | None:
    """Return the person with exactly this log-in name, else the one whose name has this key."""
    found = session.scalar(sa.select(User).where(User.name == name))
    return found or session.scalar(sa.select(User).where(User.name_key == key))


def user_printed(session: Session, printed_name: str, key: str) -> User | None:
    """Return a person whose printed name is this one, or has this key."""
    alike = (User.printed_name == printed_name) | (User.printed_key == key)
    return session.scalar(sa.select(User).where(alike).limit(1))


def users(session: Session) -> Sequence[User]:
    """Return everyone, by log-in name."""
    return session.scalars(sa.select(User).order_by(User.name)).all()
