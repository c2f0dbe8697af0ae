"""Tables of other programs' files, as they stand: cells by column name, and the row of the file that each came from.

CSV, JSON Lines and Parquet are read as telemetry is; other text tables, FITS and VOTables by astropy, which is loaded when the
first of these is met. What a file may take is told before it is read: its bytes, the length of its lines, its rows and cells; of a
VOTable the rows that it announces, and nothing is fetched from elsewhere for it.
"""

from __future__ import annotations

import csv
import difflib
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from boresight.arrays import IntArray
from boresight.errors import Fault, RefusedInputError
from boresight.telemetry.imports.profile import DecimalMark, Format, Layout, Separator
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.read.compression import expanded
from boresight.telemetry.read.formats import (
    BYTE_ORDER_MARK,
    parse_json,
    read_bytes,
    read_text,
    refuse_other_kinds,
)
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.read.tables import open_tables

#: Bytes of a text that is split here or by astropy, of one that becomes Python objects, and of cells that are held in memory.
MOST_TEXT_BYTES, MOST_OBJECT_BYTES, MOST_BYTES = 64_000_000, 16_000_000, 400_000_000
#: Stars of nested JSON, which are Python objects on their way.
MOST_OBJECTS = 200_000
#: Of a member with the objects that it is in.
LONGEST_KEY = 1_000
#: Of a FITS file or VOTable.
MOST_BINARY_BYTES, MOST_XML_BYTES = 400_000_000, 32_000_000
_UNIT = "\x1f"
_SEPARATORS = {"tab": "\t", "space": " "}
_FITS = b"SIMPLE  ="
_SEXTRACTOR = re.compile(rb"#\s*1\s+[A-Za-z_]")
_SEXTRACTOR_NUMBER = re.compile(r"\s*#\s*(\d+)\s")
_LDAC = ("LDAC_IMHEAD",)
_DECIMAL_COMMA = re.compile(r"\s*[-+]?(?:[0-9]+,[0-9]*|,[0-9]+)(?:[eE][-+]?[0-9]+)?\s*")
#: A number, or a time that begins with its day.
_VALUE = re.compile(
    r"[-+]?(?:[0-9]+[.,]?[0-9]*|[.,][0-9]+)(?:[ed][-+]?[0-9]+)?|nan|[-+]?inf|[0-9]{4}-[0-9]{2}-[0-9]{2}\S*|[0-9:.]+Z?",
    re.IGNORECASE,
)
#: What comments before a table begin with.
_COMMENTS = ("#", "%", "//", "!")
#: Of a text that is looked at to see how it is written.
_HEAD_BYTES, _LOOKED_AT = 65_536, 100
_BAD_LINE = re.compile(r"data line (\d+)")
_LISTED = 30
#: Extensions of a FITS file that are looked at for an image.
_MOST_HDUS = 100


@dataclass(frozen=True)
class SourceTable:
    """A table as its file has it.

    `columns`: cells by name, (n,) each, null where empty. `row`: (n,) row of the file, as an editor counts, or of its table.
    `record`: (n,) which row, line or object of the file it is of, from 0. `keywords`: a FITS file's first header.
    """

    name: str
    columns: Mapping[str, pa.Array]
    row: IntArray
    record: IntArray
    keywords: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.row)

    def has(self, name: str) -> bool:
        """Say whether a column is there under this name."""
        return len(self._found(name)) == 1

    def find(self, name: str) -> str:
        """Return the name that a column has in the file; see the module `profile`."""
        found = self._found(name)
        if len(found) == 1:
            return found[0]
        if found:
            raise RefusedInputError(
                f"{self.name}: column {name}: {len(found)} columns end like this, {', '.join(found[:3])}: write the full name.",
                (Fault(None, name, f"{len(found)} columns end like this"),),
            )
        close = difflib.get_close_matches(name.split("|", maxsplit=1)[0], self.columns, 1, 0.6)
        listed = ", ".join([*list(self.columns)[:_LISTED], *(["..."] if len(self.columns) > _LISTED else [])])
        meant = f"did you mean {close[0]}? " if close else ""
        raise RefusedInputError(
            f"{self.name}: column {name}: the column is missing: {meant}the file has {listed or 'none'}; choose another profile, "
            "or name the file's own columns in one of yours.",
            (Fault(None, name, f"the column is missing: {meant}the file has {listed or 'none'}"),),
        )

    def _found(self, name: str) -> list[str]:
        if name in self.columns:
            return [name]
        if "|" in name:
            return next((found for part in name.split("|") if (found := self._found(part))), [])
        low = name.casefold()
        same = [column for column in self.columns if column.casefold() == low]
        return same or [column for column in self.columns if re.split(r"[/ .:]", column.casefold())[-1] == low]


def read_source(
    path: Path, name: str, layout: Layout, wanted: Sequence[str] = (), limits: Limits = LIMITS
) -> SourceTable:
    """Read a file, also one that is compressed by gzip; of several tables in it the first that has the wanted columns.

    Raises
    ------
    RefusedInputError
        When it cannot be read, or is larger than may be.
    """
    with expanded(path, name, limits) as place:
        return _read_source(place, name, layout, wanted, limits)


def _read_source(path: Path, name: str, layout: Layout, wanted: Sequence[str], limits: Limits) -> SourceTable:
    form = layout.format if layout.format != "auto" else detect_form(path, name, layout)
    if form == "csv" and layout.format == "auto":
        form, layout = _by_separators(path, layout)
    match form:
        case "csv" | "jsonl" | "parquet":
            table = _read_plain(path, name, limits)
        case "text" | "ecsv" | "sextractor":
            table = _read_text_table(path, name, form, layout, limits)
        case "ragged":
            table = _read_ragged(path, name, layout, limits)
        case "json":
            table = _read_objects(path, name, layout, limits)
        case "fits":
            table = _read_fits(path, name, layout, wanted, limits)
        case _:
            table = _read_votable(path, name, layout, limits)
    if not len(table):
        raise RefusedInputError(f"{name} has no rows: give a file with rows.")
    return _chosen(table, layout)


def detect_form(path: Path, name: str, layout: Layout) -> Format:  # noqa: PLR0911 - one a form
    """Tell by its first bytes how a file is written."""
    head = read_head(path)
    if head.startswith(_FITS):
        return "fits"
    start = head.removeprefix(BYTE_ORDER_MARK).lstrip()
    if start.startswith(b"<") and b"VOTABLE" in head:
        return "votable"
    if start.startswith(b"# %ECSV"):
        return "ecsv"
    if _SEXTRACTOR.match(start):
        return "sextractor"
    refuse_other_kinds(name, head)
    if layout.explode or start.startswith(b"["):
        return "json"
    if layout.separator != "," or not layout.header or layout.comment:
        return "text"
    return "csv"  # or JSON Lines or Parquet: telemetry's reader tells


def _by_separators(path: Path, layout: Layout) -> tuple[Format, Layout]:
    """Return how a text is read that has comments before its header, or columns that no commas separate, as of spreadsheets."""
    found = look_at_text(read_head(path))
    if found.separator == "," and not (found.comment and found.has_header):
        return "csv", layout
    return "text", replace(layout, separator=found.separator, decimal=found.decimal, comment=found.comment)


@dataclass(frozen=True)
class TextHead:
    """How a text table is written, by its first lines.

    `lines`: the first that hold something, of a header or of rows. `comments`: without the mark `comment` that they begin with.
    """

    lines: tuple[str, ...]
    separator: Separator = ","
    decimal: DecimalMark = "."
    comment: str = ""
    comments: tuple[str, ...] = ()
    has_header: bool = True


def look_at_text(head: bytes) -> TextHead:
    """Tell by a file's first bytes what separates its columns, and its decimal mark: a comma where cells have that and no point."""
    if head.startswith(b"PAR1"):
        return TextHead(())
    lines = [line for line in head.removeprefix(BYTE_ORDER_MARK).decode(errors="replace").splitlines() if line.strip()]
    if len(head) == _HEAD_BYTES and len(lines) > 1:
        lines.pop()  # it is cut
    comment = next((mark for mark in _COMMENTS if lines and lines[0].lstrip().startswith(mark)), "")
    told = [line for line in lines if not (comment and line.lstrip().startswith(comment))]
    found = _look_at_lines(told[:_LOOKED_AT])
    widths = {len(split_row(line, found.separator)) for line in found.lines[:2]}
    if (
        not comment or len(widths) != 1 or widths == {1} or len(told) == found.has_header
    ):  # a mark before what is no table
        return _look_at_lines(lines[:_LOOKED_AT])
    comments = [line.lstrip().removeprefix(comment).strip() for line in lines if line.lstrip().startswith(comment)]
    return replace(found, comment=comment, comments=tuple(comments))


def _look_at_lines(lines: Sequence[str]) -> TextHead:
    header = lines[0] if lines else ""
    is_data = holds_no_name(re.split(r"[,;\s]", header.replace('"', "")))
    has_decimal_commas = is_data and (";" in header or _are_decimal(header.split()))
    separator: Separator = ","
    if not header.lstrip().startswith(("{", "[")) and ("," not in header or has_decimal_commas):
        spaced = _is_spaced(lines, is_data=is_data)
        separator = ";" if ";" in header else "tab" if "\t" in header else "space" if spaced else ","
    cells = [cell for line in lines[not is_data :] for cell in split_row(line, separator)]
    commas = any(_DECIMAL_COMMA.fullmatch(cell) for cell in cells)
    points = any(_DECIMAL_COMMA.fullmatch(cell.replace(".", ",")) for cell in cells if "." in cell)
    decimal: DecimalMark = "," if separator != "," and commas and not points else "."
    return TextHead(tuple(lines), separator, decimal, has_header=not is_data)


def holds_no_name(cells: Sequence[str]) -> bool:
    """Whether cells are numbers and times alone, as no header's are."""
    return any(cells) and all(not cell or _VALUE.fullmatch(cell.strip()) for cell in cells)


def _are_decimal(words: Sequence[str]) -> bool:
    """Whether the commas in words are decimal, as of numbers between blanks."""
    return len(words) > 1 and all(_VALUE.fullmatch(word) and not word.endswith(",") for word in words)


def _is_spaced(lines: Sequence[str], *, is_data: bool) -> bool:
    """Whether the first line has words, and every other as many; numbers are so alone, and before a line of another length."""
    words = [len(line.split()) for line in lines]
    return bool(words) and words[0] > 1 and (is_data or (len(words) > 1 and len(set(words)) == 1))


def split_row(line: str, separator: str) -> list[str]:
    """Return the cells of a line without blanks around them."""
    mark = _SEPARATORS.get(separator, separator)
    cells = line.split() if mark == " " else next(csv.reader([line], delimiter=mark), [])
    return [cell.strip() for cell in cells]


def read_head(path: Path) -> bytes:
    """Return a file's first bytes."""
    if not path.exists():
        raise RefusedInputError(f"{path} does not exist: check the name.", code="no-such-file")
    if path.is_dir():
        raise RefusedInputError(f"{path} is a folder: name the file inside it.")
    with path.open("rb") as file:
        return file.read(_HEAD_BYTES)


def _refuse_size(path: Path, name: str, most: int, what: str) -> None:
    """Refuse a file of too many bytes."""
    if path.exists() and path.stat().st_size > most:
        raise RefusedInputError(f"{name} exceeds the limit of {most / 1e6:,.0f} MB for {what}: split it by time.")


def _refuse_cells(name: str, rows: int, columns: int, limits: Limits) -> None:
    limits.refuse_rows(name, rows)
    limits.refuse_columns(name, columns)
    if 8 * rows * columns > MOST_BYTES:
        raise RefusedInputError(
            f"{name} has {rows:,} rows of {columns:,} columns, over {MOST_BYTES / 1e6:,.0f} MB in memory: split it, or leave "
            "out columns."
        )


def _read_plain(path: Path, name: str, limits: Limits) -> SourceTable:
    """Read CSV, JSON Lines or Parquet."""
    tables = open_tables(path, name, limits, as_text=True)
    parts, held, rows = [], 0, 0
    for part in tables.read():
        held, rows = held + part.nbytes, rows + part.num_rows
        limits.refuse_rows(name, rows)
        if held > MOST_BYTES:
            raise RefusedInputError(f"{name} takes over {MOST_BYTES / 1e6:,.0f} MB in memory: split it by time.")
        parts.append(part)
    tables.form.refuse()
    whole = pa.concat_tables(parts, promote_options="permissive") if parts else pa.table({})
    columns = {column: _plain(whole[column]) for column in whole.column_names}
    return SourceTable(name, columns, np.arange(rows) + tables.first_row, np.arange(rows))


def _plain(column: pa.ChunkedArray) -> pa.Array:
    """Return one array without dictionaries."""
    cells = column.combine_chunks()
    cells = pa.concat_arrays(cells.chunks) if isinstance(cells, pa.ChunkedArray) else cells
    return cells.cast(cells.type.value_type) if pa.types.is_dictionary(cells.type) else cells


def _lines(path: Path, name: str, limits: Limits, most: int = MOST_TEXT_BYTES) -> list[str]:
    """Return a text file's lines, none longer than may be."""
    read_head(path)
    _refuse_size(path, name, most, "such a table")
    lines = read_text(name, read_bytes(path, name)).decode().split("\n")
    for row, line in enumerate(lines, start=1):
        if len(line) > limits.line_bytes:
            raise RefusedInputError(
                f"{name}: row {row}: is over {limits.line_bytes:,} characters long: check the file."
            )
    return lines


def _read_text_table(path: Path, name: str, form: str, layout: Layout, limits: Limits) -> SourceTable:
    """Read a text table by astropy: its own names for SExtractor's and ECSV's headers, else by the layout."""
    lines = _lines(path, name, limits)
    comment = layout.comment or ("#" if form in {"ecsv", "sextractor"} else "")
    rows = [
        row for row, line in enumerate(lines, 1) if line.strip() and not (comment and line.lstrip().startswith(comment))
    ]
    separator = _SEPARATORS.get(layout.separator, layout.separator)
    if form == "sextractor":
        separator = " "
    elif form == "ecsv":
        separator = "," if any(line.startswith("# delimiter: ','") for line in lines[:1000]) else " "
    has_header = form == "ecsv" or (form == "text" and layout.header)
    data = rows[1:] if has_header else rows
    if not data:
        raise RefusedInputError(f"{name} has no rows: give a file with rows.")
    width = max(len(_split(lines[row - 1], separator)) for row in rows[:2])
    _refuse_cells(name, len(data), width, limits)
    names = _sextractor_names(name, lines, rows, limits) if form == "sextractor" else None
    text = "\n".join(lines[row - 1] for row in rows) + "\n"
    found = _by_astropy(name, text, separator, data, names=names, has_header=has_header)
    if layout.decimal == ",":
        found = {column: _with_points(cells) for column, cells in found.items()}
    return SourceTable(name, found, np.array(data, np.int64), np.arange(len(data)))


def _with_points(cells: pa.Array) -> pa.Array:
    """Return texts with a point in each that is a number with a comma; others stay as they are."""
    if not pa.types.is_string(cells.type):
        return cells
    texts = [
        text.replace(",", ".") if text is not None and _DECIMAL_COMMA.fullmatch(text) else text
        for text in cells.to_pylist()
    ]
    return pa.array(texts, pa.string())


def _split(line: str, separator: str) -> list[str]:
    return line.split() if separator == " " else line.split(separator)


def _sextractor_names(name: str, lines: list[str], rows: list[int], limits: Limits) -> list[str]:
    """Return the columns that a SExtractor header names; astropy numbers those of a vector."""
    from astropy.io import ascii as tables  # noqa: PLC0415 - loaded with the first file that needs it

    head = [line for line in lines[: rows[0] if rows else len(lines)] if line.strip()]
    numbers = [found.group(1) for line in head if (found := _SEXTRACTOR_NUMBER.match(line))]
    limits.refuse_columns(name, max((int(number[:12]) for number in numbers), default=0))
    try:
        return list(tables.read("\n".join(head) + "\n", format="sextractor", guess=False).colnames)
    except (ValueError, IndexError, TypeError) as error:
        raise RefusedInputError(
            f"{name} has a SExtractor header that cannot be read: write the catalogue as ASCII_HEAD or FITS_LDAC again."
        ) from error


def _by_astropy(
    name: str, text: str, separator: str, data: list[int], *, names: list[str] | None, has_header: bool
) -> dict[str, pa.Array]:
    """Read the rows of a text table; `data`: the rows of the file that they are."""
    from astropy.io import ascii as tables  # noqa: PLC0415 - loaded with the first file that needs it

    form = "basic" if has_header else "no_header"
    if separator == "\t":  # astropy strips tabs, and with them empty cells, from the ends of lines
        separator, text = _UNIT, text.replace("\t", _UNIT)
    settings: dict[str, Any] = {"names": names} if names else {}
    try:
        with warnings.catch_warnings(action="ignore"):
            found = tables.read(
                text, format=form, delimiter=separator, guess=False, comment=None, fill_values=[("", "0")], **settings
            )
    except (ValueError, IndexError, TypeError, OverflowError) as error:
        place = _BAD_LINE.search(str(error))
        row = data[min(max(int(place.group(1)) - 1, 0), len(data) - 1)] if place else None
        fault = Fault(
            row,
            None,
            "does not have as many cells as the header, or has cells that cannot be read: check the separator",
        )
        raise RefusedInputError(f"{name}: {fault}.", (fault,)) from error
    columns = {column: _convert_masked(found[column]) for column in found.colnames}
    if not has_header and names is None:
        columns = {str(number): cells for number, cells in enumerate(columns.values(), 1)}
    return columns


def _convert_masked(values: Any) -> pa.Array:
    """Return a column of numbers or texts, null where it is masked."""
    mask = np.ma.getmaskarray(values)
    plain = np.asarray(np.ma.getdata(values))
    if plain.dtype.kind == "S":
        plain = np.char.decode(plain, "utf-8", "replace")
    if plain.dtype.kind in "fiub":
        plain = plain.astype(plain.dtype.newbyteorder("="))
        return pa.array(plain.astype(np.int64) if plain.dtype.kind == "b" else plain, mask=mask)
    texts = [
        None if absent or text == "" else str(text) for text, absent in zip(plain.tolist(), mask.tolist(), strict=True)
    ]
    return pa.array(texts, pa.string())


def _read_ragged(path: Path, name: str, layout: Layout, limits: Limits) -> SourceTable:
    """Read lines of stars, so many cells each; every line is an exposure."""
    width = layout.cells_per_star or 1
    cells: list[list[str]] = [[] for _ in range(width)]
    rows, records, faults = [], [], Faults(name)
    separator = _SEPARATORS.get(layout.separator, layout.separator)
    record = -1
    for row, line in enumerate(_lines(path, name, limits, MOST_OBJECT_BYTES), start=1):
        if not line.strip() or (layout.comment and line.lstrip().startswith(layout.comment)):
            continue
        record += 1
        try:
            found = line.split() if separator == " " else next(csv.reader([line], delimiter=separator))
        except csv.Error:
            faults.add(f"has a cell of over {csv.field_size_limit():,} characters: check the separator", row=row)
            continue
        if len(found) % width:
            faults.add(f"has {len(found)} cells, which is not a multiple of {width}: give all of every star", row=row)
            continue
        for place in range(width):
            cells[place] += found[place::width]
        rows += [row] * (len(found) // width)
        records += [record] * (len(found) // width)
    faults.refuse()
    limits.refuse_rows(name, len(rows))
    columns = {
        str(place + 1): pa.array([cell.strip() or None for cell in column], pa.string())
        for place, column in enumerate(cells)
    }
    return SourceTable(name, columns, np.array(rows, np.int64), np.array(records, np.int64))


def _read_objects(path: Path, name: str, layout: Layout, limits: Limits) -> SourceTable:
    """Read JSON objects, a list of them or one a line, whose lists have an entry a star."""
    _refuse_size(path, name, MOST_OBJECT_BYTES, "JSON that is nested")
    faults = Faults(name)
    collected: list[tuple[dict[str, Any], dict[str, Any]]] = []
    rows, records, held = [], [], 0
    for record, (row, document) in enumerate(_objects(path, name, limits)):
        common, stars = _exploded(document, layout, row, faults)
        held += len(stars) * sum(8 + len(str(value)) for value in common.values())
        if held > MOST_BYTES:
            raise RefusedInputError(
                f"{name} takes over {MOST_BYTES / 1e6:,.0f} MB in memory because the fields of each object are repeated for "
                "each of its stars: remove unneeded fields, or split it by time."
            )
        collected += [(common, star) for star in stars]
        rows += [row] * len(stars)
        records += [record] * len(stars)
        if len(rows) > MOST_OBJECTS:
            raise RefusedInputError(
                f"{name} exceeds the limit of {MOST_OBJECTS:,} stars for nested JSON: split it by time."
            )
        _refuse_cells(name, len(rows), len(common) + len(stars[0]) if stars else 1, limits)
    faults.refuse()
    names = dict.fromkeys(key for parts in collected for part in parts for key in part)
    _refuse_cells(name, len(rows), len(names), limits)
    columns = {
        key: pa.array([_cell(star.get(key, common.get(key))) for common, star in collected], pa.string())
        for key in names
    }
    return SourceTable(name, columns, np.array(rows, np.int64), np.array(records, np.int64))


def _objects(path: Path, name: str, limits: Limits) -> Iterator[tuple[int, Mapping[str, Any]]]:
    """Yield the objects of a JSON file with the row, or the number in the list, of each."""
    read_head(path)
    text = read_text(name, read_bytes(path, name))
    try:
        document = parse_json(text)
        found = list(enumerate(document if isinstance(document, list) else [document], start=1))
    except ValueError:
        lines = text.decode().split("\n")
        limits.refuse_rows(name, len(lines))
        found = [(row, _parsed(name, row, line)) for row, line in enumerate(lines, start=1) if line.strip()]
    for row, item in found:
        if not isinstance(item, Mapping):
            raise RefusedInputError(f"{name}: row {row}: is not a JSON object: give one object per exposure.")
        yield row, item


def _parsed(name: str, row: int, line: str) -> Any:
    try:
        return parse_json(line)
    except ValueError as error:
        raise RefusedInputError(f"{name}: row {row}: is not JSON ({error}): give one object per line.") from error


def _exploded(
    document: Mapping[str, Any], layout: Layout, row: int, faults: Faults
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return what all stars of an object share, and one object a star of the lists that are to be taken apart."""
    apart = {key: document.get(key) for key in layout.explode}
    lists = {key: value for key, value in apart.items() if isinstance(value, list)}
    for key, value in apart.items():
        if value is not None and not isinstance(value, list):
            faults.add("is not a list: give one entry per star", row=row, column=key)
    count = max((len(value) for value in lists.values()), default=0)
    if count > MOST_OBJECTS:
        raise RefusedInputError(
            f"{faults.subject}: row {row}: has over {MOST_OBJECTS:,} stars: give one object per exposure."
        )
    common = dict(
        _flat("", {key: value for key, value in document.items() if key not in apart and key not in layout.indexed})
    )
    stars: list[dict[str, Any]] = [{} for _ in range(count)]
    for key, value in lists.items():
        if len(value) != count:
            faults.add(
                f"has {len(value)} entries where another list has {count}: give one per star", row=row, column=key
            )
            continue
        for star, item in zip(stars, value, strict=True):
            star.update(_flat(key, item))
    _place_indexed(document, layout, stars, row, faults)
    return common, stars


def _place_indexed(
    document: Mapping[str, Any], layout: Layout, stars: list[dict[str, Any]], row: int, faults: Faults
) -> None:
    """Give entries of a list to the stars that another list names."""
    for key, by in layout.indexed.items():
        values, places = document.get(key), document.get(by)
        if not isinstance(values, list) or not isinstance(places, list) or len(values) != len(places):
            if values is not None or places is not None:
                faults.add(
                    f"is not as long as {by}, the list that it refers to: give one for each", row=row, column=key
                )
            continue
        for value, place in zip(values, places, strict=True):
            if isinstance(place, int) and 0 <= place < len(stars):
                stars[place].update(_flat(key, value))
            else:
                faults.add(f"{place!r} is not the number of a star: give 0 to {len(stars) - 1}", row=row, column=by)


def _flat(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the cells in a value, `key.x` of objects and `key.1` of short lists."""
    if len(key) > LONGEST_KEY:
        raise RefusedInputError(
            f"The member name {key[:40]}… is over {LONGEST_KEY} characters long including its parent objects: use a shorter name."
        )
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _flat(f"{key}.{name}" if key else str(name), item)
    elif isinstance(value, list):
        for number, item in enumerate(value[:100], start=1):
            yield from _flat(f"{key}.{number}", item)
    else:
        yield key, value


def _cell(value: Any) -> str | None:
    return None if value is None else value if isinstance(value, str) else repr(value)


def _read_fits(path: Path, name: str, layout: Layout, wanted: Sequence[str], limits: Limits) -> SourceTable:
    """Read a binary or text table of a FITS file."""
    from astropy.io import fits  # noqa: PLC0415 - loaded with the first file that needs it

    if not read_head(path).startswith(_FITS):  # astropy would expand what is packed, without a limit
        raise RefusedInputError(
            f"{name} is not a FITS file: unpack it, or choose a profile of another format.", code="not-fits"
        )
    _refuse_size(path, name, MOST_BINARY_BYTES, "a FITS file")
    try:
        with warnings.catch_warnings(action="ignore"), path.open("rb") as raw, fits.open(raw, memmap=False) as file:
            header = file[0].header
            keywords = {
                key: str(header[key]) for key in ("DATE-OBS", "MJD-OBS", "EXPTIME", "IMAGEW", "IMAGEH") if key in header
            }
            found = _chosen_hdu(file, name, layout, wanted)
            keywords |= {"DATE-OBS": str(found.header["DATE-OBS"])} if "DATE-OBS" in found.header else {}
            _refuse_cells(name, int(found.header["NAXIS2"]), int(found.header["TFIELDS"]), limits)
            _refuse_shape(name, path, found)
            columns = dict(_fits_columns(found, limits, name))
            rows = int(found.header["NAXIS2"])
    except RefusedInputError:
        raise
    except Exception as error:
        raise RefusedInputError(f"{name} is a FITS file that is damaged: write it again.") from error
    return SourceTable(name, columns, np.arange(rows) + 1, np.arange(rows), keywords)


def find_fits_columns(path: Path, name: str) -> tuple[str, ...]:
    """Return the columns of the first table of a FITS file by its headers; none where it has an image or no table."""
    from astropy.io import fits  # noqa: PLC0415 - loaded with the first file that needs it

    if not read_head(path).startswith(_FITS):
        return ()
    try:
        with warnings.catch_warnings(action="ignore"), path.open("rb") as raw, fits.open(raw, memmap=False) as file:
            if any(hdu.is_image and len(hdu.shape) >= 2 for hdu in file[:_MOST_HDUS]):
                return ()
            return tuple(str(column) for column in _chosen_hdu(file, name, Layout(), ()).columns.names)
    except RefusedInputError:
        return ()
    except Exception as error:
        raise RefusedInputError(f"{name} is a FITS file that is damaged: write it again.") from error


def _chosen_hdu(file: Any, name: str, layout: Layout, wanted: Sequence[str]) -> Any:
    """Return the table that a profile means."""
    tables = []
    for number, hdu in enumerate(file):
        if number >= 1000:
            raise RefusedInputError(f"{name} has over 1,000 extensions: give a file of one table.")
        if hdu.header.get("XTENSION", "").strip() in {"BINTABLE", "TABLE"} and not hdu.header.get(
            "ZIMAGE", default=False
        ):
            tables.append((number, hdu))
    if layout.extension is not None:
        tables = [(number, hdu) for number, hdu in tables if layout.extension in {number, hdu.name, hdu.name.lower()}]
    else:
        tables = [(number, hdu) for number, hdu in tables if hdu.name not in _LDAC]
    for _, hdu in tables:
        present = {str(column).casefold() for column in hdu.columns.names}
        if all(any(part.casefold() in present for part in column.split("|")) for column in wanted):
            return hdu
    if tables:
        return tables[0][1]
    called = "" if layout.extension is None else f" {layout.extension}"
    raise RefusedInputError(
        f"{name} contains no table{called}: give the table of stars; images go through an extractor first."
    )


def _refuse_shape(name: str, path: Path, hdu: Any) -> None:
    """Refuse a table that says it is larger than its file."""
    size = int(hdu.header["NAXIS1"]) * int(hdu.header["NAXIS2"])
    if size > path.stat().st_size:
        raise RefusedInputError(f"{name} ends before its table does: download it again.")


def _fits_columns(hdu: Any, limits: Limits, name: str) -> Iterator[tuple[str, pa.Array]]:
    """Yield a table's columns; each of a vector's elements is one, and what has no cells of its own is left out."""
    count = 0
    for column in hdu.columns:
        form = str(column.format)
        if any(letter in form for letter in "PQCMX"):  # arrays of any length, complex numbers, bits
            continue
        values = np.asarray(hdu.data[column.name])
        masked = (
            np.ma.masked_equal(values, column.null) if column.null is not None and values.dtype.kind in "iu" else values
        )
        flat = masked.reshape(len(masked), -1)
        count += flat.shape[1]
        limits.refuse_columns(name, count)
        for place in range(flat.shape[1]):
            yield (
                (f"{column.name}_{place + 1}" if flat.shape[1] > 1 else str(column.name)),
                _convert_masked(_real(flat[:, place])),
            )


def _real(values: Any) -> Any:
    """Return numbers with those that are none masked, as FITS has it."""
    return np.ma.masked_invalid(values) if values.dtype.kind == "f" else values


#: A value may hold `>`, and no `<`; every tag is looked through once.
_STREAM = re.compile(rb"<(?:[^<>\s/]*:)?STREAM\s[^<]*href", re.IGNORECASE)
_NUMBER_OF_ROWS = re.compile(rb"""nrows\s*=\s*["']\s*([0-9]+)""")
_ARRAY_SIZE = re.compile(rb"""arraysize\s*=\s*["']([0-9x]+)""")


def _read_votable(path: Path, name: str, layout: Layout, limits: Limits) -> SourceTable:
    """Read a VOTable."""
    from astropy.io import votable  # noqa: PLC0415 - loaded with the first file that needs it

    read_head(path)
    _refuse_size(path, name, MOST_XML_BYTES, "a VOTable")
    data = read_bytes(path, name)
    _refuse_xml(name, data)
    try:
        with warnings.catch_warnings(action="ignore"):
            document = votable.parse(path, verify="ignore")
            tables = [table for table in document.iter_tables() if len(table.array)]
    except Exception as error:
        raise RefusedInputError(f"{name} is not a readable VOTable: write it again.") from error
    if layout.extension is not None:
        named = enumerate(tables)
        tables = [table for number, table in named if layout.extension in {number, table.ID, table.name}]
    if not tables:
        raise RefusedInputError(f"{name} contains no table with rows: give a file that does.")
    table = tables[0]
    rows = len(table.array)
    _refuse_cells(name, rows, len(table.fields), limits)
    columns = {}
    for item, key in zip(table.fields, table.array.dtype.names, strict=True):
        values = table.array[key]
        if values.ndim == 1:
            columns[str(item.name or key)] = _convert_masked(_real(values))
        else:
            flat = values.reshape(rows, -1)
            limits.refuse_columns(name, len(columns) + flat.shape[1])
            columns |= {
                f"{item.name or key}_{place + 1}": _convert_masked(_real(flat[:, place]))
                for place in range(flat.shape[1])
            }
    return SourceTable(name, columns, np.arange(rows) + 1, np.arange(rows))


def _refuse_xml(name: str, data: bytes) -> None:
    """Refuse XML that would fetch, expand or announce more than it holds."""
    if b"\0" in data[:4096] or not data.lstrip(BYTE_ORDER_MARK + b" \t\r\n").startswith(b"<"):
        raise RefusedInputError(f"{name} is XML of another encoding: save it as UTF-8.")
    declared = re.search(rb"""^\s*<\?xml[^>]*encoding\s*=\s*["']([^"']+)""", data[:200].removeprefix(BYTE_ORDER_MARK))
    if declared is not None and declared.group(1).upper() not in {b"UTF-8", b"US-ASCII", b"ASCII", b"ISO-8859-1"}:
        raise RefusedInputError(f"{name} is XML of another encoding: save it as UTF-8.")
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise RefusedInputError(f"{name} declares a document type of its own: write it without one.")
    if _STREAM.search(data):
        raise RefusedInputError(f"{name} says that its rows are in another file: write them into this one.")
    announced = [int(found) for found in _NUMBER_OF_ROWS.findall(data)]
    if any(rows > len(data) for rows in announced):
        raise RefusedInputError(f"{name} announces more rows than it can contain: write it again.")
    sizes = [
        int(np.prod([float(part) for part in found.split(b"x") if part], dtype=float))
        for found in _ARRAY_SIZE.findall(data)
    ]
    rows = max([*announced, len(re.findall(rb"<TR\b", data, re.IGNORECASE)), len(re.findall(rb":TR\b", data))])
    fields = len(re.findall(rb"[<:]FIELD\b", data, re.IGNORECASE))
    if 8 * max(rows, 1) * (sum(sizes) + fields) > MOST_BYTES:
        raise RefusedInputError(f"{name} announces more cells than it can contain: write it again.")


def _chosen(table: SourceTable, layout: Layout) -> SourceTable:
    """Return the rows that a profile takes."""
    if not layout.where:
        return table
    taken = np.ones(len(table), dtype=np.bool_)
    for column, texts in layout.where.items():
        cells = table.columns[table.find(column)]
        taken &= np.fromiter((_text(cell) in texts for cell in cells.to_pylist()), np.bool_, len(cells))
    if not taken.any():
        asked = " and ".join(f"{column} of {' or '.join(texts)}" for column, texts in layout.where.items())
        raise RefusedInputError(
            f"{table.name} has no row that the profile selects, which needs {asked}: check layout.where."
        )
    chosen = pa.array(np.flatnonzero(taken))
    columns = {column: cells.take(chosen) for column, cells in table.columns.items()}
    return SourceTable(table.name, columns, table.row[taken], table.record[taken], table.keywords)


def _text(cell: Any) -> str:
    """Return a cell as text, whole numbers without a point."""
    return "" if cell is None else str(int(cell)) if isinstance(cell, float) and cell.is_integer() else str(cell)
