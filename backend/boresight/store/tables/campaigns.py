"""Settings that were given a name, and the launches of one setting over many sensors."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.store.documents import JsonText
from boresight.store.tables.declared import STRICT, Base


class Preset(Base):
    """Settings under a name, with a sentence on when to use them; each version is a row, and only archiving changes one."""

    __tablename__ = "presets"
    __table_args__ = (sa.UniqueConstraint("name", "number"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.Text)
    number: Mapped[int]
    sentence: Mapped[str] = mapped_column(sa.Text)
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)  # the settings
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    archived_utc: Mapped[str | None] = mapped_column(sa.Text)


class Campaign(Base):
    """One setting launched over many sensors; what it is stands fixed, how it goes is told by its runs."""

    __tablename__ = "campaigns"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    label: Mapped[str] = mapped_column(sa.Text)
    preset: Mapped[str | None] = mapped_column(sa.Text)  # the name that its settings had
    settings: Mapped[dict[str, Any]] = mapped_column(JsonText)
    launched_utc: Mapped[str] = mapped_column(sa.Text)
    launched_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    cancelled_utc: Mapped[str | None] = mapped_column(sa.Text)


class CampaignRun(Base):
    """A sensor of a campaign: its run, or why it has none. The newest row of a sensor counts, the older ones are its past."""

    __tablename__ = "campaign_runs"
    __table_args__ = (sa.Index("ix_campaign_runs_campaign_sensor", "campaign_id", "sensor_id", "id"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    campaign_id: Mapped[int] = mapped_column(sa.ForeignKey("campaigns.id"))
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    run_id: Mapped[int | None] = mapped_column(sa.ForeignKey("runs.id"), index=True)
    refusal: Mapped[str | None] = mapped_column(sa.Text)
