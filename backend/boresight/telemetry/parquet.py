"""Reading Parquet, the form in which telemetry is kept."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import chain, islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet

from boresight.errors import RefusedInputError
from boresight.telemetry.formats import worth_threads
from boresight.telemetry.refusals import Faults
from boresight.telemetry.tables import FormFaults, Tables

#: There is no header; a viewer counts from 1.
FIRST_ROW = 1

_MOST_ROWS = 100_000_000
#: Decoded at a time, however large the groups are in which the file was compressed.
_BATCH_ROWS = 131_072
#: Read at a time of each column, so that a group of rows as large as the file is not in memory either.
_BUFFER_BYTES = 1_000_000


def parquet_tables(path: Path, name: str, rows: range | None = None) -> Tables:
    """Open a Parquet file.

    Parameters
    ----------
    path
        Where it is.
    name
        Its name, for refusals.
    rows
        Which are read; None is all.

    Raises
    ------
    RefusedInputError
        When the file is truncated or damaged, has a column twice, claims more rows than can be worked on, or none.
    """
    with open_parquet(path, name) as file:
        columns, count = file.schema_arrow.names, file.metadata.num_rows
    _refuse_repeated_columns(name, columns)
    if count > _MOST_ROWS:
        raise RefusedInputError(f"{name} has {count} rows: split it below {_MOST_ROWS}.")
    rows = range(count) if rows is None else rows
    read = partial(_tables, path, name, rows)
    return Tables(columns=tuple(columns), first_row=FIRST_ROW + rows.start, read=read, form=FormFaults(name))


def rows_of_parquet(path: Path, name: str) -> int:
    """Return how many rows a Parquet file says it has; refuses as `parquet_tables`."""
    with open_parquet(path, name) as file:
        return int(file.metadata.num_rows)


def _tables(path: Path, name: str, rows: range) -> Iterator[pa.Table]:
    """Yield the rows, a batch at a time."""
    with open_parquet(path, name) as file:
        for batch in _batches(file, rows, threads=worth_threads(path.stat().st_size)):
            batch.validate(full=True)  # text that is not UTF-8 would only be noticed where it is used
            yield pa.Table.from_batches([batch])


def _batches(file: arrow_parquet.ParquetFile, rows: range, *, threads: bool) -> Iterator[pa.RecordBatch]:
    """Yield the batches of these rows, from the groups that hold them; of the last group only what is wanted is decoded."""
    starts = np.cumsum([0, *(file.metadata.row_group(k).num_rows for k in range(file.metadata.num_row_groups))])
    first, last = np.searchsorted(starts, [rows.start, rows.stop], side="right") - 1
    reading = partial(file.iter_batches, use_threads=threads)
    whole = reading(batch_size=_BATCH_ROWS, row_groups=list(range(first, last)))
    if left := rows.stop - int(starts[last]):
        whole = chain(
            whole, islice(reading(batch_size=min(left, _BATCH_ROWS), row_groups=[last]), -(-left // _BATCH_ROWS))
        )
    skip, wanted = rows.start - int(starts[first]), len(rows)
    for batch in whole:
        part = batch.slice(skip, wanted)
        skip, wanted = max(skip - len(batch), 0), wanted - len(part)
        if len(part):
            yield part


@contextmanager
def open_parquet(path: Path, name: str) -> Iterator[arrow_parquet.ParquetFile]:
    """Open a file, refusing one that is damaged wherever that shows, while it is open too."""
    try:
        with arrow_parquet.ParquetFile(path, buffer_size=_BUFFER_BYTES, pre_buffer=False) as file:
            yield file
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise RefusedInputError(
            f"{name} is a truncated or damaged Parquet file: download or export it again."
        ) from error


def _refuse_repeated_columns(name: str, columns: list[str]) -> None:
    faults = Faults(name)
    for number, column in enumerate(columns):
        if column in columns[:number]:
            faults.add("is there twice: leave one out", column=column)
    faults.refuse()
