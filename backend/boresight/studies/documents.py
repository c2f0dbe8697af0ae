"""What a reproduction's document holds whatever the paper: tables of judged rows, counted verdicts, versions."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from boresight import __version__
from boresight.studies.verdicts import VERDICTS, Row

SCHEMA = "boresight.reproduction/1"


@dataclass(frozen=True)
class Table:
    """One table: number and title of the paper, what its rows are judged by, the heading of the labels, and the rows."""

    number: str
    title: str
    conclusion: str
    head: str
    rows: tuple[Row, ...]


def table_document(table: Table) -> dict[str, Any]:
    """Write a table as JSON values."""
    return {
        "number": table.number,
        "title": table.title,
        "conclusion": table.conclusion,
        "head": table.head,
        "rows": [_row(row) for row in table.rows],
    }


def _row(row: Row) -> dict[str, Any]:
    cells = [{**asdict(cell), "verdict": cell.verdict} for cell in row.cells]
    return {"label": row.label, "verdict": row.verdict, "reason": row.reason, "cells": cells}


def verdict_counts(tables: Sequence[Mapping[str, Any]], figures: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Count the verdicts of all rows and figures, each of the three named."""
    counts = Counter(item["verdict"] for item in (*(row for table in tables for row in table["rows"]), *figures))
    return {verdict: counts[verdict] for verdict in VERDICTS}


def versions() -> dict[str, str]:
    """Name the versions that computed a study."""
    return {name: version(name) for name in ("numpy", "numba", "scipy", "pyerfa")} | {
        "boresight": __version__,
        "python": platform.python_version(),
    }
