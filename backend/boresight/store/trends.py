"""Queries on sensors over the mission, some at once: finished calibrations, the data behind them, baselines, records on board."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import Any

import sqlalchemy as sa

from boresight.store.documents import among
from boresight.store.sessions import Session
from boresight.store.tables import ParameterSet, Promotion, Run, Sensor, TelemetrySet, Uplink


def finished(session: Session, sensor_ids: Collection[int]) -> dict[int, list[Any]]:
    """Return sensor_id, id, telemetry_set_id, method, label, ended_utc and summary of the runs that succeeded, by sensor."""
    columns = (Run.sensor_id, Run.id, Run.telemetry_set_id, Run.method, Run.label, Run.ended_utc, Run.summary)
    query = sa.select(*columns).where(Run.sensor_id.in_(sensor_ids), Run.state == "SUCCEEDED")
    return _by_sensor(sensor_ids, session.execute(query.order_by(Run.sensor_id, Run.id)), lambda row: row)


def stamps(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, tuple[int, str | None]]:
    """Return of each sensor how many of its runs succeeded, and when the last of them ended: it changes when a trend does."""
    every = sa.select(Sensor.id)  # named, or SQLite reads every run that succeeded instead of an index by sensor
    counted = sa.select(Run.sensor_id, sa.func.count(Run.id), sa.func.max(Run.ended_utc)).group_by(Run.sensor_id)
    of_them = Run.sensor_id.in_(every) if sensor_ids is None else among(Run.sensor_id, sensor_ids)
    rows = session.execute(counted.where(of_them, Run.state == "SUCCEEDED"))
    return {sensor_id: (count, ended_utc) for sensor_id, count, ended_utc in rows}


def telemetry(session: Session, sensor_ids: Collection[int]) -> dict[int, dict[int, TelemetrySet]]:
    """Return all telemetry sets of each sensor, and those that its runs used, by number."""
    used = sa.select(Run.sensor_id, Run.telemetry_set_id).where(Run.sensor_id.in_(sensor_ids)).distinct()
    pairs = {(sensor_id, set_id) for sensor_id, set_id in session.execute(used)}
    named = sa.or_(TelemetrySet.sensor_id.in_(sensor_ids), TelemetrySet.id.in_({set_id for _, set_id in pairs}))
    sets = {row.id: row for row in session.scalars(sa.select(TelemetrySet).where(named).order_by(TelemetrySet.id))}
    pairs |= {(row.sensor_id, row.id) for row in sets.values()}
    return {
        sensor_id: {number: sets[number] for number in sets if (sensor_id, number) in pairs} for sensor_id in sensor_ids
    }


def baselines(session: Session, sensor_ids: Collection[int]) -> dict[int, list[tuple[Promotion, ParameterSet]]]:
    """Return the promotions of each sensor with their sets, oldest first."""
    query = sa.select(Promotion.sensor_id, Promotion, ParameterSet).where(Promotion.sensor_id.in_(sensor_ids))
    query = query.join(ParameterSet, Promotion.parameter_set_id == ParameterSet.id)
    rows = session.execute(query.order_by(Promotion.at_utc, Promotion.id))
    return _by_sensor(sensor_ids, rows, lambda row: (row[1], row[2]))


def records(session: Session, sensor_ids: Collection[int]) -> dict[int, list[tuple[Uplink, ParameterSet]]]:
    """Return what was recorded on board of each sensor's sets, oldest first."""
    query = sa.select(ParameterSet.sensor_id, Uplink, ParameterSet).where(ParameterSet.sensor_id.in_(sensor_ids))
    query = query.join(ParameterSet, Uplink.parameter_set_id == ParameterSet.id)
    return _by_sensor(sensor_ids, session.execute(query.order_by(Uplink.id)), lambda row: (row[1], row[2]))


def _by_sensor(sensor_ids: Collection[int], rows: Iterable[Any], part: Callable[[Any], Any]) -> dict[int, list[Any]]:
    """Sort rows, whose first column is a sensor, under their sensors."""
    found: dict[int, list[Any]] = {sensor_id: [] for sensor_id in sensor_ids}
    for row in rows:
        found[row[0]].append(part(row))
    return found


def recent_summaries(session: Session, sensor_ids: Collection[int], limit: int) -> dict[int, list[dict[str, Any]]]:
    """Return of some sensors the summaries of their newest runs that succeeded, oldest first."""
    succeeded = sa.select(Run.id).where(Run.sensor_id == Sensor.id, Run.state == "SUCCEEDED").correlate(Sensor)
    first = succeeded.order_by(Run.id.desc()).offset(limit - 1).limit(1).scalar_subquery()
    query = sa.select(Run.sensor_id, Run.summary).join(Sensor, Run.sensor_id == Sensor.id)
    query = query.where(Sensor.id.in_(sensor_ids), Run.state == "SUCCEEDED", Run.id >= sa.func.coalesce(first, 0))
    found: dict[int, list[dict[str, Any]]] = {}
    for sensor_id, summary in session.execute(query.order_by(Run.id)):
        found.setdefault(sensor_id, []).append(summary or {})
    return found
