"""Queries on sensors: rows, names and heads; calibrations, data and records over the mission; what happened, in order.

A head is a row without its documents, which are most of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import sqlalchemy as sa

from boresight.console.access.tables import User
from boresight.console.approvals.tables import Approval, GateProfile, Signature, Waiver
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.console.runs.tables import CALIBRATIONS, Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.uplinks.tables import Package, TableDefinition, Uplink
from boresight.platform.db.documents import among
from boresight.platform.db.sessions import Session
from boresight.verdicts.verdict import RunSummary, parse_run_summary


def find_sensor(session: Session, name: str) -> Sensor | None:
    """Return the sensor with a name."""
    return session.scalar(sa.select(Sensor).where(Sensor.name == name))


def list_sensors(
    session: Session, sensor_ids: Collection[int] | None = None, *, documents: bool = True
) -> Sequence[Sensor]:
    """Return the fleet, or some of it, by name; on request without the documents, which then cannot be read."""
    query = (
        sa.select(Sensor)
        .where(*_filter_sensors(Sensor.id, sensor_ids))
        .options(*_but(documents, Sensor.document, Sensor.truth))
    )
    return session.scalars(query.order_by(Sensor.name)).all()


def list_sensor_heads(session: Session, sensor_ids: Collection[int] | None = None) -> Sequence[Any]:
    """Return id, name and version of the sensors of the fleet, or of some, by name."""
    query = sa.select(Sensor.id, Sensor.name, Sensor.version).where(*_filter_sensors(Sensor.id, sensor_ids))
    return session.execute(query.order_by(Sensor.name)).all()


def list_camera_models(session: Session) -> list[str]:
    """Return the camera models of the registered sensors, that of the most sensors first."""
    documents = session.scalars(sa.select(Sensor.document))
    return [name for name, _ in Counter(str(document["camera_model"]) for document in documents).most_common()]


def read_names(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, str]:
    """Return the names of the fleet, or of some sensors, by their numbers."""
    query = sa.select(Sensor.id, Sensor.name).where(*_filter_sensors(Sensor.id, sensor_ids))
    return {row[0]: row[1] for row in session.execute(query)}


def read_names_holding(session: Session, text: str, limit: int) -> dict[int, str]:
    """Return id and name of the first sensors, by name, whose name contains a text in upper or lower case."""
    query = sa.select(Sensor.id, Sensor.name).where(*_holding(text)).order_by(Sensor.name).limit(limit)
    return {row[0]: row[1] for row in session.execute(query)}


def count_holding(session: Session, text: str) -> int:
    """Count the sensors whose name contains a text in upper or lower case."""
    return session.scalar(sa.select(sa.func.count(Sensor.name)).where(*_holding(text))) or 0


def _holding(text: str) -> list[sa.ColumnElement[bool]]:
    """Return the condition that a name contains a text; an empty text matches every name."""
    return [Sensor.name.icontains(text, autoescape=True)] if text else []


def list_baselines(
    session: Session, sensor_ids: Collection[int] | None = None, *, documents: bool = True
) -> dict[int, ParameterSet]:
    """Return each sensor's baseline, or those of some, by sensor; on request without their documents."""
    query = _baselines(sensor_ids, ParameterSet).options(*_but(documents, ParameterSet.document))
    return {row.sensor_id: row for row in session.scalars(query)}


def list_baseline_heads(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, Any]:
    """Return id, name, run_id and baseline_from_utc of each sensor's baseline, or of those of some, by sensor."""
    columns = (ParameterSet.sensor_id, ParameterSet.id, ParameterSet.name, ParameterSet.run_id)
    query = _baselines(sensor_ids, *columns, ParameterSet.baseline_from_utc)
    return {row.sensor_id: row for row in session.execute(query)}


def _baselines(sensor_ids: Collection[int] | None, *columns: Any) -> sa.Select[Any]:
    query = sa.select(*columns).where(ParameterSet.ground_state == "BASELINE")
    return query.where(*_filter_sensors(ParameterSet.sensor_id, sensor_ids))


def list_last_runs(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, Run]:
    """Return each sensor's newest run, or those of some, by sensor, without their sensors' documents."""
    query = _last_runs(sensor_ids, Run).options(*_but(False, Run.sensor_document, Run.settings))
    return {row.sensor_id: row for row in session.scalars(query)}


def list_last_run_heads(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, Any]:
    """Return id, state, reason and summary of each sensor's newest run, or of those of some, by sensor."""
    query = _last_runs(sensor_ids, Run.sensor_id, Run.id, Run.state, Run.reason, Run.summary)
    return {row.sensor_id: row for row in session.execute(query)}


def _last_runs(sensor_ids: Collection[int] | None, *columns: Any) -> sa.Select[Any]:
    """Select each sensor's newest calibration by the end of an index, fast for any number of runs."""
    newest = (
        sa.select(sa.func.max(Run.id))
        .where(Run.sensor_id == Sensor.id, CALIBRATIONS)
        .correlate(Sensor)
        .scalar_subquery()
    )
    of_each = sa.select(newest).select_from(Sensor).where(*_filter_sensors(Sensor.id, sensor_ids))
    return sa.select(*columns).where(Run.id.in_(of_each))


def count_sets(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, int]:
    """Count the telemetry sets that are in use of each sensor, or of some, by sensor."""
    query = sa.select(TelemetrySet.sensor_id, sa.func.count()).where(TelemetrySet.archived_utc.is_(None))
    query = query.where(*_filter_sensors(TelemetrySet.sensor_id, sensor_ids))
    return {sensor_id: count for sensor_id, count in session.execute(query.group_by(TelemetrySet.sensor_id))}  # noqa: C416 - rows are not pairs to a type checker


def read_waiting_approvals(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, str]:
    """Return the name of a set that waits for a signature, by sensor."""
    query = sa.select(ParameterSet.sensor_id, ParameterSet.name).join(Approval).where(Approval.state == "OPEN")
    query = query.where(*_filter_sensors(ParameterSet.sensor_id, sensor_ids))
    return {sensor_id: name for sensor_id, name in session.execute(query)}  # noqa: C416 - rows are not pairs to a type checker


def list_onboard_sets(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, list[ParameterSet]]:
    """Return the sets, without documents, with the on-board state that determines what a sensor runs with, by sensor."""
    return _by_sensor(session.scalars(_onboard(sensor_ids, ParameterSet).options(*_but(False, ParameterSet.document))))


def list_onboard_heads(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, list[Any]]:
    """Return id, name and onboard_state of those same sets, by sensor."""
    columns = (ParameterSet.sensor_id, ParameterSet.id, ParameterSet.name, ParameterSet.onboard_state)
    return _by_sensor(session.execute(_onboard(sensor_ids, *columns)))


def _onboard(sensor_ids: Collection[int] | None, *columns: Any) -> sa.Select[Any]:
    query = sa.select(*columns).where(ParameterSet.onboard_state.in_(("ACTIVE", "MISMATCH")))
    return query.where(*_filter_sensors(ParameterSet.sensor_id, sensor_ids))


def _but(whole: bool, *documents: Any) -> list[Any]:
    """Defer the documents of rows, which take most of the reading time, unless whole rows are asked for."""
    return [] if whole else [sa.orm.defer(column, raiseload=True) for column in documents]


def _by_sensor(found: Iterable[Any]) -> dict[int, list[Any]]:
    by_sensor: dict[int, list[Any]] = {}
    for row in found:
        by_sensor.setdefault(row.sensor_id, []).append(row)
    return by_sensor


def _filter_sensors(column: Any, sensor_ids: Collection[int] | None) -> list[sa.ColumnElement[bool]]:
    """Restrict a query to some sensors where some are named."""
    return [] if sensor_ids is None else [among(column, sensor_ids)]


def list_finished_runs(session: Session, sensor_ids: Collection[int]) -> dict[int, list[Any]]:
    """Return sensor_id, id, telemetry_set_id, method, label, ended_utc and summary of the runs that succeeded, by sensor."""
    columns = (Run.sensor_id, Run.id, Run.telemetry_set_id, Run.method, Run.label, Run.ended_utc, Run.summary)
    query = sa.select(*columns).where(Run.sensor_id.in_(sensor_ids), Run.state == "SUCCEEDED", CALIBRATIONS)
    return _trend_by_sensor(sensor_ids, session.execute(query.order_by(Run.sensor_id, Run.id)), lambda row: row)


def list_failed_sets(session: Session, sensor_ids: Collection[int]) -> set[tuple[int, int]]:
    """Return sensor_id and telemetry_set_id of the sets whose newest calibration failed."""
    newest = sa.select(sa.func.max(Run.id)).where(Run.sensor_id.in_(sensor_ids), CALIBRATIONS)
    newest = newest.group_by(Run.sensor_id, Run.telemetry_set_id)
    query = sa.select(Run.sensor_id, Run.telemetry_set_id).where(Run.id.in_(newest), Run.state == "FAILED")
    return {(sensor_id, set_id) for sensor_id, set_id in session.execute(query)}


def read_trend_stamps(session: Session, sensor_ids: Collection[int] | None = None) -> dict[int, tuple[int, str | None]]:
    """Return for each sensor how many of its runs succeeded and when the last one ended, which changes when its trend does."""
    every = sa.select(Sensor.id)  # makes SQLite use an index by sensor
    counted = sa.select(Run.sensor_id, sa.func.count(Run.id), sa.func.max(Run.ended_utc)).group_by(Run.sensor_id)
    of_them = Run.sensor_id.in_(every) if sensor_ids is None else among(Run.sensor_id, sensor_ids)
    rows = session.execute(counted.where(of_them, Run.state == "SUCCEEDED", CALIBRATIONS))
    return {sensor_id: (count, ended_utc) for sensor_id, count, ended_utc in rows}


def list_telemetry(session: Session, sensor_ids: Collection[int]) -> dict[int, dict[int, TelemetrySet]]:
    """Return all telemetry sets of each sensor, and those that its runs used, by number."""
    used = sa.select(Run.sensor_id, Run.telemetry_set_id).where(Run.sensor_id.in_(sensor_ids)).distinct()
    pairs = {(sensor_id, set_id) for sensor_id, set_id in session.execute(used)}
    named = sa.or_(TelemetrySet.sensor_id.in_(sensor_ids), TelemetrySet.id.in_({set_id for _, set_id in pairs}))
    sets = {row.id: row for row in session.scalars(sa.select(TelemetrySet).where(named).order_by(TelemetrySet.id))}
    pairs |= {(row.sensor_id, row.id) for row in sets.values()}
    return {
        sensor_id: {number: sets[number] for number in sets if (sensor_id, number) in pairs} for sensor_id in sensor_ids
    }


def list_baselines_over_time(
    session: Session, sensor_ids: Collection[int]
) -> dict[int, list[tuple[Promotion, ParameterSet]]]:
    """Return the promotions of each sensor with their sets, oldest first."""
    query = sa.select(Promotion.sensor_id, Promotion, ParameterSet).where(Promotion.sensor_id.in_(sensor_ids))
    query = query.join(ParameterSet, Promotion.parameter_set_id == ParameterSet.id)
    rows = session.execute(query.order_by(Promotion.at_utc, Promotion.id))
    return _trend_by_sensor(sensor_ids, rows, lambda row: (row[1], row[2]))


def list_records(session: Session, sensor_ids: Collection[int]) -> dict[int, list[tuple[Uplink, ParameterSet]]]:
    """Return the states that were recorded on board of each sensor's sets, oldest first."""
    query = sa.select(ParameterSet.sensor_id, Uplink, ParameterSet)
    query = query.where(ParameterSet.sensor_id.in_(sensor_ids), Uplink.leaves_state.is_(None))
    query = query.join(ParameterSet, Uplink.parameter_set_id == ParameterSet.id)
    return _trend_by_sensor(sensor_ids, session.execute(query.order_by(Uplink.id)), lambda row: (row[1], row[2]))


def _trend_by_sensor(
    sensor_ids: Collection[int], rows: Iterable[Any], part: Callable[[Any], Any]
) -> dict[int, list[Any]]:
    found: dict[int, list[Any]] = {sensor_id: [] for sensor_id in sensor_ids}
    for row in rows:
        found[row[0]].append(part(row))
    return found


def list_recent_summaries(session: Session, sensor_ids: Collection[int], limit: int) -> dict[int, list[RunSummary]]:
    """Return of some sensors the summaries of their newest runs that succeeded, oldest first."""
    succeeded = sa.select(Run.id).where(Run.sensor_id == Sensor.id, Run.state == "SUCCEEDED", CALIBRATIONS)
    succeeded = succeeded.correlate(Sensor)
    first = succeeded.order_by(Run.id.desc()).offset(limit - 1).limit(1).scalar_subquery()
    query = sa.select(Run.sensor_id, Run.summary).join(Sensor, Run.sensor_id == Sensor.id)
    query = query.where(Sensor.id.in_(sensor_ids), Run.state == "SUCCEEDED", CALIBRATIONS)
    query = query.where(Run.id >= sa.func.coalesce(first, 0))
    found: dict[int, list[RunSummary]] = {}
    for sensor_id, summary in session.execute(query.order_by(Run.id)):
        found.setdefault(sensor_id, []).append(parse_run_summary(summary))
    return found


KINDS = ("table definition", "gate profile", "request", "waiver", "signature", "promotion", "package", "uplink")
Versioned = TypeVar("Versioned", GateProfile, TableDefinition)


class Key(NamedTuple):
    """The position of an event: its time, the index of its kind in KINDS, its row; keys sort as the events do."""

    at_utc: str
    kind: int
    row_id: int


def _make_sensor_queries(sensor_id: int) -> dict[str, tuple[Any, Any, sa.Select[Any]]]:
    """Return for every kind its table, the column of its time, and the query for a sensor's rows."""
    of_set = ParameterSet.sensor_id == sensor_id
    return {
        "table definition": _direct(TableDefinition, TableDefinition.created_utc, sensor_id),
        "gate profile": _direct(GateProfile, GateProfile.created_utc, sensor_id),
        "request": (Approval, Approval.submitted_utc, sa.select(Approval).join(ParameterSet).where(of_set)),
        "waiver": (Waiver, Waiver.made_utc, sa.select(Waiver).join(ParameterSet).where(of_set)),
        "signature": (
            Signature,
            Signature.signed_utc,
            sa.select(Signature).join(Approval).join(ParameterSet).where(of_set),
        ),
        "promotion": _direct(Promotion, Promotion.at_utc, sensor_id),
        "package": (Package, Package.created_utc, sa.select(Package).join(ParameterSet).where(of_set)),
        "uplink": (Uplink, Uplink.recorded_utc, sa.select(Uplink).join(ParameterSet).where(of_set)),
    }


def _direct(table: Any, time: Any, sensor_id: int) -> tuple[Any, Any, sa.Select[Any]]:
    """Return the query of a table that names its sensor itself."""
    return table, time, sa.select(table).where(table.sensor_id == sensor_id)


def list_event_keys(
    session: Session, sensor_id: int, *, until_utc: str | None, before: Key | None, limit: int | None
) -> Sequence[Key]:
    """Return the keys of a sensor's events, newest first, in one query over all kinds."""
    parts = [
        query.with_only_columns(
            time.label("at_utc"), sa.literal(KINDS.index(kind)).label("kind"), table.id.label("row_id")
        )
        for kind, (table, time, query) in _make_sensor_queries(sensor_id).items()
    ]
    every = sa.union_all(*parts).subquery()
    order = (every.c.at_utc, every.c.kind, every.c.row_id)
    query = sa.select(*order).order_by(*(column.desc() for column in order))
    if until_utc is not None:
        query = query.where(every.c.at_utc <= until_utc)
    if before is not None:
        query = query.where(sa.tuple_(*order) < sa.tuple_(*map(sa.literal, before)))
    return [Key(*row) for row in session.execute(query if limit is None else query.limit(limit))]


def find_event_key(session: Session, sensor_id: int, kind: int, row_id: int) -> Key | None:
    """Return the key of one event; None when it is not of this sensor."""
    table, time, query = _make_sensor_queries(sensor_id)[KINDS[kind]]
    at_utc = session.scalar(query.with_only_columns(time).where(table.id == row_id))
    return None if at_utc is None else Key(at_utc, kind, row_id)


def read_rows_at(session: Session, sensor_id: int, found: Sequence[Key]) -> dict[Key, Any]:
    """Return the row behind each key; one query a kind."""
    rows: dict[tuple[int, int], Any] = {}
    for kind, (table, _, query) in enumerate(_make_sensor_queries(sensor_id).values()):
        ids = [key.row_id for key in found if key.kind == kind]
        if ids:
            rows |= {(kind, row.id): row for row in session.scalars(query.where(table.id.in_(ids)))}
    return {key: rows[key.kind, key.row_id] for key in found}


def read_set_names(session: Session, sensor_id: int) -> dict[int, str]:
    """Return the names of a sensor's sets."""
    query = sa.select(ParameterSet.id, ParameterSet.name).where(ParameterSet.sensor_id == sensor_id)
    return {number: name for number, name in session.execute(query)}  # noqa: C416 - rows are not pairs to a type checker


def read_printed_names(session: Session) -> dict[int, str]:
    """Return everybody's printed name."""
    query = sa.select(User.id, User.printed_name)
    return {number: name for number, name in session.execute(query)}  # noqa: C416 - rows are not pairs to a type checker


def list_requests(session: Session, sensor_id: int) -> dict[int, Approval]:
    """Return every request for a sensor's sets, by its number."""
    query = sa.select(Approval).join(ParameterSet).where(ParameterSet.sensor_id == sensor_id)
    return {row.id: row for row in session.scalars(query)}


def read_first_promotions(session: Session, sensor_id: int) -> dict[int, int]:
    """Return the first promotion of each set that was ever baseline; any later one is a roll-back."""
    query = sa.select(Promotion.parameter_set_id, sa.func.min(Promotion.id)).where(Promotion.sensor_id == sensor_id)
    rows = session.execute(query.group_by(Promotion.parameter_set_id))
    return {set_id: first for set_id, first in rows}  # noqa: C416 - rows are not pairs to a type checker


def find_promotion_at(session: Session, sensor_id: int, time_utc: str) -> Promotion | None:
    """Return the promotion that a sensor's baseline at a time came from."""
    query = sa.select(Promotion).where(Promotion.sensor_id == sensor_id, Promotion.at_utc <= time_utc)
    return session.scalar(query.order_by(Promotion.at_utc.desc(), Promotion.id.desc()).limit(1))


def find_in_force_at(session: Session, table: type[Versioned], sensor_id: int, time_utc: str) -> Versioned | None:
    """Return the gate profile or table definition that was in force at a time."""
    query = sa.select(table).where(table.sensor_id == sensor_id, table.created_utc <= time_utc)
    return session.scalar(query.order_by(table.number.desc()).limit(1))


def list_records_after(session: Session, sensor_id: int, time_utc: str) -> Sequence[tuple[ParameterSet, Uplink]]:
    """Return the states that were recorded on board after a time, oldest first."""
    query = sa.select(ParameterSet, Uplink).join(Uplink, Uplink.parameter_set_id == ParameterSet.id)
    query = query.where(ParameterSet.sensor_id == sensor_id, Uplink.recorded_utc > time_utc)
    query = query.where(Uplink.leaves_state.is_(None))
    return [(row, uplink) for row, uplink in session.execute(query.order_by(Uplink.id))]
