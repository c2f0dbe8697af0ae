"""Queries on people's addresses and their messages."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import sqlalchemy as sa

from boresight.console.access.tables import User
from boresight.console.messages.tables import Message, MessageAddress
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Session

IN_USE = MessageAddress.removed_utc.is_(None)


def list_addresses(session: Session, user_id: int | None = None) -> Sequence[MessageAddress]:
    """Return the addresses that were not removed, of a person or of everybody, oldest first."""
    query = sa.select(MessageAddress).where(IN_USE).order_by(MessageAddress.id)
    return session.scalars(query if user_id is None else query.where(MessageAddress.user_id == user_id)).all()


def list_subscribed(session: Session) -> Sequence[MessageAddress]:
    """Return the addresses in use of people who may log in."""
    query = sa.select(MessageAddress).join(User, User.id == MessageAddress.user_id)
    return session.scalars(query.where(IN_USE, User.disabled_utc.is_(None)).order_by(MessageAddress.id)).all()


def is_any_untold(session: Session) -> bool:
    """Whether there is an audit record that an address in use was not told of yet."""
    newest = sa.select(sa.func.max(AuditRecord.id)).scalar_subquery()
    query = sa.select(MessageAddress.id).join(User, User.id == MessageAddress.user_id)
    return (
        session.scalar(query.where(IN_USE, User.disabled_utc.is_(None), MessageAddress.told_audit_id < newest).limit(1))
        is not None
    )


def list_due(session: Session, now_utc: str, limit: int, *, among: Collection[int]) -> Sequence[Message]:
    """Return the oldest due messages of some addresses, by address."""
    due = sa.select(Message).where(Message.state == "PENDING", Message.due_utc <= now_utc)
    found = session.scalars(due.where(Message.address_id.in_(among)).order_by(Message.due_utc, Message.id).limit(limit))
    return sorted(found, key=lambda row: (row.address_id, row.id))


def put_off(session: Session, address_id: int, until_utc: str) -> None:
    """Postpone the waiting messages of an address to a time at least."""
    session.flush()
    waits = (Message.address_id == address_id, Message.state == "PENDING", Message.due_utc < until_utc)
    session.execute(sa.update(Message).where(*waits).values(due_utc=until_utc))


def drop_waiting(session: Session, address_id: int, outcome: str) -> None:
    """End the waiting messages of an address that was removed."""
    session.flush()
    waits = (Message.address_id == address_id, Message.state == "PENDING")
    session.execute(sa.update(Message).where(*waits).values(state="DROPPED", outcome=outcome))


def forget_before(session: Session, before_utc: str) -> int:
    """Remove the messages that ended before a time; return how many."""
    over = (Message.state != "PENDING", Message.created_utc < before_utc)
    return int(session.execute(sa.delete(Message).where(*over)).rowcount)  # type: ignore[attr-defined]  # a DELETE's result has it


def read_newest(session: Session, address_ids: Collection[int]) -> dict[int, Message]:
    """Return the newest attempted message of each of some addresses that has any."""
    newest = (
        sa.select(sa.func.max(Message.id))
        .where(Message.address_id.in_(address_ids), Message.attempted_utc.is_not(None))
        .group_by(Message.address_id)
    )
    return {row.address_id: row for row in session.scalars(sa.select(Message).where(Message.id.in_(newest)))}


def count_by_state(session: Session) -> dict[str, int]:
    """Count the messages of each state that has any."""
    return {
        row[0]: row[1] for row in session.execute(sa.select(Message.state, sa.func.count()).group_by(Message.state))
    }
