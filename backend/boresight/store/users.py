"""Queries on people and their failed log-ins."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import LoginFailure, User


def user_named(session: Session, name: str) -> User | None:
    """Return the person with a log-in name."""
    return session.scalar(sa.select(User).where(User.name == name))


def users(session: Session) -> Sequence[User]:
    """Return everyone, by log-in name."""
    return session.scalars(sa.select(User).order_by(User.name)).all()


def failures_since(session: Session, name: str, since_utc: str) -> Sequence[str]:
    """Return the times of a name's failed log-ins after a time, the newest first."""
    query = sa.select(LoginFailure.at_utc).where(LoginFailure.name == name, LoginFailure.at_utc > since_utc)
    return session.scalars(query.order_by(LoginFailure.at_utc.desc())).all()


def forget_failures(session: Session, *, before_utc: str) -> None:
    """Remove the failed log-ins that no longer count."""
    session.execute(sa.delete(LoginFailure).where(LoginFailure.at_utc < before_utc))
