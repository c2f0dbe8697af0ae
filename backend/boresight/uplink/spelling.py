"""How the package's texts are spelt, so that one content has one sequence of bytes.

JSON has its keys sorted, two spaces a level, numbers by Python's `repr` (the shortest text that reads back as the same number),
no NaN, and a line end at its end. CSV has a header, commas, quotes where needed, and line ends of one character. All is UTF-8.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from typing import Any


def json_bytes(document: Any) -> bytes:
    """Write a JSON document.

    Raises
    ------
    ValueError
        When a number is NaN or infinite.
    """
    text = json.dumps(document, sort_keys=True, indent=2, ensure_ascii=False, allow_nan=False)
    return f"{text}\n".encode()


def canonical_bytes(document: Any) -> bytes:
    """Write a JSON document without a space and without a line end: the spelling that its hash is taken of."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode()


def csv_bytes(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    """Write a table; None becomes an empty cell, a number its shortest text.

    A text that a spreadsheet would take for a formula is led by an apostrophe.
    """
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([_cell(value) for value in row] for row in rows)
    return file.getvalue().encode()


def _cell(value: Any) -> str:
    """Write one value."""
    if value is None:
        return ""
    if isinstance(value, str):
        return f"'{value}" if value[:1] in tuple("=+-@\t\r") else value
    return repr(value)
