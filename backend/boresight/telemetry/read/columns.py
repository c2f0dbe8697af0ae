"""From a file's tables to arrays: every column of the contract under its name, in SI, and a fault with its row elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import TypeVar

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.schema import COLUMN_GROUPS, OPTIONAL_COLUMNS, REQUIRED_COLUMNS, UNMATCHED, Telemetry

_NUMBER = r"^-?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?$|^-?(?i:nan|inf|infinity)$"
_HEXADECIMAL = r"^0[xX][0-9a-fA-F]{1,16}$"
#: From here on a float may stand for a neighbour: 2**53 + 1 is read as 2**53.
_FIRST_AMBIGUOUS = 2.0**53
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_ABSENT_TIME = int(np.datetime64("NaT", "us").astype(np.int64))
#: The Earth's ephemeris holds between these years.
_EARLIEST, _LATEST = np.datetime64("1900-01-01", "us"), np.datetime64("2100-01-01", "us")


def floats(column: pa.ChunkedArray, name: str, faults: Faults) -> tuple[FloatArray, BoolArray]:
    """Return a column as (n,) floats, NaN where absent, and the (n,) mask of absent cells.

    Text and non-finite cells become faults; their floats are of no use.
    """
    cells = _plain(column)
    absent = _absent(cells)
    if _is_text(cells):
        cells, absent = _numbers_of_text(cells, name, faults)
    elif not _is_number(cells):
        faults.add(f"holds {cells.type} where numbers are expected: write it as numbers", column=name)
        return np.full(len(cells), np.nan), np.zeros(len(cells), dtype=np.bool_)
    values = np.array(pc.cast(cells, pa.float64(), safe=False).to_numpy(zero_copy_only=False))
    faults.add_entries(
        ~np.isfinite(values) & ~_absent(cells),
        name,
        lambda entry: f"{values[entry]} is not a measurement: leave the cell empty or drop the row",
    )
    return values, absent


def integers(column: pa.ChunkedArray, name: str, faults: Faults) -> tuple[IntArray, BoolArray]:
    """Return a column as (n,) integers and the (n,) mask of absent cells, where the integer is 0.

    `3.0` is taken as 3, for table programs write so when a column has gaps.
    """
    cells = _plain(column)
    if _is_text(cells) or pa.types.is_integer(cells.type):
        try:
            exact = pc.cast(cells, pa.int64())
        except pa.ArrowInvalid:
            pass  # some cell is not an integer, or too large for one: look at them as numbers
        else:
            return exact.fill_null(0).to_numpy(), _absent(exact)
    cells = _without_hexadecimals(cells)
    values, absent = floats(pa.chunked_array([cells]), name, faults)
    whole = (values == np.round(values)) & (np.abs(values) < _FIRST_AMBIGUOUS)
    result = np.where(whole, values, 0.0).astype(np.int64)
    for entry in np.flatnonzero(np.isfinite(values) & ~whole).tolist():
        exactly = _exactly(cells[entry].as_py())
        if exactly is not None:
            whole[entry], result[entry] = True, exactly
    faults.add_entries(
        np.isfinite(values) & ~whole,
        name,
        lambda entry: f"{values[entry]:.15g} is not a whole number: write an integer",
    )
    return result, absent


def _without_hexadecimals(cells: pa.Array) -> pa.Array:
    """Return text with the hexadecimal numbers, which Arrow reads as integers, written as decimal ones."""
    if not _is_text(cells):
        return cells
    marked = pc.match_substring_regex(cells, _HEXADECIMAL).fill_null(fill_value=False)
    if not pc.any(marked).as_py():
        return cells
    texts = cells.to_pylist()
    for entry in np.flatnonzero(marked.to_numpy(zero_copy_only=False)).tolist():
        texts[entry] = str(int(texts[entry], 16))
    return pa.array(texts, cells.type)


def _exactly(cell: object) -> int | None:
    """Return a large integer that is written as one to its last digit, or None."""
    try:
        number = int(cell) if isinstance(cell, int | str) else None
    except ValueError:
        return None
    return number if number is not None and -(2**63) <= number < 2**63 else None


def times(column: pa.ChunkedArray, name: str, faults: Faults) -> NDArray[np.datetime64]:
    """Return a column as (n,) datetime64[us] UTC, NaT where absent; a time without a zone is taken as UTC."""
    cells = _plain(column)
    if pa.types.is_timestamp(cells.type):
        stamps = (
            pc.cast(cells, pa.timestamp("us", tz=cells.type.tz), safe=False).cast(pa.int64()).fill_null(_ABSENT_TIME)
        )
        moments = np.array(stamps.to_numpy()).view("datetime64[us]")
    elif _is_text(cells):
        moments = _times_of_text(cells, name, faults)
    else:
        faults.add(f"holds {cells.type} where times are expected: write ISO 8601, as 2026-11-21T08:30:00Z", column=name)
        return np.full(len(cells), np.datetime64("NaT"), dtype="datetime64[us]")
    faults.add_entries(
        (moments < _EARLIEST) | (moments >= _LATEST),
        name,
        lambda entry: f"{moments[entry]} is not between the years 1900 and 2100: correct the clock or leave it empty",
    )
    return moments


def texts(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Return a column nobody interprets as (n,) texts, empty where absent; a dictionary stays one, of the texts that are used."""
    if not pa.types.is_dictionary(column.type):
        return pa.chunked_array([_texts(_plain(column))], pa.string())
    return pa.chunked_array(map(_used_texts, column.chunks), pa.dictionary(pa.int32(), pa.string()))


def _used_texts(chunk: pa.DictionaryArray) -> pa.DictionaryArray:
    """Return a dictionary without the texts that no row has: a batch brings those of all batches before it."""
    absent = len(chunk.dictionary)
    indices = chunk.indices.cast(pa.int32()).fill_null(absent).to_numpy()
    used, place = np.unique(indices, return_inverse=True)
    known = _texts(chunk.dictionary.take(pa.array(used[used < absent])))
    if len(known) < len(used):
        known = pa.concat_arrays([known, pa.array([""])])
    return pa.DictionaryArray.from_arrays(pa.array(place.astype(np.int32)), known)


def _texts(cells: pa.Array) -> pa.Array:
    """Return values of any type as texts, empty where absent."""
    try:
        return pc.cast(cells, pa.string()).fill_null("")
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # nested cells and raw bytes have no text of their own
        return pa.array([orjson.dumps(cell, default=str).decode() for cell in cells.to_pylist()], pa.string())


def _plain(column: pa.ChunkedArray) -> pa.Array:
    """Return a column as one array, without dictionaries; a column of nothing but nulls counts as text."""
    cells = column.combine_chunks()
    if isinstance(cells, pa.ChunkedArray):
        cells = pa.concat_arrays(cells.chunks)
    if pa.types.is_dictionary(cells.type):
        cells = pc.cast(cells, cells.type.value_type)
    return pc.cast(cells, pa.string()) if pa.types.is_null(cells.type) else cells


def _is_text(cells: pa.Array) -> bool:
    return bool(pa.types.is_string(cells.type) or pa.types.is_large_string(cells.type))


def _is_number(cells: pa.Array) -> bool:
    kind = cells.type
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind))


def _absent(cells: pa.Array) -> BoolArray:
    return np.asarray(cells.is_null().to_numpy(zero_copy_only=False), dtype=np.bool_)


def _numbers_of_text(cells: pa.Array, name: str, faults: Faults) -> tuple[pa.Array, BoolArray]:
    """Return text as numbers, null where absent or wrong, and the (n,) mask of absent ones.

    Blanks around a number and a leading plus are let pass.
    """
    try:
        return pc.cast(cells, pa.float64()), _absent(cells)
    except pa.ArrowInvalid:
        pass  # at least one cell is not a plain number: find out which
    bare = pc.replace_substring_regex(pc.utf8_trim_whitespace(cells), r"^\+", "")
    number = pc.match_substring_regex(bare, _NUMBER).fill_null(fill_value=False)
    absent = pc.utf8_length(bare).fill_null(0).to_numpy() == 0
    faults.add_entries(
        ~number.to_numpy(zero_copy_only=False) & ~absent,
        name,
        lambda entry: f"{_quoted(cells, entry)} is not a number: correct it or leave it empty",
    )
    return pc.cast(pc.if_else(number, bare, None), pa.float64()), absent


def _times_of_text(cells: pa.Array, name: str, faults: Faults) -> NDArray[np.datetime64]:
    """Return (n,) texts as times; each distinct text is read once, for all stars of an exposure share theirs."""
    encoded = cells.dictionary_encode()
    stamps = [_stamp(text) for text in encoded.dictionary.to_pylist()]
    codes = encoded.indices.fill_null(len(stamps)).to_numpy()
    wrong = np.array([stamp is None for stamp in stamps] + [False])
    values = np.array([_ABSENT_TIME if stamp is None else stamp for stamp in stamps] + [_ABSENT_TIME], dtype=np.int64)
    faults.add_entries(
        wrong[codes],
        name,
        lambda entry: f"{_quoted(cells, entry)} is not a time: write ISO 8601, as 2026-11-21T08:30:00Z",
    )
    return np.asarray(values[codes].view("datetime64[us]"))


def _stamp(text: str) -> int | None:
    """Return microseconds since 1970 for an ISO 8601 text, or None."""
    if not text.strip():
        return _ABSENT_TIME
    try:
        moment = datetime.fromisoformat(text.strip())
        moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
        return (moment - _EPOCH) // _MICROSECOND
    except (ValueError, OverflowError):
        return None


def _quoted(cells: pa.Array, entry: int) -> str:
    text = str(cells[entry].as_py())
    return repr(text if len(text) <= 40 else text[:39] + "…")


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
