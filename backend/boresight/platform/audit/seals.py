"""Seals: which rows the audit log vouches for, and the digest that it keeps of each.

With `canon` the canonical JSON of a row's lasting columns that are not NULL, documents as the text that is stored::

    digest(row) = SHA-256(canon({column: value, ...}))

Each table says by its `sealing` what is left out and why: a column is lasting unless it is fleeting, a table is sealed unless it
is unsealed. A new column or table is sealed without anybody thinking of it. NULL is left out, so a column that a migration adds
without a value changes no digest. A run is two promises: what was launched, and once it has ended everything about it.

A session notes every sealed row that it inserts, changes or deletes, when it is flushed. A bulk UPDATE or DELETE passes
the session by, so one on a sealed table is refused unless it says, with `BULK`, that it touches fleeting columns or
notes its rows itself.

Journals: tables whose rows are only added, too many and too small for a seal in the audit log each.

With `canon` the canonical JSON of a row's lasting columns that are not NULL, each row is chained to the one before::

    id_n = id_(n-1) + 1,    hash_0 = 64 zeros,    hash_n = SHA-256(hash_(n-1) || canon(row_n))
    outcome_hash_n = SHA-256(hash_n || canon(other columns of row_n))

The other columns are those that move, and those that came when the chain was there already.

So an edit, a row put in between and a removed row are told by the row itself or the next one. Whoever chains the rest again meets
the audit log: each of its records carries the newest hash of every journal that has grown since the record before. What came
after the newest record can be cut unseen, as the end of any log. The one writer at a time numbers the rows.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import ORMExecuteState, Session

from boresight.platform.db.declared import Base, Journal
from boresight.platform.db.documents import JsonText, canonical

BULK = {"sealed_by": "its writer"}
ROWS_AT_A_TIME = 500
NOTED = "sealed rows that changed"


def list_tables() -> list[type[Base]]:
    """Return every table, by name. A program that opens a store has imported the console, which declares them all."""
    models = sorted((mapper.class_ for mapper in Base.registry.mappers), key=lambda model: model.__tablename__)
    if all(model.__module__.startswith("boresight.platform.") for model in models):
        raise RuntimeError(
            "Expected every table to be declared / Received the platform's alone; import boresight.console."
        )
    return models


def list_sealed() -> list[type[Base]]:
    """Return the tables whose rows are sealed, by name."""
    return [model for model in list_tables() if not model.sealing.unsealed]


def lasting(model: type[Base]) -> tuple[str, ...]:
    """Return the columns of a sealed table that its digest covers, the key first."""
    return tuple(name for name in model.__table__.columns.keys() if name not in model.sealing.fleeting)  # noqa: SIM118 - a collection of columns iterates over columns


def note(session: Session, model: type[Base], row_id: int) -> None:
    """Note that a row changed by a bulk update needs a new seal."""
    session.info.setdefault(NOTED, {}).setdefault(model, set()).add(row_id)


def note_flushed(session: Session, context: Any) -> None:  # noqa: ARG001 - SQLAlchemy gives both
    """Remember the sealed rows that a flush wrote."""
    for row in (*session.new, *session.dirty, *session.deleted):
        model = type(row)
        if not model.sealing.unsealed and (row not in session.dirty or _has_moved(row)):
            note(session, model, row.id)


def _has_moved(row: Base) -> bool:
    """Whether any column that the row's digest covers was given another value."""
    attributes, left_out = sa.inspect(row).attrs, _left_out(type(row), getattr(row, "state", None))
    return any(attributes[name].history.has_changes() for name in lasting(type(row)) if name not in left_out)


def _left_out(model: type[Base], state: str | None) -> frozenset[str]:
    """Return the lasting columns that are not sealed yet for a row in this state."""
    return frozenset() if state in model.sealing.settled else model.sealing.moving


def refuse_bulk(state: ORMExecuteState) -> None:
    """Refuse a bulk change of a sealed table that does not declare how it keeps the seals."""
    changes = state.is_insert or state.is_update or state.is_delete
    if not changes or state.bind_mapper is None or not BULK.items().isdisjoint(state.execution_options.items()):
        return
    model = state.bind_mapper.class_
    if not model.sealing.unsealed:
        raise ValueError(
            f"Expected a change of {model.__tablename__} through its rows, or with BULK / Received a bulk statement"
        )


def take(session: Session) -> dict[str, str | None]:
    """Return and clear the digests of all noted rows, by `table/id`; None stands for a removed row."""
    session.flush()
    noted: dict[type[Base], set[int]] = session.info.pop(NOTED, {})
    digests: dict[str, str | None] = {}
    for model, ids in noted.items():
        digests |= {f"{model.__tablename__}/{row_id}": None for row_id in ids}
        for some in portions(sorted(ids)):
            digests |= {
                f"{model.__tablename__}/{row_id}": digest for row_id, digest in iterate_digests(session, model, some)
            }
    return digests


def portions(ids: Sequence[int]) -> Iterator[Sequence[int]]:
    """Split keys into portions that fit into a statement and a record."""
    for start in range(0, len(ids), ROWS_AT_A_TIME):
        yield ids[start : start + ROWS_AT_A_TIME]


def iterate_digests(session: Session, model: type[Base], ids: Sequence[int] | None = None) -> Iterator[tuple[int, str]]:
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


def find_orphans(session: Session, model: type[Base]) -> frozenset[int]:
    """Return the keys of a sealed table's rows that refer to a row of an unsealed table that is not there.

    The row itself is as it was sealed then, and what it names was edited or removed by hand: no transaction could.
    """
    table, unsealed = model.__table__, {other.__table__ for other in list_tables() if other.sealing.unsealed}
    lost = [
        column.is_not(None) & ~sa.exists().where(key.column == column)
        for column in table.columns
        for key in column.foreign_keys
        if key.column.table in unsealed
    ]
    return frozenset(session.scalars(sa.select(table.columns["id"]).where(sa.or_(*lost)))) if lost else frozenset()


def _digest(model: type[Base], values: Mapping[str, Any]) -> str:
    """Return the digest of a row's lasting columns, for a run that has not ended only those fixed at launch."""
    left_out = _left_out(model, values.get("state"))
    kept = {name: value for name, value in values.items() if value is not None and name not in left_out}
    return hashlib.sha256(canonical(kept).encode()).hexdigest()


FIRST_HASH = "0" * 64
JOURNAL_ROWS_AT_A_TIME = 1000
MOST_STORES = 64


@dataclass(frozen=True)
class AppendOnlyTable:
    """The columns of a journal that the chain's hash covers, and those that the outcome hash covers."""

    model: type[Base]

    @property
    def name(self) -> str:
        """The table's name."""
        return str(self.model.__tablename__)

    @property
    def columns(self) -> Journal:
        """The table's declaration of its columns."""
        if (journal := self.model.sealing.journal) is None:
            raise ValueError(f"Expected a table with a journal / Received {self.name}")
        return journal

    def compute_hash(self, previous: str, row: Mapping[str, Any]) -> str:
        """Return the hash of a row after the one before."""
        return _hash(previous, {name: row[name] for name in self.columns.lasting})

    def compute_outcome_hash(self, row: Mapping[str, Any]) -> str:
        """Return the hash of the other columns."""
        return _hash(row["hash"] or "", {name: row[name] for name in self.columns.others})


def list_journals() -> list[AppendOnlyTable]:
    """Return the append-only tables, by name."""
    return [AppendOnlyTable(model) for model in list_tables() if model.sealing.journal]


_anchored: dict[str, dict[str, str]] = {}  # by store and journal: the newest hash in a record written by this process


def _hash(previous: str, row: Mapping[str, Any]) -> str:
    kept = {name: value for name, value in row.items() if value is not None}
    return hashlib.sha256(f"{previous}{canonical(kept)}".encode()).hexdigest()


def newest(session: Session, journal: AppendOnlyTable) -> tuple[int, str]:
    """Return number and hash of the newest row; 0 and `FIRST_HASH` where there is none."""
    table = journal.model.__table__
    query = sa.select(table.c.id, table.c.hash).order_by(table.c.id.desc()).limit(1)
    found = session.connection().execute(query).first()
    return (0, FIRST_HASH) if found is None else (found.id, found.hash or "")


def chained(session: Session, model: type[Base], rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Number and chain rows that are about to be added, in this order."""
    journal = AppendOnlyTable(model)
    last_id, previous = newest(session, journal)
    made = []
    for row_id, row in enumerate(rows, start=last_id + 1):
        previous = journal.compute_hash(previous, {**row, "id": row_id})
        numbered = {**row, "id": row_id, "hash": previous}
        made.append({**numbered, "outcome_hash": journal.compute_outcome_hash(numbered)})
    return made


def chain_new(session: Session, context: Any, instances: Any) -> None:  # noqa: ARG001 - SQLAlchemy gives all three
    """Number and chain the rows that a flush is about to write, and update the outcome hash of those that it changes."""
    added: dict[type[Base], list[Any]] = {}
    for row in sorted(filter(_is_of_journal, session.new), key=lambda row: sa.inspect(row).insert_order):
        added.setdefault(type(row), []).append(row)
    for model, rows in added.items():
        columns = AppendOnlyTable(model).columns
        values = [{name: _value(row, name) for name in (*columns.lasting, *columns.others)} for row in rows]
        for row, made in zip(rows, chained(session, model, values), strict=True):
            row.id, row.hash, row.outcome_hash = made["id"], made["hash"], made["outcome_hash"]
    for row in filter(_is_of_journal, session.dirty):
        its = AppendOnlyTable(type(row))
        row.outcome_hash = its.compute_outcome_hash({name: _value(row, name) for name in (*its.columns.others, "hash")})


def _is_of_journal(row: Base) -> bool:
    return row.sealing.journal is not None


def _value(row: Base, name: str) -> Any:
    """Return the value that will be stored in a column, its default where none was given."""
    value = getattr(row, name)
    default = type(row).__table__.columns[name].default
    return default.arg if value is None and default is not None else value


def heads(session: Session) -> dict[str, str]:
    """Return the newest hash of each journal that has grown since the last record, by `table/id`, for the next record."""
    found = {}
    known = _anchored.setdefault(_store(session), {})
    while len(_anchored) > MOST_STORES:
        del _anchored[next(iter(_anchored))]
    for journal in list_journals():
        last_id, digest = newest(session, journal)
        if last_id and known.get(journal.name) != digest:
            found[f"{journal.name}/{last_id}"] = known[journal.name] = digest
    return found


def forget(session: Session) -> None:
    """Have the next record carry the newest hashes again, after the record with them was rolled back."""
    _anchored.pop(_store(session), None)


def _store(session: Session) -> str:
    return session.get_bind().engine.url.render_as_string()


def iterate_rows(session: Session, journal: AppendOnlyTable) -> Iterator[dict[str, Any]]:
    """Yield every row in order, without holding them all."""
    columns = [*journal.columns.lasting, *journal.columns.others, "hash", "outcome_hash"]
    table = journal.model.__table__
    query = sa.select(*(table.columns[name] for name in columns)).order_by(table.c.id)
    with closing(session.execute(query, execution_options={"yield_per": JOURNAL_ROWS_AT_A_TIME})) as found:
        for row in found:
            yield dict(zip(columns, row, strict=True))
