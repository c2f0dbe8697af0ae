"""What a file is, told by its bytes and its suffix; CSV and JSON Lines are read here in pieces of whole rows, as tables.

A large file never is in memory at once.
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path, PurePath
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as arrow_csv
import pyarrow.json as arrow_json
from numpy.typing import NDArray

from boresight.errors import RefusedInputError
from boresight.telemetry.read.checks import MOST_FAULTS, Faults
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.schema import FLOAT_COLUMNS, INTEGER_COLUMNS

#: A tape archive names itself here.
_TAR_OFFSET = 257
#: Enough of a ZIP archive for the names of its first members.
_FIRST_MEMBERS_BYTES = 4096

_CENTROIDS = (
    "star centroids are expected: extract them from images with `boresight extract` and give its output; `calibrate`, `match` "
    "and the upload page do so by themselves"
)
_UNPACK = "unpack it and give the CSV, JSON Lines or Parquet file inside"
_SAVE_SHEET = "save the sheet as CSV and give that"
_EXPORT = "write its table of stars as CSV, JSON Lines or Parquet"
_BESIDE = "give it beside the table of stars, by the option {} of `boresight import`"
_OTHER_FILE = "give the telemetry itself, as CSV, JSON Lines or Parquet"


class FileKind(NamedTuple):
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
    **{magic: FileKind(f"a {name} image", _CENTROIDS) for magic, name in _IMAGES.items()},
    b"\x1f\x8b": FileKind("compressed by gzip", _UNPACK),
    b"BZh": FileKind("compressed by bzip2", _UNPACK),
    b"\xfd7zXZ\0": FileKind("compressed by xz", _UNPACK),
    b"\x28\xb5\x2f\xfd": FileKind("compressed by Zstandard", _UNPACK),
    b"7z\xbc\xaf\x27\x1c": FileKind("a 7-Zip archive", _UNPACK),
    b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1": FileKind("an old Office document, as Excel's .xls", _SAVE_SHEET),
    b"%PDF-": FileKind("a PDF document", _OTHER_FILE),
    b"\x89HDF\r\n\x1a\n": FileKind("an HDF5 file", _EXPORT),
    b"CDF\x01": FileKind("a NetCDF file", _EXPORT),
    b"CDF\x02": FileKind("a NetCDF file", _EXPORT),
    b"MATLAB 5.0 MAT-file": FileKind("a MATLAB file", _EXPORT),
    b"\x93NUMPY": FileKind("a NumPy array", _EXPORT),
    b"ARROW1\0\0": FileKind("an Arrow (Feather) file", "save it as Parquet"),
    b"FEA1": FileKind("a Feather file", "save it as Parquet"),
    b"ORC": FileKind("an ORC file", "save it as Parquet"),
    b"Obj\x01": FileKind("an Avro file", "save it as Parquet"),
    b"SQLite format 3\0": FileKind("an SQLite database", _EXPORT),
    b"\x7fELF": FileKind("a program (ELF)", _OTHER_FILE),
}
#: What is text of its own kind, and belongs beside telemetry.
_MESSAGES = {
    b"CCSDS_AEM_VERS": FileKind("a file of attitudes (CCSDS AEM)", _BESIDE.format("--attitude")),
    b"CCSDS_OEM_VERS": FileKind("a file of an orbit (CCSDS OEM)", _BESIDE.format("--orbit")),
}
_ZIP = b"PK\x03\x04"
#: What the names of an archive's first members say it is.
_ZIP_MEMBERS = {
    b"xl/": FileKind("an Excel workbook", _SAVE_SHEET),
    b"opendocument.spreadsheet": FileKind("an OpenDocument spreadsheet", _SAVE_SHEET),
    b"[Content_Types].xml": FileKind("an Office document, as an Excel workbook", _SAVE_SHEET),
    b".npy": FileKind("an archive of NumPy arrays", _EXPORT),
}
_PARQUET = b"PAR1"


def detect_kind(head: bytes) -> FileKind | None:
    """Say what a file is that is not telemetry, by its first bytes; None where no signature is known."""
    if head.startswith(_ZIP):
        members = head[:_FIRST_MEMBERS_BYTES]
        for word, kind in _ZIP_MEMBERS.items():
            if word in members:
                return kind
        return FileKind("a ZIP archive", f"{_UNPACK}, or save a spreadsheet as CSV")
    if head[_TAR_OFFSET : _TAR_OFFSET + 5] == b"ustar":
        return FileKind("a tar archive", _UNPACK)
    for magic, kind in _SIGNATURES.items():
        # a text may well begin as a short signature does, a binary file is not text for long
        if head.startswith(magic) and not (magic.isalnum() and _is_text(head)):
            return kind
    return None


def refuse_other_kinds(name: str, head: bytes) -> None:
    """Refuse a file that cannot be telemetry, by its first bytes."""
    message = next((kind for magic, kind in _MESSAGES.items() if head.lstrip().startswith(magic)), None)
    if (kind := message or detect_kind(head)) is not None:
        raise RefusedInputError(f"{name} is {kind.name}: {kind.remedy}.")


def refuse_no_json(name: str, head: bytes) -> None:
    """Refuse a file that is known to be no JSON text, by its first bytes."""
    kind = FileKind("a Parquet file", "") if head.startswith(_PARQUET) else detect_kind(head)
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
TOO_DEEP = f"it is nested too deeply, over {DEEPEST_DOCUMENT} objects or lists"


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
                f"{name} is over {LONGEST_DOCUMENT_BYTES / 1e6:,.0f} MB, too large for a document: check the name."
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
        raise RefusedInputError(f"{path} is a folder: name the telemetry file inside it.", code="is-a-folder")
    try:
        with path.open("rb") as file:
            yield file
    except FileNotFoundError as error:
        raise RefusedInputError(f"{path} does not exist: check the name.", code="no-such-file") from error
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
            raise RefusedInputError(f"{name} contains only blanks: download it again.")


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
            f"{name} is named like {promised} but its content looks like {found}: rename it or export it again."
        )
    if found not in _SUFFIXES.values():
        raise RefusedInputError(f"{name} contains {found}: export it as CSV, JSON Lines or Parquet.")
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


#: Read at a time; some hundred thousand rows.
PIECE_BYTES = 8_000_000


def text_pieces(path: Path, name: str, limits: Limits = LIMITS) -> Iterator[bytes]:
    """Yield the rows of a text file, some hundred thousand at a time."""
    row, waiting = 1, b""
    for block, is_last in _blocks(path):
        waiting += block
        _refuse_long_rows(name, row, waiting, limits)
        whole = waiting if is_last else waiting[: waiting.rfind(b"\n") + 1]
        if not whole.isascii():
            refuse_other_encodings(name, whole, row)
        end = end_of_last_row(whole)
        if not whole[:end].strip():
            _refuse_endless(name, row, waiting, is_last=is_last)
            continue
        yield whole[:end]
        row += whole.count(b"\n", 0, end) + 1
        waiting = waiting[end + 1 :]


def _refuse_long_rows(name: str, first_row: int, text: bytes, limits: Limits) -> None:
    """Refuse a row that is longer than may be, also one that goes on after this text."""
    begins = 0
    while len(text) - begins > limits.line_bytes:
        end = text.rfind(b"\n", begins, begins + limits.line_bytes + 1)
        if end < 0:
            row = first_row + text.count(b"\n", 0, begins)
            raise RefusedInputError(
                f"{name}: row {row}: is over {limits.line_bytes:,} bytes long: write one star per row, of at most "
                f"{limits.columns:,} "
                "columns."
            )
        begins = end + 1


def _refuse_endless(name: str, row: int, waiting: bytes, *, is_last: bool) -> None:
    """Refuse what fills a piece and still holds no whole row."""
    if len(waiting) > PIECE_BYTES and not is_last:
        raise RefusedInputError(
            f"{name}: row {row}: blank rows follow for over {PIECE_BYTES:,} bytes: write one star per row."
        )


def _blocks(path: Path) -> Iterator[tuple[bytes, bool]]:
    """Yield the bytes of a file with plain line ends, without byte-order mark, and whether they are the last."""
    with path.open("rb") as file:
        if file.read(len(BYTE_ORDER_MARK)) != BYTE_ORDER_MARK:
            file.seek(0)
        block, half_line_end = file.read(PIECE_BYTES), b""
        while block:
            following = file.read(PIECE_BYTES)
            text = half_line_end + block
            half_line_end = b"\r" if following and text.endswith(b"\r") else b""
            text = text[: len(text) - len(half_line_end)]
            if b"\r" in text:
                text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
            yield text, not following
            block = following


#: The header is row 1.
FIRST_CSV_ROW = 2

_CELL = re.compile(rb'(?:"(?:[^"]|"")*+"[^,]*+|(?!")[^,]*+)(?:,|$)')


def csv_tables(path: Path, name: str, limits: Limits = LIMITS, *, as_text: bool = False) -> Tables:
    """Open a CSV file whose known columns are read as numbers or, in a piece where some cell is not one, as text."""
    form = FormFaults(name)
    pieces = text_pieces(path, name, limits)
    first = next(pieces)
    header_line, _, rows = first.partition(b"\n")
    try:
        header = _header(name, header_line, limits)
    except RefusedInputError:
        for _ in pieces:  # text of another encoding comes first
            pass
        raise
    if not header:
        form.look_for_blank_rows(first, 1)
    if not rows:
        rows = next(pieces, b"")
    if not rows and header:
        raise RefusedInputError(f"{name} has a header but no rows: export it again, with its stars.")
    return Tables(
        columns=tuple(header),
        first_row=FIRST_CSV_ROW,
        read=partial(_csv_tables, chain([rows], pieces), header, form, limits, as_text=as_text),
        form=form,
    )


def _csv_tables(
    pieces: Iterator[bytes], header: list[str], form: FormFaults, limits: Limits, *, as_text: bool
) -> Iterator[pa.Table]:
    """Yield a table a piece; of a piece with rows that do not fit the header, none."""
    row = FIRST_CSV_ROW
    types = {} if as_text else _types(header)
    for text in pieces:
        form.look_for_blank_rows(text, row)
        rows = text.count(b"\n") + 1
        is_open = _cells_in(text[text.rfind(b"\n") + 1 :]) is None  # of any other line Arrow's rows would tell
        table = None if form.found or is_open else _table(text, header, types)
        if table is not None and table.num_rows == rows:
            look_for_long_cells(table, row, limits, form.rows)
            yield table
        elif not form.has_blank_rows:
            _look_at_lines(text, len(header), row, form.rows)
            if not form.found:
                form.rows.add("this is not CSV: write cells separated by commas, one row per line")
        row += rows


def _types(header: list[str]) -> dict[str, pa.DataType]:
    typed = {column: pa.float64() for column in header if column in FLOAT_COLUMNS}
    return typed | {column: pa.int64() for column in header if column in INTEGER_COLUMNS}


def look_for_long_cells(table: pa.Table, first_row: int, limits: Limits, faults: Faults) -> None:
    """Find texts that are longer than may be."""
    for column in table.column_names:
        cells = table[column]
        if pa.types.is_string(cells.type) and (pc.max(pc.binary_length(cells)).as_py() or 0) > limits.cell_bytes:
            length = pc.binary_length(cells).fill_null(0).to_numpy()
            for entry in (length > limits.cell_bytes).nonzero()[0].tolist():
                detail = f"is a text of {length[entry]:,} bytes, at most {limits.cell_bytes:,} are read: shorten it"
                faults.add(detail, row=first_row + entry, column=column)


def _header(name: str, line: bytes, limits: Limits) -> list[str]:
    """Return the column names, stripped of blanks; refuse nameless and repeated ones and other separators."""
    limits.refuse_columns(name, line.count(b",") + 1)  # at most: a comma may be part of a name
    text = line.decode()
    faults = Faults(name)
    try:
        header = [column.strip() for column in next(csv.reader([text]), [])]
    except csv.Error as error:  # a name is longer than any cell that the library reads
        faults.add("a name is too long to be read: give every column a short name", row=1)
        raise faults.refusal() from error
    for separator, spelled in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in text:
            faults.add(f"columns are separated by {spelled}: save the file with commas", row=1)
    seen: set[str] = set()
    for number, column in enumerate(header, start=1):
        if not column:
            faults.add(f"column {number} has no name: name it or leave it out", row=1)
        elif column in seen:
            faults.add("is there twice: leave one out", row=1, column=column)
        seen.add(column)
    faults.refuse()
    limits.refuse_names(name, tuple(header))
    return header


def _table(text: bytes, header: list[str], types: dict[str, pa.DataType]) -> pa.Table | None:
    """Read with the given types or, where some cell does not fit, all as text; None when some row does not fit."""
    table = _read_csv(text, header, types)
    return _read_csv(text, header, {}) if table is None and types else table


def _read_csv(text: bytes, header: list[str], typed: dict[str, pa.DataType]) -> pa.Table | None:
    """Read with the given types, everything else as text; None when some row or cell does not fit."""
    try:
        return arrow_csv.read_csv(
            pa.BufferReader(text),
            read_options=arrow_csv.ReadOptions(
                column_names=header, block_size=len(text) + 1, use_threads=worth_threads(len(text))
            ),
            convert_options=arrow_csv.ConvertOptions(
                column_types={column: typed.get(column, pa.string()) for column in header},
                null_values=[""],
                strings_can_be_null=True,
            ),
        )
    except pa.ArrowInvalid:
        return None


def _look_at_lines(text: bytes, expected: int, first_row: int, faults: Faults) -> None:
    """Find rows whose number of cells is not the header's, and cells that do not end on their line."""
    for row, line in enumerate(text.split(b"\n"), start=first_row):
        cells = _cells_in(line)
        if cells is None:
            faults.add(
                "a quotation mark is not closed on its line: write one row per line, without line breaks", row=row
            )
        elif cells != expected and line:
            faults.add(f"has {cells} cells where the header has {expected}: correct its commas", row=row)


def _cells_in(line: bytes) -> int | None:
    """Count the cells of a line; None when the last one is still open at its end."""
    if b'"' not in line:
        return line.count(b",") + 1
    cells, place = 0, 0
    while True:
        cell = _CELL.match(line, place)
        if cell is None:
            return None
        cells, place = cells + 1, cell.end()
        if not cell.group().endswith(b","):
            return cells


#: There is no header.
FIRST_JSON_ROW = 1

#: Cells of a piece of text: so many in any case, else one a byte, for a cell that is written takes six.
_LEAST_CELLS = 1_000_000
_TYPES = {column: pa.float64() for column in FLOAT_COLUMNS} | {column: pa.int64() for column in INTEGER_COLUMNS}
_TYPES["time_utc"] = pa.string()
_KEYS = {column: re.compile(rf'"{column}"\s*:'.encode()) for column in _TYPES}


def json_tables(path: Path, name: str, limits: Limits = LIMITS, *, as_text: bool = False) -> Tables:
    """Open a JSON Lines file whose known columns are read as numbers or, in a piece where some cell is not one, as text."""
    form = FormFaults(name)
    tables = _json_tables(path, name, form, limits, as_text=as_text)
    first = next(tables)
    columns, is_all, rows = dict.fromkeys(first.column_names), True, first.num_rows
    for table in tables:
        columns, is_all, rows = columns | dict.fromkeys(table.column_names), False, rows + table.num_rows
        limits.refuse_rows(name, rows)
        limits.refuse_columns(name, len(columns))
    form.refuse()
    limits.refuse_names(name, tuple(columns))
    known = [column for column in _TYPES if column in columns]
    return Tables(
        columns=(*known, *(column for column in columns if column not in _TYPES)),
        first_row=FIRST_JSON_ROW,
        read=partial(iter, (first,)) if is_all else partial(_json_tables, path, name, form, limits, as_text=as_text),
        form=form,
    )


def _json_tables(path: Path, name: str, form: FormFaults, limits: Limits, *, as_text: bool) -> Iterator[pa.Table]:
    row = FIRST_JSON_ROW
    for text in text_pieces(path, name, limits):
        form.look_for_blank_rows(text, row)
        rows = text.count(b"\n") + 1
        table = None if as_text else _typed(text, name, limits)
        if table is None or table.num_rows != rows:
            table = _line_by_line(text, row, form.rows, name, limits)
        look_for_long_cells(table, row, limits, form.rows)
        yield table
        row += rows


def _typed(text: bytes, name: str, limits: Limits) -> pa.Table | None:
    """Read with the known columns typed; None when some cell does not fit."""
    known = {column: kind for column, kind in _TYPES.items() if _KEYS[column].search(text)}
    table = _read_json(text, known, "error")
    if table is not None:
        return table
    table = _read_json(text, known, "ignore")  # there are other columns, or some cell does not fit
    return None if table is None else _with_other_columns(table, text, name, limits)


def _read_json(text: bytes, types: dict[str, pa.DataType], others: str) -> pa.Table | None:
    """Read the columns of the given types; None when some cell does not fit, or others are there and are an error."""
    try:
        return arrow_json.read_json(
            pa.BufferReader(text),
            read_options=arrow_json.ReadOptions(use_threads=worth_threads(len(text))),
            parse_options=arrow_json.ParseOptions(
                explicit_schema=pa.schema(list(types.items())), unexpected_field_behavior=others
            ),
        )
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return None


def _with_other_columns(table: pa.Table, text: bytes, name: str, limits: Limits) -> pa.Table | None:
    """Add the columns the contract does not name, as text; None when a line cannot be read by itself."""
    faults = Faults("")
    other = _line_by_line(text, FIRST_JSON_ROW, faults, name, limits)
    if faults.count or other.num_rows != table.num_rows:
        return None
    for column in other.column_names:
        if column not in _TYPES:
            table = table.append_column(column, other[column])
    return table


def _line_by_line(text: bytes, first_row: int, faults: Faults, name: str, limits: Limits) -> pa.Table:
    """Read every cell as text, noting lines that are not one object."""
    columns: dict[str, list[str | None]] = {}
    rows, most_cells = 0, max(_LEAST_CELLS, len(text))
    for row, line in enumerate(text.split(b"\n"), start=first_row):
        try:
            cells = _json(line)
        except orjson.JSONDecodeError as error:
            faults.add(f"is not JSON ({error.msg}): write one object per line, without NaN", row=row)
            continue
        if not isinstance(cells, dict):
            faults.add("is not a JSON object: write one object per line, with the columns as keys", row=row)
            continue
        for key, cell in cells.items():
            column = columns.setdefault(key, [])
            if len(column) < rows:
                column += [None] * (rows - len(column))
            column.append(_text(cell))
        rows += 1
        if len(columns) > limits.columns or len(columns) * rows > most_cells:
            limits.refuse_columns(name, len(columns))
            raise RefusedInputError(
                f"{name}: row {row}: {len(columns):,} different keys up to here, of which a line has few: give every "
                "object the same keys."
            )
    return pa.table(
        {key: pa.array(cells + [None] * (rows - len(cells)), pa.string()) for key, cells in columns.items()}
    )


def _json(line: bytes) -> Any:
    """Parse a line; NaN and infinity are read as Arrow reads them, for `columns` to refuse by their row."""
    try:
        return orjson.loads(line)
    except orjson.JSONDecodeError:
        if b"NaN" not in line and b"Infinity" not in line:
            raise
        try:
            cells = json.loads(line)
            orjson.dumps(cells)  # fails on text that is no text
        except (ValueError, RecursionError, orjson.JSONEncodeError):
            cells = None
        if cells is None:
            raise
        return cells


def _text(cell: object) -> str | None:
    if cell is None or isinstance(cell, str):
        return cell
    return str(cell) if isinstance(cell, float) and not math.isfinite(cell) else orjson.dumps(cell).decode()
