"""Reading CSV and JSON Lines, in pieces of whole rows, so that a large file never is in memory at once."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import orjson
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as arrow_csv
import pyarrow.json as arrow_json

from boresight.errors import RefusedInputError
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.read.formats import (
    BYTE_ORDER_MARK,
    FormFaults,
    Tables,
    end_of_last_row,
    refuse_other_encodings,
    worth_threads,
)
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.schema import FLOAT_COLUMNS, INTEGER_COLUMNS

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
                f"{name}: row {row}: is over {limits.line_bytes:,} bytes long: write one star a row, of at most {limits.columns:,} "
                "columns."
            )
        begins = end + 1


def _refuse_endless(name: str, row: int, waiting: bytes, *, is_last: bool) -> None:
    """Refuse what fills a piece and still holds no whole row."""
    if len(waiting) > PIECE_BYTES and not is_last:
        raise RefusedInputError(
            f"{name}: row {row}: blank rows follow for over {PIECE_BYTES:,} bytes: write one star a row."
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
        raise RefusedInputError(f"{name} has a header but no rows: there is nothing to calibrate from.")
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
                form.rows.add("this is not CSV: write cells separated by commas, a row a line")
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
            faults.add("a quotation mark is not closed on its line: write one row a line, without line breaks", row=row)
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
            faults.add(f"is not JSON ({error.msg}): write one object a line, without NaN", row=row)
            continue
        if not isinstance(cells, dict):
            faults.add("is not a JSON object: write one object a line, its keys the columns", row=row)
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
                f"{name}: row {row}: {len(columns):,} different keys came up to here, of which a line has few: give every "
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
