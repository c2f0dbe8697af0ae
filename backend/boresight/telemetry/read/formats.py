"""What a file is, told by its bytes and its suffix: telemetry in one of three formats, read as tables, or something else."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from boresight.errors import RefusedInputError
from boresight.telemetry.read.checks import MOST_FAULTS, Faults

#: A tape archive names itself here.
_TAR_OFFSET = 257
#: Enough of a ZIP archive for the names of its first members.
_FIRST_MEMBERS_BYTES = 4096

_CENTROIDS = (
    "Boresight reads star centroids, not images; find the stars with a centroiding program and write one row a star "
    "(frame, exposure, row_px, col_px) as CSV, JSON Lines or Parquet"
)
_UNPACK = "unpack it and give the CSV, JSON Lines or Parquet file inside"
_SAVE_SHEET = "save the sheet as CSV and give that"
_EXPORT = "write its table of stars as CSV, JSON Lines or Parquet"
_OTHER_FILE = "give the telemetry itself, as CSV, JSON Lines or Parquet"


class Kind(NamedTuple):
    """What a file is, with its article, and what to make telemetry of it by."""

    name: str
    remedy: str


_IMAGES = {
    b"SIMPLE  =": "FITS",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"II+\0": "TIFF",
    b"MM\0+": "TIFF",
    b"\x89PNG\r\n\x1a\n": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"\0\0\0\x0cjP  \r\n\x87\n": "JPEG 2000",
    b"GIF87a": "GIF",
    b"GIF89a": "GIF",
}
_SIGNATURES = {
    **{magic: Kind(f"a {name} image", _CENTROIDS) for magic, name in _IMAGES.items()},
    b"\x1f\x8b": Kind("compressed by gzip", _UNPACK),
    b"BZh": Kind("compressed by bzip2", _UNPACK),
    b"\xfd7zXZ\0": Kind("compressed by xz", _UNPACK),
    b"\x28\xb5\x2f\xfd": Kind("compressed by Zstandard", _UNPACK),
    b"7z\xbc\xaf\x27\x1c": Kind("a 7-Zip archive", _UNPACK),
    b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1": Kind("an old Office document, as Excel's .xls", _SAVE_SHEET),
    b"%PDF-": Kind("a PDF document", _OTHER_FILE),
    b"\x89HDF\r\n\x1a\n": Kind("an HDF5 file", _EXPORT),
    b"CDF\x01": Kind("a NetCDF file", _EXPORT),
    b"CDF\x02": Kind("a NetCDF file", _EXPORT),
    b"MATLAB 5.0 MAT-file": Kind("a MATLAB file", _EXPORT),
    b"\x93NUMPY": Kind("a NumPy array", _EXPORT),
    b"ARROW1\0\0": Kind("an Arrow (Feather) file", "write it as Parquet"),
    b"FEA1": Kind("a Feather file", "write it as Parquet"),
    b"ORC": Kind("an ORC file", "write it as Parquet"),
    b"Obj\x01": Kind("an Avro file", "write it as Parquet"),
    b"SQLite format 3\0": Kind("an SQLite database", _EXPORT),
    b"\x7fELF": Kind("a program (ELF)", _OTHER_FILE),
}
_ZIP = b"PK\x03\x04"
#: What the names of an archive's first members say it is.
_ZIP_MEMBERS = {
    b"xl/": Kind("an Excel workbook", _SAVE_SHEET),
    b"opendocument.spreadsheet": Kind("an OpenDocument spreadsheet", _SAVE_SHEET),
    b"[Content_Types].xml": Kind("an Office document, as an Excel workbook", _SAVE_SHEET),
    b".npy": Kind("an archive of NumPy arrays", _EXPORT),
}
_PARQUET = b"PAR1"


def detect_kind(head: bytes) -> Kind | None:
    """Say what a file is that is not telemetry, by its first bytes; None where no signature is known."""
    if head.startswith(_ZIP):
        members = head[:_FIRST_MEMBERS_BYTES]
        for word, kind in _ZIP_MEMBERS.items():
            if word in members:
                return kind
        return Kind("a ZIP archive", f"{_UNPACK}, or save a spreadsheet as CSV")
    if head[_TAR_OFFSET : _TAR_OFFSET + 5] == b"ustar":
        return Kind("a tar archive", _UNPACK)
    for magic, kind in _SIGNATURES.items():
        # a text may well begin as a short signature does, a binary file is not text for long
        if head.startswith(magic) and not (magic.isalnum() and _is_text(head)):
            return kind
    return None


def refuse_other_kinds(name: str, head: bytes) -> None:
    """Refuse a file that cannot be telemetry, by its first bytes."""
    if (kind := detect_kind(head)) is not None:
        raise RefusedInputError(f"{name} is {kind.name}: {kind.remedy}.")


def refuse_no_json(name: str, head: bytes) -> None:
    """Refuse a file that is known to be no JSON text, by its first bytes."""
    kind = Kind("a Parquet file", "") if head.startswith(_PARQUET) else detect_kind(head)
    if kind is not None:
        raise RefusedInputError(f"{name} is {kind.name}, where a JSON text is expected: give the JSON file.")


def _is_text(head: bytes) -> bool:
    """Whether bytes could go on as text: no control characters but line ends and tabs, and UTF-8 but for a cut at the end."""
    if any(byte < 0x20 and byte not in b"\t\n\r" for byte in head):
        return False
    try:
        head[: max(len(head) - 3, 0)].decode()
    except UnicodeDecodeError as error:
        return error.reason == "unexpected end of data"
    return True


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
    if data.startswith(_PARQUET):
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
