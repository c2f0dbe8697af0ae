"""The stored table of a set: the arrays of `Telemetry` in SI, checked once when they came, mapped whenever they are used.

Of the columns that the contract does not name it keeps those that say which image a frame is; a table without them reads as one of
a set that came as a file.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from boresight import disks as integrity
from boresight.arrays import IntArray
from boresight.errors import CorruptFileError, RefusedInputError
from boresight.telemetry.schema import Telemetry, joined, select_rows

MEDIA_TYPE = "application/vnd.apache.arrow.file"
_MAGIC = b"ARROW1"
_KIND, _FIRST_ROW = b"boresight.telemetry", b"first_row"
_VERSION = b"1"
#: The arrays there may be, in the order of the file's columns.
ARRAYS = tuple(item.name for item in fields(Telemetry) if item.name not in {"unknown", "first_row", "site"})

#: The further columns that are kept: name and SHA-256 of the image that a row's frame is.
KEPT_TEXTS = ("image", "image_sha256")


@dataclass(frozen=True)
class FrameImage:
    """The image that a frame is: the name it came under, and the SHA-256 of its bytes."""

    name: str
    sha256: str


def find_image(telemetry: Telemetry, row: int) -> FrameImage | None:
    """Return which image the frame of a row is; None where the telemetry does not say it."""
    if not set(KEPT_TEXTS) <= set(telemetry.unknown):
        return None
    name, sha256 = (str(telemetry.unknown[column][row].as_py() or "") for column in KEPT_TEXTS)
    return FrameImage(name, sha256) if name and sha256 else None


def is_working_table(path: Path) -> bool:
    """Whether a stored table is one of these; those stored before are Parquet in the units of the upload."""
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


class WorkingTableParts:
    """Parts of one set written into one table; the file is made with the first."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._writer: pa.ipc.RecordBatchFileWriter | None = None

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        if self._writer is not None:
            self._writer.close()

    def write(self, part: Telemetry) -> None:
        """Write the next rows, whole frames; they have the columns of the first part."""
        columns = {name: _arrow(values) for name in ARRAYS if (values := getattr(part, name)) is not None}
        columns |= {name: _plain(part.unknown[name]) for name in KEPT_TEXTS if name in part.unknown}
        batch = pa.record_batch(list(columns.values()), names=list(columns))
        if self._writer is None:
            said = {_KIND: _VERSION, _FIRST_ROW: str(part.first_row).encode()}
            self._writer = pa.ipc.new_file(str(self._path), batch.schema.with_metadata(said))
        self._writer.write_batch(batch)


@dataclass(frozen=True)
class WorkingTable:
    """A stored table."""

    path: Path
    sha256: str | None = None

    @cached_property
    def row_start(self) -> IntArray:
        """(n_parts + 1,) first row of each part, and the end."""
        _, reader = self._mapped()
        rows = [reader.get_batch(k).num_rows for k in range(reader.num_record_batches)]
        return np.cumsum([0, *rows], dtype=np.int64)

    def __len__(self) -> int:
        """Count the rows."""
        return int(self.row_start[-1])

    @property
    def n_parts(self) -> int:
        """Count the parts."""
        return len(self.row_start) - 1

    def part(self, number: int) -> Telemetry:
        """Map one part; what is written into its arrays stays with this process (the compiled loops take writable ones)."""
        mapped, reader = self._mapped()
        base, batch = pa.py_buffer(mapped).address, reader.get_batch(number)
        columns = dict(zip(batch.schema.names, batch.columns, strict=True))
        texts = {name: pa.chunked_array([columns.pop(name)]) for name in KEPT_TEXTS if name in columns}
        arrays: dict[str, Any] = {name: _array(mapped, base, column) for name, column in columns.items()}
        first_row = int(reader.schema.metadata[_FIRST_ROW]) + int(self.row_start[number])
        return Telemetry(**arrays, unknown=texts, first_row=first_row)

    def parts(self) -> Iterator[Telemetry]:
        """Map the parts one after the other."""
        return (self.part(number) for number in range(self.n_parts))

    def read(self) -> Telemetry:
        """Map all of it; several parts are put together in memory."""
        return joined(list(self.parts()))

    def rows(self, begin: int, end: int) -> Telemetry:
        """Map the rows begin <= k < end."""
        first, last = np.searchsorted(self.row_start, [begin, end - 1], side="right") - 1
        before = int(self.row_start[first])
        return select_rows(joined([self.part(k) for k in range(first, last + 1)]), slice(begin - before, end - before))

    def _mapped(self) -> tuple[mmap.mmap, pa.ipc.RecordBatchFileReader]:
        if self.sha256 is not None and not integrity.is_intact(self.path, self.sha256):
            raise CorruptFileError(
                f"The stored file {self.sha256[:12]} was altered on the disk, so it is not used; restore it from a backup.",
                self.sha256,
                code="altered-file",
            )
        try:
            with self.path.open("rb") as file:
                mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
            reader = pa.ipc.open_file(pa.py_buffer(mapped))
            if (reader.schema.metadata or {}).get(_KIND) == _VERSION:
                return mapped, reader
        except (pa.ArrowException, OSError, ValueError) as error:
            raise self._damaged() from error
        raise self._damaged()

    def _damaged(self) -> RefusedInputError:
        return RefusedInputError(
            f"The stored table {self.path.name[:12]} is damaged: restore it from a backup, or upload the telemetry again.",
            code="damaged-table",
        )


def _plain(cells: pa.ChunkedArray) -> pa.Array:
    """Put texts into one array, each as often as it stands there: parts of a file cannot have dictionaries of their own."""
    whole = cells.cast(pa.string()).combine_chunks()
    return whole.combine_chunks() if isinstance(whole, pa.ChunkedArray) else whole


def _arrow(values: NDArray[Any]) -> pa.Array:
    """Wrap an array (n,) or (n, k) as a column without a copy; NaN, 0 and NaT stay what they are in memory."""
    flat = np.ascontiguousarray(values).reshape(-1)
    kind = pa.timestamp("us", tz="UTC") if flat.dtype.kind == "M" else pa.from_numpy_dtype(flat.dtype)
    plain = flat.view(np.int64) if flat.dtype.kind == "M" else flat
    column = pa.Array.from_buffers(kind, len(flat), [None, pa.py_buffer(plain)])
    return column if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(column, values.shape[1])


def _array(mapped: mmap.mmap, base: int, column: pa.Array) -> NDArray[Any]:
    wide = isinstance(column, pa.FixedSizeListArray)
    flat = column.flatten() if wide else column
    dtype = np.dtype("datetime64[us]") if pa.types.is_timestamp(flat.type) else flat.type.to_pandas_dtype()
    if not len(flat):
        return np.empty((0, column.type.list_size) if wide else 0, dtype)
    values = np.frombuffer(mapped, dtype, len(flat), flat.buffers()[1].address - base)
    return values.reshape(len(column), -1) if wide else values
