"""Seals: which rows the audit log vouches for, and the digest that it keeps of each.

With `canon` the canonical JSON of a row's lasting columns that are not NULL, documents as the text that is stored::

    digest(row) = SHA-256(canon({column: value, ...}))

A column is lasting unless `FLEETING` says why not, a table is sealed unless `UNSEALED` says why not: a new column or
table is sealed without anybody thinking of it. NULL is left out, so a column that a migration adds without a value
changes no digest. A run is two promises: what was launched, and once it has ended everything about it.

A session notes every sealed row that it inserts, changes or deletes, when it is flushed. A bulk UPDATE or DELETE passes
the session by, so one on a sealed table is refused unless it says, with `BULK`, that it touches fleeting columns or
notes its rows itself.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import ORMExecuteState, Session

from boresight.store.documents import JsonText, canonical
from boresight.store.tables import (
    TERMINAL_RUN_STATES,
    ApiKey,
    AuditRecord,
    Base,
    Blob,
    IdempotentResponse,
    LoginSession,
    Opening,
    Run,
    RunEvent,
    User,
    Webhook,
    WebhookDelivery,
)

UNSEALED: Mapping[type[Base], str] = {
    AuditRecord: "is the chain itself",
    Blob: "is named by the SHA-256 of its bytes; the rows that name it are sealed, and lose it if it is edited",
    IdempotentResponse: "is forgotten after a day",
    LoginSession: "moves with its use and is forgotten; what was done under it is sealed with its own record",
    Opening: "is shown and decides nothing",
    RunEvent: "is a journal, with hashes of its own",
    WebhookDelivery: "is a journal, with hashes of its own",
}
FLEETING: Mapping[type[Base], Mapping[str, str]] = {
    ApiKey: {"last_used_utc": "moves with every use"},
    Run: {"lease_until_utc": "is renewed while a run computes"},
    User: {"name_key": "follows from the name", "printed_key": "follows from the printed name"},
    Webhook: {"told_audit_id": "moves with every audit record"},
}
WHILE_UNDER_WAY = frozenset(
    (
        "state",
        "reason",
        "attempt",
        "owner",
        "cancel_requested",
        "started_utc",
        "ended_utc",
        "progress",
        "result_sha256",
        "summary",
    )
)  # of a run: lasting from its end on
SEALED: Mapping[str, type[Base]] = {
    model.__tablename__: model
    for model in sorted((mapper.class_ for mapper in Base.registry.mappers), key=lambda model: model.__tablename__)
    if model not in UNSEALED
}
BULK = {"sealed_by": "its writer"}
ROWS_AT_A_TIME = 500
NOTED = "sealed rows that changed"


def lasting(model: type[Base]) -> tuple[str, ...]:
    """Return the columns of a sealed table that its digest covers, the key first."""
    return tuple(name for name in model.__table__.columns.keys() if name not in FLEETING.get(model, {}))  # noqa: SIM118 - a collection of columns iterates over columns


def note(session: Session, model: type[Base], row_id: int) -> None:
    """Remember that a row needs a new seal: what a bulk update changed."""
    session.info.setdefault(NOTED, {}).setdefault(model, set()).add(row_id)


def note_flushed(session: Session, context: Any) -> None:  # noqa: ARG001 - SQLAlchemy gives both
    """Remember the sealed rows that a flush wrote."""
    for row in (*session.new, *session.dirty, *session.deleted):
        model = type(row)
        if model.__tablename__ in SEALED and (row not in session.dirty or _has_moved(row)):
            note(session, model, row.id)


def _has_moved(row: Base) -> bool:
    """Whether any column that the row's digest covers was given another value."""
    attributes, left_out = sa.inspect(row).attrs, _left_out(type(row), getattr(row, "state", None))
    return any(attributes[name].history.has_changes() for name in lasting(type(row)) if name not in left_out)


def _left_out(model: type[Base], state: str | None) -> frozenset[str]:
    """Return the lasting columns that a row in this state does not promise yet."""
    return WHILE_UNDER_WAY if model is Run and state not in TERMINAL_RUN_STATES else frozenset()


def refuse_bulk(state: ORMExecuteState) -> None:
    """Refuse a bulk change of a sealed table that says nothing of its seals.

    Raises
    ------
    ValueError
        A programming error: the change would later look as if it was made by hand.
    """
    changes = state.is_insert or state.is_update or state.is_delete
    if not changes or state.bind_mapper is None or not BULK.items().isdisjoint(state.execution_options.items()):
        return
    table = state.bind_mapper.class_.__tablename__
    if table in SEALED:
        raise ValueError(f"Expected a change of {table} through its rows, or with BULK / Received a bulk statement")


def take(session: Session) -> dict[str, str | None]:
    """Return the digests of all rows that were noted, by `table/id`, and note them no longer; None is a removed row."""
    session.flush()
    noted: dict[type[Base], set[int]] = session.info.pop(NOTED, {})
    digests: dict[str, str | None] = {}
    for model, ids in noted.items():
        digests |= {f"{model.__tablename__}/{row_id}": None for row_id in ids}
        for some in portions(sorted(ids)):
            digests |= {
                f"{model.__tablename__}/{row_id}": digest for row_id, digest in digests_of(session, model, some)
            }
    return digests


def portions(ids: Sequence[int]) -> Iterator[Sequence[int]]:
    """Cut keys into portions that a statement, and a record, can hold."""
    for start in range(0, len(ids), ROWS_AT_A_TIME):
        yield ids[start : start + ROWS_AT_A_TIME]


def digests_of(session: Session, model: type[Base], ids: Sequence[int] | None = None) -> Iterator[tuple[int, str]]:
    """Yield key and digest of a sealed table's rows, all or some, in the order of their keys, without holding them all."""
    names = lasting(model)
    table = model.__table__
    columns = [
        sa.type_coerce(column, sa.Text) if isinstance(column.type, JsonText) else column
        for column in (table.columns[name] for name in names)
    ]
    query = sa.select(*columns).order_by(table.columns["id"])
    if ids is not None:
        query = query.where(table.columns["id"].in_(ids))
    with closing(session.execute(query, execution_options={"yield_per": ROWS_AT_A_TIME})) as found:
        for row in found:
            yield row[0], _digest(model, dict(zip(names, row, strict=True)))


def orphans(session: Session, model: type[Base]) -> frozenset[int]:
    """Return the keys of a sealed table's rows that refer to a row of an unsealed table that is not there.

    The row itself is as it was sealed then, and what it names was edited or removed by hand: no transaction could.
    """
    table, unsealed = model.__table__, {other.__table__ for other in UNSEALED}
    lost = [
        column.is_not(None) & ~sa.exists().where(key.column == column)
        for column in table.columns
        for key in column.foreign_keys
        if key.column.table in unsealed
    ]
    return frozenset(session.scalars(sa.select(table.columns["id"]).where(sa.or_(*lost)))) if lost else frozenset()


def _digest(model: type[Base], values: Mapping[str, Any]) -> str:
    """Return the digest of a row's lasting columns; of a run under way, of what was launched."""
    left_out = _left_out(model, values.get("state"))
    kept = {name: value for name, value in values.items() if value is not None and name not in left_out}
    return hashlib.sha256(canonical(kept).encode()).hexdigest()
