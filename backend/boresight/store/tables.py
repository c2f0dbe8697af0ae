"""Every table. SQLite (STRICT) by default, PostgreSQL by URL, the same definitions and migrations for both.

Times are text in one form, `2026-11-21T03:04:05.123456Z`, which sorts as time and reads the same in both engines.
Documents are `JsonText`. Large things (telemetry, results, histories) are blobs: rows hold their SHA-256 address.
"""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from boresight.store.documents import JsonText


class Base(DeclarativeBase):
    """All tables share one naming convention, so that migrations can name what they drop."""

    metadata = sa.MetaData(
        naming_convention={
            "ix": "ix_%(column_0_label)s",
            "uq": "uq_%(table_name)s_%(column_0_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
            "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )


STRICT = {"sqlite_strict": True}


def _one_of(column: str, values: tuple[str, ...]) -> sa.CheckConstraint:
    """Allow only these words in a column."""
    return sa.CheckConstraint(f"{column} IN ({', '.join(repr(value) for value in values)})", name=column)


def _only_one(name: str, column: str, where: str) -> sa.Index:
    """Allow one row for each value of a column among the rows that meet a condition."""
    return sa.Index(name, column, unique=True, sqlite_where=sa.text(where), postgresql_where=sa.text(where))


ROLES = ("viewer", "analyst", "operator", "approver", "administrator")
RUN_STATES = ("QUEUED", "RUNNING", "CANCELLING", "SUCCEEDED", "FAILED", "CANCELLED", "LOST")
TERMINAL_RUN_STATES = ("SUCCEEDED", "FAILED", "CANCELLED", "LOST")
GROUND_STATES = ("CANDIDATE", "SUBMITTED", "APPROVED", "BASELINE", "SUPERSEDED", "REJECTED", "WITHDRAWN", "EXPIRED")
ONBOARD_STATES = ("NOT SENT", "SENT", "LOADED", "VERIFIED", "ACTIVE", "MISMATCH", "UNKNOWN")
APPROVAL_STATES = ("OPEN", "APPROVED", "REJECTED", "WITHDRAWN", "STALE", "EXPIRED")


class User(Base):
    """A person. Roles are a list of words; an administrator cannot sign."""

    __tablename__ = "users"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.Text, unique=True)
    printed_name: Mapped[str] = mapped_column(sa.Text)
    password_hash: Mapped[str] = mapped_column(sa.Text)
    roles: Mapped[list[str]] = mapped_column(JsonText)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    disabled_utc: Mapped[str | None] = mapped_column(sa.Text)
    session_epoch: Mapped[int] = mapped_column(default=0)


class ApiKey(Base):
    """A scoped key for automation, stored hashed, shown once."""

    __tablename__ = "api_keys"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    label: Mapped[str] = mapped_column(sa.Text)
    prefix: Mapped[str] = mapped_column(sa.Text, unique=True)
    key_hash: Mapped[str] = mapped_column(sa.Text)
    scopes: Mapped[list[str]] = mapped_column(JsonText)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    expires_utc: Mapped[str | None] = mapped_column(sa.Text)
    revoked_utc: Mapped[str | None] = mapped_column(sa.Text)


class LoginFailure(Base):
    """A failed log-in, kept for throttling."""

    __tablename__ = "login_failures"
    __table_args__ = (sa.Index("ix_login_failures_name_at_utc", "name", "at_utc"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.Text)
    at_utc: Mapped[str] = mapped_column(sa.Text)


class Sensor(Base):
    """A star tracker; `document` is the contract's sensor file. `version` counts its edits."""

    __tablename__ = "sensors"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.Text, unique=True)
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)
    version: Mapped[int] = mapped_column(default=1)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    simulated: Mapped[int] = mapped_column(default=0)
    truth: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # true parameters of a simulated sensor


class Blob(Base):
    """A content-addressed file; the bytes are in the blob folder under their SHA-256."""

    __tablename__ = "blobs"
    __table_args__ = (STRICT,)
    sha256: Mapped[str] = mapped_column(sa.Text, primary_key=True)
    size_bytes: Mapped[int] = mapped_column(sa.BigInteger().with_variant(sa.Integer, "sqlite"))
    media_type: Mapped[str] = mapped_column(sa.Text)
    created_utc: Mapped[str] = mapped_column(sa.Text)


class TelemetrySet(Base):
    """An uploaded file of one sensor: the original bytes, the Parquet form that is worked on, the quality report."""

    __tablename__ = "telemetry_sets"
    __table_args__ = (sa.UniqueConstraint("sensor_id", "original_sha256"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"), index=True)
    name: Mapped[str] = mapped_column(sa.Text)
    purpose: Mapped[str] = mapped_column(sa.Text)  # calibration | validation
    original_sha256: Mapped[str] = mapped_column(sa.ForeignKey("blobs.sha256"))
    table_sha256: Mapped[str] = mapped_column(sa.ForeignKey("blobs.sha256"))
    frames: Mapped[int]
    stars: Mapped[int]
    quality: Mapped[dict[str, Any]] = mapped_column(JsonText)
    uploaded_utc: Mapped[str] = mapped_column(sa.Text)
    uploaded_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    archived_utc: Mapped[str | None] = mapped_column(sa.Text)


class Run(Base):
    """A calibration. The row is the truth; engines only compute. Terminal states are written once."""

    __tablename__ = "runs"
    __table_args__ = (_one_of("state", RUN_STATES), sa.Index("ix_runs_state_id", "state", "id"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"), index=True)
    telemetry_set_id: Mapped[int] = mapped_column(sa.ForeignKey("telemetry_sets.id"))
    validation_set_id: Mapped[int | None] = mapped_column(sa.ForeignKey("telemetry_sets.id"))
    method: Mapped[str] = mapped_column(sa.Text)
    settings: Mapped[dict[str, Any]] = mapped_column(JsonText)
    sensor_document: Mapped[dict[str, Any]] = mapped_column(JsonText)  # the sensor as it was at launch
    label: Mapped[str] = mapped_column(sa.Text, default="")
    state: Mapped[str] = mapped_column(sa.Text)
    reason: Mapped[str | None] = mapped_column(sa.Text)  # why it failed, was lost or was cancelled
    attempt: Mapped[int] = mapped_column(default=0)
    owner: Mapped[str | None] = mapped_column(sa.Text)
    lease_until_utc: Mapped[str | None] = mapped_column(sa.Text)
    cancel_requested: Mapped[int] = mapped_column(default=0)
    launched_utc: Mapped[str] = mapped_column(sa.Text)
    launched_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    started_utc: Mapped[str | None] = mapped_column(sa.Text)
    ended_utc: Mapped[str | None] = mapped_column(sa.Text)
    progress: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # fraction, message, partial history
    result_sha256: Mapped[str | None] = mapped_column(sa.ForeignKey("blobs.sha256"))
    summary: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # the figures a list shows


class RunEvent(Base):
    """One line of a run's log, in the order it happened; also what the event stream replays."""

    __tablename__ = "run_events"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(sa.ForeignKey("runs.id", ondelete="CASCADE"), index=True)
    attempt: Mapped[int]
    at_utc: Mapped[str] = mapped_column(sa.Text)
    kind: Mapped[str] = mapped_column(sa.Text)  # state | log
    message: Mapped[str] = mapped_column(sa.Text)


class ParameterSet(Base):
    """Camera parameters with their covariance: immutable, identified by the SHA-256 of their canonical JSON."""

    __tablename__ = "parameter_sets"
    __table_args__ = (
        _one_of("ground_state", GROUND_STATES),
        _one_of("onboard_state", ONBOARD_STATES),
        sa.UniqueConstraint("sensor_id", "number"),
        _only_one("uq_parameter_sets_one_baseline", "sensor_id", "ground_state = 'BASELINE'"),
        _only_one("uq_parameter_sets_one_active", "sensor_id", "onboard_state = 'ACTIVE'"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.Text, unique=True)  # PS-<sensor>-<number>
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"), index=True)
    number: Mapped[int]
    run_id: Mapped[int | None] = mapped_column(sa.ForeignKey("runs.id"))  # None: the ground calibration
    sha256: Mapped[str] = mapped_column(sa.Text)
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)
    ground_state: Mapped[str] = mapped_column(sa.Text)
    onboard_state: Mapped[str] = mapped_column(sa.Text, default="NOT SENT")
    version: Mapped[int] = mapped_column(default=1)  # counts transitions; the ETag
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    baseline_from_utc: Mapped[str | None] = mapped_column(sa.Text)  # the latest period; all of them are in promotions
    baseline_to_utc: Mapped[str | None] = mapped_column(sa.Text)


class Promotion(Base):
    """A set became its sensor's baseline; never edited, so that what was baseline at a time is one query."""

    __tablename__ = "promotions"
    __table_args__ = (sa.Index("ix_promotions_sensor_id_at_utc", "sensor_id", "at_utc"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    parameter_set_id: Mapped[int] = mapped_column(sa.ForeignKey("parameter_sets.id"))
    approval_id: Mapped[int | None] = mapped_column(sa.ForeignKey("approvals.id"))  # None: the ground calibration
    at_utc: Mapped[str] = mapped_column(sa.Text)
    promoted_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))


class Approval(Base):
    """A request that a parameter set become baseline; binds the hashes of what was shown."""

    __tablename__ = "approvals"
    __table_args__ = (
        _one_of("state", APPROVAL_STATES),
        _only_one("uq_approvals_one_open", "parameter_set_id", "state = 'OPEN'"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    parameter_set_id: Mapped[int] = mapped_column(sa.ForeignKey("parameter_sets.id"), index=True)
    state: Mapped[str] = mapped_column(sa.Text)
    reason: Mapped[str] = mapped_column(sa.Text)
    submitted_utc: Mapped[str] = mapped_column(sa.Text)
    submitted_by: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    bound: Mapped[dict[str, Any]] = mapped_column(JsonText)  # set, run and incumbent hashes
    version: Mapped[int] = mapped_column(default=1)
    closed_utc: Mapped[str | None] = mapped_column(sa.Text)


class Signature(Base):
    """A person's GO or NO-GO on a request, with what it means and the hash of what was shown."""

    __tablename__ = "signatures"
    __table_args__ = (_one_of("decision", ("APPROVE", "REFUSE")), sa.UniqueConstraint("approval_id", "user_id"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    approval_id: Mapped[int] = mapped_column(sa.ForeignKey("approvals.id"))
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    printed_name: Mapped[str] = mapped_column(sa.Text)
    decision: Mapped[str] = mapped_column(sa.Text)
    meaning: Mapped[str] = mapped_column(sa.Text)
    comment: Mapped[str] = mapped_column(sa.Text)
    shown_sha256: Mapped[str] = mapped_column(sa.Text)
    signed_utc: Mapped[str] = mapped_column(sa.Text)


class Uplink(Base):
    """What was exported or recorded as loaded on board, entry by entry; never edited."""

    __tablename__ = "uplinks"
    __table_args__ = (_one_of("onboard_state", ONBOARD_STATES), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    parameter_set_id: Mapped[int] = mapped_column(sa.ForeignKey("parameter_sets.id"), index=True)
    onboard_state: Mapped[str] = mapped_column(sa.Text)
    source: Mapped[str] = mapped_column(sa.Text)
    recorded_utc: Mapped[str] = mapped_column(sa.Text)
    recorded_by: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))


class AuditRecord(Base):
    """The append-only, hash-chained log; triggers refuse UPDATE and DELETE."""

    __tablename__ = "audit"
    __table_args__ = (sa.Index("ix_audit_object_id", "object", "id"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    at_utc: Mapped[str] = mapped_column(sa.Text)
    actor_id: Mapped[int | None] = mapped_column(sa.Integer)
    actor: Mapped[str] = mapped_column(sa.Text)
    credential: Mapped[str] = mapped_column(sa.Text)  # session | key:<prefix> | command line | system
    action: Mapped[str] = mapped_column(sa.Text)
    object: Mapped[str] = mapped_column(sa.Text)
    before: Mapped[dict[str, Any] | None] = mapped_column(JsonText)
    after: Mapped[dict[str, Any] | None] = mapped_column(JsonText)
    reason: Mapped[str | None] = mapped_column(sa.Text)
    request_id: Mapped[str | None] = mapped_column(sa.Text)
    previous_hash: Mapped[str] = mapped_column(sa.Text)
    hash: Mapped[str] = mapped_column(sa.Text, unique=True)


class IdempotentResponse(Base):
    """What a POST answered under an Idempotency-Key, stored in the transaction of its effect."""

    __tablename__ = "idempotent_responses"
    __table_args__ = (STRICT,)
    key: Mapped[str] = mapped_column(sa.Text, primary_key=True)
    actor: Mapped[str] = mapped_column(sa.Text, primary_key=True)
    request_sha256: Mapped[str] = mapped_column(sa.Text)
    status: Mapped[int]
    headers: Mapped[dict[str, str]] = mapped_column(JsonText)
    body: Mapped[dict[str, Any]] = mapped_column(JsonText)
    created_utc: Mapped[str] = mapped_column(sa.Text, index=True)
