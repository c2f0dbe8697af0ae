"""What a telemetry file is: its bytes decide, and its suffix must agree with them.

A telemetry file as a run of tables, whatever its form: what the three formats offer to the reader.

What is wrong with the form of a file (blank rows, rows of too few cells, lines that are no JSON) is collected while the tables
are taken, for the cells of such a file mean nothing; whoever takes them refuses it at the end, before all else.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from boresight.errors import RefusedInputError
from boresight.telemetry.read.checks import MOST_FAULTS, Faults
from boresight.telemetry.read.signatures import refuse_no_json, refuse_other_kinds

_PARQUET_MAGIC = b"PAR1"
_SUFFIXES = {".csv": "CSV", ".jsonl": "JSON Lines", ".ndjson": "JSON Lines", ".parquet": "Parquet"}
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_WORTH_THREADS_BYTES = 8_000_000
_HEAD_BYTES = 65_536
#: Of a JSON document: a calibration of a long set has some megabytes, and nothing is nested deeper than ten.
LONGEST_DOCUMENT_BYTES, DEEPEST_DOCUMENT = 64_000_000, 32
TOO_DEEP = f"it is nested too deep, over {DEEPEST_DOCUMENT} objects or lists"


def worth_threads(size_bytes: int) -> bool:
    """Whether Arrow should read with its pool of threads.

    A small file gains nothing by it, and a process that a refusal ends while the pool is still starting aborts on its
    way out, once in some dozens of times on a busy machine.
    """
    return size_bytes > _WORTH_THREADS_BYTES


def format_at(path: Path, name: str) -> str:
    """Return `CSV`, `JSON Lines` or `Parquet` for a file, looking at its first bytes only."""
    with _opened(path) as file:
        head = file.read(_HEAD_BYTES)
        _refuse_emptiness(name, head, file)
    return detect_format(name, head)


def read_bytes(path: Path, name: str) -> bytes:
    """Return the content of a file."""
    with _opened(path) as file:
        data = file.read()
        _refuse_emptiness(name, data, file)
    return data


def read_json(path: Path, name: str) -> Any:
    """Return what a JSON file holds."""
    with _opened(path) as file:
        if file.seek(0, 2) > LONGEST_DOCUMENT_BYTES:
            raise RefusedInputError(
                f"{name} is over {LONGEST_DOCUMENT_BYTES / 1e6:,.0f} MB: this is no document that is read here, check the name."
            )
    return parse_json(read_text(name, read_bytes(path, name)))


def parse_json(text: bytes | str) -> Any:
    """Return what a JSON text holds."""
    try:
        document = json.loads(text)
    except json.JSONDecodeError:
        raise
    except RecursionError as error:
        raise json.JSONDecodeError(TOO_DEEP, "", 0) from error
    except ValueError as error:
        raise json.JSONDecodeError("a number has thousands of digits", "", 0) from error
    level = [document]
    for _ in range(DEEPEST_DOCUMENT):
        parts = [item.values() if isinstance(item, dict) else item for item in level if isinstance(item, dict | list)]
        level = [value for part in parts for value in part if isinstance(value, dict | list)]
        if not level:
            return document
    raise json.JSONDecodeError(TOO_DEEP, "", 0)


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file, refusing what cannot be read."""
    if path.is_dir():
        raise RefusedInputError(f"{path} is a folder: name the telemetry file inside it.")
    try:
        with path.open("rb") as file:
            yield file
    except FileNotFoundError as error:
        raise RefusedInputError(f"{path} does not exist: check the name.") from error
    except OSError as error:
        raise RefusedInputError(f"{path} cannot be read ({error.strerror}): check its permissions.") from error


def _refuse_emptiness(name: str, head: bytes, rest: BinaryIO) -> None:
    """Refuse a file that holds nothing, or nothing but blanks, in its first bytes and the rest."""
    if not head:
        raise RefusedInputError(f"{name} is empty: download it again.")
    head = head.removeprefix(BYTE_ORDER_MARK)
    while not head or head.isspace():
        head = rest.read(_HEAD_BYTES)
        if not head:
            raise RefusedInputError(f"{name} holds nothing but blanks: download it again.")


def detect_format(name: str, data: bytes) -> str:
    """Return `CSV`, `JSON Lines` or `Parquet`.

    A file without one of the known suffixes is what its bytes are; content-addressed files have no suffix.
    """
    refuse_other_kinds(name, data)
    if _is_wide_text(data):
        raise RefusedInputError(f"{name} is UTF-16 or UTF-32 text: save it as UTF-8.")
    found = _sniff(data)
    promised = _SUFFIXES.get(PurePath(name).suffix.lower(), found)
    if promised != found:
        raise RefusedInputError(
            f"{name} is named as {promised} but its content looks like {found}: rename it or export it again."
        )
    if found not in _SUFFIXES.values():
        raise RefusedInputError(f"{name} holds {found}: export it as CSV, JSON Lines or Parquet.")
    return found


def read_text(name: str, data: bytes) -> bytes:
    """Return the text of a JSON file as UTF-8 with plain line ends, without byte-order mark and closing blank lines."""
    refuse_no_json(name, data)
    data = data.removeprefix(BYTE_ORDER_MARK)
    if not data.isascii():
        refuse_other_encodings(name, data)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data[: end_of_last_row(data)]


def blank_rows(text: bytes) -> NDArray[np.int64]:
    """Return the numbers (n,) of the rows that hold nothing, counted as an editor does."""
    if b"\n\n" not in text and not text.startswith(b"\n"):
        return np.empty(0, np.int64)
    ends = np.flatnonzero(np.frombuffer(text, np.uint8) == ord("\n"))
    return np.flatnonzero(np.diff(ends, prepend=-1, append=len(text)) == 1) + 1


def end_of_last_row(data: bytes) -> int:
    """Return where the last row ends that is not blank; 0 where every row is."""
    last = len(data.rstrip())
    end = data.find(b"\n", last)
    return (len(data) if end < 0 else end) if last else 0


def _is_wide_text(data: bytes) -> bool:
    """Say whether every other byte is zero, as ASCII is written in UTF-16 and UTF-32, or such a mark comes first."""
    return data.startswith(_UTF16_MARKS) or (len(data) > 3 and (not any(data[:64:2]) or not any(data[1:64:2])))


def refuse_other_encodings(name: str, data: bytes, first_row: int = 1) -> None:
    """Refuse bytes that are not UTF-8, naming the row of the first; `first_row` is that of the first byte."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        row = data.count(b"\n", 0, error.start) + first_row
        byte = data[error.start]
        raise RefusedInputError(
            f"{name}: row {row}: the byte 0x{byte:02x} is not UTF-8 (Latin-1 or Windows text?): save it as UTF-8."
        ) from error


def _sniff(data: bytes) -> str:
    """Say what the bytes look like."""
    if data.startswith(_PARQUET_MAGIC):
        return "Parquet"
    if b"\0" in data[:4096]:
        return "binary data"
    start = data[:4096].removeprefix(BYTE_ORDER_MARK).lstrip()
    if start.startswith((b"{", b"[")):
        return "JSON Lines"
    return "CSV"


class FormFaults:
    """What is wrong with the form of a file: blank rows first, then all else."""

    def __init__(self, subject: str) -> None:
        self._blank, self.rows = Faults(subject), Faults(subject)

    @property
    def found(self) -> bool:
        """Whether there is something to refuse."""
        return bool(self._blank.count or self.rows.count)

    @property
    def has_blank_rows(self) -> bool:
        """Whether rows are blank, so that nothing else will be told."""
        return bool(self._blank.count)

    def look_for_blank_rows(self, text: bytes, first_row: int) -> None:
        """Collect the blank rows of a piece of text whose first row has this number."""
        rows = blank_rows(text)
        for row in rows[:MOST_FAULTS].tolist():
            self._blank.add("is blank: delete it", row=row + first_row - 1)
        self._blank.count += max(len(rows) - MOST_FAULTS, 0)

    def refuse(self) -> None:
        """Raise what was collected."""
        self._blank.refuse()
        self.rows.refuse()


@dataclass(frozen=True)
class Tables:
    """A telemetry file."""

    columns: tuple[str, ...]
    first_row: int
    read: Callable[[], Iterator[pa.Table]]
    form: FormFaults
