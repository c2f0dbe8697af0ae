"""What sentences of every floor are put together from: words in a row, and a value that somebody gave."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

LONGEST_QUOTE = 40


def join_words(words: Sequence[str]) -> str:
    """Write words in a row, the last after an "and"."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def quote(value: Any) -> str:
    """Write a given value as a refusal shows it, cut where it is long."""
    text = repr(value)
    return text if len(text) <= LONGEST_QUOTE else text[: LONGEST_QUOTE - 1] + "…"
