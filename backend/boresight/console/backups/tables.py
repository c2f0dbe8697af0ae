"""Schedules of backups, and the backups that were taken by them."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base, Sealing, allow_only

BACKUP_STATES = ("RUNNING", "TESTING", "SUCCEEDED", "FAILED")
ENDED_STATES = ("SUCCEEDED", "FAILED")


class BackupSchedule(Base):
    """When backups are taken, where they go and how long they are kept; the newest row is in force, and none is ever changed."""

    __tablename__ = "backup_schedules"
    noun = "backup schedule"
    __table_args__ = (STRICT,)
    id: Mapped[int] = mapped_column(primary_key=True)
    destination: Mapped[str] = mapped_column(sa.Text)  # a folder or the address of a bucket; empty: no backups any more
    at_minute: Mapped[int] = mapped_column()  # of the day, UTC
    every_hours: Mapped[int] = mapped_column()
    keep_daily: Mapped[int] = mapped_column()
    keep_weekly: Mapped[int] = mapped_column()
    keep_monthly: Mapped[int] = mapped_column()
    created_utc: Mapped[str] = mapped_column(sa.Text)
    created_by: Mapped[int | None] = mapped_column(sa.ForeignKey("users.id"))


class Backup(Base):
    """A backup by a schedule: RUNNING while it is written, TESTING while it is restored, then SUCCEEDED or FAILED."""

    __tablename__ = "backups"
    noun = "backup"
    __table_args__ = (allow_only("state", BACKUP_STATES), sa.Index("ix_backups_state_id", "state", "id"), STRICT)
    sealing = Sealing(
        fleeting={"lease_until_utc": "is renewed while the backup is taken"},
        moving=frozenset(
            (
                "state",
                "attempt",
                "name",
                "started_utc",
                "written_utc",
                "ended_utc",
                "sentence",
                "size_bytes",
                "key_id",
                "files",
                "head",
                "tested_utc",
                "removed_utc",
            )
        ),
        settled=ENDED_STATES,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    schedule_id: Mapped[int] = mapped_column(sa.ForeignKey("backup_schedules.id"))
    due_utc: Mapped[str] = mapped_column(sa.Text)  # the time of the schedule that it is taken for
    state: Mapped[str] = mapped_column(sa.Text)
    attempt: Mapped[int] = mapped_column()
    name: Mapped[str] = mapped_column(sa.Text)
    started_utc: Mapped[str] = mapped_column(sa.Text)
    lease_until_utc: Mapped[str | None] = mapped_column(sa.Text)
    written_utc: Mapped[str | None] = mapped_column(sa.Text)
    ended_utc: Mapped[str | None] = mapped_column(sa.Text)
    sentence: Mapped[str | None] = mapped_column(sa.Text)  # what the restore test found, or why the backup failed
    size_bytes: Mapped[int | None] = mapped_column(sa.BigInteger().with_variant(sa.Integer, "sqlite"))
    key_id: Mapped[str | None] = mapped_column(sa.Text)
    files: Mapped[int | None] = mapped_column()
    head: Mapped[str | None] = mapped_column(sa.Text)  # of the audit log, when it was taken
    tested_utc: Mapped[str | None] = mapped_column(sa.Text)  # the newest restore test
    removed_utc: Mapped[str | None] = mapped_column(sa.Text)  # its file was removed: newer ones took its place
