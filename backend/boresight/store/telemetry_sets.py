"""Queries on telemetry sets."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import TelemetrySet


def set_with_bytes(session: Session, sensor_id: int, original_sha256: str) -> TelemetrySet | None:
    """Return the sensor's set that was uploaded as these bytes."""
    query = sa.select(TelemetrySet).where(TelemetrySet.sensor_id == sensor_id)
    return session.scalar(query.where(TelemetrySet.original_sha256 == original_sha256))


def sets(
    session: Session, *, sensor_id: int | None, purpose: str | None, archived: bool, before_id: int | None, limit: int
) -> Sequence[TelemetrySet]:
    """Return a page of sets, newest first."""
    query = sa.select(TelemetrySet).order_by(TelemetrySet.id.desc()).limit(limit)
    if sensor_id is not None:
        query = query.where(TelemetrySet.sensor_id == sensor_id)
    if purpose is not None:
        query = query.where(TelemetrySet.purpose == purpose)
    if not archived:
        query = query.where(TelemetrySet.archived_utc.is_(None))
    if before_id is not None:
        query = query.where(TelemetrySet.id < before_id)
    return session.scalars(query).all()


def names(session: Session, set_ids: Collection[int] | None) -> dict[int, str]:
    """Return the names of sets by their numbers; of all where None is given."""
    query = sa.select(TelemetrySet.id, TelemetrySet.name)
    if set_ids is not None:
        query = query.where(TelemetrySet.id.in_(set_ids))
    return {row[0]: row[1] for row in session.execute(query)}
