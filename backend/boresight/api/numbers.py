"""The numbers of rows as requests name them: what the store's 64-bit keys can hold."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Le

GREATEST_ID = 2**63 - 1
MOST_DIGITS = len(str(GREATEST_ID))

Id = Annotated[int, Ge(1), Le(GREATEST_ID)]


def row_number(text: str) -> int | None:
    """Read the number of a row; None where the text is none, or greater than any row's."""
    text = text.strip()
    if not text.isdecimal() or len(text.lstrip("0")) > MOST_DIGITS:
        return None
    number = int(text[-MOST_DIGITS:])
    return number if number <= GREATEST_ID else None
