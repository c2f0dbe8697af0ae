"""Changes of gate limits and table layouts that were proposed."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base, allow_only
from boresight.platform.db.documents import JsonText, TypedText

PROPOSAL_KINDS = ("gate-profile", "table-definition")
PROPOSAL_STATES = ("OPEN", "CONFIRMED", "REFUSED", "WITHDRAWN", "STALE", "EXPIRED")


class ChangeProposal(Base):
    """A change that somebody asks for; what it says never changes, and it takes effect when another person confirms it."""

    __tablename__ = "change_proposals"
    noun = "proposal"
    __table_args__ = (
        allow_only("kind", PROPOSAL_KINDS),
        allow_only("state", PROPOSAL_STATES),
        sa.Index("ix_change_proposals_sensor_id_state", "sensor_id", "state"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    sensor_id: Mapped[int] = mapped_column(sa.ForeignKey("sensors.id"))
    kind: Mapped[str] = mapped_column(sa.Text)
    base_number: Mapped[int]  # the version in force that it was made against
    document: Mapped[dict[str, Any]] = mapped_column(JsonText)
    sha256: Mapped[str] = mapped_column(sa.Text)
    reason: Mapped[str] = mapped_column(TypedText)
    proposed_utc: Mapped[str] = mapped_column(sa.Text)
    proposed_by: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    expires_utc: Mapped[str] = mapped_column(sa.Text)
    state: Mapped[str] = mapped_column(sa.Text)
    version: Mapped[int] = mapped_column(default=1)
    closed_utc: Mapped[str | None] = mapped_column(sa.Text)
    closed_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))
    comment: Mapped[str | None] = mapped_column(TypedText)  # of who closed it
    number: Mapped[int | None]  # the version that it became
