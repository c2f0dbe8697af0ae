"""Reading CSV: a header line, commas, a row a line.

Arrow reads the known columns as numbers at once. Where that fails, every cell is read as text, and `columns` finds
the ones that are wrong; only a file with faults pays for it.
"""

from __future__ import annotations

import contextlib
import csv
import io

import pyarrow as pa
import pyarrow.csv as arrow_csv

from boresight.errors import RefusedInputError
from boresight.telemetry.formats import blank_rows, worth_threads
from boresight.telemetry.refusals import Faults
from boresight.telemetry.schema import FLOAT_COLUMNS, INTEGER_COLUMNS

#: The header is row 1.
FIRST_ROW = 2


def read_csv(name: str, text: bytes) -> pa.Table:
    """Read CSV text into a table whose known columns are numbers or, where some cell is not one, text.

    Parameters
    ----------
    name
        The file's name, for refusals.
    text
        UTF-8, lines ended by a line feed.

    Raises
    ------
    RefusedInputError
        For a header that is unusable, rows with too many or too few cells, blank rows, line breaks inside cells.
    """
    header = _header(name, text)
    _refuse_blank_rows(name, text)
    if b"\n" not in text:
        raise RefusedInputError(f"{name} has a header but no rows: there is nothing to calibrate from.")
    typed = {column: pa.float64() for column in header if column in FLOAT_COLUMNS}
    typed |= {column: pa.int64() for column in header if column in INTEGER_COLUMNS}
    table = _read(text, header, typed)
    if table is None:
        table = _read(text, header, {})
    if table is None:
        _refuse_ragged_rows(name, text, header)
        raise RefusedInputError(f"{name} is not CSV: a quotation mark is not closed.")
    if table.num_rows != text.count(b"\n"):
        raise RefusedInputError(f"{name} has line breaks inside quoted cells: write one row a line.")
    return table


def _header(name: str, text: bytes) -> list[str]:
    """Return the column names, stripped of blanks; refuse nameless and repeated ones and other separators."""
    line = io.BytesIO(text).readline().decode()
    header = [column.strip() for column in next(csv.reader([line]), [])]
    faults = Faults(name)
    for separator, spelled in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in line:
            faults.add(f"columns are separated by {spelled}: save the file with commas", row=1)
    for number, column in enumerate(header, start=1):
        if not column:
            faults.add(f"column {number} has no name: name it or leave it out", row=1)
        elif column in header[: number - 1]:
            faults.add("is there twice: leave one out", row=1, column=column)
    faults.refuse()
    return header


def _refuse_blank_rows(name: str, text: bytes) -> None:
    faults = Faults(name)
    for row in blank_rows(text):
        faults.add("is blank: delete it", row=row)
    faults.refuse()


def _read(text: bytes, header: list[str], typed: dict[str, pa.DataType]) -> pa.Table | None:
    """Read with the given types, everything else as text; None when some row or cell does not fit."""
    try:
        return arrow_csv.read_csv(
            pa.BufferReader(text),
            read_options=arrow_csv.ReadOptions(column_names=header, skip_rows=1, use_threads=worth_threads(text)),
            convert_options=arrow_csv.ConvertOptions(
                column_types={column: typed.get(column, pa.string()) for column in header},
                null_values=[""],
                strings_can_be_null=True,
            ),
        )
    except pa.ArrowInvalid:
        return None


def _refuse_ragged_rows(name: str, text: bytes, header: list[str]) -> None:
    """Read row by row and refuse the rows whose number of cells is not the header's."""
    faults = Faults(name)

    def note(row: arrow_csv.InvalidRow) -> str:
        faults.add(
            f"has {row.actual_columns} cells where the header has {row.expected_columns}: correct its commas",
            row=row.number,
        )
        return "skip"

    # an unclosed quotation mark ends the reading itself; the rows before it may still be at fault
    with contextlib.suppress(pa.ArrowInvalid):
        arrow_csv.read_csv(
            pa.BufferReader(text),
            read_options=arrow_csv.ReadOptions(use_threads=False),
            parse_options=arrow_csv.ParseOptions(invalid_row_handler=note),
            convert_options=arrow_csv.ConvertOptions(column_types=dict.fromkeys(header, pa.string())),
        )
    faults.refuse()
