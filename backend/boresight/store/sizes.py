"""How large a store is: rows and bytes of each table with its indexes, as the database itself counts its pages."""

from __future__ import annotations

from dataclasses import dataclass

import sqlalchemy as sa

from boresight.store.sessions import Engine
from boresight.store.tables.declared import Base

_SQLITE = """
    SELECT coalesce(of.tbl_name, pages.name), sum(pages.pgsize) FROM dbstat AS pages
    LEFT JOIN sqlite_schema AS of ON of.name = pages.name GROUP BY 1
"""
_POSTGRESQL = """
    SELECT relname, pg_total_relation_size(oid) FROM pg_class
    WHERE relkind = 'r' AND relnamespace = 'public'::regnamespace
"""


@dataclass(frozen=True)
class TableSize:
    """Of one table.

    Parameters
    ----------
    rows
        How many there are.
    size
        Bytes of its pages and of its indexes'.
    """

    rows: int
    size: int


def table_sizes(engine: Engine) -> dict[str, TableSize]:
    """Count the rows and bytes of every table."""
    with engine.connect() as connection:
        pages = connection.execute(sa.text(_SQLITE if engine.dialect.name == "sqlite" else _POSTGRESQL)).all()
        sizes: dict[str, int] = {name: int(size) for name, size in pages}
        return {
            name: TableSize(connection.scalar(sa.select(sa.func.count()).select_from(table)) or 0, sizes.get(name, 0))
            for name, table in Base.metadata.tables.items()
        }
