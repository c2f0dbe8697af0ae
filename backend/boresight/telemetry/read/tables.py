"""A telemetry file as tables of its columns, whatever its format."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa

from boresight.telemetry.read.compression import expanded
from boresight.telemetry.read.formats import Tables, csv_tables, format_at, json_tables
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.read.parquet import (
    parquet_tables,
)


def open_tables(path: Path, name: str, limits: Limits = LIMITS, *, as_text: bool = False) -> Tables:
    """Open a telemetry file as tables; `as_text` reads CSV and JSON Lines as text cells. Refuses as `read_chunks`."""
    match format_at(path, name):
        case "Parquet":
            return parquet_tables(path, name, limits)
        case "JSON Lines":
            return json_tables(path, name, limits, as_text=as_text)
        case _:
            return csv_tables(path, name, limits, as_text=as_text)


def read_table(path: Path, name: str, limits: Limits = LIMITS) -> pa.Table:
    """Return the columns of a telemetry file as they stand in it."""
    with expanded(path, name, limits) as place:
        tables = open_tables(place, name, limits)
        parts = list(tables.read())
        if any(part.schema != parts[0].schema for part in parts):  # some cell is no number: then every cell is a text
            tables = open_tables(place, name, limits, as_text=True)
            parts = list(tables.read())
        tables.form.refuse()
    plain = [part.cast(pa.schema([_plain(field) for field in part.schema])) for part in parts]
    return pa.concat_tables(plain, promote_options="default")


def _plain(field: pa.Field) -> pa.Field:
    """A column's type without a dictionary."""
    return field.with_type(field.type.value_type) if pa.types.is_dictionary(field.type) else field
