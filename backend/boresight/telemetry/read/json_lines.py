"""Reading JSON Lines: one object a line, a key a column.

Arrow parses well-formed lines with the known columns typed. Where that fails, or where an object does not have a line of its
own, the lines of the piece are parsed one by one and every cell becomes text, so that `columns` can name row and column.
Cells of other columns are kept as they were written, which takes a look at every line. Only the end of the file tells which
columns it has; a file of more than one piece is therefore read twice.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import orjson
import pyarrow as pa
import pyarrow.json as arrow_json

from boresight.errors import RefusedInputError
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.read.comma_separated import look_for_long_cells
from boresight.telemetry.read.formats import FormFaults, Tables, worth_threads
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.read.text_pieces import text_pieces
from boresight.telemetry.schema import FLOAT_COLUMNS, INTEGER_COLUMNS

#: There is no header.
FIRST_ROW = 1

#: Cells of a piece of text: so many in any case, else one a byte, for a cell that is written takes six.
_LEAST_CELLS = 1_000_000
_TYPES = {column: pa.float64() for column in FLOAT_COLUMNS} | {column: pa.int64() for column in INTEGER_COLUMNS}
_TYPES["time_utc"] = pa.string()
_KEYS = {column: re.compile(rf'"{column}"\s*:'.encode()) for column in _TYPES}


def json_tables(path: Path, name: str, limits: Limits = LIMITS, *, as_text: bool = False) -> Tables:
    """Open a JSON Lines file whose known columns are read as numbers or, in a piece where some cell is not one, as text."""
    form = FormFaults(name)
    tables = _tables(path, name, form, limits, as_text=as_text)
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
        first_row=FIRST_ROW,
        read=partial(iter, (first,)) if is_all else partial(_tables, path, name, form, limits, as_text=as_text),
        form=form,
    )


def _tables(path: Path, name: str, form: FormFaults, limits: Limits, *, as_text: bool) -> Iterator[pa.Table]:
    """Yield a table a piece."""
    row = FIRST_ROW
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
    table = _read(text, known, "error")
    if table is not None:
        return table
    table = _read(text, known, "ignore")  # there are other columns, or some cell does not fit
    return None if table is None else _with_other_columns(table, text, name, limits)


def _read(text: bytes, types: dict[str, pa.DataType], others: str) -> pa.Table | None:
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
    other = _line_by_line(text, FIRST_ROW, faults, name, limits)
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
    """Return a JSON value as the text a CSV cell would hold; None for null."""
    if cell is None or isinstance(cell, str):
        return cell
    return str(cell) if isinstance(cell, float) and not math.isfinite(cell) else orjson.dumps(cell).decode()
