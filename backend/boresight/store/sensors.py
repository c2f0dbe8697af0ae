"""Queries on sensors."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import Approval, ParameterSet, Run, Sensor, TelemetrySet


def sensor_named(session: Session, name: str) -> Sensor | None:
    """Return the sensor with a name."""
    return session.scalar(sa.select(Sensor).where(Sensor.name == name))


def sensors(session: Session, sensor_ids: Collection[int] | None = None) -> Sequence[Sensor]:
    """Return the fleet, or some of it, by name."""
    query = sa.select(Sensor).where(*_of(Sensor.id, sensor_ids))
    return session.scalars(query.order_by(Sensor.name)).all()


def baselines(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, ParameterSet]:
    """Return each sensor's baseline, or those of some, by sensor."""
    query = sa.select(ParameterSet).where(ParameterSet.ground_state == "BASELINE")
    return {row.sensor_id: row for row in session.scalars(query.where(*_of(ParameterSet.sensor_id, sensor_ids)))}


def last_runs(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, Run]:
    """Return each sensor's newest run, or those of some, by sensor."""
    newest = sa.select(sa.func.max(Run.id)).where(*_of(Run.sensor_id, sensor_ids)).group_by(Run.sensor_id)
    return {row.sensor_id: row for row in session.scalars(sa.select(Run).where(Run.id.in_(newest)))}


def set_counts(session: Session) -> dict[int, int]:
    """Count each sensor's telemetry sets that are in use, by sensor."""
    query = sa.select(TelemetrySet.sensor_id, sa.func.count()).where(TelemetrySet.archived_utc.is_(None))
    return {sensor_id: count for sensor_id, count in session.execute(query.group_by(TelemetrySet.sensor_id))}  # noqa: C416 - rows are not pairs to a type checker


def waiting_approvals(session: Session) -> dict[int, str]:
    """Return the name of a set that waits for a signature, by sensor."""
    query = sa.select(ParameterSet.sensor_id, ParameterSet.name).join(Approval).where(Approval.state == "OPEN")
    return {sensor_id: name for sensor_id, name in session.execute(query)}  # noqa: C416 - rows are not pairs to a type checker


def onboard_sets(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, list[ParameterSet]]:
    """Return the sets whose on-board state says something about what a sensor runs with, by sensor; not those without any."""
    query = sa.select(ParameterSet).where(ParameterSet.onboard_state.in_(("ACTIVE", "MISMATCH")))
    found: dict[int, list[ParameterSet]] = {}
    for row in session.scalars(query.where(*_of(ParameterSet.sensor_id, sensor_ids))):
        found.setdefault(row.sensor_id, []).append(row)
    return found


def _of(column: Any, sensor_ids: Collection[int] | None) -> list[sa.ColumnElement[bool]]:
    """Keep to some sensors where some are named."""
    return [] if sensor_ids is None else [column.in_(sensor_ids)]
