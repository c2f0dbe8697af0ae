"""Addresses at which people get messages, and every message with its outcome."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base, Sealing, allow_only
from boresight.platform.db.documents import JsonText, TypedText

MESSAGE_STATES = ("PENDING", "DELIVERED", "FAILED", "DROPPED")


class MessageAddress(Base):
    """An address of one person; `address` may hold a token, is stored encrypted and never shown again."""

    __tablename__ = "message_addresses"
    noun = "address for messages"
    __table_args__ = (sa.Index("ix_message_addresses_user_id", "user_id"), STRICT)
    sealing = Sealing(fleeting={"told_audit_id": "moves with every audit record"})
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    label: Mapped[str] = mapped_column(TypedText)
    service: Mapped[str] = mapped_column(sa.Text)  # its scheme, such as mailto or slack
    shown: Mapped[str] = mapped_column(sa.Text)  # what is shown of it
    address: Mapped[str] = mapped_column(sa.Text)  # empty once it was removed
    kinds: Mapped[list[str]] = mapped_column(JsonText)
    quiet_from: Mapped[str | None] = mapped_column(sa.Text)  # HH:MM in `quiet_zone`
    quiet_until: Mapped[str | None] = mapped_column(sa.Text)
    quiet_zone: Mapped[str] = mapped_column(sa.Text, default="")  # empty: UTC
    told_audit_id: Mapped[int] = mapped_column(default=0)  # the newest audit record that messages were made of
    created_utc: Mapped[str] = mapped_column(sa.Text)
    removed_utc: Mapped[str | None] = mapped_column(sa.Text)


class Message(Base):
    """One message to one address, with the outcome of its last attempt."""

    __tablename__ = "messages"
    noun = "message"
    __table_args__ = (
        allow_only("state", MESSAGE_STATES),
        sa.Index("ix_messages_state_due_utc", "state", "due_utc"),
        sa.Index("ix_messages_address_id_id", "address_id", "id"),
        STRICT,
    )
    sealing = Sealing(unsealed="tells a person of what the audit log has, and is forgotten after a month")
    id: Mapped[int] = mapped_column(primary_key=True)
    address_id: Mapped[int] = mapped_column(sa.ForeignKey("message_addresses.id"))
    audit_id: Mapped[int | None] = mapped_column(sa.Integer)  # None: a test message
    kind: Mapped[str] = mapped_column(sa.Text)
    subject: Mapped[str] = mapped_column(sa.Text)
    text: Mapped[str] = mapped_column(sa.Text)
    path: Mapped[str] = mapped_column(sa.Text)  # of the page that it is about
    state: Mapped[str] = mapped_column(sa.Text)
    attempts: Mapped[int] = mapped_column(default=0)
    due_utc: Mapped[str] = mapped_column(sa.Text)
    attempted_utc: Mapped[str | None] = mapped_column(sa.Text)
    outcome: Mapped[str | None] = mapped_column(sa.Text)
    created_utc: Mapped[str] = mapped_column(sa.Text)
