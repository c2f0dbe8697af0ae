"""Reading long lists page by page, sorted and narrowed: sensors, runs, telemetry, parameter sets, approvals, audit records."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from boresight.console import list_queries as lists
from boresight.console.list_queries import LISTS, ListQuery
from boresight.errors import RefusedInputError
from boresight.platform.db.sessions import Session


def read_page(
    session: Session, name: str, where: Mapping[str, Any], sort: str, *, before_id: int | None = None, limit: int
) -> list[Any]:
    """Return a page of a list; the next page is that before the last row's id."""
    return lists.page(session, name, _asked(name, where, sort, before_id), limit)


def count(session: Session, name: str, where: Mapping[str, Any]) -> int:
    """Return how many rows a list has that is narrowed so."""
    return lists.count(session, name, _checked(name, where))


def read_all(session: Session, name: str, where: Mapping[str, Any], sort: str) -> Iterator[Any]:
    """Yield every row of a list in its order."""
    return lists.walk(session, name, _asked(name, where, sort, None))


def _asked(name: str, where: Mapping[str, Any], sort: str, before_id: int | None) -> ListQuery:
    """Check the names."""
    known = LISTS[name]
    if sort.removeprefix("-") not in known.keys:
        raise RefusedInputError(f"The list is not sorted by {sort!r}; choose from {', '.join(known.keys)}.")
    return ListQuery(_checked(name, where), sort, before_id)


def _checked(name: str, where: Mapping[str, Any]) -> Mapping[str, Any]:
    """Refuse filters that a list does not know."""
    known = LISTS[name].filters
    if strange := sorted(set(where) - set(known)):
        raise RefusedInputError(f"The list has no filter {', '.join(strange)}; choose from {', '.join(known)}.")
    return where
