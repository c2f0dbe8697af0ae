"""The audit log, its anchors, and the answers kept for Idempotency-Keys."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.audit.signing import PublicKey
from boresight.platform.audit.subjects import AuditOutcome, AuditSubject, parse_outcome, parse_subject
from boresight.platform.db.declared import STRICT, Base, Journal, Sealing
from boresight.platform.db.documents import JsonText, TypedText


class AuditRecord(Base):
    """The append-only, hash-chained log; triggers refuse UPDATE and DELETE."""

    __tablename__ = "audit"
    __table_args__ = (sa.Index("ix_audit_object_id", "object", "id"), STRICT)
    sealing = Sealing(unsealed="is the chain itself")
    id: Mapped[int] = mapped_column(primary_key=True)
    at_utc: Mapped[str] = mapped_column(sa.Text)
    actor_id: Mapped[int | None] = mapped_column(sa.Integer)
    actor: Mapped[str] = mapped_column(sa.Text)
    credential: Mapped[str] = mapped_column(sa.Text)  # session | key:<prefix> | command line | system
    action: Mapped[str] = mapped_column(sa.Text)
    object: Mapped[str] = mapped_column(sa.Text)
    before: Mapped[dict[str, Any] | None] = mapped_column(JsonText)
    after: Mapped[dict[str, Any] | None] = mapped_column(JsonText)
    reason: Mapped[str | None] = mapped_column(TypedText)
    request_id: Mapped[str | None] = mapped_column(sa.Text)
    previous_hash: Mapped[str] = mapped_column(sa.Text)
    hash: Mapped[str] = mapped_column(sa.Text, unique=True)
    rows: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # SHA-256 of each row as this change left it
    roles: Mapped[list[str] | None] = mapped_column(JsonText)  # of the actor, at the time

    @property
    def subject(self) -> AuditSubject:
        """Its object, typed."""
        return parse_subject(self.object)

    @property
    def outcome(self) -> AuditOutcome:
        """The state that it left its object in."""
        return parse_outcome(self.after)


class AuditAnchor(Base):
    """A head of the log that was signed, and its time-stamp once there is one."""

    __tablename__ = "audit_anchors"
    noun = "anchor"
    __table_args__ = (STRICT,)
    sealing = Sealing(
        unsealed="is a journal, with hashes of its own",
        journal=Journal(
            lasting=("id", "record_id", "head", "at_utc", "made_by", "public_key", "signature"),
            others=("time_stamp", "stamped_utc"),
        ),
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    record_id: Mapped[int] = mapped_column(sa.Integer)  # the newest record then
    head: Mapped[str] = mapped_column(sa.Text)
    at_utc: Mapped[str] = mapped_column(sa.Text)
    made_by: Mapped[str] = mapped_column(sa.Text)
    public_key: Mapped[str] = mapped_column(sa.Text)  # base64
    signature: Mapped[str] = mapped_column(sa.Text)  # base64
    time_stamp: Mapped[str | None] = mapped_column(sa.Text)  # the answer of the service, base64
    stamped_utc: Mapped[str | None] = mapped_column(sa.Text)  # the time in it
    hash: Mapped[str | None] = mapped_column(sa.Text)  # chains it to the anchor before
    outcome_hash: Mapped[str | None] = mapped_column(sa.Text)  # of its time-stamp

    @property
    def key(self) -> str:
        """The id of the key that signed it."""
        return PublicKey.decode(self.public_key).id


class IdempotentResponse(Base):
    """What a POST answered under an Idempotency-Key, stored in the transaction of its effect."""

    __tablename__ = "idempotent_responses"
    __table_args__ = (STRICT,)
    sealing = Sealing(unsealed="is forgotten after a day")
    key: Mapped[str] = mapped_column(sa.Text, primary_key=True)
    actor: Mapped[str] = mapped_column(sa.Text, primary_key=True)
    request_sha256: Mapped[str] = mapped_column(sa.Text)
    status: Mapped[int]
    headers: Mapped[dict[str, str]] = mapped_column(JsonText)
    body: Mapped[dict[str, Any]] = mapped_column(JsonText)
    created_utc: Mapped[str] = mapped_column(sa.Text, index=True)
