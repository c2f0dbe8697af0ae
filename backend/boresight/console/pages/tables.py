"""One table for every long list, whose columns, order, page and filters are in the address; works without scripts.

A page declares a `Table`; `read_view` reads the address against it, `list_table.html` draws it, `write_csv` gives every
page of it in SI.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlencode

from fastapi import Request
from fastapi.responses import Response

from boresight.console import list_queries as lists
from boresight.platform.db.sessions import Session
from boresight.platform.web.paging import parse_row_id

LONGEST_FILTER = 200
MOST_CHOSEN = 200
Accepts = Callable[[str], bool]


@dataclass(frozen=True)
class TableColumn:
    """One column; `csv` names what stands for it in a file."""

    name: str
    title: str
    sort: str = ""
    kind: str = ""
    hint: str = ""
    unit: str = ""
    head: bool = False
    optional: bool = False
    csv: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """A list: its name in `boresight.console.list_queries` and in the address, its columns, its filters and its first order.

    `filters` maps what may stand in the address to whether a value is one; `chosen` names the rows' check boxes.
    """

    name: str
    title: str
    columns: tuple[TableColumn, ...]
    filters: Mapping[str, Accepts]
    sort: str
    kind: str = ""
    chosen: str = ""
    rows_a_page: int = 50
    path: str = ""

    @property
    def address(self) -> str:
        """Where it is."""
        return self.path or f"/{self.name}"


def is_number(text: str) -> bool:
    """Accept a row's number."""
    return parse_row_id(text) is not None


def is_text(text: str) -> bool:
    """Accept any text that a store can hold."""
    return bool(text.strip()) and "\0" not in text


def accept_one(words: Iterable[str]) -> Accepts:
    """Accept one of these words."""
    return frozenset(words).__contains__


@dataclass(frozen=True)
class TableView:
    """A view of a table: its filters, columns, order and page."""

    table: Table
    where: Mapping[str, str] = field(default_factory=dict)
    sort: str = ""
    columns: tuple[TableColumn, ...] = ()
    before: int | None = None
    chosen: tuple[int, ...] = ()

    @property
    def picked(self) -> str:
        """The names of the columns; empty for the default columns."""
        usual = tuple(column for column in self.table.columns if not column.optional)
        return "" if self.columns == usual else ",".join(column.name for column in self.columns)

    def hide_archived(self) -> dict[str, Any]:
        """Return the filter that hides what is archived, unless the view shows that too."""
        return {"archived": None, "in_use": None if self.where.get("archived") else 1}

    def list_parameters(self, **changes: Any) -> dict[str, Any]:
        """Return the parameters of this view's address, with changes; empty ones are left out."""
        held = dict(self.where) | {
            "sort": self.sort if self.sort != self.table.sort else "",
            "columns": self.picked,
            "before": self.before,
            self.table.chosen or "chosen": ",".join(map(str, self.chosen)),
        }
        return {name: value for name, value in (held | changes).items() if value not in {"", None}}

    def query(self, **changes: Any) -> str:
        """Return the query of the address of this view, with changes."""
        return urlencode(self.list_parameters(**changes), safe=",")

    def address(self, **changes: Any) -> str:
        """Return the address of this view, with changes."""
        query = self.query(**changes)
        return self.table.address + (f"?{query}" if query else "")

    @property
    def unfiltered(self) -> str:
        """The address without filters, from the first page on."""
        return self.address(before=None, **dict.fromkeys(self.table.filters))

    def pressed(self, column: TableColumn) -> str:
        """Return the order after a click on a column's title: the column's default first, then reversed."""
        name = column.sort.removeprefix("-")
        return (name if self.sort.startswith("-") else f"-{name}") if self.direction(column) else column.sort

    def direction(self, column: TableColumn) -> str:
        """Say how the list is sorted by a column, as `aria-sort` does; empty where it is not."""
        if not column.sort or self.sort.removeprefix("-") != column.sort.removeprefix("-"):
            return ""
        return "descending" if self.sort.startswith("-") else "ascending"


@dataclass(frozen=True)
class TablePage:
    """The rows that are shown, and the last of them where more follow."""

    rows: Sequence[Any]
    last: int | None


def read_view(request: Request, table: Table) -> TableView:
    """Read the address; names that are no filter, column or order of the table are ignored."""
    asked = request.query_params
    given = {name: asked.get(name, "").strip()[:LONGEST_FILTER] for name in table.filters}
    sorts = {column.sort.removeprefix("-") for column in table.columns if column.sort}
    sort, before = asked.get("sort", ""), asked.get("before", "")
    return TableView(
        table,
        {name: text for name, text in given.items() if text and table.filters[name](text)},
        sort if sort.removeprefix("-") in sorts else table.sort,
        _columns(table, _several(request, "columns")),
        parse_row_id(before),
        tuple(number for text in _several(request, table.chosen) if (number := parse_row_id(text)))[:MOST_CHOSEN],
    )


def _several(request: Request, name: str) -> list[str]:
    """Return the values of a parameter that is repeated, or has commas, or both."""
    return [text for value in request.query_params.getlist(name) for text in value.split(",") if text]


def _columns(table: Table, picked: Sequence[str]) -> tuple[TableColumn, ...]:
    """Return the chosen columns with those that name the row; the default columns where none was chosen."""
    if not any(column.name in picked for column in table.columns):
        return tuple(column for column in table.columns if not column.optional)
    return tuple(column for column in table.columns if column.head or column.name in picked)


def read_page(session: Session, view: TableView, **where: Any) -> TablePage:
    """Read the rows of a view; `where` adds or overrides filters, and None removes one."""
    narrowed = {name: value for name, value in ({**view.where} | where).items() if value is not None}
    rows = view.table.rows_a_page
    found = lists.read_page(session, view.table.name, narrowed, view.sort, before_id=view.before, limit=rows + 1)
    return TablePage(found[:rows], found[rows - 1].id if len(found) > rows else None)


def read_all(session: Session, view: TableView, **where: Any) -> Iterable[Any]:
    """Yield every row of a view, from its first page on."""
    narrowed = {name: value for name, value in ({**view.where} | where).items() if value is not None}
    return lists.read_all(session, view.table.name, narrowed, view.sort)


def write_csv(view: TableView, rows: Iterable[Any]) -> Response:
    """Give a view as CSV, its columns read from the rows."""
    names = [name for column in view.columns for name in column.csv]
    return csv_file(view.table.name, names, ({name: getattr(row, name) for name in names} for row in rows))


def csv_file(title: str, names: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> Response:
    """Return rows as the CSV file `<title>.csv` with these columns."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(names)
    writer.writerows([_plain(row[name]) for name in names] for row in rows)
    headers = {"Content-Disposition": f'attachment; filename="{title}.csv"'}
    return Response(text.getvalue(), media_type="text/csv", headers=headers)


def _plain(value: Any) -> Any:
    """Escape a text so that no spreadsheet takes it for a formula."""
    return f"'{value}" if isinstance(value, str) and value[:1] in {"=", "+", "-", "@", "\t", "\r"} else value
