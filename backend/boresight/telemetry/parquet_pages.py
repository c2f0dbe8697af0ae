"""What the pages of a Parquet file say of their size, read before one of them is decompressed.

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
from dataclasses import dataclass

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
class Page:
    """One page: what its header says.

    Parameters
    ----------
    is_dictionary
        Whether it holds the different values of a column; another holds values, or what is passed over.
    uncompressed_bytes
        What it takes when decompressed; as much is allocated.
    values
        In it.
    encoding
        Of the values, by its number in the format; -1 for none.
    """

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


def chunks_of(file: mmap.mmap | bytes) -> list[list[Chunk]]:
    """The columns of every group of rows, as the footer says.

    Raises
    ------
    DamagedPageError
        When it cannot be read.
    """
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


def pages_of(file: mmap.mmap | bytes, start: int, size: int) -> Iterator[Page]:
    """Yield the pages of a column chunk that lies at these bytes.

    Raises
    ------
    DamagedPageError
        When a header cannot be read, or a page ends beyond its chunk.
    """
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


def _page(fields: dict[int, object], uncompressed: int) -> Page:
    """Make a page of the fields of its header."""
    kind = _number(fields, 1)
    inner = fields.get({_DATA: 5, _DICTIONARY: 7, _DATA_V2: 8}.get(kind, 0))
    if not isinstance(inner, dict):
        return Page(is_dictionary=False, uncompressed_bytes=uncompressed, values=0, encoding=-1)
    encoding = _number(inner, 4 if kind == _DATA_V2 else 2)
    return Page(kind == _DICTIONARY, uncompressed, _number(inner, 1), encoding)


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
            raise DamagedPageError("a page header holds what none has")
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
