"""Journals: tables whose rows are only added, too many and too small for a seal in the audit log each.

With `canon` the canonical JSON of a row's lasting columns that are not NULL, each row is chained to the one before::

    id_n = id_(n-1) + 1,    hash_0 = 64 zeros,    hash_n = SHA-256(hash_(n-1) || canon(row_n))
    outcome_hash_n = SHA-256(hash_n || canon(other columns of row_n))

The other columns are those that move, and those that came when the chain was there already.

So an edit, a row put in between and a removed row are told by the row itself or the next one. Whoever chains the rest anew meets
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
from sqlalchemy.orm import Session

from boresight.store.documents import canonical
from boresight.store.tables import Base, RunEvent, WebhookDelivery

FIRST_HASH = "0" * 64
ROWS_AT_A_TIME = 1000
MOST_STORES = 64


@dataclass(frozen=True)
class Journal:
    """What of a table the chain's hash covers, and what the other one."""

    model: type[RunEvent | WebhookDelivery]
    lasting: tuple[str, ...]
    others: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The table's name."""
        return self.model.__tablename__

    def hash_of(self, previous: str, row: Mapping[str, Any]) -> str:
        """Return the hash of a row after the one before."""
        return _hash(previous, {name: row[name] for name in self.lasting})

    def outcome_hash_of(self, row: Mapping[str, Any]) -> str:
        """Return the hash of the other columns."""
        return _hash(row["hash"] or "", {name: row[name] for name in self.others})


JOURNALS: Mapping[str, Journal] = {
    journal.name: journal
    for journal in (
        Journal(
            RunEvent,
            ("id", "run_id", "attempt", "at_utc", "kind", "message"),
            ("state", "cause", "level", "numbers"),
        ),
        Journal(
            WebhookDelivery,
            ("id", "webhook_id", "audit_id", "body", "created_utc"),
            ("state", "attempts", "attempted_utc", "status", "outcome"),
        ),
    )
}
_anchored: dict[str, dict[str, str]] = {}  # by store and journal: the newest hash that a record of this process carries


def _hash(previous: str, row: Mapping[str, Any]) -> str:
    kept = {name: value for name, value in row.items() if value is not None}
    return hashlib.sha256(f"{previous}{canonical(kept)}".encode()).hexdigest()


def newest(session: Session, journal: Journal) -> tuple[int, str]:
    """Return number and hash of the newest row; 0 and `FIRST_HASH` where there is none."""
    table = journal.model.__table__
    query = sa.select(table.c.id, table.c.hash).order_by(table.c.id.desc()).limit(1)
    found = session.connection().execute(query).first()
    return (0, FIRST_HASH) if found is None else (found.id, found.hash or "")


def chained(
    session: Session, model: type[RunEvent | WebhookDelivery], rows: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Number rows that are about to be added and chain them, in this order."""
    journal = JOURNALS[model.__tablename__]
    last_id, previous = newest(session, journal)
    made = []
    for row_id, row in enumerate(rows, start=last_id + 1):
        previous = journal.hash_of(previous, {**row, "id": row_id})
        numbered = {**row, "id": row_id, "hash": previous}
        made.append({**numbered, "outcome_hash": journal.outcome_hash_of(numbered)})
    return made


def chain_new(session: Session, context: Any, instances: Any) -> None:  # noqa: ARG001 - SQLAlchemy gives all three
    """Number and chain the rows that a flush is about to write, and hash anew what it changes in others."""
    added = sorted((row for row in session.new if _journal(row)), key=lambda row: sa.inspect(row).insert_order)
    for journal in JOURNALS.values():
        rows = [row for row in added if isinstance(row, journal.model)]
        values = [{name: _value(row, name) for name in (*journal.lasting, *journal.others)} for row in rows]
        for row, made in zip(rows, chained(session, journal.model, values) if rows else (), strict=True):
            row.id, row.hash, row.outcome_hash = made["id"], made["hash"], made["outcome_hash"]
    for row in session.dirty:
        if (its := _journal(row)) is not None:
            row.outcome_hash = its.outcome_hash_of({name: _value(row, name) for name in (*its.others, "hash")})


def _journal(row: Base) -> Journal | None:
    return JOURNALS.get(type(row).__tablename__)


def _value(row: Base, name: str) -> Any:
    """Return what will be stored in a column: its default where nothing was given."""
    value = getattr(row, name)
    default = type(row).__table__.columns[name].default
    return default.arg if value is None and default is not None else value


def heads(session: Session) -> dict[str, str]:
    """Return the newest hash of each journal that has grown since the last record, by `table/id`, to be carried by the next."""
    found = {}
    known = _anchored.setdefault(_store(session), {})
    while len(_anchored) > MOST_STORES:
        del _anchored[next(iter(_anchored))]
    for name, journal in JOURNALS.items():
        last_id, digest = newest(session, journal)
        if last_id and known.get(name) != digest:
            found[f"{name}/{last_id}"] = known[name] = digest
    return found


def forget(session: Session) -> None:
    """Carry the newest hashes again: what carried them was not kept."""
    _anchored.pop(_store(session), None)


def _store(session: Session) -> str:
    return session.get_bind().engine.url.render_as_string()


def rows_of(session: Session, journal: Journal) -> Iterator[dict[str, Any]]:
    """Yield every row in order, without holding them all."""
    columns = [*journal.lasting, *journal.others, "hash", "outcome_hash"]
    table = journal.model.__table__
    query = sa.select(*(table.columns[name] for name in columns)).order_by(table.c.id)
    with closing(session.execute(query, execution_options={"yield_per": ROWS_AT_A_TIME})) as found:
        for row in found:
            yield dict(zip(columns, row, strict=True))
