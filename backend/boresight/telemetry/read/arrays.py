"""From tables to arrays: every column of the contract under its name, in SI, nothing checked across rows yet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import pyarrow as pa

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.read.columns import floats, integers, texts, times
from boresight.telemetry.schema import COLUMN_GROUPS, OPTIONAL_COLUMNS, REQUIRED_COLUMNS, UNMATCHED, Telemetry

#: Columns that a refusal names.
_LISTED = 30
Values = TypeVar("Values", IntArray, FloatArray)


def check_columns(present: Sequence[str], faults: Faults) -> None:
    """Find missing columns, and groups of which a part is given."""
    for column in REQUIRED_COLUMNS:
        if column not in present:
            listed = ", ".join([*present[:_LISTED], "..."] if len(present) > _LISTED else present)
            faults.add(f"the column is missing: add it, the file has {listed or 'none'}", column=column)
    for group in COLUMN_GROUPS:
        missing = [column for column in group if column not in present]
        if len(missing) < len(group):
            for column in missing:
                faults.add(f"the column is missing: give all of {', '.join(group)}, or none", column=column)


def make_arrays(table: pa.Table, faults: Faults) -> Telemetry:
    """Turn a table in which every column is there that must be into arrays."""
    return Telemetry(
        frame=_complete(integers(table["frame"], "frame", faults), "frame", faults),
        exposure=_complete(integers(table["exposure"], "exposure", faults), "exposure", faults),
        row_px=_complete(floats(table["row_px"], "row_px", faults), "row_px", faults),
        col_px=_complete(floats(table["col_px"], "col_px", faults), "col_px", faults),
        time_utc=times(table["time_utc"], "time_utc", faults) if "time_utc" in table.column_names else None,
        magnitude=_optional_floats(table, "magnitude", faults),
        sigma_px=_optional_floats(table, "sigma_px", faults),
        star_id=_star_ids(table, faults),
        ra_rad=_angle(table, "ra_deg", faults),
        dec_rad=_angle(table, "dec_deg", faults),
        quaternion=_joined(table, ("q_x", "q_y", "q_z", "q_w"), faults),
        velocity_m_s=_velocity(table, faults),
        temperature_c=_optional_floats(table, "temperature_c", faults),
        unknown={name: texts(table[name]) for name in table.column_names if not is_known(name)},
        first_row=faults.first_row,
    )


def is_known(name: str) -> bool:
    """Say whether the contract names a column."""
    return name in REQUIRED_COLUMNS or name in OPTIONAL_COLUMNS


def scale_quaternions(telemetry: Telemetry) -> None:
    """Scale the quaternions to unit length, in place: nobody else holds the array yet."""
    if telemetry.quaternion is not None:
        telemetry.quaternion[:] /= np.linalg.norm(telemetry.quaternion, axis=1, keepdims=True)


def _complete(cells: tuple[Values, BoolArray], name: str, faults: Faults) -> Values:
    """Return the values of a column in which no cell may be absent."""
    values, absent = cells
    faults.add_entries(absent, name, lambda _: "the cell is empty: every row needs a number here")
    return values


def _optional_floats(table: pa.Table, name: str, faults: Faults) -> FloatArray | None:
    return floats(table[name], name, faults)[0] if name in table.column_names else None


def _angle(table: pa.Table, name: str, faults: Faults) -> FloatArray | None:
    degrees = _optional_floats(table, name, faults)
    return None if degrees is None else np.radians(degrees)


def _joined(table: pa.Table, names: tuple[str, ...], faults: Faults) -> FloatArray | None:
    """Return (n_rows, n_names) from columns of which all or none are there."""
    if names[0] not in table.column_names:
        return None
    return np.column_stack([floats(table[name], name, faults)[0] for name in names])


def _velocity(table: pa.Table, faults: Faults) -> FloatArray | None:
    km_s = _joined(table, ("vx_km_s", "vy_km_s", "vz_km_s"), faults)
    with np.errstate(over="ignore"):  # a speed beyond all numbers is refused as one
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
