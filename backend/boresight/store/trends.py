"""Queries on a sensor over the mission: its finished calibrations, the data behind them, its baselines, its records on board."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import ParameterSet, Promotion, Run, Sensor, TelemetrySet, Uplink


def finished(session: Session, sensor_id: int) -> Sequence[Any]:
    """Return id, telemetry_set_id, method, label, ended_utc and summary of a sensor's runs that succeeded."""
    columns = (Run.id, Run.telemetry_set_id, Run.method, Run.label, Run.ended_utc, Run.summary)
    query = sa.select(*columns).where(Run.sensor_id == sensor_id, Run.state == "SUCCEEDED")
    return session.execute(query.order_by(Run.id)).all()


def stamps(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, tuple[int, str | None]]:
    """Return of each sensor how many of its runs succeeded, and when the last of them ended: it changes when a trend does."""
    every = sa.select(Sensor.id)  # named, or SQLite reads every run that succeeded instead of an index by sensor
    counted = sa.select(Run.sensor_id, sa.func.count(Run.id), sa.func.max(Run.ended_utc)).group_by(Run.sensor_id)
    counted = counted.where(Run.sensor_id.in_(every if sensor_ids is None else sensor_ids), Run.state == "SUCCEEDED")
    rows = session.execute(counted)
    return {sensor_id: (count, ended_utc) for sensor_id, count, ended_utc in rows}


def telemetry(session: Session, sensor_id: int) -> dict[int, TelemetrySet]:
    """Return all telemetry sets of a sensor, and those that its runs used, by number."""
    used = sa.select(Run.telemetry_set_id).where(Run.sensor_id == sensor_id)
    query = sa.select(TelemetrySet).where(sa.or_(TelemetrySet.sensor_id == sensor_id, TelemetrySet.id.in_(used)))
    return {row.id: row for row in session.scalars(query.order_by(TelemetrySet.id))}


def baselines(session: Session, sensor_id: int) -> Sequence[tuple[Promotion, ParameterSet]]:
    """Return a sensor's promotions with their sets, oldest first."""
    query = sa.select(Promotion, ParameterSet).join(ParameterSet, Promotion.parameter_set_id == ParameterSet.id)
    rows = session.execute(query.where(Promotion.sensor_id == sensor_id).order_by(Promotion.at_utc, Promotion.id))
    return [(promotion, row) for promotion, row in rows]


def records(session: Session, sensor_id: int) -> Sequence[tuple[Uplink, ParameterSet]]:
    """Return what was recorded on board of a sensor's sets, oldest first."""
    query = sa.select(Uplink, ParameterSet).join(ParameterSet, Uplink.parameter_set_id == ParameterSet.id)
    rows = session.execute(query.where(ParameterSet.sensor_id == sensor_id).order_by(Uplink.id))
    return [(uplink, row) for uplink, row in rows]


def recent_summaries(session: Session, limit: int) -> dict[int, list[dict[str, Any]]]:
    """Return of each sensor the summaries of its newest runs that succeeded, oldest first."""
    place = sa.func.row_number().over(partition_by=Run.sensor_id, order_by=Run.id.desc())
    newest = sa.select(Run.id, place.label("place")).where(Run.state == "SUCCEEDED").subquery()
    query = sa.select(Run.sensor_id, Run.summary).join(newest, newest.c.id == Run.id).where(newest.c.place <= limit)
    found: dict[int, list[dict[str, Any]]] = {}
    for sensor_id, summary in session.execute(query.order_by(Run.id)):
        found.setdefault(sensor_id, []).append(summary or {})
    return found
