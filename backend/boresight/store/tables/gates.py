"""Gate profiles, what they found of a parameter set, and the waivers that were given."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.store.documents import JsonText
from boresight.store.tables.declared import STRICT, Base


class GateProfile(Base):
    """The limits that a sensor's sets are held to; each version is a row, the newest is in force."""

    __tablename__ = "gate_profiles"
    __table_args__ = (sa.UniqueConstraint("sensor_id", "number"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    number: Mapped[int]
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)
    sha256: Mapped[str] = mapped_column(sa.Text)
    reason: Mapped[str] = mapped_column(sa.Text)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))


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
    reason: Mapped[str] = mapped_column(sa.Text)
    expires_utc: Mapped[str] = mapped_column(sa.Text)
    made_utc: Mapped[str] = mapped_column(sa.Text)
    made_by: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    printed_name: Mapped[str] = mapped_column(sa.Text)
