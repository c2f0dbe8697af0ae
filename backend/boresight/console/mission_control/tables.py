"""How far each link to a mission control system has come."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.mission_control.systems import TITLES
from boresight.platform.db.declared import STRICT, Base, Sealing, allow_only, only_one

#: Failures in a row after which an alarm is raised; with the waits between them, eight minutes.
FAILURES_TOLD = 6


class MissionControlLink(Base):
    """The telemetry of a sensor from an archive or, without a sensor, the events that a system is told."""

    __tablename__ = "mission_control_links"
    noun = "mission control link"
    __table_args__ = (
        allow_only("system", tuple(TITLES)),
        only_one("uq_mission_control_links_one_a_sensor", "sensor_id", "sensor_id IS NOT NULL"),
        only_one("uq_mission_control_links_one_of_events", "system", "sensor_id IS NULL"),
        STRICT,
    )
    sealing = Sealing(unsealed="is how far a link has come; what it brought and told is sealed")
    id: Mapped[int] = mapped_column(primary_key=True)
    system: Mapped[str] = mapped_column(sa.Text)
    sensor_id: Mapped[int | None] = mapped_column(sa.ForeignKey("sensors.id"))
    begins_utc: Mapped[str] = mapped_column(sa.Text)  # nothing before it is asked for
    asked_to_utc: Mapped[str] = mapped_column(sa.Text)  # the end of the newest range that was taken
    taken: Mapped[bytes] = mapped_column(sa.LargeBinary, default=b"")  # times of rows taken within the look-back
    told_audit_id: Mapped[int] = mapped_column(default=0)  # the newest audit record that was told, or passed over
    due_utc: Mapped[str] = mapped_column(sa.Text)  # not tried before
    succeeded_utc: Mapped[str | None] = mapped_column(sa.Text)
    failures: Mapped[int] = mapped_column(default=0)  # in a row
    fault: Mapped[str] = mapped_column(sa.Text, default="")  # of the newest one, a sentence
    version: Mapped[int] = mapped_column(default=1)
