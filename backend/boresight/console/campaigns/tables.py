"""The launches of one setting over many sensors."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base
from boresight.platform.db.documents import JsonText, TypedText


class Campaign(Base):
    """One setting launched over many sensors; the row never changes, and its runs tell its progress."""

    __tablename__ = "campaigns"
    noun = "campaign"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    label: Mapped[str] = mapped_column(TypedText)
    preset: Mapped[str | None] = mapped_column(sa.Text)  # the name of the preset
    settings: Mapped[dict[str, Any]] = mapped_column(JsonText)
    launched_utc: Mapped[str] = mapped_column(sa.Text)
    launched_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    cancelled_utc: Mapped[str | None] = mapped_column(sa.Text)


class CampaignRun(Base):
    """A sensor of a campaign: its run, or why it has none. The newest row of a sensor counts."""

    __tablename__ = "campaign_runs"
    __table_args__ = (sa.Index("ix_campaign_runs_campaign_sensor", "campaign_id", "sensor_id", "id"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    campaign_id: Mapped[int] = mapped_column(sa.ForeignKey("campaigns.id"))
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    run_id: Mapped[int | None] = mapped_column(sa.ForeignKey("runs.id"), index=True)
    refusal: Mapped[str | None] = mapped_column(sa.Text)
