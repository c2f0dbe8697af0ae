"""Queries on sensors: whole rows, names, and heads, which say how a sensor stands without the documents that are most of a row."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

import sqlalchemy as sa

from boresight.store.documents import among
from boresight.store.sessions import Session
from boresight.store.tables import Approval, ParameterSet, Run, Sensor, TelemetrySet


def sensor_named(session: Session, name: str) -> Sensor | None:
    """Return the sensor with a name."""
    return session.scalar(sa.select(Sensor).where(Sensor.name == name))


def sensors(session: Session, sensor_ids: Collection[int] | None = None, *, documents: bool = True) -> Sequence[Sensor]:
    """Return the fleet, or some of it, by name; on request without their documents, which then cannot be asked for."""
    query = (
        sa.select(Sensor).where(*_of(Sensor.id, sensor_ids)).options(*_but(documents, Sensor.document, Sensor.truth))
    )
    return session.scalars(query.order_by(Sensor.name)).all()


def sensor_heads(session: Session, sensor_ids: Collection[int] | None = None) -> Sequence[Any]:
    """Return id, name and version of the sensors of the fleet, or of some, by name."""
    query = sa.select(Sensor.id, Sensor.name, Sensor.version).where(*_of(Sensor.id, sensor_ids))
    return session.execute(query.order_by(Sensor.name)).all()


def names(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, str]:
    """Return the names of the fleet, or of some sensors, by their numbers."""
    query = sa.select(Sensor.id, Sensor.name).where(*_of(Sensor.id, sensor_ids))
    return {row[0]: row[1] for row in session.execute(query)}


def names_holding(session: Session, text: str, limit: int) -> dict[int, str]:
    """Return the first sensors by name whose name holds a text in letters of either case, their names by their numbers."""
    query = sa.select(Sensor.id, Sensor.name).where(*_holding(text)).order_by(Sensor.name).limit(limit)
    return {row[0]: row[1] for row in session.execute(query)}


def count_holding(session: Session, text: str) -> int:
    """Count the sensors whose name holds a text in letters of either case."""
    return session.scalar(sa.select(sa.func.count(Sensor.name)).where(*_holding(text))) or 0


def _holding(text: str) -> list[sa.ColumnElement[bool]]:
    """Keep to names that hold a text; every name holds nothing."""
    return [Sensor.name.icontains(text, autoescape=True)] if text else []


def baselines(
    session: Session, sensor_ids: Collection[int] | None = None, *, documents: bool = True
) -> dict[int, ParameterSet]:
    """Return each sensor's baseline, or those of some, by sensor; on request without their documents."""
    query = _baselines(sensor_ids, ParameterSet).options(*_but(documents, ParameterSet.document))
    return {row.sensor_id: row for row in session.scalars(query)}


def baseline_heads(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, Any]:
    """Return id, name, run_id and baseline_from_utc of each sensor's baseline, or of those of some, by sensor."""
    columns = (ParameterSet.sensor_id, ParameterSet.id, ParameterSet.name, ParameterSet.run_id)
    query = _baselines(sensor_ids, *columns, ParameterSet.baseline_from_utc)
    return {row.sensor_id: row for row in session.execute(query)}


def _baselines(sensor_ids: Collection[int] | None, *columns: Any) -> sa.Select[Any]:
    query = sa.select(*columns).where(ParameterSet.ground_state == "BASELINE")
    return query.where(*_of(ParameterSet.sensor_id, sensor_ids))


def last_runs(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, Run]:
    """Return each sensor's newest run, or those of some, by sensor, without their sensors' documents."""
    query = _last_runs(sensor_ids, Run).options(*_but(False, Run.sensor_document, Run.settings))
    return {row.sensor_id: row for row in session.scalars(query)}


def last_run_heads(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, Any]:
    """Return id, state, reason and summary of each sensor's newest run, or of those of some, by sensor."""
    query = _last_runs(sensor_ids, Run.sensor_id, Run.id, Run.state, Run.reason, Run.summary)
    return {row.sensor_id: row for row in session.execute(query)}


def _last_runs(sensor_ids: Collection[int] | None, *columns: Any) -> sa.Select[Any]:
    """Ask each sensor for its newest run: the end of an index, however many it has."""
    newest = sa.select(sa.func.max(Run.id)).where(Run.sensor_id == Sensor.id).correlate(Sensor).scalar_subquery()
    of_each = sa.select(newest).select_from(Sensor).where(*_of(Sensor.id, sensor_ids))
    return sa.select(*columns).where(Run.id.in_(of_each))


def set_counts(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, int]:
    """Count the telemetry sets that are in use of each sensor, or of some, by sensor."""
    query = sa.select(TelemetrySet.sensor_id, sa.func.count()).where(TelemetrySet.archived_utc.is_(None))
    query = query.where(*_of(TelemetrySet.sensor_id, sensor_ids))
    return {sensor_id: count for sensor_id, count in session.execute(query.group_by(TelemetrySet.sensor_id))}  # noqa: C416 - rows are not pairs to a type checker


def waiting_approvals(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, str]:
    """Return the name of a set that waits for a signature, by sensor."""
    query = sa.select(ParameterSet.sensor_id, ParameterSet.name).join(Approval).where(Approval.state == "OPEN")
    query = query.where(*_of(ParameterSet.sensor_id, sensor_ids))
    return {sensor_id: name for sensor_id, name in session.execute(query)}  # noqa: C416 - rows are not pairs to a type checker


def onboard_sets(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, list[ParameterSet]]:
    """Return the sets whose on-board state says something about what a sensor runs with, by sensor; not those without any.

    They come without their documents.
    """
    return _by_sensor(session.scalars(_onboard(sensor_ids, ParameterSet).options(*_but(False, ParameterSet.document))))


def onboard_heads(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, list[Any]]:
    """Return id, name and onboard_state of those same sets, by sensor."""
    columns = (ParameterSet.sensor_id, ParameterSet.id, ParameterSet.name, ParameterSet.onboard_state)
    return _by_sensor(session.execute(_onboard(sensor_ids, *columns)))


def _onboard(sensor_ids: Collection[int] | None, *columns: Any) -> sa.Select[Any]:
    query = sa.select(*columns).where(ParameterSet.onboard_state.in_(("ACTIVE", "MISMATCH")))
    return query.where(*_of(ParameterSet.sensor_id, sensor_ids))


def _but(whole: bool, *documents: Any) -> list[Any]:
    """Leave documents out, which are most of a row and of the time that it takes to read, unless rows are asked for whole."""
    return [] if whole else [sa.orm.defer(column, raiseload=True) for column in documents]


def _by_sensor(found: Iterable[Any]) -> dict[int, list[Any]]:
    """Put rows under their sensors."""
    by_sensor: dict[int, list[Any]] = {}
    for row in found:
        by_sensor.setdefault(row.sensor_id, []).append(row)
    return by_sensor


def _of(column: Any, sensor_ids: Collection[int] | None) -> list[sa.ColumnElement[bool]]:
    """Keep to some sensors where some are named."""
    return [] if sensor_ids is None else [among(column, sensor_ids)]
