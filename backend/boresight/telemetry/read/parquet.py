"""Reading Parquet, the form in which telemetry is kept.

A small file can stand for any number of rows, and for texts of any length: it is compressed, and repeats are written once. So
what it takes when it is read is told from its footer and from the header of every page (`parquet_pages`) before anything is
decompressed, and held to `Limits`; texts are read as they are written, each different one once, and their lengths added up.

What the pages of a Parquet file say of their size, read before one of them is decompressed.

A footer says how large a file is when it is read, and may lie; what is allocated follows the header that stands before every page.
Such a header is a Thrift struct in compact form, of which five numbers matter here::

    PageHeader      1 type, 2 uncompressed_page_size, 3 compressed_page_size, 5 data header, 7 dictionary header, 8 data header v2
    data header     1 num_values, 2 encoding                    (DataPageHeader)
    data header v2  1 num_values, 4 encoding                    (DataPageHeaderV2)

Where the pages begin stands in the footer, which is read here too: Arrow's own way to ask for a column of a group ends the process
where the footer is damaged in the wrong place::

    FileMetaData    4 row_groups                RowGroup        1 columns, 3 num_rows
    ColumnChunk     3 meta_data                 ColumnMetaData  5 num_values, 7 total_compressed_size, 9 and 11 offsets of the pages

Every field is a byte (difference of field numbers, type) and a value; integers are zigzag varints, a struct ends with 0.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from boresight.errors import RefusedInputError
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.read.formats import FormFaults, Tables, worth_threads
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.schema import FLOAT_COLUMNS, INTEGER_COLUMNS, OPTIONAL_COLUMNS, REQUIRED_COLUMNS

if TYPE_CHECKING:
    import pyarrow.parquet as arrow_parquet

#: Texts that share their beginnings: a page of some bytes can stand for any length of text.
DELTA_BYTE_ARRAY = 7
_DATA, _DICTIONARY, _DATA_V2 = 0, 2, 3
#: A header with the statistics of long texts; ours are under a hundred bytes.
_LONGEST_HEADER = 65_536
_DEEPEST = 8
#: Types of Thrift values: true and false (which a field holds in its type), byte, integers, double, binary, list, set, struct.
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _STRUCT = (*range(1, 11), 12)


class DamagedPageError(ValueError):
    """A page header that cannot be read."""


@dataclass(frozen=True)
class PageHeader:
    """One page: what its header says."""

    is_dictionary: bool
    uncompressed_bytes: int
    values: int
    encoding: int


@dataclass(frozen=True)
class Chunk:
    """A column of a group of rows: how many values it has, and the bytes of its pages."""

    values: int
    start: int
    size: int


def list_chunks(file: mmap.mmap | bytes) -> list[list[Chunk]]:
    """The columns of every group of rows, as the footer says."""
    end = len(file) - 8
    start = end - int.from_bytes(file[end : end + 4], "little")
    if start < 0:
        raise DamagedPageError("the footer is longer than the file")
    groups = _Thrift(file, start, end).struct().get(4, [])
    return [[_chunk(column) for column in _structs(_fields(group).get(1))] for group in _structs(groups)]


def _chunk(column: dict[int, object]) -> Chunk:
    fields = _fields(column.get(3))
    start, dictionary = _number(fields, 9), fields.get(11)
    if isinstance(dictionary, int) and (0 < dictionary < start or not start):
        start = dictionary  # a group of no rows has nothing after it
    return Chunk(_number(fields, 5), start, _number(fields, 7))


def _fields(value: object) -> dict[int, object]:
    if not isinstance(value, dict):
        raise DamagedPageError("a struct is missing")
    return value


def _structs(value: object) -> list[dict[int, object]]:
    if not isinstance(value, list):
        raise DamagedPageError("a list is missing")
    return [_fields(item) for item in value]


def iterate_pages(file: mmap.mmap | bytes, start: int, size: int) -> Iterator[PageHeader]:
    """Yield the pages of a column chunk that lies at these bytes."""
    end = start + size
    if start < 0 or size < 0 or end > len(file):
        raise DamagedPageError("a column lies beyond the file")
    while start < end:
        header = _Thrift(file, start, min(start + _LONGEST_HEADER, end))
        fields = header.struct()
        compressed, uncompressed = _number(fields, 3), _number(fields, 2)
        start = header.place + compressed
        if compressed < 0 or uncompressed < 0 or start > end:
            raise DamagedPageError("a page ends beyond its column")
        yield _page(fields, uncompressed)


def _page(fields: dict[int, object], uncompressed: int) -> PageHeader:
    """Make a page of the fields of its header."""
    kind = _number(fields, 1)
    inner = fields.get({_DATA: 5, _DICTIONARY: 7, _DATA_V2: 8}.get(kind, 0))
    if not isinstance(inner, dict):
        return PageHeader(is_dictionary=False, uncompressed_bytes=uncompressed, values=0, encoding=-1)
    encoding = _number(inner, 4 if kind == _DATA_V2 else 2)
    return PageHeader(kind == _DICTIONARY, uncompressed, _number(inner, 1), encoding)


def _number(fields: dict[int, object], key: int) -> int:
    value = fields.get(key)
    if not isinstance(value, int):
        raise DamagedPageError("a page header lacks a number")
    return value


class _Thrift:
    """Reads one struct in compact form; only its numbers, inner structs and lists of these are kept."""

    def __init__(self, data: mmap.mmap | bytes, place: int, end: int) -> None:
        self._data, self.place, self._end = data, place, end

    def struct(self, depth: int = 0) -> dict[int, object]:
        """Read the fields up to the end of the struct, by number."""
        fields: dict[int, object] = {}
        last = 0
        while head := self._byte():
            step, kind = head >> 4, head & 15
            last = last + step if step else self._signed()
            value = self._value(kind, depth)
            if value is not None:
                fields[last] = value
        return fields

    def _value(self, kind: int, depth: int) -> object:
        """Read a value; None for what is passed over."""
        if depth > _DEEPEST:
            raise DamagedPageError("a page header is nested too deeply")
        if kind in {_I16, _I32, _I64}:
            return self._signed()
        if kind == _STRUCT:
            return self.struct(depth + 1)
        if kind in {_LIST, _SET}:
            return self._list(depth)
        if kind == _BINARY:
            self._skip(self._unsigned())
        elif kind in {_BYTE, _DOUBLE}:
            self._skip(1 if kind == _BYTE else 8)
        elif kind not in {_TRUE, _FALSE}:
            raise DamagedPageError("a page header contains invalid data")
        return None

    def _list(self, depth: int) -> list[object]:
        head = self._byte()
        count, kind = head >> 4, head & 15
        items: list[object] = []
        for _ in range(self._unsigned() if count == 15 else count):
            if kind in {_TRUE, _FALSE}:
                self._skip(1)
            elif (item := self._value(kind, depth + 1)) is not None and kind == _STRUCT:
                items.append(item)
        return items

    def _skip(self, count: int) -> None:
        self.place += count
        if self.place > self._end:
            raise DamagedPageError("a page header does not end")

    def _byte(self) -> int:
        self._skip(1)
        return self._data[self.place - 1]

    def _unsigned(self) -> int:
        value = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise DamagedPageError("a number in a page header does not end")

    def _signed(self) -> int:
        value = self._unsigned()
        return (value >> 1) ^ -(value & 1)


#: There is no header; a viewer counts from 1.
FIRST_ROW = 1

#: Decoded at a time, however large the groups are in which the file was compressed; fewer where rows are long.
_BATCH_ROWS = 131_072
_BATCH_BYTES = 32_000_000
#: But so many cells, for each batch costs some microseconds a column.
_BATCH_CELLS = 65_536
#: Read at a time of each column, so that a group of rows as large as the file is not in memory either.
_BUFFER_BYTES = 1_000_000
#: A footer has some 100 bytes a column and group of rows; parsed it takes ten times as much.
_FOOTER_BYTES = 8_000_000
_TAIL_BYTES = 8
_MOST_CHUNKS = 50_000
#: Pages of fewer values than this, on the whole, beside the first: a header each is read, and programs write thousands.
_LEAST_VALUES, _FIRST_PAGES = 500, 20_000
#: Pages that are open together: one of each column, and its different texts.
_OPEN_BYTES = 256_000_000
#: Decimals and identifiers have 16 or 32.
_FIXED_BYTES = 32
#: Of a text in a column of numbers or times.
_NUMBER_BYTES = 128
_NUMBER = 8
_DEEPEST_SCHEMA = 16


@dataclass(frozen=True)
class ParquetLayout:
    """What a file's footer and page headers say of how it can be read."""

    columns: tuple[str, ...]
    rows: int
    texts: tuple[str, ...]
    batch_rows: int


def parquet_tables(path: Path, name: str, limits: Limits = LIMITS) -> Tables:
    """Open a Parquet file."""
    layout = read_layout(path, name, limits)
    return rows_of_file(path, name, layout, range(layout.rows), limits)


def rows_of_file(path: Path, name: str, layout: ParquetLayout, rows: range, limits: Limits = LIMITS) -> Tables:
    """Open some rows of a file whose layout was looked at."""
    read = partial(_tables, path, name, layout, rows, limits)
    return Tables(columns=layout.columns, first_row=FIRST_ROW + rows.start, read=read, form=FormFaults(name))


def rows_of_parquet(path: Path, name: str) -> int:
    """Return how many rows a Parquet file says it has; refuses what is damaged."""
    with open_parquet(path, name) as file:
        return int(file.metadata.num_rows)


def read_layout(path: Path, name: str, limits: Limits = LIMITS) -> ParquetLayout:
    """Look at footer and page headers, and refuse what is beyond the limits."""
    with open_parquet(path, name) as file:
        metadata, schema = file.metadata, file.schema_arrow
        limits.refuse_columns(name, metadata.num_columns)
        limits.refuse_names(name, tuple(schema.names))
        limits.refuse_rows(name, metadata.num_rows)
        _refuse_columns(name, file)
        size = path.stat().st_size
        limits.refuse_expansion(name, metadata.num_rows * metadata.num_columns * _NUMBER, size)
        texts = tuple(field.name for field in schema if _is_text(field.type))
        row_bytes = _look_at_pages(path, name, file, set(texts), limits)
    least = max(_BATCH_CELLS // max(len(schema.names), 1), 1)
    batch_rows = min(_BATCH_ROWS, max(least, int(_BATCH_BYTES / max(row_bytes, 1.0))))
    return ParquetLayout(tuple(schema.names), metadata.num_rows, texts, batch_rows)


def _refuse_columns(name: str, file: arrow_parquet.ParquetFile) -> None:
    """Refuse columns that are there twice, hold several values a row, or values without a bound."""
    faults = Faults(name)
    schema, columns = file.schema_arrow, set[str]()
    for field in schema:
        if field.name in columns:
            faults.add("is there twice: leave one out", column=field.name)
        columns.add(field.name)
        if pa.types.is_nested(field.type):
            known = field.name in {*INTEGER_COLUMNS, *FLOAT_COLUMNS}
            wanted = "numbers are expected" if known else "one value per row is expected"
            kind = str(field.type)
            faults.add(
                f"holds {kind if len(kind) < 80 else 'nested values'} where {wanted}: write it as numbers or as text",
                column=field.name,
            )
    faults.refuse()
    for place, field in enumerate(schema):
        column = file.schema.column(place)
        bytes_of_any_length = column.physical_type == "BYTE_ARRAY" and not _is_text(field.type)
        if bytes_of_any_length or column.length > _FIXED_BYTES:
            faults.add(
                f"holds {field.type} in {'bytes of any length' if bytes_of_any_length else f'{column.length:,} bytes per value'}: "
                "write it as floating point, or as text",
                column=field.name,
            )
    faults.refuse()


def _is_text(kind: pa.DataType) -> bool:
    """Whether values are texts or bytes of any length, each for itself or by a dictionary."""
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(
        pa.types.is_string(kind)
        or pa.types.is_large_string(kind)
        or pa.types.is_string_view(kind)
        or pa.types.is_binary(kind)
        or pa.types.is_large_binary(kind)
        or pa.types.is_binary_view(kind)
    )


def _look_at_pages(path: Path, name: str, file: arrow_parquet.ParquetFile, texts: set[str], limits: Limits) -> float:
    """Walk the headers of all pages; returns the most bytes that a row takes in memory."""
    metadata, names = file.metadata, file.schema_arrow.names
    if metadata.num_row_groups * len(names) > _MOST_CHUNKS:
        raise RefusedInputError(
            f"{name} is cut into {metadata.num_row_groups:,} groups of rows, at most {_MOST_CHUNKS // len(names):,} are read of "
            f"{len(names):,} columns: write it in groups of 65,536 rows."
        )
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    if sum(group.num_rows for group in groups) != metadata.num_rows:
        raise _damaged(name)
    walk = _Walk(name, names, texts, limits, path.stat().st_size, metadata.num_rows, len(groups))
    try:
        with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            chunks = list_chunks(data)
            are_whole = [len(columns) for columns in chunks] == [len(names)] * len(groups)
            for columns, group in zip(chunks, groups, strict=True) if are_whole else ():
                walk.look_at(data, columns, group.num_rows)
    except DamagedPageError as error:
        raise _damaged(name) from error
    if not are_whole:
        raise _damaged(name)
    return sum(walk.widths.values())


class _Walk:
    """What the pages of a file add up to, a group of rows after the other."""

    def __init__(
        self, name: str, columns: list[str], texts: set[str], limits: Limits, size: int, rows: int, groups: int
    ) -> None:
        self.widths = dict.fromkeys(columns, float(_NUMBER))
        self._name, self._texts, self._limits, self._size = name, texts, limits, size
        self._pages, self._bytes = 0, 0
        self._most_pages = _FIRST_PAGES + (groups + rows // _LEAST_VALUES) * len(columns)

    def look_at(self, data: mmap.mmap, chunks: list[Chunk], rows: int) -> None:
        """Add the pages of the next group, of so many rows."""
        if any(chunk.values != rows for chunk in chunks):
            raise DamagedPageError("a column has another number of rows than its group")
        together = 0
        for column, chunk in zip(self.widths, chunks, strict=True):
            largest = {True: 0, False: 0}
            for page in iterate_pages(data, chunk.start, chunk.size):
                self._count(page)
                largest[page.is_dictionary] = max(largest[page.is_dictionary], page.uncompressed_bytes)
                if column in self._texts:
                    width = _text_width(self._name, column, page, self._limits)
                    self.widths[column] = max(self.widths[column], width)
            together += sum(largest.values())
        if together > _OPEN_BYTES:
            raise RefusedInputError(
                f"{self._name} has pages of {together / 1e6:,.0f} MB that must be read together, but at most "
                f"{_OPEN_BYTES / 1e6:,.0f} "
                "MB are allowed: write it in groups of 65,536 rows and pages of about a megabyte."
            )

    def _count(self, page: PageHeader) -> None:
        self._pages += 1
        self._bytes += page.uncompressed_bytes
        if self._pages > self._most_pages:
            raise RefusedInputError(
                f"{self._name} is cut into over {self._most_pages:,} pages: write it in pages of about a megabyte."
            )
        self._limits.refuse_expansion(self._name, self._bytes, self._size)


def _text_width(name: str, column: str, page: PageHeader, limits: Limits) -> float:
    """The most bytes that a text of a page takes on average; refuses longer ones than may be."""
    if page.encoding == DELTA_BYTE_ARRAY:
        raise RefusedInputError(
            f"{name}: column {column}: its texts are written by their differences (DELTA_BYTE_ARRAY), so their length is not "
            "known beforehand: write them with a dictionary, or plain."
        )
    width = page.uncompressed_bytes / max(page.values, 1)
    if page.values and width > limits.cell_bytes + 2 * _NUMBER:
        raise RefusedInputError(
            f"{name}: column {column}: its texts are over {limits.cell_bytes:,} bytes long: shorten them, or leave the column out."
        )
    return _NUMBER if page.is_dictionary else width


def _tables(path: Path, name: str, layout: ParquetLayout, rows: range, limits: Limits) -> Iterator[pa.Table]:
    size, texts = path.stat().st_size, 0
    with open_parquet(path, name, layout.texts) as file:
        row = FIRST_ROW + rows.start
        for batch in _batches(file, rows, layout.batch_rows, threads=worth_threads(size)):
            for column in layout.texts:
                texts += _text_bytes(name, column, batch.column(column), row, limits)
            limits.refuse_expansion(name, texts, size)
            batch.validate(full=True)  # text that is not UTF-8 would only be noticed where it is used
            yield pa.Table.from_batches([batch])
            row += len(batch)
            pa.default_memory_pool().release_unused()  # or what was freed stays with us, batch for batch


def _text_bytes(name: str, column: str, cells: pa.Array, row: int, limits: Limits) -> int:
    """How many bytes the texts of some cells have; refuses those that are too long."""
    if pa.types.is_dictionary(cells.type):
        lengths = pc.take(pc.binary_length(cells.dictionary), cells.indices)
    else:
        lengths = pc.binary_length(cells)
    most = _NUMBER_BYTES if column in {*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS} else limits.cell_bytes
    if (pc.max(lengths).as_py() or 0) > most:
        faults = Faults(name, row)
        length = lengths.fill_null(0).to_numpy(zero_copy_only=False)
        faults.add_entries(
            length > most,
            column,
            lambda entry: f"is a text of {length[entry]:,} bytes, at most {most:,} are read: shorten it",
        )
        faults.refuse()
    return int(pc.sum(lengths).as_py() or 0)


def _batches(
    file: arrow_parquet.ParquetFile, rows: range, batch_rows: int, *, threads: bool
) -> Iterator[pa.RecordBatch]:
    """Yield the batches of these rows, from the groups that hold them; of the last group only what is wanted is decoded."""
    starts = np.cumsum([0, *(file.metadata.row_group(k).num_rows for k in range(file.metadata.num_row_groups))])
    first, last = np.searchsorted(starts, [rows.start, rows.stop], side="right") - 1
    reading = partial(file.iter_batches, use_threads=threads)
    whole = reading(batch_size=batch_rows, row_groups=list(range(first, last)))
    if left := rows.stop - int(starts[last]):
        whole = chain(
            whole, islice(reading(batch_size=min(left, batch_rows), row_groups=[last]), -(-left // batch_rows))
        )
    skip, wanted = rows.start - int(starts[first]), len(rows)
    for batch in whole:
        part = batch.slice(skip, wanted)
        skip, wanted = max(skip - len(batch), 0), wanted - len(part)
        if len(part):
            yield part


@contextmanager
def open_parquet(path: Path, name: str, texts: tuple[str, ...] = ()) -> Iterator[arrow_parquet.ParquetFile]:
    """Open a file, refusing one that is damaged wherever that shows, while it is open too; `texts` come as dictionaries."""
    import pyarrow.parquet as arrow_parquet  # noqa: PLC0415 - with every file system that Arrow knows, 40 ms

    _refuse_footer(path, name)
    try:
        with arrow_parquet.ParquetFile(
            path,
            read_dictionary=list(texts),
            buffer_size=_BUFFER_BYTES,
            pre_buffer=False,
            thrift_string_size_limit=_FOOTER_BYTES,
            thrift_container_size_limit=_MOST_CHUNKS,
            schema_depth_limit=_DEEPEST_SCHEMA,
            arrow_extensions_enabled=False,
        ) as file:
            yield file
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise _damaged(name) from error


def _damaged(name: str) -> RefusedInputError:
    return RefusedInputError(
        f"{name} is a truncated or damaged Parquet file, or an encrypted one: download or export it again.",
        code="damaged-parquet",
    )


def _refuse_footer(path: Path, name: str) -> None:
    """Refuse a footer that is larger than that of any telemetry; it is parsed whole."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(size - _TAIL_BYTES, 0))
        tail = file.read(_TAIL_BYTES)
    footer = int.from_bytes(tail[:4], "little")
    if tail[4:] == b"PAR1" and footer > _FOOTER_BYTES:
        raise RefusedInputError(
            f"{name} has a footer of {footer / 1e6:,.0f} MB, at most {_FOOTER_BYTES / 1e6:,.0f} MB are read: write fewer "
            "columns, in groups of 65,536 rows."
        )
