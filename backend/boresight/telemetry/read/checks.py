"""What a telemetry set must satisfy: its columns become arrays in SI, and every fault is collected with row and column.

Nothing is refused before all was looked at: the columns cell by cell, then what cells say together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, TypeVar

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.errors import Fault, RefusedInputError
from boresight.telemetry.read.limits import LIMITS
from boresight.telemetry.schema import (
    COLUMN_GROUPS,
    OPTIONAL_COLUMNS,
    REQUIRED_COLUMNS,
    UNMATCHED,
    Exposures,
    Telemetry,
    find_exposures,
)

MOST_FAULTS = 20
#: Faults that are met one by one are not looked for beyond so many: each costs some microseconds.
MOST_COUNTED = 100_000
_MOST_HELD = 50 * MOST_FAULTS


#: Where an entry and its column stand in the file that a table was made from.
Places = Callable[[int, str | None], tuple[int, str | None]]


class Faults:
    """Faults of one input in the order of its rows; `places` where it was made from another file, whose rows are told."""

    def __init__(self, subject: str, first_row: int = 1, places: Places | None = None) -> None:
        self.subject = subject
        self.first_row = first_row
        self._places = places
        self.count = 0
        self._kept: list[Fault] = []
        self._last: int | None = None  # row from which on a fault is none of the first, once there are enough

    def add(self, detail: str, *, column: str | None = None, row: int | None = None, name: str = "") -> None:
        """Add one fault; `row` as an editor counts, `name` of the field that it is about."""
        self.count += 1
        if self.count > MOST_COUNTED:
            self.refuse()
        if self._last is None or (row or 0) < self._last:
            self._keep([Fault(row, column, detail, name)])

    def place(self, entry: int, column: str | None = None) -> tuple[int, str | None]:
        """Return row, as an editor counts, and column of an entry."""
        return self._places(entry, column) if self._places is not None else (entry + self.first_row, column)

    def add_entry(self, entry: int, column: str, detail: str) -> None:
        """Add a fault of one entry."""
        row, named = self.place(entry, column)
        self.add(detail, row=row, column=named)

    def add_entries(self, wrong: NDArray[np.bool_], column: str | None, detail: Callable[[int], str]) -> None:
        """Add a fault for every entry of the (n,) mask; `detail` writes the sentence of one entry."""
        entries = np.flatnonzero(wrong)
        self.count += len(entries)
        self._keep([Fault(*self.place(entry, column), detail(entry)) for entry in entries[:MOST_FAULTS].tolist()])

    def absorb(self, other: Faults) -> None:
        """Take over the faults of another collection; at the same row they come after those that are here."""
        self.count += other.count
        self._keep(other._kept)

    def refuse(self) -> None:
        """Raise what was collected, if anything was."""
        if self.count:
            raise self.refusal()

    def refusal(self) -> RefusedInputError:
        """Return what `refuse` raises, of at least one fault."""
        kept = _first(self._kept)
        others = self.count - 1
        more = f" (and {others} more {'fault' if others == 1 else 'faults'})" if others else ""
        return RefusedInputError(f"{self.subject}: {kept[0]}{more}", tuple(kept))

    def _keep(self, faults: list[Fault]) -> None:
        """Hold faults, and of very many only those that can be among the first."""
        self._kept += faults
        if len(self._kept) > _MOST_HELD:
            self._kept = _first(self._kept)
            self._last = self._kept[-1].row or 0


def _first(faults: list[Fault]) -> list[Fault]:
    """Return the first twenty by row; those of one row in the order in which they came."""
    return sorted(faults, key=lambda fault: fault.row or 0)[:MOST_FAULTS]


_QUATERNION_TOLERANCE = 1e-3
_FASTEST_M_S = 100e3
_SIGMA_PX = (1e-6, 1e4)


class Checks:
    """Checks of a set that comes in parts of whole frames.

    Exposures lie within a frame, so a part has all that belongs together; only the order of the frames runs over the seams.
    """

    def __init__(self, subject: str, most_stars: int = LIMITS.stars, places: Places | None = None) -> None:
        self._most_stars = most_stars
        self._order, self._torn, self._others = (Faults(subject, places=places) for _ in range(3))
        self._last_frame: int | None = None

    @property
    def found(self) -> bool:
        """Whether there is something to refuse."""
        return bool(self._order.count or self._torn.count or self._others.count)

    def look_at(self, telemetry: Telemetry) -> None:
        """Collect every fault of the next part; nothing is raised here."""
        for faults in (self._order, self._torn, self._others):
            faults.first_row = telemetry.first_row
        exposures = find_exposures(telemetry)
        _check_order(telemetry, self._last_frame, self._order)
        self._last_frame = int(telemetry.frame[-1])
        _check_torn(telemetry, exposures, self._torn)
        _check_stars(telemetry, exposures, self._most_stars, self._others)
        _check_repeated_centroids(telemetry, exposures, self._others)
        with np.errstate(over="ignore"):  # the length of what is beyond all numbers is infinite, and refused
            _check_directions(telemetry, self._others)
            _check_quaternions(telemetry, self._others)
            _check_velocities(telemetry, self._others)
        _check_noise(telemetry, self._others)

    def refuse(self) -> None:
        """Raise what was collected; an exposure counts as torn only where the frames are in order."""
        faults = self._order if self._order.count else self._torn
        faults.absorb(self._others)
        faults.refuse()


def _check_order(telemetry: Telemetry, last_frame: int | None, faults: Faults) -> None:
    """Find frames that descend, also from the last one of the part before."""
    frame = telemetry.frame
    before = np.append(frame[0] if last_frame is None else last_frame, frame[:-1])
    faults.add_entries(
        frame < before,
        "frame",
        lambda entry: f"frame {frame[entry]} follows frame {before[entry]}: sort the rows by frame",
    )


def _check_torn(telemetry: Telemetry, exposures: Exposures, faults: Faults) -> None:
    """Find exposures that are not one run of rows."""
    later, _ = repeats_within(np.zeros(len(exposures), dtype=np.int64), exposures.frame, exposures.exposure)
    torn = np.zeros(len(telemetry), dtype=np.bool_)
    torn[exposures.start[later]] = True
    faults.add_entries(
        torn,
        "exposure",
        lambda entry: (
            f"exposure {telemetry.exposure[entry]} of frame {telemetry.frame[entry]} was interrupted by another: "
            "sort the rows by frame and exposure"
        ),
    )


def _check_stars(telemetry: Telemetry, exposures: Exposures, most: int, faults: Faults) -> None:
    """Find exposures of more detections than can be compared with one another."""
    full = np.zeros(len(telemetry), dtype=np.bool_)
    full[exposures.start[exposures.count > most]] = True
    faults.add_entries(
        full,
        "exposure",
        lambda entry: (
            f"exposure {telemetry.exposure[entry]} of frame {telemetry.frame[entry]} has over {most:,} detections: raise the "
            "detection threshold, or number the exposures"
        ),
    )


def _check_repeated_centroids(telemetry: Telemetry, exposures: Exposures, faults: Faults) -> None:
    """Find detections of an exposure in the very same place."""
    later, earlier = repeats_within(exposures.of_entry, telemetry.row_px, telemetry.col_px)
    for entry, before in zip(later.tolist(), earlier.tolist(), strict=True):
        faults.add_entry(
            entry,
            "row_px",
            f"the centroid is that of row {faults.place(before)[0]} in the same exposure: delete one of the two rows",
        )


#: Multiplier of the hash, 2^64 over the golden ratio, and the shift that brings its high bits down.
_ODD, _HALF = np.uint64(0x9E3779B97F4A7C15), np.uint64(32)


def repeats_within(exposure_of_entry: IntArray, *keys: NDArray[np.generic]) -> tuple[IntArray, IntArray]:
    """Find entries that have the same keys as an earlier entry of their exposure.

    `exposure_of_entry`: (n,) exposure of each entry. `keys`: (n,) each; all must be equal. Returns later, earlier:
    (n_repeats,) positions of the repeating entries and of the ones just before with the same keys; ascending.
    """
    suspects = _suspects((exposure_of_entry, *keys))
    if not len(suspects):
        return suspects, suspects
    chosen = [key[suspects] for key in (*keys, exposure_of_entry)]
    order = np.lexsort(chosen)
    same = np.ones(len(order) - 1, dtype=np.bool_)
    for key in chosen:
        same &= np.diff(key[order]) == 0
    place = np.flatnonzero(same)
    later, earlier = suspects[order[place + 1]], suspects[order[place]]
    ascending = np.argsort(later)
    return later[ascending], earlier[ascending]


def _suspects(keys: tuple[NDArray[np.generic], ...]) -> IntArray:
    """Return, ascending, every entry whose keys may be those of another: their hashes are equal.

    Equal keys have equal hashes, so nothing is missed; sorting one column of hashes costs a tenth of sorting all the keys,
    and in a good file nothing is left to sort.
    """
    mixed = np.zeros(len(keys[0]), dtype=np.uint64)
    for key in keys:
        number = key.astype(np.float64) + 0.0 if key.dtype.kind == "f" else key.astype(np.int64)  # -0.0 equals 0.0
        mixed = (mixed ^ number.view(np.uint64)) * _ODD
        mixed ^= mixed >> _HALF
    ordered = np.sort(mixed)
    repeated = ordered[1:][ordered[1:] == ordered[:-1]]
    return np.flatnonzero(np.isin(mixed, repeated)) if len(repeated) else np.empty(0, np.int64)


def _check_directions(telemetry: Telemetry, faults: Faults) -> None:
    """Find directions given by half or out of range."""
    ra_rad, dec_rad = telemetry.ra_rad, telemetry.dec_rad
    if ra_rad is None or dec_rad is None:
        return
    _check_together(np.column_stack([ra_rad, dec_rad]), "ra_deg", "ra_deg and dec_deg", faults)
    ra_deg, dec_deg = np.degrees(ra_rad), np.degrees(dec_rad)
    faults.add_entries(
        (ra_deg < -180.0 - 1e-9) | (ra_deg > 360.0 + 1e-9),
        "ra_deg",
        lambda entry: f"{ra_deg[entry]:.9g} is not between -180 and 360: give degrees",
    )
    faults.add_entries(
        np.abs(dec_deg) > 90.0 + 1e-9,
        "dec_deg",
        lambda entry: f"{dec_deg[entry]:.9g} is not between -90 and 90: give degrees",
    )


def _check_quaternions(telemetry: Telemetry, faults: Faults) -> None:
    """Find quaternions given in part or not of unit length."""
    if telemetry.quaternion is None:
        return
    _check_together(telemetry.quaternion, "q_x", "q_x, q_y, q_z and q_w", faults)
    length = np.linalg.norm(telemetry.quaternion, axis=1)
    faults.add_entries(
        np.abs(length - 1.0) > _QUATERNION_TOLERANCE,
        "q_x",
        lambda entry: f"the quaternion's length is {length[entry]:.6g}, not 1: give a unit quaternion x, y, z, w",
    )


def _check_velocities(telemetry: Telemetry, faults: Faults) -> None:
    """Find velocities given in part or in metres per second."""
    if telemetry.velocity_m_s is None:
        return
    _check_together(telemetry.velocity_m_s, "vx_km_s", "vx_km_s, vy_km_s and vz_km_s", faults)
    speed = np.linalg.norm(telemetry.velocity_m_s, axis=1)
    faults.add_entries(
        speed > _FASTEST_M_S,
        "vx_km_s",
        lambda entry: f"the speed is {speed[entry] / 1e3:.6g} km/s: give kilometres per second, not metres",
    )


def _check_noise(telemetry: Telemetry, faults: Faults) -> None:
    """Find standard deviations that are none of a centroid's or a star's image; of less, or more, no weight can be computed."""
    for column in ("sigma_px", "psf_sigma_px"):
        if (values := getattr(telemetry, column)) is not None:
            _check_sigmas(values, column, faults)


def _check_sigmas(sigma_px: FloatArray, column: str, faults: Faults) -> None:
    faults.add_entries(
        sigma_px <= 0.0,
        column,
        lambda entry: f"{sigma_px[entry]:g} is not positive: give the standard deviation, or leave it empty",
    )
    low, high = _SIGMA_PX
    faults.add_entries(
        (sigma_px > 0.0) & ((sigma_px < low) | (sigma_px > high)),
        column,
        lambda entry: (
            f"{sigma_px[entry]:g} is not between {low:g} and {high:g} pixels: check its unit, or leave it empty"
        ),
    )


def _check_together(values: FloatArray, column: str, group: str, faults: Faults) -> None:
    """Refuse rows of the (n_rows, n_columns) values that are given in part."""
    absent = np.isnan(values)
    given = absent.shape[1] - np.count_nonzero(absent, axis=1)
    partial = (given > 0) & (given < absent.shape[1])
    faults.add_entries(partial, column, lambda _: f"give all of {group}, or leave all empty")


_NUMBER = r"^-?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?$|^-?(?i:nan|inf|infinity)$"
_HEXADECIMAL = r"^0[xX][0-9a-fA-F]{1,16}$"
#: From here on a float may stand for a neighbour: 2**53 + 1 is read as 2**53.
_FIRST_AMBIGUOUS = 2.0**53
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_ABSENT_TIME = int(np.datetime64("NaT", "us").astype(np.int64))
#: The Earth's ephemeris holds between these years.
EARLIEST, LATEST = np.datetime64("1900-01-01", "us"), np.datetime64("2100-01-01", "us")


def floats(column: pa.ChunkedArray, name: str, faults: Faults) -> tuple[FloatArray, BoolArray]:
    """Return a column as (n,) floats, NaN where absent, and the (n,) mask of absent cells.

    Text and non-finite cells become faults; their floats are of no use.
    """
    cells = _plain(column)
    absent = _absent(cells)
    if _is_text(cells):
        cells, absent = _numbers_of_text(cells, name, faults)
    elif not _is_number(cells):
        faults.add(f"contains {cells.type} where numbers are expected: write it as numbers", column=name)
        return np.full(len(cells), np.nan), np.zeros(len(cells), dtype=np.bool_)
    values = np.array(pc.cast(cells, pa.float64(), safe=False).to_numpy(zero_copy_only=False))
    faults.add_entries(
        ~np.isfinite(values) & ~_absent(cells),
        name,
        lambda entry: f"{values[entry]} is not a measurement: correct it or {_otherwise(name)}",
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
            return fill_absent(exact, 0), _absent(exact)
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
        stamps = pc.cast(cells, pa.timestamp("us", tz=cells.type.tz), safe=False).cast(pa.int64())
        moments = fill_absent(stamps, _ABSENT_TIME).view("datetime64[us]")
    elif _is_text(cells):
        moments = _times_of_text(cells, name, faults)
    else:
        faults.add(
            f"contains {cells.type} where times are expected: write ISO 8601, as 2026-11-21T08:30:00Z", column=name
        )
        return np.full(len(cells), np.datetime64("NaT"), dtype="datetime64[us]")
    faults.add_entries(
        (moments < EARLIEST) | (moments >= LATEST),
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


def fill_absent(cells: pa.Array, value: int) -> NDArray[Any]:
    """Return whole numbers (n,) with a value where they are absent.

    `fill_null` wants a value of Arrow's, and Arrow loads pandas to make one, wherever that is installed: a fifth of a second.
    """
    kind, numbers, n = np.dtype(str(cells.type)), cells.buffers()[1], len(cells)
    if numbers is None or n == 0:  # Arrow keeps nothing where there is nothing
        return np.full(n, value, kind)
    values = np.frombuffer(numbers, kind, cells.offset + n)[cells.offset :].copy()
    if cells.null_count:
        values[_absent(cells)] = value
    return values


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
        lambda entry: f"{_quoted(cells, entry)} is not a number: correct it or {_otherwise(name)}",
    )
    return pc.cast(pc.if_else(number, bare, None), pa.float64()), absent


def _otherwise(column: str) -> str:
    """Say what to do with a cell that cannot be corrected; of a column that every row needs it cannot be left empty."""
    return "drop the row" if column in REQUIRED_COLUMNS else "leave it empty"


def _times_of_text(cells: pa.Array, name: str, faults: Faults) -> NDArray[np.datetime64]:
    """Return (n,) texts as times; each distinct text is read once, for all stars of an exposure share theirs."""
    encoded = cells.dictionary_encode()
    stamps = [_stamp(text) for text in encoded.dictionary.to_pylist()]
    codes = fill_absent(encoded.indices, len(stamps))
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
        psf_sigma_px=_optional_floats(table, "psf_sigma_px", faults),
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
    faults.add_entries(absent, name, lambda _: "the cell is empty: give every row a number here")
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
