"""What a list in the database is made of, and its newest rows; the lists themselves are `LISTS` of `console.list_queries`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import defer

from boresight.platform.db.documents import MOST_NUMBER
from boresight.platform.db.sessions import Session

Condition = Callable[[Any], sa.ColumnElement[bool]]


@dataclass(frozen=True)
class List:
    """The definition of a list."""

    table: Any
    keys: Mapping[str, Any]
    filters: Mapping[str, Condition]
    unread: tuple[str, ...] = ()
    large: tuple[str, ...] = ()


def equals(column: Any) -> Condition:
    """Compare a column with a value, or with one of several."""
    one = _equals_one(column)
    return lambda value: column.in_(value) if isinstance(value, list | tuple) else one(value)


def _equals_one(column: Any) -> Condition:
    """Compare a column with a value, for a numeric column as a number, because PostgreSQL does not compare it with text."""
    if not isinstance(column.type, sa.Integer):
        return lambda value: column == value
    return lambda value: column == number if abs(number := int(value)) < MOST_NUMBER else sa.false()


def list_newest_rows(
    session: Session, known: List, *, before_id: int | None = None, limit: int | None = None, **where: Any
) -> list[Any]:
    """Return a page of a list, newest first, narrowed by what is not None; the next starts before the last one's id."""
    query = sa.select(known.table).order_by(known.table.id.desc()).limit(limit)
    query = query.where(*(known.filters[name](value) for name, value in where.items() if value is not None))
    if before_id is not None:
        query = query.where(known.table.id < before_id)
    return list(session.scalars(query.options(*(defer(getattr(known.table, name)) for name in known.large))))
