"""Policies of sensors for new telemetry, and what was decided on each file by them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.calibration.calibration import parse_part
from boresight.errors import RefusedInputError
from boresight.platform.db.declared import STRICT, Base, Sealing, allow_only, only_one
from boresight.platform.db.documents import JsonText, TypedText

POLICY_STATES = ("DRAFT", "ACTIVE", "PAUSED", "OFF")
PAUSE_CODES = ("TOO MANY SETS", "TOO MANY REQUESTS", "BAD CLOCK", "WRONG SENSOR", "FAILURES", "FOLDER", "PERSON")
DECISION_STATES = (
    "CALIBRATING",
    "WITHIN FORECAST",
    "UNCONFIRMED",
    "ASKED",
    "ANSWERED",
    "SUPERSEDED",
    "NOT JUDGED",
    "REFUSED",
)
FAILED_STATES = ("NOT JUDGED", "REFUSED")
SOURCES = ("FOLDER", "REST", "ARCHIVE", "BUCKET")
ANSWERS = ("SUBMIT", "WAIT", "MORE DATA", "RECALIBRATE")


class IngestPolicy(Base):
    """How a sensor's new telemetry is judged, and when people are asked; a version each row, one of them in force at most."""

    __tablename__ = "ingest_policies"
    noun = "ingest policy"
    __table_args__ = (
        allow_only("state", POLICY_STATES),
        allow_only("pause_code", PAUSE_CODES),
        sa.UniqueConstraint("sensor_id", "number"),
        only_one("uq_ingest_policies_one_in_force", "sensor_id", "state IN ('ACTIVE', 'PAUSED')"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    number: Mapped[int]
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)  # its rules
    sha256: Mapped[str] = mapped_column(sa.Text)
    reason: Mapped[str] = mapped_column(TypedText)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    state: Mapped[str] = mapped_column(sa.Text)
    version: Mapped[int] = mapped_column(default=1)  # counts transitions; the ETag
    rehearsal: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # what it would have asked in the past
    rehearsed_utc: Mapped[str | None] = mapped_column(sa.Text)
    enabled_utc: Mapped[str | None] = mapped_column(sa.Text)
    pause_code: Mapped[str | None] = mapped_column(sa.Text)
    pause_reason: Mapped[str | None] = mapped_column(sa.Text)
    paused_utc: Mapped[str | None] = mapped_column(sa.Text)
    resumed_utc: Mapped[str | None] = mapped_column(sa.Text)

    @property
    def feed(self) -> str:
        """The archive that its rules pull from; none where an older version wrote them."""
        return str(self.document.get("feed", ""))


@dataclass(frozen=True)
class DecisionEvidence:
    """What the console itself reads of a decision's evidence; None where it does not say."""

    reference_id: int | None = None
    advised: str | None = None


class IngestDecision(Base):
    """What was made of one file: its set, its run, what the policy found, and what a person answered."""

    __tablename__ = "ingest_decisions"
    noun = "ingest decision"
    __table_args__ = (
        allow_only("state", DECISION_STATES),
        allow_only("source", SOURCES),
        allow_only("answer", ANSWERS),
        sa.Index("ix_ingest_decisions_sensor_id_id", "sensor_id", "id"),
        sa.Index("ix_ingest_decisions_state", "state"),
        only_one("uq_ingest_decisions_one_asked", "sensor_id", "state = 'ASKED'"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    policy_id: Mapped[int] = mapped_column(sa.ForeignKey("ingest_policies.id"))
    source: Mapped[str] = mapped_column(sa.Text)
    file_name: Mapped[str] = mapped_column(TypedText)
    file_sha256: Mapped[str | None] = mapped_column(sa.Text, index=True)
    size_bytes: Mapped[int]
    received_utc: Mapped[str] = mapped_column(sa.Text)
    received_by: Mapped[int | None] = mapped_column(
        sa.ForeignKey("users.id")
    )  # None: the watched folder or bucket, or an archive
    telemetry_set_id: Mapped[int | None] = mapped_column(sa.ForeignKey("telemetry_sets.id"))
    run_id: Mapped[int | None] = mapped_column(sa.ForeignKey("runs.id"), index=True)
    parameter_set_id: Mapped[int | None] = mapped_column(sa.ForeignKey("parameter_sets.id"))
    approval_id: Mapped[int | None] = mapped_column(sa.ForeignKey("approvals.id"))
    state: Mapped[str] = mapped_column(sa.Text)
    version: Mapped[int] = mapped_column(default=1)  # counts transitions; the ETag
    sentence: Mapped[str] = mapped_column(sa.Text)
    evidence: Mapped[dict[str, Any]] = mapped_column(JsonText)  # the numbers, the reasons and the alternatives
    decided_utc: Mapped[str | None] = mapped_column(sa.Text)
    answer: Mapped[str | None] = mapped_column(sa.Text)
    answer_reason: Mapped[str | None] = mapped_column(TypedText)
    answered_utc: Mapped[str | None] = mapped_column(sa.Text)
    answered_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    quiet_until_utc: Mapped[str | None] = mapped_column(sa.Text)  # of WAIT: how long the same change is not asked again

    @property
    def typed_evidence(self) -> DecisionEvidence:
        """What it rests on, typed."""
        return parse_part(DecisionEvidence, self.evidence, RefusedInputError)


class TakenObject(Base):
    """A version of an object in the watched bucket that was taken, so that it is taken once; a decision says what came of it."""

    __tablename__ = "taken_objects"
    noun = "object of the watched bucket"
    __table_args__ = (sa.UniqueConstraint("address", "version"), STRICT)
    sealing = Sealing(unsealed="is which objects were taken; what they brought is sealed")
    id: Mapped[int] = mapped_column(primary_key=True)
    address: Mapped[str] = mapped_column(sa.Text)
    version: Mapped[str] = mapped_column(sa.Text)  # its ETag
    taken_utc: Mapped[str] = mapped_column(sa.Text)
