"""The triggers that guard the rows, held against those that the migrations make.

Which there are to be is asked of the migrations themselves, run once a process on an empty database in memory, so no second list
can go out of date. SQLite keeps the words of a trigger as they were given, and they must be the same. PostgreSQL has the same by
name, and one more against TRUNCATE beside each that refuses a removal; what it keeps is spelled anew, so their event, their columns
and literals, the function that they call and its words are compared, and that nobody switched them off.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import sqlalchemy as sa

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
    """A trigger that there is: whether it works, and its words."""

    name: str
    enabled: bool
    words: str
    function: str = ""
    body: str = ""


def strange_guards(connection: sa.Connection, migrated: Callable[[sa.Connection], None]) -> list[tuple[str, str]]:
    """Return the triggers that are not as the migrations make them, each with what was done: removed, inserted or changed.

    Parameters
    ----------
    migrated
        Brings an empty database to the newest schema.
    """
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
    with engine.begin() as connection:
        migrated(connection)
        return {trigger.name: trigger.words for trigger in _found(connection, postgresql=False)}


def _found(connection: sa.Connection, *, postgresql: bool) -> Iterator[Trigger]:
    """Yield the triggers of a database."""
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
    """Return the columns and literals of a condition, however it is spelled."""
    _, _, condition = words.partition(" WHEN ")
    condition = re.split(r"\bEXECUTE\b|\bBEGIN\b", condition)[0]
    return sorted(found.lower() for found in SPELLED.findall(condition))
