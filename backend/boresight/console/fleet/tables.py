"""Sensors."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base
from boresight.platform.db.documents import JsonText, TypedText


class SensorDocument:
    """The columns of a document of a sensor that has versions: each is a row, the newest is in force."""

    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    number: Mapped[int]
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)
    sha256: Mapped[str] = mapped_column(sa.Text)
    reason: Mapped[str] = mapped_column(TypedText)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))


class Sensor(Base):
    """A star tracker; `document` is the contract's sensor file. `version` counts its edits."""

    __tablename__ = "sensors"
    noun = "sensor"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.Text, unique=True)
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)
    version: Mapped[int] = mapped_column(default=1)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    simulated: Mapped[int] = mapped_column(default=0)
    truth: Mapped[dict[str, Any] | None] = mapped_column(JsonText)  # true parameters of a simulated sensor
