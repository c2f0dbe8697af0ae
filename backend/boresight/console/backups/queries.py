"""Queries on backups and their schedules."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.console.backups.tables import Backup, BackupSchedule
from boresight.platform.db.sessions import Session


def find_schedule(session: Session) -> BackupSchedule | None:
    """Return the newest schedule; None where there never was one."""
    return session.scalar(sa.select(BackupSchedule).order_by(BackupSchedule.id.desc()).limit(1))


def find_newest(session: Session, *states: str, schedule_id: int | None = None) -> Backup | None:
    """Return the newest backup, of all or in some states, and by any schedule or one."""
    query = sa.select(Backup)
    if states:
        query = query.where(Backup.state.in_(states))
    if schedule_id is not None:
        query = query.where(Backup.schedule_id == schedule_id)
    return session.scalar(query.order_by(Backup.id.desc()).limit(1))


def find_by_name(session: Session, name: str) -> Backup | None:
    """Return the backup with a file name."""
    return session.scalar(sa.select(Backup).where(Backup.name == name))


def list_newest(session: Session, limit: int | None, before_id: int | None = None) -> Sequence[Backup]:
    """Return the newest backups, of all or before one, newest first; None for all."""
    query = sa.select(Backup) if before_id is None else sa.select(Backup).where(Backup.id < before_id)
    return session.scalars(query.order_by(Backup.id.desc()).limit(limit)).all()


def list_stored(session: Session, destination: str) -> Sequence[Backup]:
    """Return the backups that have ended and whose files are at a place, oldest first."""
    schedules = sa.select(BackupSchedule.id).where(BackupSchedule.destination == destination)
    query = sa.select(Backup).where(
        Backup.schedule_id.in_(schedules),
        Backup.state.in_(("SUCCEEDED", "FAILED")),
        Backup.written_utc.is_not(None),
        Backup.removed_utc.is_(None),
    )
    return session.scalars(query.order_by(Backup.id)).all()
