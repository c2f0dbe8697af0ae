"""Queries on links to mission control systems."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sqlalchemy as sa

from boresight.console.mission_control.tables import MissionControlLink
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Session


def find_link(session: Session, sensor_id: int) -> MissionControlLink | None:
    """Return the link that a sensor's telemetry comes by."""
    return session.scalar(sa.select(MissionControlLink).where(MissionControlLink.sensor_id == sensor_id))


def find_event_link(session: Session, system: str) -> MissionControlLink | None:
    """Return the link that a system is told events by."""
    row = MissionControlLink
    return session.scalar(sa.select(row).where(row.sensor_id.is_(None), row.system == system))


def read_failing(session: Session, failures: int) -> Mapping[int | None, MissionControlLink]:
    """Return the links that failed at least so often in a row, by sensor; None for that of events."""
    query = sa.select(MissionControlLink).where(MissionControlLink.failures >= failures)
    return {row.sensor_id: row for row in session.scalars(query)}


def list_records_after(session: Session, record_id: int, limit: int) -> Sequence[AuditRecord]:
    """Return the audit records after one, oldest first."""
    query = sa.select(AuditRecord).where(AuditRecord.id > record_id).order_by(AuditRecord.id).limit(limit)
    return session.scalars(query).all()
