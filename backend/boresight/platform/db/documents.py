"""Canonical JSON documents, so that equal documents have equal hashes."""

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

from boresight.verdicts.numbers import Typed

#: An integer that may not fit into 64 bits, which the fast reader would round to a float.
_LONG_INTEGER = re.compile(r"(?<![.\d])\d{19}")

#: Larger than any row's id.
MOST_NUMBER = 1 << 31


def canonical(document: Any) -> str:
    """Return a JSON document as canonical text."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def read(text: str) -> Any:
    """Parse a JSON text as `json.loads` does, in a fifth of its time."""
    return json.loads(text) if _LONG_INTEGER.search(text) else orjson.loads(text)


def compute_sha256(document: Any) -> str:
    """Return the SHA-256, in hexadecimal, of the canonical text."""
    return hashlib.sha256(canonical(document).encode()).hexdigest()


class JsonText(sa.types.TypeDecorator[Any]):
    """A JSON document in a TEXT column, in its canonical form; None is NULL."""

    impl = sa.Text
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: sa.Dialect) -> Any:  # noqa: ARG002 - SQLAlchemy gives both
        """Encode on the way in."""
        return None if value is None else canonical(value)

    def process_result_value(self, value: Any, dialect: sa.Dialect) -> Any:  # noqa: ARG002 - SQLAlchemy gives both
        """Decode on the way out."""
        return None if value is None else read(value)


class TypedText(sa.types.TypeDecorator[str]):
    """A TEXT column of what people typed, such as a file name: pages keep its numbers as they are."""

    impl = sa.Text
    cache_ok = True

    @property
    def python_type(self) -> type[str]:
        """What stands in it."""
        return str

    def process_result_value(self, value: str | None, dialect: sa.Dialect) -> str | None:  # noqa: ARG002 - SQLAlchemy gives both
        """Mark it for the pages."""
        return None if value is None else Typed(value)


class _TextIn(sa.sql.functions.GenericFunction[str]):
    """SQL expression for a text inside a document, different on each engine."""

    type = sa.Text()
    inherit_cache = True


class _NumberIn(sa.sql.functions.GenericFunction[float]):
    """SQL expression for a number inside a document."""

    type = sa.Double()
    inherit_cache = True


@compiles(_TextIn)
@compiles(_NumberIn)
def _compile_for_sqlite(element: _TextIn | _NumberIn, compiler: SQLCompiler, **options: Any) -> str:
    """Extract by a path."""
    column, path = (compiler.process(clause, **options) for clause in element.clauses)
    return f"json_extract({column}, '$.' || {path})"


@compiles(_TextIn, "postgresql")
def _compile_text_for_postgresql(element: _TextIn | _NumberIn, compiler: SQLCompiler, **options: Any) -> str:
    """Read the text as JSON."""
    column, path = (compiler.process(clause, **options) for clause in element.clauses)
    return f"(CAST({column} AS JSON) #>> string_to_array({path}, '.'))"


@compiles(_NumberIn, "postgresql")
def _compile_number_for_postgresql(element: _NumberIn, compiler: SQLCompiler, **options: Any) -> str:
    """Read the text as JSON, and the member as a number."""
    return f"CAST({_compile_text_for_postgresql(element, compiler, **options)} AS DOUBLE PRECISION)"


def text_in(column: Any, path: str) -> sa.ColumnElement[str]:
    """Return the expression for a text in a document by its dotted path; NULL where there is none."""
    return _TextIn(sa.type_coerce(column, sa.Text), sa.literal(path, sa.Text))


def number_in(column: Any, path: str) -> sa.ColumnElement[float]:
    """Return the expression for a number in a document by its dotted path; NULL where there is none."""
    return _NumberIn(sa.type_coerce(column, sa.Text), sa.literal(path, sa.Text))


class _Among(sa.sql.functions.GenericFunction[bool]):
    """SQL expression for whether a number is in a JSON list of numbers."""

    type = sa.Boolean()
    inherit_cache = True
    _is_implicitly_boolean = True  # otherwise SQLite, which has no boolean type, compares it with 1


@compiles(_Among)
def _among_of_sqlite(element: _Among, compiler: SQLCompiler, **options: Any) -> str:
    """Compile it for SQLite with `json_each`."""
    column, listed = (compiler.process(clause, **options) for clause in element.clauses)
    return f"({column} IN (SELECT value FROM json_each({listed})))"  # noqa: S608 - compiled clauses, whose values are bound


@compiles(_Among, "postgresql")
def _among_of_postgresql(element: _Among, compiler: SQLCompiler, **options: Any) -> str:
    """Compile it for PostgreSQL as an array, whose length the planner sees; for rows from JSON it assumes a hundred."""
    column, listed = (compiler.process(clause, **options) for clause in element.clauses)
    return f"({column} = ANY (CAST(translate({listed}, '[]', '{{}}') AS INTEGER[])))"


def among(column: Any, numbers: Iterable[int]) -> sa.ColumnElement[bool]:
    """Return the condition that a key is one of any number of ids, bound as one value; values that cannot be ids match nothing."""
    listed = json.dumps(sorted(number for number in set(numbers) if 0 < number < MOST_NUMBER))
    return _Among(column, sa.literal(listed, sa.Text))
