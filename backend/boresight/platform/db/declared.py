"""What every table has in common: one declarative base, STRICT tables, words and rows that are limited, what is sealed of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import sqlalchemy as sa
from sqlalchemy.orm import DeclarativeBase


@dataclass(frozen=True)
class Journal:
    """The columns of an append-only table that its chain of hashes covers, and those that move, which have a hash of their own."""

    lasting: tuple[str, ...]
    others: tuple[str, ...]


@dataclass(frozen=True)
class Sealing:
    """What the audit log (`boresight.platform.audit.seals`) vouches for in the rows of a table: everything, but what this says."""

    unsealed: str = ""  # why for none of it
    fleeting: Mapping[str, str] = field(default_factory=dict)  # for which columns not, and why
    moving: frozenset[str] = frozenset()  # for which columns only once the row's state is one of these
    settled: Collection[str] = ()
    journal: Journal | None = None


class Base(DeclarativeBase):
    """All tables share one naming convention, so that migrations can name what they drop."""

    noun: ClassVar[str]  # what a row is called where there is none of a number
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
    """Allow only these words in a column."""
    return sa.CheckConstraint(f"{column} IN ({', '.join(repr(value) for value in values)})", name=column)


def only_one(name: str, column: str, where: str) -> sa.Index:
    """Allow one row for each value of a column among the rows that meet a condition."""
    return sa.Index(name, column, unique=True, sqlite_where=sa.text(where), postgresql_where=sa.text(where))
