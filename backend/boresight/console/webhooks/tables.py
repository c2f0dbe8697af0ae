"""Webhooks, and every attempt to deliver to them."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base, Journal, Sealing, allow_only
from boresight.platform.db.documents import JsonText, TypedText

DELIVERY_STATES = ("PENDING", "DELIVERED", "FAILED")


class Webhook(Base):
    """A webhook; `secret` signs each delivery, is stored encrypted and shown once."""

    __tablename__ = "webhooks"
    noun = "webhook"
    __table_args__ = (STRICT,)
    sealing = Sealing(
        fleeting={
            "told_audit_id": "moves with every audit record",
            "told_head": "moves with every head of the audit log",
        }
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    label: Mapped[str] = mapped_column(TypedText)
    url: Mapped[str] = mapped_column(sa.Text)
    actions: Mapped[list[str]] = mapped_column(JsonText)  # empty: all
    secret: Mapped[str] = mapped_column(sa.Text)
    version: Mapped[int] = mapped_column(default=1)
    told_audit_id: Mapped[int] = mapped_column(default=0)  # the newest audit record that deliveries were made of
    told_head: Mapped[str | None] = mapped_column(sa.Text)  # hash of the newest head that a delivery was made of
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    disabled_utc: Mapped[str | None] = mapped_column(sa.Text)
    previous_secret: Mapped[str | None] = mapped_column(sa.Text)  # signs too until `previous_until_utc`
    previous_until_utc: Mapped[str | None] = mapped_column(sa.Text)


class WebhookDelivery(Base):
    """One message to one webhook, with the outcome of its last attempt."""

    __tablename__ = "webhook_deliveries"
    noun = "delivery"
    __table_args__ = (
        allow_only("state", DELIVERY_STATES),
        sa.Index("ix_webhook_deliveries_state_due_utc", "state", "due_utc"),
        STRICT,
    )
    sealing = Sealing(
        unsealed="is a journal, with hashes of its own",
        journal=Journal(
            lasting=("id", "webhook_id", "audit_id", "body", "created_utc"),
            others=("state", "attempts", "attempted_utc", "status", "outcome"),
        ),
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    webhook_id: Mapped[int] = mapped_column(sa.ForeignKey("webhooks.id"), index=True)
    audit_id: Mapped[int | None] = mapped_column(sa.Integer)  # None: a trial message
    body: Mapped[str] = mapped_column(sa.Text)
    state: Mapped[str] = mapped_column(sa.Text)
    attempts: Mapped[int] = mapped_column(default=0)
    due_utc: Mapped[str] = mapped_column(sa.Text)
    attempted_utc: Mapped[str | None] = mapped_column(sa.Text)
    status: Mapped[int | None] = mapped_column(sa.Integer)  # of the answer
    outcome: Mapped[str | None] = mapped_column(sa.Text)  # what went wrong, a sentence
    created_utc: Mapped[str] = mapped_column(sa.Text)
    hash: Mapped[str | None] = mapped_column(sa.Text)  # chains it to the message before
    outcome_hash: Mapped[str | None] = mapped_column(sa.Text)  # of its state and what came of it
