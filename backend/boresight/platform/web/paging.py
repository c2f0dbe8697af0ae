"""Lists by pages with an opaque cursor, and the converters of ids and names in addresses."""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar

from annotated_types import Ge, Le
from fastapi import Depends, Query
from pydantic import BaseModel, Field
from starlette.convertors import IntegerConvertor, StringConvertor, register_url_convertor
from starlette.requests import Request

from boresight.errors import RefusedInputError

GREATEST_ID = 2**63 - 1
MOST_DIGITS = len(str(GREATEST_ID))

Id = Annotated[int, Ge(1), Le(GREATEST_ID)]


def parse_row_id(text: str) -> int | None:
    """Parse a row's id; None where the text is no number, or too large."""
    text = text.strip()
    if not text.isdecimal() or len(text.lstrip("0")) > MOST_DIGITS:
        return None
    number = int(text[-MOST_DIGITS:])
    return number if number <= GREATEST_ID else None


USUAL_LENGTH = 50
LONGEST = 200
PLACING = ("cursor", "limit")  # parameters that select the page, not the rows

T = TypeVar("T")


class Page(BaseModel, Generic[T]):
    """One page of a list."""

    items: list[T]
    next: str | None = Field(description="Send it as `cursor` for the next page; null on the last page.")


@dataclass(frozen=True)
class Listing(Generic[T]):
    """Rows of a list, and the cursor of the next page."""

    items: Sequence[T]
    next: str | None = None


@dataclass(frozen=True)
class Paging:
    """Which page is asked for: up to `limit` rows after the row `last_id`, from the beginning when None."""

    last_id: int | None
    limit: int
    filters: str

    @property
    def rows(self) -> dict[str, int | None]:
        """The number of rows to query: one more than the page holds, to know whether there is another page."""
        return {"before_id": self.last_id, "limit": self.limit + 1}

    def cut(self, rows: Sequence[T], show: Callable[[T], Any] = lambda row: row) -> Listing[Any]:
        """Make a page of at most `limit + 1` rows; the extra row only shows that there is a next page."""
        kept = rows[: self.limit]
        cursor = _cursor(kept[-1].id, self.filters) if len(rows) > self.limit else None  # type: ignore[attr-defined]  # every row has a number
        return Listing([show(row) for row in kept], cursor)

    def cut_whole(self, rows: Sequence[T], show: Callable[[T], Any] = lambda row: row) -> Listing[Any]:
        """Make a page of a list that is read whole.

        Only lists that people alone make longer are: users, their keys, webhooks, and one sensor's versions of its gate
        profile and of its table definition.
        """
        ids = [row.id for row in rows]  # type: ignore[attr-defined]  # every row has a number
        begin = ids.index(self.last_id) + 1 if self.last_id is not None and self.last_id in ids else 0
        return self.cut(rows[begin : begin + self.limit + 1], show)


def _cursor(last_id: int, filters: str) -> str:
    return base64.urlsafe_b64encode(f"{last_id}.{filters}".encode()).decode().rstrip("=")


def _last_id(cursor: str, filters: str) -> int:
    """Read a cursor that was made for these filters."""
    try:
        text = base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode()
        last_id, _, made_for = text.partition(".")
        number = int(last_id)
    except (binascii.Error, ValueError) as error:
        raise RefusedInputError("This cursor cannot be read; start again without one.") from error
    if not 0 <= number <= GREATEST_ID or made_for != filters:
        raise RefusedInputError("This cursor belongs to a list with other filters; start again without one.")
    return number


async def get_paging(
    request: Request,
    cursor: Annotated[str | None, Query(description="`next` of the previous page.")] = None,
    limit: Annotated[int, Query(ge=1, le=LONGEST, description="Items on a page.")] = USUAL_LENGTH,
) -> Paging:
    """Read which page is asked for."""
    asked = sorted(pair for pair in request.query_params.multi_items() if pair[0] not in PLACING)
    filters = hashlib.sha256(repr((request.url.path, asked)).encode()).hexdigest()[:12]
    return Paging(None if cursor is None else _last_id(cursor, filters), limit, filters)


Paged = Annotated[Paging, Depends(get_paging)]


class TextConvertor(StringConvertor):
    """A text up to the next slash or verb."""

    regex = "[^/:]+"


class NumberConvertor(IntegerConvertor):
    """A number that a row's id could be."""

    regex = "[0-9]{1,19}"


def register() -> None:
    """Register the converters for paths that are compiled from now on."""
    register_url_convertor("str", TextConvertor())
    register_url_convertor("int", NumberConvertor())
