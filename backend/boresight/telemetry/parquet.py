"""Reading and writing Parquet, the form in which telemetry is kept."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.parquet as arrow_parquet

from boresight.errors import RefusedInputError
from boresight.telemetry.formats import worth_threads
from boresight.telemetry.refusals import Faults

#: There is no header; a viewer counts from 1.
FIRST_ROW = 1

_MOST_ROWS = 100_000_000


def read_parquet(name: str, data: bytes) -> pa.Table:
    """Read a Parquet file.

    Parameters
    ----------
    name
        The file's name, for refusals.
    data
        The file's bytes.

    Raises
    ------
    RefusedInputError
        When the file is truncated or damaged, has a column twice, or claims more rows than fit into memory.
    """
    try:
        file = arrow_parquet.ParquetFile(pa.BufferReader(data))
        _refuse_repeated_columns(name, file.schema_arrow.names)
        if file.metadata.num_rows > _MOST_ROWS:
            raise RefusedInputError(f"{name} has {file.metadata.num_rows} rows: split it below {_MOST_ROWS}.")
        table = file.read(use_threads=worth_threads(data))
        table.validate(full=True)  # text that is not UTF-8 would only be noticed where it is used
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise RefusedInputError(
            f"{name} is a truncated or damaged Parquet file: download or export it again."
        ) from error
    return table


def _refuse_repeated_columns(name: str, columns: list[str]) -> None:
    faults = Faults(name)
    for number, column in enumerate(columns):
        if column in columns[:number]:
            faults.add("is there twice: leave one out", column=column)
    faults.refuse()
