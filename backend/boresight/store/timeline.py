"""Queries on a sensor's history: what happened in order, and which row was in force at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import (
    Approval,
    GateProfile,
    Package,
    ParameterSet,
    Promotion,
    Signature,
    TableDefinition,
    Uplink,
    User,
    Waiver,
)

KINDS = ("table definition", "gate profile", "request", "waiver", "signature", "promotion", "package", "uplink")
Versioned = TypeVar("Versioned", GateProfile, TableDefinition)


class Key(NamedTuple):
    """Where an event stands: its time, its kind's place in KINDS, its row; keys sort as the events do."""

    at_utc: str
    kind: int
    row_id: int


def _of_sensor(sensor_id: int) -> dict[str, tuple[Any, Any, sa.Select[Any]]]:
    """Return of every kind the table, the column of its time, and the query of a sensor's rows."""
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


def keys(
    session: Session, sensor_id: int, *, until_utc: str | None, before: Key | None, limit: int | None
) -> Sequence[Key]:
    """Return where a sensor's events stand, newest first; one query over all kinds."""
    parts = [
        query.with_only_columns(
            time.label("at_utc"), sa.literal(KINDS.index(kind)).label("kind"), table.id.label("row_id")
        )
        for kind, (table, time, query) in _of_sensor(sensor_id).items()
    ]
    every = sa.union_all(*parts).subquery()
    order = (every.c.at_utc, every.c.kind, every.c.row_id)
    query = sa.select(*order).order_by(*(column.desc() for column in order))
    if until_utc is not None:
        query = query.where(every.c.at_utc <= until_utc)
    if before is not None:
        query = query.where(sa.tuple_(*order) < sa.tuple_(*map(sa.literal, before)))
    return [Key(*row) for row in session.execute(query if limit is None else query.limit(limit))]


def key_of(session: Session, sensor_id: int, kind: int, row_id: int) -> Key | None:
    """Return where one event stands; None when it is none of the sensor's."""
    table, time, query = _of_sensor(sensor_id)[KINDS[kind]]
    at_utc = session.scalar(query.with_only_columns(time).where(table.id == row_id))
    return None if at_utc is None else Key(at_utc, kind, row_id)


def rows_at(session: Session, sensor_id: int, found: Sequence[Key]) -> dict[Key, Any]:
    """Return the row behind each key; one query a kind."""
    rows: dict[tuple[int, int], Any] = {}
    for kind, (table, _, query) in enumerate(_of_sensor(sensor_id).values()):
        ids = [key.row_id for key in found if key.kind == kind]
        if ids:
            rows |= {(kind, row.id): row for row in session.scalars(query.where(table.id.in_(ids)))}
    return {key: rows[key.kind, key.row_id] for key in found}


def set_names(session: Session, sensor_id: int) -> dict[int, str]:
    """Return the names of a sensor's sets."""
    query = sa.select(ParameterSet.id, ParameterSet.name).where(ParameterSet.sensor_id == sensor_id)
    return {number: name for number, name in session.execute(query)}  # noqa: C416 - rows are not pairs to a type checker


def printed_names(session: Session) -> dict[int, str]:
    """Return everybody's printed name."""
    query = sa.select(User.id, User.printed_name)
    return {number: name for number, name in session.execute(query)}  # noqa: C416 - rows are not pairs to a type checker


def requests_of(session: Session, sensor_id: int) -> dict[int, Approval]:
    """Return every request for a sensor's sets, by its number."""
    query = sa.select(Approval).join(ParameterSet).where(ParameterSet.sensor_id == sensor_id)
    return {row.id: row for row in session.scalars(query)}


def first_promotions(session: Session, sensor_id: int) -> dict[int, int]:
    """Return of each set that was ever baseline its first promotion; any later one is a roll-back to it."""
    query = sa.select(Promotion.parameter_set_id, sa.func.min(Promotion.id)).where(Promotion.sensor_id == sensor_id)
    rows = session.execute(query.group_by(Promotion.parameter_set_id))
    return {set_id: first for set_id, first in rows}  # noqa: C416 - rows are not pairs to a type checker


def promotion_at(session: Session, sensor_id: int, time_utc: str) -> Promotion | None:
    """Return the promotion that a sensor's baseline at a time came from."""
    query = sa.select(Promotion).where(Promotion.sensor_id == sensor_id, Promotion.at_utc <= time_utc)
    return session.scalar(query.order_by(Promotion.at_utc.desc(), Promotion.id.desc()).limit(1))


def in_force_at(session: Session, table: type[Versioned], sensor_id: int, time_utc: str) -> Versioned | None:
    """Return the gate profile or table definition that was in force at a time."""
    query = sa.select(table).where(table.sensor_id == sensor_id, table.created_utc <= time_utc)
    return session.scalar(query.order_by(table.number.desc()).limit(1))


def records_after(session: Session, sensor_id: int, time_utc: str) -> Sequence[tuple[ParameterSet, Uplink]]:
    """Return what was recorded on board after a time, oldest first."""
    query = sa.select(ParameterSet, Uplink).join(Uplink, Uplink.parameter_set_id == ParameterSet.id)
    query = query.where(ParameterSet.sensor_id == sensor_id, Uplink.recorded_utc > time_utc)
    return [(row, uplink) for row, uplink in session.execute(query.order_by(Uplink.id))]
