"""Reading a telemetry file: bytes to a table, table to arrays, arrays checked; and writing one again.

Every fault of the file is collected with row and column, as an editor counts them, and refused in one sentence.
A quaternion is scaled to unit length on the way in; a star number of -1 becomes 0, which means unmatched.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from boresight.telemetry import comma_separated, json_lines, parquet
from boresight.telemetry.checks import check_telemetry
from boresight.telemetry.columns import floats, integers, texts, times
from boresight.telemetry.formats import format_of, read_bytes, text_of
from boresight.telemetry.refusals import Faults
from boresight.telemetry.schema import COLUMN_GROUPS, OPTIONAL_COLUMNS, REQUIRED_COLUMNS, UNMATCHED, Telemetry
from boresight.telemetry.writers import write_csv, write_parquet

__all__ = ["read_table", "read_telemetry", "write_csv", "write_parquet"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def read_telemetry(path: Path, name: str | None = None) -> Telemetry:
    """Read a telemetry file.

    Parameters
    ----------
    path
        Where it is.
    name
        What its sender called it, and refusals call it; None for the name it has. The suffix says CSV, JSON Lines or
        Parquet; without one a file is what its bytes are.

    Raises
    ------
    RefusedInputError
        When the file cannot be used; the first twenty faults name row and column.
    """
    name = name or path.name
    table, first_row = read_table(path, name)
    return telemetry_of(table, Faults(name, first_row))


def read_table(path: Path, name: str) -> tuple[pa.Table, int]:
    """Return the columns of a telemetry file as they stand in it, and the number of its first row; refuses as `read_telemetry`."""
    data = read_bytes(path, name)
    match format_of(name, data):
        case "Parquet":
            return parquet.read_parquet(name, data), parquet.FIRST_ROW
        case "JSON Lines":
            return json_lines.read_json_lines(name, text_of(name, data)), json_lines.FIRST_ROW
        case _:
            return comma_separated.read_csv(name, text_of(name, data)), comma_separated.FIRST_ROW


def telemetry_of(table: pa.Table, faults: Faults) -> Telemetry:
    """Turn a table into telemetry.

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
    _check_columns(table, faults)
    faults.refuse()
    telemetry = Telemetry(
        frame=_complete_integers(table, "frame", faults),
        exposure=_complete_integers(table, "exposure", faults),
        row_px=_complete_floats(table, "row_px", faults),
        col_px=_complete_floats(table, "col_px", faults),
        time_utc=times(table["time_utc"], "time_utc", faults) if "time_utc" in table.column_names else None,
        magnitude=_optional_floats(table, "magnitude", faults),
        sigma_px=_optional_floats(table, "sigma_px", faults),
        star_id=_star_ids(table, faults),
        ra_rad=_angle(table, "ra_deg", faults),
        dec_rad=_angle(table, "dec_deg", faults),
        quaternion=_joined(table, ("q_x", "q_y", "q_z", "q_w"), faults),
        velocity_m_s=_velocity(table, faults),
        temperature_c=_optional_floats(table, "temperature_c", faults),
        unknown={name: texts(table[name]) for name in table.column_names if not _is_known(name)},
        first_row=faults.first_row,
    )
    faults.refuse()
    check_telemetry(telemetry, faults)
    faults.refuse()
    return _with_unit_quaternions(telemetry)


def _is_known(name: str) -> bool:
    return name in REQUIRED_COLUMNS or name in OPTIONAL_COLUMNS


def _check_columns(table: pa.Table, faults: Faults) -> None:
    """Find missing columns, groups given in part, and tables without rows."""
    present = table.column_names
    for column in REQUIRED_COLUMNS:
        if column not in present:
            faults.add(f"the column is missing: add it, the file has {', '.join(present) or 'none'}", column=column)
    for group in COLUMN_GROUPS:
        missing = [column for column in group if column not in present]
        if len(missing) < len(group):
            for column in missing:
                faults.add(f"the column is missing: give all of {', '.join(group)}, or none", column=column)
    if not table.num_rows:
        faults.add("there are no rows: there is nothing to calibrate from")


def _complete_integers(table: pa.Table, name: str, faults: Faults) -> IntArray:
    """Return an integer column in which no cell may be absent."""
    before = faults.count
    values, absent = integers(table[name], name, faults)
    if faults.count == before:
        faults.add_entries(absent, name, lambda _: "the cell is empty: every row needs a number here")
    return values


def _complete_floats(table: pa.Table, name: str, faults: Faults) -> FloatArray:
    """Return a float column in which no cell may be absent."""
    before = faults.count
    values = floats(table[name], name, faults)
    if faults.count == before:
        faults.add_entries(np.isnan(values), name, lambda _: "the cell is empty: every row needs a number here")
    return values


def _optional_floats(table: pa.Table, name: str, faults: Faults) -> FloatArray | None:
    return floats(table[name], name, faults) if name in table.column_names else None


def _angle(table: pa.Table, name: str, faults: Faults) -> FloatArray | None:
    degrees = _optional_floats(table, name, faults)
    return None if degrees is None else np.radians(degrees)


def _joined(table: pa.Table, names: tuple[str, ...], faults: Faults) -> FloatArray | None:
    """Return (n_rows, n_names) from columns of which all or none are there."""
    if names[0] not in table.column_names:
        return None
    return np.column_stack([floats(table[name], name, faults) for name in names])


def _velocity(table: pa.Table, faults: Faults) -> FloatArray | None:
    km_s = _joined(table, ("vx_km_s", "vy_km_s", "vz_km_s"), faults)
    return None if km_s is None else km_s * 1e3


def _star_ids(table: pa.Table, faults: Faults) -> IntArray | None:
    """Return star numbers, 0 where the file says empty, 0 or -1."""
    if "star_id" not in table.column_names:
        return None
    star_id, _ = integers(table["star_id"], "star_id", faults)
    faults.add_entries(
        star_id < -1,
        "star_id",
        lambda entry: f"{star_id[entry]} is not a Hipparcos number: leave it empty where no star is matched",
    )
    return np.where(star_id > 0, star_id, UNMATCHED)


def _with_unit_quaternions(telemetry: Telemetry) -> Telemetry:
    """Scale the quaternions to unit length, in place: nobody else holds the array yet."""
    if telemetry.quaternion is not None:
        telemetry.quaternion[:] /= np.linalg.norm(telemetry.quaternion, axis=1, keepdims=True)
    return telemetry
