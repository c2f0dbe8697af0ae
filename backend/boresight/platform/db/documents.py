"""JSON documents with one spelling, so that a hash of the text is a hash of the meaning."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable
from typing import Any

import orjson
import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.compiler import SQLCompiler

#: An integer that may not fit into 64 bits, which the fast reader would round to a float.
_LONG_INTEGER = re.compile(r"(?<![.\d])\d{19}")

#: No key of a row is as large.
MOST_NUMBER = 1 << 31


def canonical(document: Any) -> str:
    """Return the one spelling of a JSON document."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def read(text: str) -> Any:
    """Return the document of a spelling: what `json.loads` returns, at a fifth of its time."""
    return json.loads(text) if _LONG_INTEGER.search(text) else orjson.loads(text)


def compute_sha256(document: Any) -> str:
    """Return the SHA-256, in hexadecimal, of the canonical spelling."""
    return hashlib.sha256(canonical(document).encode()).hexdigest()


class JsonText(sa.types.TypeDecorator[Any]):
    """A JSON document in a TEXT column, in its canonical spelling; None is NULL."""

    impl = sa.Text
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: sa.Dialect) -> Any:  # noqa: ARG002 - SQLAlchemy gives both
        """Encode on the way in."""
        return None if value is None else canonical(value)

    def process_result_value(self, value: Any, dialect: sa.Dialect) -> Any:  # noqa: ARG002 - SQLAlchemy gives both
        """Decode on the way out."""
        return None if value is None else read(value)


class _TextIn(sa.sql.functions.GenericFunction[str]):
    """A text inside a document: the engines read JSON in TEXT differently."""

    type = sa.Text()
    inherit_cache = True


class _NumberIn(sa.sql.functions.GenericFunction[float]):
    """A number inside a document."""

    type = sa.Double()
    inherit_cache = True


@compiles(_TextIn)
@compiles(_NumberIn)
def _of_sqlite(element: _TextIn | _NumberIn, compiler: SQLCompiler, **options: Any) -> str:
    """Extract by a path."""
    column, path = (compiler.process(clause, **options) for clause in element.clauses)
    return f"json_extract({column}, '$.' || {path})"


@compiles(_TextIn, "postgresql")
def _text_of_postgresql(element: _TextIn | _NumberIn, compiler: SQLCompiler, **options: Any) -> str:
    """Read the text as JSON."""
    column, path = (compiler.process(clause, **options) for clause in element.clauses)
    return f"(CAST({column} AS JSON) #>> string_to_array({path}, '.'))"


@compiles(_NumberIn, "postgresql")
def _number_of_postgresql(element: _NumberIn, compiler: SQLCompiler, **options: Any) -> str:
    """Read the text as JSON, and the member as a number."""
    return f"CAST({_text_of_postgresql(element, compiler, **options)} AS DOUBLE PRECISION)"


def text_in(column: Any, path: str) -> sa.ColumnElement[str]:
    """Return the expression of a text in a document by the names on the way to it, a dot between; NULL where there is none."""
    return _TextIn(sa.type_coerce(column, sa.Text), sa.literal(path, sa.Text))


def number_in(column: Any, path: str) -> sa.ColumnElement[float]:
    """Return the expression of a number in a document by the names on the way to it, a dot between; NULL where there is none."""
    return _NumberIn(sa.type_coerce(column, sa.Text), sa.literal(path, sa.Text))


class _Among(sa.sql.functions.GenericFunction[bool]):
    """Whether a number is in a JSON list of numbers."""

    type = sa.Boolean()
    inherit_cache = True
    _is_implicitly_boolean = True  # or SQLite, which has none, is asked whether it equals 1


@compiles(_Among)
def _among_of_sqlite(element: _Among, compiler: SQLCompiler, **options: Any) -> str:
    """Take the list apart."""
    column, listed = (compiler.process(clause, **options) for clause in element.clauses)
    return f"({column} IN (SELECT value FROM json_each({listed})))"  # noqa: S608 - compiled clauses, whose values are bound


@compiles(_Among, "postgresql")
def _among_of_postgresql(element: _Among, compiler: SQLCompiler, **options: Any) -> str:
    """Spell the list as an array: of one the planner sees how long it is, of rows from JSON it takes it to be a hundred."""
    column, listed = (compiler.process(clause, **options) for clause in element.clauses)
    return f"({column} = ANY (CAST(translate({listed}, '[]', '{{}}') AS INTEGER[])))"


def among(column: Any, numbers: Iterable[int]) -> sa.ColumnElement[bool]:
    """Keep to rows whose key is one of these, any number of them: one value is bound, not one each. What no key is, is none."""
    listed = json.dumps(sorted(number for number in set(numbers) if 0 < number < MOST_NUMBER))
    return _Among(column, sa.literal(listed, sa.Text))
