"""What every table has in common: one declarative base, STRICT tables, constraints, and which columns are sealed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import sqlalchemy as sa
from sqlalchemy.orm import DeclarativeBase


@dataclass(frozen=True)
class Journal:
    """The columns of an append-only table that its hash chain covers, and the changing ones, which have a hash of their own."""

    lasting: tuple[str, ...]
    others: tuple[str, ...]


@dataclass(frozen=True)
class Sealing:
    """Which parts of a table's rows the audit log does not seal (`boresight.platform.audit.seals`); everything else is sealed."""

    unsealed: str = ""  # why the table is not sealed at all
    fleeting: Mapping[str, str] = field(default_factory=dict)  # columns that are not sealed, and why
    moving: frozenset[str] = frozenset()  # columns that are sealed only in these states of the row
    settled: Collection[str] = ()
    journal: Journal | None = None


class Base(DeclarativeBase):
    """All tables share one naming convention, so that migrations can name what they drop."""

    noun: ClassVar[str]  # name of a row in refusals of an unknown id
    sealing: ClassVar[Sealing] = Sealing()
    metadata = sa.MetaData(
        naming_convention={
            "ix": "ix_%(column_0_label)s",
            "uq": "uq_%(table_name)s_%(column_0_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
            "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )


STRICT = {"sqlite_strict": True}


def allow_only(column: str, values: tuple[str, ...]) -> sa.CheckConstraint:
    """Return a constraint that allows only these words in a column."""
    return sa.CheckConstraint(f"{column} IN ({', '.join(repr(value) for value in values)})", name=column)


def only_one(name: str, column: str, where: str) -> sa.Index:
    """Return a unique index on a column among the rows that meet a condition."""
    return sa.Index(name, column, unique=True, sqlite_where=sa.text(where), postgresql_where=sa.text(where))
