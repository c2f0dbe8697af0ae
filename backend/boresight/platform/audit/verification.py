"""Verifying the store against its audit log: first the chain, record by record, then every sealed row.

The newest digest that the chain has of each row is gathered in a scratch file of SQLite's, ordered by table and key, and
is then met by the tables in the same order, as two sorted lists are merged. So memory does not grow with the log, and
each record and each row is read once::

    digest in the chain, row as sealed      good
    digest in the chain, another row        changed by hand
    digest in the chain, no row             removed by hand
    row as sealed, what it refers to gone   parted by hand from an unsealed row, such as its blob
    no digest in the chain, a row           inserted by hand

Then every journal is walked along its own chain, and meets what the records carry of it; at last the triggers are looked at.

Comparing the database's triggers with those that the migrations make.

Which there are to be is asked of the migrations themselves, run once a process on an empty database in memory, so no second list
can go out of date. SQLite keeps the words of a trigger as they were given, and they must be the same. PostgreSQL has the same by
name, and one more against TRUNCATE beside each that refuses a removal; what it keeps is spelled again, so their event, their
columns and literals, the function that they call and its words are compared, and that nobody switched them off.
"""

from __future__ import annotations

import json
import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from functools import cache

import sqlalchemy as sa

from boresight.platform.audit import chain
from boresight.platform.audit import queries as audit
from boresight.platform.audit import seals as journals
from boresight.platform.audit.seals import AppendOnlyTable
from boresight.platform.db.declared import Base
from boresight.platform.db.sessions import Session, upgrade_tables

REMOVAL, TRUNCATION = "_no_removal", "_no_truncation"
EVENTS = {"_no_change": "BEFORE UPDATE", REMOVAL: "BEFORE DELETE", TRUNCATION: "BEFORE TRUNCATE"}
WORDS = {"refuse_change": "is never changed", "refuse_removal": "is never removed"}
SPELLED = re.compile(r"\b(?:new|old)\.\w+|'[^']*'", re.IGNORECASE)
OF_SQLITE = "SELECT name, sql FROM sqlite_master WHERE type = 'trigger'"
OF_POSTGRESQL = """
SELECT t.tgname AS name, t.tgenabled <> 'D' AS enabled, pg_get_triggerdef(t.oid) AS words, p.proname AS function, p.prosrc AS body
FROM pg_trigger t JOIN pg_class c ON c.oid = t.tgrelid JOIN pg_proc p ON p.oid = t.tgfoid
WHERE NOT t.tgisinternal AND c.relnamespace = current_schema()::regnamespace
"""


@dataclass(frozen=True)
class Trigger:
    """An existing trigger: whether it is enabled, and its definition."""

    name: str
    enabled: bool
    words: str
    function: str = ""
    body: str = ""


def find_changed_triggers(
    connection: sa.Connection, migrated: Callable[[sa.Connection], None]
) -> list[tuple[str, str]]:
    """Return the triggers that differ from the migrations, each with how: removed, inserted or changed."""
    expected, postgresql = _expected(migrated), connection.dialect.name == "postgresql"
    found = {trigger.name: trigger for trigger in _found(connection, postgresql=postgresql)}
    if postgresql:
        beside = {
            name.replace(REMOVAL, TRUNCATION): words for name, words in expected.items() if name.endswith(REMOVAL)
        }
        expected = expected | beside
    fits = _fits_postgresql if postgresql else _fits_sqlite
    strange = [(name, "removed") for name in sorted(expected.keys() - found.keys())]
    strange += [(name, "inserted") for name in sorted(found.keys() - expected.keys())]
    both = sorted(found.keys() & expected.keys())
    return strange + [(name, "changed") for name in both if not fits(found[name], expected[name])]


@cache
def _expected(migrated: Callable[[sa.Connection], None]) -> dict[str, str]:
    """Return the triggers of the newest schema, as SQLite has them."""
    engine = sa.create_engine("sqlite://")
    try:
        with engine.begin() as connection:
            migrated(connection)
            return {trigger.name: trigger.words for trigger in _found(connection, postgresql=False)}
    finally:
        engine.dispose()


def _found(connection: sa.Connection, *, postgresql: bool) -> Iterator[Trigger]:
    if postgresql:
        for row in connection.exec_driver_sql(OF_POSTGRESQL):
            yield Trigger(row.name, row.enabled, row.words, row.function, row.body)
        return
    for name, words in connection.exec_driver_sql(OF_SQLITE):
        yield Trigger(name, enabled=True, words=words)


def _fits_sqlite(found: Trigger, expected: str) -> bool:
    return found.words == expected


def _fits_postgresql(found: Trigger, expected: str) -> bool:
    """Whether a trigger of PostgreSQL does what SQLite's of the same purpose does."""
    event = next(words for ending, words in EVENTS.items() if found.name.endswith(ending))
    called = "refuse_change" if event == "BEFORE UPDATE" else "refuse_removal"
    same_when = event == "BEFORE TRUNCATE" or _spelled(found.words) == _spelled(expected)
    is_ours = found.function == called and f"RAISE EXCEPTION '% {WORDS[called]}', TG_ARGV[0];" in found.body
    return found.enabled and f" {event} ON " in found.words and same_when and is_ours


def _spelled(words: str) -> list[str]:
    """Return the columns and literals of a condition, independent of its formatting."""
    _, _, condition = words.partition(" WHEN ")
    condition = re.split(r"\bEXECUTE\b|\bBEGIN\b", condition)[0]
    return sorted(found.lower() for found in SPELLED.findall(condition))


SCRATCH = (
    "PRAGMA journal_mode=OFF",
    "PRAGMA synchronous=OFF",
    "CREATE TABLE seals (name TEXT, id INTEGER, digest TEXT, record INTEGER, PRIMARY KEY (name, id)) WITHOUT ROWID",
)
PUT = "INSERT OR REPLACE INTO seals VALUES (?, ?, ?, ?)"
COVERING = "SELECT record FROM seals WHERE name = ? AND id >= ? ORDER BY id LIMIT 1"
GET = "SELECT id, digest, record FROM seals WHERE name = ? AND digest IS NOT NULL ORDER BY id"

PARTED = "separated from a row that it refers to"

Seal = tuple[int, str, int]  # key of a row, its digest, the record that it is in


@dataclass(frozen=True)
class RowMismatch:
    """A row that differs from its seal in the chain."""

    row: str
    what: str
    record_id: int | None


@dataclass
class VerificationFindings:
    """The findings of a verification."""

    records: int = 0
    head: str = chain.FIRST_HASH
    last_id: int = 0
    broken_id: int | None = None
    unmet: list[str] = field(default_factory=list)
    rows: int = 0
    misfits: int = 0
    misfit: RowMismatch | None = None
    guards: list[RowMismatch] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether everything is as it was written."""
        return self.broken_id is None and self.misfit is None and not self.unmet and not self.guards


def verify(session: Session, *expected_heads: str | None) -> VerificationFindings:
    """Verify the whole chain, then every sealed table."""
    found = VerificationFindings(
        unmet=[head for head in dict.fromkeys(expected_heads) if head is not None and head != chain.FIRST_HASH]
    )
    with closing(sqlite3.connect("")) as scratch:  # a file without a name, in memory while it is small
        for statement in SCRATCH:
            scratch.execute(statement)
        _walk(session, scratch, found)
        for model in journals.list_sealed() if found.broken_id is None else ():
            for misfit in _misfits(session, scratch, found, model):
                _count(found, misfit)
        for journal in journals.list_journals() if found.broken_id is None else ():
            for misfit in _gaps(session, scratch, found, journal):
                _count(found, misfit)
    strange = find_changed_triggers(session.connection(), upgrade_tables)
    found.guards = [RowMismatch(f"the trigger {name}", what, None) for name, what in strange]
    return found


def _walk(session: Session, scratch: sqlite3.Connection, found: VerificationFindings) -> None:
    """Check every record against the one before, and gather the seals."""
    with closing(audit.walk(session)) as records:
        for record in records:
            if not chain.follows(found.last_id, found.head, record):
                found.broken_id = record["id"]
                return
            if record["rows"] is not None:
                scratch.executemany(PUT, _seals_in(record["rows"], record["id"]))
            found.records, found.head, found.last_id = found.records + 1, record["hash"], record["id"]
            if found.head in found.unmet:
                found.unmet.remove(found.head)


def _seals_in(text: str, record_id: int) -> Iterator[tuple[str, int, str | None, int]]:
    """Yield the seals in a record, a table and a key each."""
    for row, digest in json.loads(text).items():
        name, _, row_id = row.rpartition("/")
        yield name, int(row_id), digest, record_id


def _misfits(
    session: Session, scratch: sqlite3.Connection, found: VerificationFindings, model: type[Base]
) -> Iterator[RowMismatch]:
    """Compare a table's rows with their seals, both in the order of their keys."""
    name = model.__tablename__
    sealed: Iterable[Seal] = scratch.execute(GET, (name,))
    waiting = iter(sealed)
    seal = next(waiting, None)
    orphans = journals.find_orphans(session, model)
    for row_id, digest in journals.iterate_digests(session, model):
        found.rows += 1
        while seal is not None and seal[0] < row_id:
            yield RowMismatch(f"{name}/{seal[0]}", "removed", seal[2])
            seal = next(waiting, None)
        if seal is None or seal[0] > row_id:
            yield RowMismatch(f"{name}/{row_id}", "inserted", None)
            continue
        if seal[1] != digest:
            yield RowMismatch(f"{name}/{row_id}", "changed", seal[2])
        elif row_id in orphans:
            yield RowMismatch(f"{name}/{row_id}", PARTED, seal[2])
        seal = next(waiting, None)
    while seal is not None:
        yield RowMismatch(f"{name}/{seal[0]}", "removed", seal[2])
        seal = next(waiting, None)


def _gaps(
    session: Session, scratch: sqlite3.Connection, found: VerificationFindings, journal: AppendOnlyTable
) -> Iterator[RowMismatch]:
    """Verify a journal along its chain and against the hashes in the audit records."""
    carried = {row_id: (digest, record) for row_id, digest, record in scratch.execute(GET, (journal.name,))}
    previous, last_id = journals.FIRST_HASH, 0
    for row in journals.iterate_rows(session, journal):
        found.rows += 1
        digest, _ = carried.pop(row["id"], (row["hash"], 0))
        moved = row["outcome_hash"] != journal.compute_outcome_hash(row)
        if row["hash"] is None:
            yield RowMismatch(f"{journal.name}/{row['id']}", "inserted", None)
            continue
        if row["hash"] != journal.compute_hash(previous, row):
            row_id, what = (last_id + 1, "removed") if row["id"] > last_id + 1 else (row["id"], "changed")
            yield RowMismatch(f"{journal.name}/{row_id}", what, _covering(scratch, journal, row_id))
        elif row["hash"] != digest or moved:
            yield RowMismatch(f"{journal.name}/{row['id']}", "changed", _covering(scratch, journal, row["id"]))
        previous, last_id = row["hash"], row["id"]
    for row_id, (_, record) in sorted(carried.items()):
        yield RowMismatch(f"{journal.name}/{row_id}", "removed", record)


def _covering(scratch: sqlite3.Connection, journal: AppendOnlyTable, row_id: int) -> int | None:
    """Return the first record whose hash covers a row; None where there is none yet."""
    found = scratch.execute(COVERING, (journal.name, row_id)).fetchone()
    return None if found is None else int(found[0])


def _count(found: VerificationFindings, misfit: RowMismatch) -> None:
    """Count a misfit, and keep the one with the oldest record."""
    found.misfits += 1
    kept = found.misfit
    if kept is None or _age(misfit) < _age(kept):
        found.misfit = misfit


def _age(misfit: RowMismatch) -> tuple[bool, int]:
    return misfit.record_id is None, misfit.record_id or 0
