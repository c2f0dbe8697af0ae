"""Parameter sets and their promotions."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base, allow_only, only_one
from boresight.platform.db.documents import JsonText, TypedText

GROUND_STATES = ("CANDIDATE", "SUBMITTED", "APPROVED", "BASELINE", "SUPERSEDED", "REJECTED", "WITHDRAWN", "EXPIRED")
ONBOARD_STATES = ("NOT SENT", "SENT", "LOADED", "VERIFIED", "ACTIVE", "MISMATCH", "UNKNOWN")
#: What the audit log calls the record of each.
ONBOARD_ACTIONS = {state: f"recorded {state} for" for state in ONBOARD_STATES}


class ParameterSet(Base):
    """Camera parameters with their covariance: immutable, identified by the SHA-256 of their canonical JSON."""

    __tablename__ = "parameter_sets"
    noun = "parameter set"
    __table_args__ = (
        allow_only("ground_state", GROUND_STATES),
        allow_only("onboard_state", ONBOARD_STATES),
        sa.UniqueConstraint("sensor_id", "number"),
        only_one("uq_parameter_sets_one_baseline", "sensor_id", "ground_state = 'BASELINE'"),
        only_one("uq_parameter_sets_one_active", "sensor_id", "onboard_state = 'ACTIVE'"),
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
    baseline_from_utc: Mapped[str | None] = mapped_column(sa.Text)  # the latest baseline period; all are in promotions
    baseline_to_utc: Mapped[str | None] = mapped_column(sa.Text)


class Promotion(Base):
    """A set became its sensor's baseline; never edited, so that the baseline at any time is one query."""

    __tablename__ = "promotions"
    __table_args__ = (sa.Index("ix_promotions_sensor_id_at_utc", "sensor_id", "at_utc"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    parameter_set_id: Mapped[int] = mapped_column(sa.ForeignKey("parameter_sets.id"))
    approval_id: Mapped[int | None] = mapped_column(sa.ForeignKey("approvals.id"))  # None: the ground calibration
    at_utc: Mapped[str] = mapped_column(sa.Text)
    promoted_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    reason: Mapped[str | None] = mapped_column(TypedText)  # None: none was given, or it came with the sensor
