"""Reading JSON Lines: one object a line, a key a column.

Arrow parses a well-formed file with the known columns typed. Where that fails, or where an object does not have a line
of its own, the lines are parsed one by one and every cell becomes text, so that `columns` can name row and column.
"""

from __future__ import annotations

import orjson
import pyarrow as pa
import pyarrow.json as arrow_json

from boresight.telemetry.formats import blank_rows, worth_threads
from boresight.telemetry.refusals import Faults
from boresight.telemetry.schema import FLOAT_COLUMNS, INTEGER_COLUMNS

#: There is no header.
FIRST_ROW = 1


def read_json_lines(name: str, text: bytes) -> pa.Table:
    """Read JSON Lines into a table whose known columns are numbers or, where some cell is not one, text.

    Parameters
    ----------
    name
        The file's name, for refusals.
    text
        UTF-8, lines ended by a line feed.

    Raises
    ------
    RefusedInputError
        For blank lines and lines that are not one JSON object.
    """
    blank = Faults(name)
    for row in blank_rows(text):
        blank.add("is blank: delete it", row=row)
    blank.refuse()
    types = {column: pa.float64() for column in FLOAT_COLUMNS} | {column: pa.int64() for column in INTEGER_COLUMNS}
    types["time_utc"] = pa.string()
    known = {column: kind for column, kind in types.items() if f'"{column}"'.encode() in text}
    table = _read(text, known)
    if table is not None and any(pa.types.is_timestamp(field.type) for field in table.schema):
        looks_like_time = [field.name for field in table.schema if pa.types.is_timestamp(field.type)]
        table = _read(text, known | dict.fromkeys(looks_like_time, pa.string()))
    if table is None or table.num_rows != text.count(b"\n") + 1:
        return _read_line_by_line(name, text)
    return table


def _read(text: bytes, types: dict[str, pa.DataType]) -> pa.Table | None:
    """Read with the given types, others as they are found; None when some cell does not fit."""
    try:
        return arrow_json.read_json(
            pa.BufferReader(text),
            read_options=arrow_json.ReadOptions(use_threads=worth_threads(text)),
            parse_options=arrow_json.ParseOptions(explicit_schema=pa.schema(list(types.items()))),
        )
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return None


def _read_line_by_line(name: str, text: bytes) -> pa.Table:
    """Read every cell as text, refusing lines that are not one object."""
    faults = Faults(name)
    objects = []
    for row, line in enumerate(text.split(b"\n"), start=FIRST_ROW):
        try:
            cells = orjson.loads(line)
        except orjson.JSONDecodeError as error:
            faults.add(f"is not JSON ({error.msg}): write one object a line, without NaN", row=row)
            continue
        if isinstance(cells, dict):
            objects.append(cells)
        else:
            faults.add("is not a JSON object: write one object a line, its keys the columns", row=row)
    faults.refuse()
    columns = dict.fromkeys(key for cells in objects for key in cells)
    return pa.table({key: pa.array([_text(cells.get(key)) for cells in objects], pa.string()) for key in columns})


def _text(cell: object) -> str | None:
    """Return a JSON value as the text a CSV cell would hold; None for null."""
    return cell if cell is None or isinstance(cell, str) else orjson.dumps(cell).decode()
