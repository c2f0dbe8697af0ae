"""The numbers in a page's address: one greater than any row's is the number of nothing, and the store is not asked."""

from __future__ import annotations

from collections.abc import Iterator

from fastapi import Request

from boresight.errors import NotFoundError

GREATEST_NUMBER = 2**63 - 1  # of a row: SQLite's and PostgreSQL's greatest integer
MOST_DIGITS = len(str(GREATEST_NUMBER))
NUMBERED = frozenset({"sensor", "set", "clone", "before", "runs", "reference"})


async def check_numbers(request: Request) -> None:
    """Refuse an address with a number that no row can have.

    Raises
    ------
    NotFoundError
        When a number of the path or of the query is too great.
    """
    for text in _numbers(request):
        if len(text) > MOST_DIGITS or int(text) > GREATEST_NUMBER:
            raise NotFoundError("There is nothing of this number; choose one of the list.")


def _numbers(request: Request) -> Iterator[str]:
    """Yield every number of the address in digits, without leading zeros."""
    queried = [value for name, value in request.query_params.multi_items() if name in NUMBERED]
    parts = (part.strip() for value in [*map(str, request.path_params.values()), *queried] for part in value.split(","))
    yield from (part.lstrip("0") or "0" for part in parts if part.isdecimal())
