"""Queries on proposed changes."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.console.change_proposals.tables import ChangeProposal
from boresight.platform.db.sessions import Session


def list_due_proposals(session: Session, now_utc: str) -> Sequence[ChangeProposal]:
    """Return the open proposals whose time is over, oldest first."""
    is_due = (ChangeProposal.state == "OPEN", ChangeProposal.expires_utc <= now_utc)
    return session.scalars(sa.select(ChangeProposal).where(*is_due).order_by(ChangeProposal.id)).all()


def count_open_proposals(session: Session) -> int:
    """Count the proposals that wait."""
    return session.scalar(sa.select(sa.func.count()).where(ChangeProposal.state == "OPEN")) or 0
