"""Reading CSV: a header line, commas, a row a line.

Arrow reads the known columns as numbers at once. Where that fails, every cell of the piece is read as text, and `columns`
finds the ones that are wrong; only a file with faults pays for it. Where even that fails, the lines are looked at one by one.
A line of CSV is cells between commas; a cell that begins with a quotation mark ends at the next single one::

    cell = "( not-a-quote | "" )*" rest | plain
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from functools import partial
from itertools import chain
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as arrow_csv

from boresight.errors import RefusedInputError
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.read.formats import FormFaults, Tables, worth_threads
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.read.text_pieces import text_pieces
from boresight.telemetry.schema import FLOAT_COLUMNS, INTEGER_COLUMNS

#: The header is row 1.
FIRST_ROW = 2

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
        first_row=FIRST_ROW,
        read=partial(_tables, chain([rows], pieces), header, form, limits, as_text=as_text),
        form=form,
    )


def _tables(
    pieces: Iterator[bytes], header: list[str], form: FormFaults, limits: Limits, *, as_text: bool
) -> Iterator[pa.Table]:
    """Yield a table a piece; of a piece with rows that do not fit the header, none."""
    row = FIRST_ROW
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
    """Return the types of the known columns."""
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
    table = _read(text, header, types)
    return _read(text, header, {}) if table is None and types else table


def _read(text: bytes, header: list[str], typed: dict[str, pa.DataType]) -> pa.Table | None:
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
