"""Requests for approval with their signatures and discussion, gate profiles, gate reports and waivers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, foreign, mapped_column, relationship

from boresight.calibration.calibration import parse_part
from boresight.console.fleet.tables import SensorDocument
from boresight.errors import RefusedInputError
from boresight.platform.db.declared import STRICT, Base, Sealing, allow_only, only_one
from boresight.platform.db.documents import JsonText, TypedText

APPROVAL_STATES = ("OPEN", "APPROVED", "REJECTED", "WITHDRAWN", "STALE", "EXPIRED")
APPROVAL_KINDS = ("PROMOTION", "ROLLBACK")
THREAD_KINDS = ("gate", "parameter", "figure")


@dataclass(frozen=True)
class Binding:
    """What a request binds: hashes of what was shown, and ids of waivers; None where there was none, or where it does not say.

    `stated`: what it says at all; requests of earlier versions say less.
    """

    set_sha256: str | None = None
    run_result_sha256: str | None = None
    gate_report_sha256: str | None = None
    profile_sha256: str | None = None
    table_definition_sha256: str | None = None
    incumbent_sha256: str | None = None
    waivers: list[int] | None = None
    stated: frozenset[str] = frozenset()

    @classmethod
    def parse(cls, document: Mapping[str, Any]) -> Binding:
        """Read what a row has."""
        return parse_part(cls, {**document, "stated": frozenset(document)}, RefusedInputError)

    def document(self) -> dict[str, Any]:
        """Return what a row keeps."""
        return {item.name: getattr(self, item.name) for item in fields(self) if item.name != "stated"}


class Approval(Base):
    """A request that a parameter set become baseline; binds the hashes of what was shown."""

    __tablename__ = "approvals"
    noun = "request for approval"
    __table_args__ = (
        allow_only("state", APPROVAL_STATES),
        only_one("uq_approvals_one_open", "parameter_set_id", "state = 'OPEN'"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    parameter_set_id: Mapped[int] = mapped_column(sa.ForeignKey("parameter_sets.id"), index=True)
    state: Mapped[str] = mapped_column(sa.Text)
    reason: Mapped[str] = mapped_column(TypedText)
    submitted_utc: Mapped[str] = mapped_column(sa.Text)
    submitted_by: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    bound: Mapped[dict[str, Any]] = mapped_column(JsonText)  # hashes of set, run, gate report, profile and incumbent
    version: Mapped[int] = mapped_column(default=1)
    closed_utc: Mapped[str | None] = mapped_column(sa.Text)
    kind: Mapped[str] = mapped_column(sa.Text, default="PROMOTION", server_default="PROMOTION")  # of APPROVAL_KINDS
    needed: Mapped[int] = mapped_column(default=1, server_default=sa.text("1"))  # approvals that make it APPROVED
    expires_utc: Mapped[str | None] = mapped_column(sa.Text)
    assigned_to: Mapped[int | None] = mapped_column(sa.Integer)  # the person asked to look at it
    signatures: Mapped[list[Signature]] = relationship(viewonly=True, order_by="Signature.id")

    @property
    def binding(self) -> Binding:
        """What it binds, typed."""
        return Binding.parse(self.bound)


class Signature(Base):
    """A person's GO or NO-GO on a request, with what it means and the hash of what was shown."""

    __tablename__ = "signatures"
    __table_args__ = (
        allow_only("decision", ("APPROVE", "REFUSE")),
        sa.UniqueConstraint("approval_id", "user_id"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    approval_id: Mapped[int] = mapped_column(sa.ForeignKey("approvals.id"))
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    printed_name: Mapped[str] = mapped_column(sa.Text)
    decision: Mapped[str] = mapped_column(sa.Text)
    meaning: Mapped[str] = mapped_column(TypedText)
    comment: Mapped[str] = mapped_column(TypedText)
    shown_sha256: Mapped[str] = mapped_column(sa.Text)
    signed_utc: Mapped[str] = mapped_column(sa.Text)
    console: Mapped[str | None] = mapped_column(sa.Text)  # whose console it was signed at, over the shoulder
    password_by: Mapped[str | None] = mapped_column(sa.Text)  # who else knew, or lately gave, the password
    points: Mapped[list[dict[str, Any]] | None] = mapped_column(JsonText)  # `review.Point`s; of a refusal none
    approval: Mapped[Approval] = relationship(viewonly=True)


class Remark(Base):
    """A word in the discussion of a request; never edited."""

    __tablename__ = "remarks"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    approval_id: Mapped[int] = mapped_column(sa.ForeignKey("approvals.id"), index=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    printed_name: Mapped[str] = mapped_column(sa.Text)
    text: Mapped[str] = mapped_column(TypedText)
    made_utc: Mapped[str] = mapped_column(sa.Text)
    thread_id: Mapped[int | None] = mapped_column(sa.Integer, index=True)  # without one it is about the whole request
    mentions: Mapped[list[str] | None] = mapped_column(JsonText)  # log-in names


class Thread(Base):
    """A discussion of one gate, parameter or figure of a request, open until somebody resolves it."""

    __tablename__ = "threads"
    noun = "thread"
    __table_args__ = (allow_only("kind", THREAD_KINDS), allow_only("state", ("OPEN", "RESOLVED")), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    approval_id: Mapped[int] = mapped_column(sa.ForeignKey("approvals.id"), index=True)
    kind: Mapped[str] = mapped_column(sa.Text)
    name: Mapped[str] = mapped_column(sa.Text)
    state: Mapped[str] = mapped_column(sa.Text)
    version: Mapped[int] = mapped_column(default=1)
    opened_by: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    printed_name: Mapped[str] = mapped_column(sa.Text)
    opened_utc: Mapped[str] = mapped_column(sa.Text)
    resolved_by: Mapped[int | None] = mapped_column(sa.Integer)
    resolver: Mapped[str | None] = mapped_column(sa.Text)  # the printed name
    resolved_utc: Mapped[str | None] = mapped_column(sa.Text)
    remarks: Mapped[list[Remark]] = relationship(
        viewonly=True, primaryjoin=lambda: foreign(Remark.thread_id) == Thread.id, order_by="Remark.id"
    )


class FigureDelivery(Base):
    """The server gave a person a figure of a request; only the first time is kept."""

    __tablename__ = "figure_deliveries"
    __table_args__ = (sa.UniqueConstraint("approval_id", "user_id", "evidence"), STRICT)
    sealing = Sealing(unsealed="only says that an opening may follow")
    id: Mapped[int] = mapped_column(primary_key=True)
    approval_id: Mapped[int] = mapped_column(sa.ForeignKey("approvals.id"))
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    evidence: Mapped[str] = mapped_column(sa.Text)
    given_utc: Mapped[str] = mapped_column(sa.Text)


class Opening(Base):
    """A figure that a person was given stood in their sight for a moment; only the first time is kept."""

    __tablename__ = "openings"
    __table_args__ = (sa.UniqueConstraint("approval_id", "user_id", "evidence"), STRICT)
    sealing = Sealing(unsealed="is sealed with the signature that counted on it")
    id: Mapped[int] = mapped_column(primary_key=True)
    approval_id: Mapped[int] = mapped_column(sa.ForeignKey("approvals.id"))
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    evidence: Mapped[str] = mapped_column(sa.Text)
    opened_utc: Mapped[str] = mapped_column(sa.Text)


class GateProfile(SensorDocument, Base):
    """The limits that a sensor's sets are held to; each version is a row, the newest is in force."""

    __tablename__ = "gate_profiles"
    __table_args__ = (sa.UniqueConstraint("sensor_id", "number"), STRICT)


class GateReport(Base):
    """A set held against a profile and the incumbent: one answer a gate, and the worst of them."""

    __tablename__ = "gate_reports"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    parameter_set_id: Mapped[int] = mapped_column(sa.ForeignKey("parameter_sets.id"), index=True)
    gate_profile_id: Mapped[int] = mapped_column(sa.ForeignKey("gate_profiles.id"))
    verdict: Mapped[str] = mapped_column(sa.Text)
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)
    sha256: Mapped[str] = mapped_column(sa.Text)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))


class Waiver(Base):
    """A person let a set pass in spite of a gate, with the reason and until when; never edited, never removed."""

    __tablename__ = "waivers"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    parameter_set_id: Mapped[int] = mapped_column(sa.ForeignKey("parameter_sets.id"), index=True)
    gate_report_id: Mapped[int] = mapped_column(sa.ForeignKey("gate_reports.id"))
    gate: Mapped[str] = mapped_column(sa.Text)
    code: Mapped[str] = mapped_column(sa.Text)
    reason: Mapped[str] = mapped_column(TypedText)
    expires_utc: Mapped[str] = mapped_column(sa.Text)
    made_utc: Mapped[str] = mapped_column(sa.Text)
    made_by: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    printed_name: Mapped[str] = mapped_column(sa.Text)
