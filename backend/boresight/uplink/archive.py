"""Files and texts whose bytes follow from their content alone: one ZIP, canonical JSON and CSV."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

FIRST_DATE = (1980, 1, 1, 0, 0, 0)
UNIX = 3
PLAIN_FILE = 0o100644 << 16


def sums(files: Mapping[str, bytes]) -> bytes:
    """Write the SHA-256 of every file as `sha256sum -c` reads it."""
    lines = (f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in sorted(files.items()))
    return "".join(lines).encode()


def archive(files: Mapping[str, bytes]) -> bytes:
    """Put files into a ZIP."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as packed:
        for name, content in sorted(files.items()):
            entry = zipfile.ZipInfo(name, FIRST_DATE)
            entry.create_system = UNIX
            entry.external_attr = PLAIN_FILE
            packed.writestr(entry, content)
    return buffer.getvalue()


def json_bytes(document: Any) -> bytes:
    """Write a JSON document."""
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
    if value is None:
        return ""
    if isinstance(value, str):
        return f"'{value}" if value[:1] in tuple("=+-@\t\r") else value
    return repr(value)
