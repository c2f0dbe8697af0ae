"""Every row of one database, copied to another that is migrated and empty, whichever engine each is on.

Values go over as they are stored, documents as their text: the audit chain hashes that text, so it holds in the copy as
it did in the original. Tables come in the order of their references, rows in the order of their keys. The copy is made
inside one transaction on each side: the source is seen in one state, and the target gets all or nothing.
"""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

from boresight.errors import ConflictError
from boresight.store.sessions import Engine, migrate
from boresight.store.tables import Base

ROWS = 500  # at once


def copy_rows(source: Engine, target: Engine) -> int:
    """Copy every row; bring both schemas up to date first.

    Returns
    -------
    int
        How many rows there were.

    Raises
    ------
    ConflictError
        When the target holds rows already.
    """
    migrate(source)
    migrate(target)
    with _seen_in_one_state(source).connect() as origin, target.begin() as copy:
        if any(
            copy.scalar(sa.select(sa.literal(1)).select_from(table).limit(1)) for table in Base.metadata.sorted_tables
        ):
            raise ConflictError("There are rows in the database already; restore into an empty one.")
        copied = sum(_copy_table(origin, copy, table) for table in Base.metadata.sorted_tables)
        if copy.dialect.name == "postgresql":
            for table in Base.metadata.sorted_tables:
                _count_on(copy, table)
    return copied


def _seen_in_one_state(engine: Engine) -> Engine:
    """Return the engine so that a connection sees one state; on SQLite every transaction does."""
    return (
        engine.execution_options(isolation_level="REPEATABLE READ") if engine.dialect.name == "postgresql" else engine
    )


def _copy_table(origin: sa.Connection, copy: sa.Connection, table: sa.Table) -> int:
    """Copy one table, some rows at a time."""
    plain = sa.table(
        table.name, *(sa.column(column.name) for column in table.columns)
    )  # no type: values as they are stored
    names = [column.name for column in table.columns]
    query = sa.select(*plain.columns).order_by(*(plain.columns[column.name] for column in table.primary_key))
    copied = 0
    for rows in origin.execution_options(yield_per=ROWS).execute(query).partitions():
        values: list[dict[str, Any]] = [dict(zip(names, row, strict=True)) for row in rows]
        copy.execute(plain.insert(), values)
        copied += len(values)
    return copied


def _count_on(copy: sa.Connection, table: sa.Table) -> None:
    """Let PostgreSQL number the next row after the last one, where it numbers them itself."""
    for column in table.primary_key:
        sequence = copy.scalar(sa.select(sa.func.pg_get_serial_sequence(table.name, column.name)))
        newest = copy.scalar(sa.select(sa.func.max(column))) if sequence else None
        if newest is not None:
            copy.execute(sa.select(sa.func.setval(sequence, newest)))
