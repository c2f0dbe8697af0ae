"""Star trackers, their telemetry and the files behind it."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.store.documents import JsonText
from boresight.store.tables.declared import STRICT, Base


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
