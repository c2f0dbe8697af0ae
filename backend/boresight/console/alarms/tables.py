"""Alarms of the fleet and their events."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base, allow_only, only_one
from boresight.platform.db.documents import JsonText, TypedText

ALARM_KINDS = ("DRIFT", "AGE", "MISMATCH", "CHAIN", "FILES", "HEAD", "CLOCK", "INGEST", "LINK", "BACKUP")
ALARM_LEVELS = ("critical", "serious", "caution")
ALARM_EVENTS = (
    "RAISED",
    "RETURNED",
    "RAISED AGAIN",
    "ACKNOWLEDGED",
    "SHELVED",
    "UNSHELVED",
    "ASSIGNED",
    "COMMENTED",
    "CLOSED",
)
#: What the audit log calls each step, and how a sentence on an alarm does.
ALARM_ACTIONS = {event: f"alarm {event.lower()}" for event in ALARM_EVENTS}
ALARM_VERBS = {action: event.lower() for event, action in ALARM_ACTIONS.items()}


class Alarm(Base):
    """One occurrence of a condition: open until it has returned to normal and was acknowledged, and then never changed."""

    __tablename__ = "alarms"
    noun = "alarm"
    __table_args__ = (
        allow_only("kind", ALARM_KINDS),
        allow_only("level", ALARM_LEVELS),
        only_one("uq_alarms_one_open", "source", "closed_utc IS NULL"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    source: Mapped[str] = mapped_column(sa.Text)  # its source, such as sensors/3/DRIFT
    sensor_id: Mapped[int | None] = mapped_column(sa.ForeignKey("sensors.id"), index=True)  # None: of the installation
    kind: Mapped[str] = mapped_column(sa.Text)
    level: Mapped[str] = mapped_column(sa.Text)
    sentence: Mapped[str] = mapped_column(sa.Text)
    evidence: Mapped[dict[str, Any]] = mapped_column(JsonText)  # the figures that the sentence rests on
    active: Mapped[int] = mapped_column(default=1)
    acknowledged: Mapped[int] = mapped_column(default=0)
    raised_utc: Mapped[str] = mapped_column(sa.Text)
    returned_utc: Mapped[str | None] = mapped_column(sa.Text)
    shelved_until_utc: Mapped[str | None] = mapped_column(sa.Text)
    assigned_to: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    version: Mapped[int] = mapped_column(default=1)  # increases with every step; the ETag
    closed_utc: Mapped[str | None] = mapped_column(sa.Text)


class AlarmEvent(Base):
    """A step in an alarm's life, by a person or by Boresight; never edited."""

    __tablename__ = "alarm_events"
    __table_args__ = (allow_only("event", ALARM_EVENTS), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    alarm_id: Mapped[int] = mapped_column(sa.ForeignKey("alarms.id"), index=True)
    event: Mapped[str] = mapped_column(sa.Text)
    user_id: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    printed_name: Mapped[str] = mapped_column(sa.Text)
    text: Mapped[str] = mapped_column(TypedText)
    at_utc: Mapped[str] = mapped_column(sa.Text)
