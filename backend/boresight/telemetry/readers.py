"""Reading a telemetry file whole: its chunks put together; and writing one again.

Every fault of the file is collected with row and column, as an editor counts them, and refused in one sentence.
A quaternion is scaled to unit length on the way in; a star number of -1 becomes 0, which means unmatched.
"""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa

from boresight.telemetry.arrays import arrays_of, check_columns, scale_quaternions
from boresight.telemetry.checks import Checks
from boresight.telemetry.chunks import open_tables, read_chunks
from boresight.telemetry.limits import LIMITS, Limits
from boresight.telemetry.refusals import Faults
from boresight.telemetry.schema import Telemetry, joined
from boresight.telemetry.writers import write_csv, write_parquet

__all__ = ["read_table", "read_telemetry", "write_csv", "write_parquet"]


def read_telemetry(path: Path, name: str | None = None, limits: Limits = LIMITS) -> Telemetry:
    """Read a telemetry file.

    Parameters
    ----------
    path
        Where it is.
    name
        What its sender called it, and refusals call it; None for the name it has. The suffix says CSV, JSON Lines or
        Parquet; without one a file is what its bytes are.
    limits
        How much it may hold.

    Raises
    ------
    RefusedInputError
        When the file cannot be used; the first twenty faults name row and column.
    """
    return joined(list(read_chunks(path, name, limits=limits)))


def read_table(path: Path, name: str, limits: Limits = LIMITS) -> pa.Table:
    """Return the columns of a telemetry file as they stand in it.

    Raises
    ------
    RefusedInputError
        When it is no table; what its cells hold is not looked at.
    """
    tables = open_tables(path, name, limits)
    parts = list(tables.read())
    if any(part.schema != parts[0].schema for part in parts):  # some cell is no number: then every cell is a text
        tables = open_tables(path, name, limits, as_text=True)
        parts = list(tables.read())
    tables.form.refuse()
    plain = [part.cast(pa.schema([_plain(field) for field in part.schema])) for part in parts]
    return pa.concat_tables(plain, promote_options="default")


def _plain(field: pa.Field) -> pa.Field:
    """A column's type without a dictionary."""
    return field.with_type(field.type.value_type) if pa.types.is_dictionary(field.type) else field


def telemetry_of(table: pa.Table, faults: Faults) -> Telemetry:
    """Turn a table of whole frames into telemetry.

    Parameters
    ----------
    table
        Columns by the contract's names, numbers or text.
    faults
        Names the file; whatever it collects is refused.

    Raises
    ------
    RefusedInputError
        When columns are missing, cells cannot be read, or the rows do not make sense together.
    """
    check_columns(table.column_names, faults)
    if not table.num_rows:
        faults.add("there are no rows: there is nothing to calibrate from")
    faults.refuse()
    telemetry = arrays_of(table, faults)
    faults.refuse()
    checks = Checks(faults.subject)
    checks.look_at(telemetry)
    checks.refuse()
    scale_quaternions(telemetry)
    return telemetry
