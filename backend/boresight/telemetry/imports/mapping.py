"""From another program's file to telemetry, by a profile: units, origins, conventions, order, and what is added to it.

A fault names row and column of the file that came. Detections are put in order by frame and exposure, in the file's order within
one. With p the coordinate of a file and o what it calls the centre of the first pixel, row = (p - o) / pitch, and (o - p) / pitch
where the coordinate is reversed. A quaternion becomes Hamilton's from ICRS to the detector,

    q = m ⊗ q_file*      (the conjugate where exactly one of sense and convention differs; m: the mounting)

and a flux becomes a magnitude, -2.5 log10 F + zero point. Places of a catalogue are turned by the velocity of Earth and satellite
(`boresight.sky.apparent.aberrated`) where a time is known; where none is, they are kept beside, as `catalogue_ra_deg`, for a place
that is not apparent would be fitted as distortion. Proper motion is not theirs to add: re-matching finds the star itself.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import orjson
import pyarrow as pa
from numpy.typing import NDArray

from boresight.arrays import BoolArray, FloatArray, IntArray, TimeArray
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import conjugate, product
from boresight.telemetry.imports.ephemerides import Attitudes, Orbit, is_aem, read_aem, read_orbit
from boresight.telemetry.imports.profile import Axis, Profile, Quaternion
from boresight.telemetry.imports.recognition import Draft, draft_profile, recognise_table
from boresight.telemetry.imports.tables import MOST_BYTES, SourceTable, read_source
from boresight.telemetry.imports.times import read_constant, read_times, tell_leap_seconds
from boresight.telemetry.read.checks import Checks, Faults, floats, integers, scale_quaternions, texts
from boresight.telemetry.read.compression import expanded
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.schema import OPTIONAL_COLUMNS, REQUIRED_COLUMNS, UNMATCHED, Telemetry, find_exposures
from boresight.telemetry.sensors import Sensor
from boresight.telemetry.writing import contract_table, write_table

SCHEMA: Final = "boresight.import/1"
METADATA: Final = b"boresight.import"
PREVIEW_ROWS, MOST_FILES = 10, 10_000
#: A larger file is not read once for every profile.
MOST_BYTES_RECOGNISED: Final = 16_000_000
_METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
_RADIANS = {"deg": np.pi / 180, "rad": 1.0, "hour": np.pi / 12}
_LIGHT_M_S = 299_792_458.0
_AU_A_DAY_IN_C = 149_597_870_700.0 / 86_400.0 / _LIGHT_M_S
_HIP = re.compile(r"^\s*(?:HIP\s*)?(\d{1,9})(?:\.0*)?\s*$", re.IGNORECASE)
_NO_TIME = np.datetime64("NaT", "us")


@dataclass(frozen=True)
class SourceFile:
    """A file that came: where it is, what its sender calls it, and the hash of its bytes."""

    path: Path
    name: str

    @cached_property
    def sha256(self) -> str:
        """Its SHA-256."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def describe(self) -> dict[str, Any]:
        """Return what a record says of it."""
        return {"name": self.name, "sha256": self.sha256, "bytes": self.path.stat().st_size}


@dataclass(frozen=True)
class Meaning:
    """What a column of the imported telemetry is made of."""

    column: str
    source: str
    sentence: str


@dataclass(frozen=True)
class PreviewRow:
    """A row of the imported telemetry and the cells that it was made of."""

    row: int
    source: dict[str, str]
    telemetry: dict[str, Any]


@dataclass(frozen=True)
class Imported:
    """Telemetry that was made of files, with the record of how."""

    telemetry: Telemetry
    profile: Profile
    sources: tuple[SourceFile, ...]
    meanings: tuple[Meaning, ...]
    preview: tuple[PreviewRow, ...]
    notes: tuple[str, ...]
    unused: tuple[str, ...]
    orbit: SourceFile | None = None
    attitude: SourceFile | None = None
    draft: Draft | None = None

    def record(self) -> dict[str, Any]:
        """Return the record that goes with the telemetry: sources, profile, meanings and notes."""
        exposures = find_exposures(self.telemetry)
        return {
            "schema": SCHEMA,
            "profile": {"name": self.profile.name, "version": self.profile.version, "sha256": self.profile.sha256},
            "sources": [source.describe() for source in self.sources],
            "orbit": None if self.orbit is None else self.orbit.describe(),
            "attitude": None if self.attitude is None else self.attitude.describe(),
            "frames": len(np.unique(exposures.frame)),
            "exposures": len(exposures),
            "stars": len(self.telemetry),
            "columns": [asdict(meaning) for meaning in self.meanings],
            "unused_columns": list(self.unused),
            "notes": list(self.notes),
        }

    def to_preview(self) -> dict[str, Any]:
        """Return the record with its first rows, what would be stored; of a drafted profile, with it and what it leaves open."""
        draft = self.draft and {"profile": self.draft.profile.to_dict(), "still": list(self.draft.still)}
        return {**self.record(), "rows": [asdict(row) for row in self.preview], "draft": draft}

    def write(self, stream: IO[bytes], suffix: str) -> None:
        """Write the telemetry as CSV, JSON Lines or, with the record in its metadata, Parquet."""
        table = contract_table(self.telemetry)
        write_table(table.replace_schema_metadata({METADATA: orjson.dumps(self.record())}), stream, suffix)


def import_files(
    files: Sequence[SourceFile],
    profile: Profile,
    *,
    sensor: Sensor | None = None,
    orbit: SourceFile | None = None,
    attitude: SourceFile | None = None,
    time: str | None = None,
    limits: Limits = LIMITS,
) -> Imported:
    """Make telemetry of files by a profile.

    Parameters
    ----------
    files
        Of one sensor, in the order of time; each is read by itself.
    profile
        Where each quantity stands.
    sensor
        For lengths and coordinates that are counted from the detector's middle.
    orbit
        Two-line elements or an OEM, where the files have no velocity.
    attitude
        An AEM, or a table of quaternions that the profile names, where the files have no attitude.
    time
        ISO 8601: when the files were taken, where they do not say it.
    limits
        How much a file may hold.

    Raises
    ------
    RefusedInputError
        When a file does not fit the profile, with row and column of that file; nothing was written.
    """
    if not 1 <= len(files) <= MOST_FILES:
        raise RefusedInputError(f"{len(files):,} files were given: import 1 to {MOST_FILES:,} at a time.")
    if profile.row is None:
        raise RefusedInputError(
            f"The profile {profile.name} contains no centroids: use it as the attitude file of another import, or choose a "
            "profile with centroids."
        )
    wanted = profile if time is None else replace(profile, time=_constant_time(profile, time))
    added = _Added(
        None if orbit is None else read_orbit(orbit.path, orbit.name),
        None if attitude is None else _read_attitude(attitude, wanted, limits),
        sensor,
    )
    parts: list[_Part] = []
    for number, file in enumerate(files):
        table = read_source(file.path, file.name, wanted.layout, _position_columns(wanted), limits)
        part = _Reading(table, wanted, added, number, limits).part()
        parts.append(_renumbered(parts, part, wanted, file.name))
    return Imported(
        _joined([part.telemetry for part in parts]), profile, tuple(files), parts[0].meanings, parts[0].preview,
        tuple(dict.fromkeys(note for part in parts for note in part.notes)), parts[0].unused, orbit, attitude,
    )  # fmt: skip


def _constant_time(profile: Profile, time: str) -> Any:
    from boresight.telemetry.imports.profile import Time  # noqa: PLC0415 - a name that this module has for something else

    if profile.time is not None and profile.time.column is not None:
        raise RefusedInputError(
            f"The profile {profile.name} takes the time from {profile.time.column}: leave out the time."
        )
    return Time(constant=time)


def _position_columns(profile: Profile) -> tuple[str, ...]:
    axes = [axis.column for axis in (profile.row, profile.col) if axis is not None]
    return () if profile.wide is not None else tuple(axes)


@dataclass(frozen=True)
class _Added:
    """What comes from files and records beside the table."""

    orbit: Orbit | None = None
    attitude: Attitudes | None = None
    sensor: Sensor | None = None


@dataclass(frozen=True)
class _Part:
    """What one file gives."""

    telemetry: Telemetry
    meanings: tuple[Meaning, ...]
    preview: tuple[PreviewRow, ...]
    notes: tuple[str, ...]
    unused: tuple[str, ...]


def _renumbered(before: list[_Part], part: _Part, profile: Profile, name: str) -> _Part:
    """Return a part whose frames come after those of the parts before it."""
    if not before:
        return part
    last, first = int(before[-1].telemetry.frame[-1]), int(part.telemetry.frame[0])
    if profile.frames.by == "column":
        if first <= last:
            raise RefusedInputError(
                f"{name} begins with frame {first}, and the file before it ends with {last}: give the files in order, and numbers "
                "that are not used twice."
            )
        return part
    if profile.frames.by == "file":
        return part
    return replace(part, telemetry=replace(part.telemetry, frame=part.telemetry.frame + last + 1))


def _joined(parts: list[Telemetry]) -> Telemetry:
    """Return several parts as one set: a column that one of them lacks is absent there."""
    if len(parts) == 1:
        return parts[0]
    arrays: dict[str, Any] = {}
    for name in ("frame", "exposure", "row_px", "col_px", "time_utc", "magnitude", "sigma_px", "star_id", "ra_rad", "dec_rad",
                 "quaternion", "velocity_m_s", "temperature_c"):  # fmt: skip
        given = [getattr(part, name) for part in parts]
        example = next((values for values in given if values is not None), None)
        if example is not None:
            arrays[name] = np.concatenate(
                [
                    _absent_like(example, len(part)) if values is None else values
                    for part, values in zip(parts, given, strict=True)
                ]
            )
    names = dict.fromkeys(name for part in parts for name in part.unknown)
    unknown = {name: pa.chunked_array([_write_cells(part, name) for part in parts], pa.string()) for name in names}
    return Telemetry(**arrays, unknown=unknown)


def _write_cells(part: Telemetry, name: str) -> pa.Array:
    if name not in part.unknown:
        return pa.array([""] * len(part), pa.string())
    cells = part.unknown[name].cast(pa.string()).combine_chunks()
    return pa.concat_arrays(cells.chunks) if isinstance(cells, pa.ChunkedArray) else cells


def _absent_like(example: NDArray[Any], rows: int) -> NDArray[Any]:
    value: Any = _NO_TIME if example.dtype.kind == "M" else UNMATCHED if example.dtype.kind == "i" else np.nan
    return np.full((rows, *example.shape[1:]), value, example.dtype)


def _read_attitude(file: SourceFile, profile: Profile, limits: Limits) -> Attitudes:
    """Read the attitudes of a file of its own, ICRS to detector."""
    return read_attitudes(file, profile, limits)[0]


def read_attitudes(
    file: SourceFile, profile: Profile, limits: Limits, beside: Sequence[str] = ()
) -> tuple[Attitudes, dict[str, FloatArray]]:
    """Read the attitudes of a file, and those of the columns `beside` them that it has, (n,) each, NaN where empty."""
    turned = profile.quaternion or Quaternion()
    if is_aem(file.path):
        found = read_aem(file.path, file.name, turned.longest_gap_s)
        return replace(found, quaternion=_mounted(found.quaternion, turned)), {}
    if not turned.columns or profile.time is None or profile.time.column is None:
        raise RefusedInputError(
            f"{file.name} is not an AEM, and the profile {profile.name} names no columns of time and quaternion: name them."
        )
    layout = replace(profile.layout, where={})
    table = read_source(file.path, file.name, layout, (*turned.columns, profile.time.column), limits)
    return attitudes_of_table(table, profile, beside)


def attitudes_of_table(
    table: SourceTable, profile: Profile, beside: Sequence[str] = ()
) -> tuple[Attitudes, dict[str, FloatArray]]:
    """The same of a table whose columns of time and quaternion a profile names."""
    turned = profile.quaternion or Quaternion()
    faults = Faults(table.name, places=lambda entry, column: (int(table.row[entry]), column))

    def read(column: str) -> FloatArray:
        name = table.find(column)
        return np.asarray(floats(pa.chunked_array([table.columns[name]]), name, faults)[0], np.float64)

    values = np.column_stack([read(column) for column in turned.columns])
    further = {column: read(column) for column in beside if table.has(column)}
    moments = _times(table, profile, faults)
    faults.refuse()
    order = _in_order(moments, values)
    found = _packets(table.name, moments, _turn_to_detector(values, turned, faults), turned.longest_gap_s)
    faults.refuse()
    return found, {column: cells[order] for column, cells in further.items()}


def _in_order(moments: TimeArray, quaternion: FloatArray) -> IntArray:
    """Rows that have a time and a quaternion, in order of time, of equal times the first."""
    usable = np.flatnonzero(~np.isnat(moments) & np.all(np.isfinite(quaternion), axis=1))
    return np.asarray(usable[np.unique(moments[usable], return_index=True)[1]])


def _packets(name: str, moments: TimeArray, quaternion: FloatArray, longest_gap_s: float) -> Attitudes:
    """Return attitudes of packets, in order of time, of equal times the first."""
    order = _in_order(moments, quaternion)
    return Attitudes(name, moments[order], quaternion[order], np.zeros(len(order), np.int64), longest_gap_s)


def _turn_to_detector(values: FloatArray, turned: Quaternion, faults: Faults | None = None) -> FloatArray:
    """Return (n, 4) quaternions of a file as Hamilton's, ICRS to detector; those that are no rotation become faults."""
    q = values if turned.order == "xyzw" else values[:, [1, 2, 3, 0]]
    length = np.linalg.norm(q, axis=1)
    if faults is not None:
        faults.add_entries(
            np.abs(length - 1) > 0.01,
            turned.columns[0],
            lambda entry: f"the quaternion's length is {length[entry]:.4g}, not 1: give a unit quaternion",
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        q = q / length[:, None]
    if (turned.sense == "icrs_to_detector") != (turned.convention == "hamilton"):
        q = conjugate(q)
    return _mounted(q, turned)


def _mounted(q: FloatArray, turned: Quaternion) -> FloatArray:
    if turned.mounting is None:
        return q
    mounting = np.array(turned.mounting)
    length = np.linalg.norm(mounting)
    if abs(length - 1) > 0.01:
        raise RefusedInputError(
            f"quaternion.mounting has the length {length:.4g}, not 1: give a unit quaternion x, y, z, w."
        )
    return product(np.broadcast_to(mounting / length, q.shape), q)


def _times(table: SourceTable, profile: Profile, faults: Faults) -> TimeArray:
    """Return (n_rows,) UTC of a table whose profile names a column."""
    time = profile.time
    if time is None or time.column is None:
        return np.full(len(table), _NO_TIME)
    name = table.find(time.column)
    week = None if time.week_column is None else table.columns[table.find(time.week_column)]
    return read_times(table.columns[name], week, replace(time, column=name), faults)


class _Reading:
    """One table on its way to telemetry."""

    def __init__(self, table: SourceTable, profile: Profile, added: _Added, number: int, limits: Limits) -> None:
        self.table, self.profile, self.added, self.number, self.limits = table, profile, added, number, limits
        self.faults = Faults(table.name, places=lambda entry, column: (int(table.row[entry]), column))
        self.meanings: list[Meaning] = []
        self.notes: list[str] = []
        self.sources: dict[str, Callable[[int], str]] = {}  # by column of telemetry, the column that an entry came from
        self.used: dict[str, None] = {}
        self.slots: list[int | None] = [None] if profile.wide is None else list(self.present_slots())
        self.profile = self.without_missing()
        if len(table) * len(self.slots) * 8 > MOST_BYTES:
            raise RefusedInputError(
                f"{table.name} has too many rows for {len(self.slots)} stars each: split it by time."
            )

    def present_slots(self) -> Iterator[int]:
        """Yield the numbers of a wide table's stars, up to the first whose column is missing."""
        wide, row = self.profile.wide, self.profile.row
        if wide is None or row is None:
            return
        yield wide.first
        for slot in range(wide.first + 1, wide.first + wide.count):
            if not self.table.has(row.column.replace("{n}", str(slot))):
                return
            yield slot

    def without_missing(self) -> Profile:
        """Return the profile without the optional quantities that the file does not have."""
        absent: dict[str, Any] = {
            name: None for name in self.profile.optional if not self.has_all(getattr(self.profile, name))
        }
        if absent:
            self.notes.append(f"The file has no {', '.join(name.replace('_', ' ') for name in absent)}.")
        return replace(self.profile, **absent)

    def has_all(self, quantity: Any) -> bool:
        """Say whether the columns of a quantity are there; one that names none is."""
        names = (
            []
            if quantity is None
            else [getattr(quantity, name, None) for name in ("column", "ra", "dec", "week_column")]
        )
        columns = [*(name for name in names if name), *getattr(quantity, "columns", ())]
        return all(self.table.has(column.replace("{n}", str(self.slots[0]))) for column in columns)

    # -- cells of the file

    def find_columns(self, column: str) -> list[str]:
        """Return a column's names in the file, one a star of a wide table."""
        if "{n}" in column and self.profile.wide is not None:
            found = [self.table.find(column.replace("{n}", str(slot))) for slot in self.slots]
        else:
            found = [self.table.find(column)]
        self.used |= dict.fromkeys(found)
        return found

    def numbers(self, column: str) -> FloatArray:
        """Return (n_rows, n_stars) numbers of a column, or (n_rows, 1)."""
        found = [
            floats(pa.chunked_array([self.table.columns[name]]), name, self.faults)[0]
            for name in self.find_columns(column)
        ]
        return np.column_stack(found)

    def taken(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return (n_entries,) of values (n_rows, n_stars) or (n_rows, 1)."""
        return np.asarray(values[self.rows, self.places if values.shape[1] > 1 else 0])

    def tell(self, column: str, source: str, sentence: str) -> None:
        """Note what a column of telemetry is made of."""
        if "{n}" in source and self.profile.wide is not None:
            self.meanings.append(Meaning(column, source, sentence))
            self.sources[column] = lambda entry: self.table.find(
                source.replace("{n}", str(self.slots[self.places[entry]]))
            )
            return
        name = self.table.find(source)
        self.meanings.append(Meaning(column, name, sentence))
        self.sources[column] = lambda _: name

    def note_sources(self, columns: Sequence[str], sources: Sequence[str]) -> None:
        """Note where the further columns of a group come from; its first tells how."""
        for column, source in zip(columns, sources, strict=True):
            name = self.table.find(source)
            self.sources[column] = lambda _, name=name: name  # type: ignore[misc]

    # -- what is made of them

    def part(self) -> _Part:
        """Return the telemetry of the table."""
        row_px, col_px = self.positions()
        moments = self.moments()
        frame, exposure = self.frames(moments)
        optional = {
            "time_utc": moments if moments is not None else None,
            "magnitude": self.magnitudes(),
            "sigma_px": self.sigmas(),
            "star_id": self.stars(),
            "temperature_c": self.temperatures(),
            "quaternion": self.quaternions(moments),
            "velocity_m_s": self.velocities(moments),
        }
        ra_rad, dec_rad, beside = self.directions(moments, optional["velocity_m_s"])
        self.faults.refuse()
        order = np.lexsort((exposure, frame))
        arrays = {
            "frame": frame,
            "exposure": exposure,
            "row_px": row_px,
            "col_px": col_px,
            "ra_rad": ra_rad,
            "dec_rad": dec_rad,
            **optional,
        }
        ordered: dict[str, Any] = {name: None if values is None else values[order] for name, values in arrays.items()}
        unknown = {name: cells.take(pa.array(order)) for name, cells in {**self.take_kept_columns(), **beside}.items()}
        telemetry = Telemetry(**ordered, unknown=unknown)
        self.check(telemetry, order)
        if self.profile.time is not None and moments is not None:
            self.notes += tell_leap_seconds(self.profile.time)
        unused = [name for name in self.table.columns if name not in self.used and name not in unknown]
        return _Part(
            telemetry, tuple(self.meanings), tuple(self.preview(telemetry, order)), tuple(self.notes), tuple(unused)
        )

    def check(self, telemetry: Telemetry, order: IntArray) -> None:
        """Refuse what telemetry may not be, by row and column of the file."""

        def place(entry: int, column: str | None) -> tuple[int, str | None]:
            came = int(order[entry])
            source = self.sources.get(column or "")
            return int(self.table.row[self.rows[came]]), column if source is None else source(came)

        checks = Checks(self.table.name, self.limits.stars, place)
        checks.look_at(telemetry)
        checks.refuse()
        scale_quaternions(telemetry)

    def positions(self) -> tuple[FloatArray, FloatArray]:
        """Return (n_entries,) rows and columns, and find which cells are stars."""
        row, col = self.profile.row, self.profile.col
        if row is None or col is None:
            raise RefusedInputError(f"The profile {self.profile.name} contains no centroids: give it row and col.")
        rows, cols = self.numbers(row.column), self.numbers(col.column)
        if rows.shape != cols.shape:
            raise RefusedInputError("The profile has {n} in one of row and col: write it in both, or in neither.")
        absent = np.isnan(rows) & np.isnan(cols)
        present = ~absent & self.filled(rows, cols)
        if self.faults.count:
            self.faults.refuse()
        for axis, values, other in ((row, rows, cols), (col, cols, rows)):
            for place, name in enumerate(self.find_columns(axis.column)):
                lone = np.isnan(values[:, place]) & ~np.isnan(other[:, place]) & present[:, place]
                self.faults.add_entries(
                    lone, name, lambda _: "the cell is empty, and the other coordinate is not: give both"
                )
        self.faults.refuse()
        self.rows, self.places = np.nonzero(present)
        if not len(self.rows):
            raise RefusedInputError(f"{self.table.name} has no star: give both {row.column} and {col.column} in a row.")
        without = int(np.count_nonzero(~present.any(axis=1)))
        if without:
            self.notes.append(f"{without:,} rows contain no star.")
        return self.pixels(rows, row, "row_px"), self.pixels(cols, col, "col_px")

    def filled(self, rows: FloatArray, cols: FloatArray) -> BoolArray:
        """Return (n_rows, n_stars) whether a place of a wide table is taken."""
        wide = self.profile.wide
        found = np.ones(rows.shape, dtype=np.bool_)
        if wide is None:
            return found
        if wide.absent is not None:
            found &= ~((rows == wide.absent) & (cols == wide.absent))
        if wide.count_column is not None:
            found &= np.arange(rows.shape[1]) < np.nan_to_num(self.numbers(wide.count_column))
        return found

    def pixels(self, values: FloatArray, axis: Axis, column: str) -> FloatArray:
        """Return (n_entries,) pixels of one axis."""
        size = self.size(column)
        pitch = 1.0 if axis.unit == "px" else self.pitch() / _METRES[axis.unit]
        found = self.taken(values)
        sign = -1.0 if axis.reversed else 1.0
        if axis.origin == "centre":
            if size is None:
                raise RefusedInputError(
                    f"{axis.column} counts from the detector's middle, of unknown size: give the sensor, or detector.rows and "
                    "detector.columns in the profile."
                )
            pixels = sign * found / pitch + (size - 1) / 2
            told = f"counted from the middle of {size} pixels"
        else:
            pixels = sign * (found - axis.origin) / pitch
            told = f"minus {axis.origin:g}, the number of the first pixel's centre" if axis.origin else "unchanged"
            told = f"{axis.origin:g} minus it, because it grows the other way" if axis.reversed else told
        if axis.unit != "px":
            told += f", in pixels of {pitch:g} {axis.unit}"
        self.tell(column, axis.column, told)
        return np.asarray(pixels)

    def size(self, column: str) -> int | None:
        """Return how many rows or columns the detector has, where that is known."""
        sensor, said = self.added.sensor, self.profile.detector
        if column == "row_px":
            return said.rows if sensor is None else sensor.rows
        return said.columns if sensor is None else sensor.columns

    def pitch(self) -> float:
        """Return the length of a pixel in metres."""
        sensor = self.added.sensor
        found = self.profile.detector.pixel_pitch_m if sensor is None else sensor.pixel_pitch_m
        if found is None or not found > 0:
            raise RefusedInputError(
                "Lengths must be converted to pixels, but the pixel pitch is not known: give the sensor, or detector.pixel_pitch_m."
            )
        return found

    def moments(self) -> TimeArray | None:
        """Return (n_entries,) UTC, or None."""
        time = self.profile.time
        if time is None:
            return None
        if time.column is not None:
            self.row_times = _times(self.table, self.profile, self.faults)
            self.used |= dict.fromkeys(
                self.table.find(name) for name in (time.column, time.week_column) if name is not None
            )
            offset = f", plus {time.offset_s:g} s" if time.offset_s else ""
            self.tell("time_utc", time.column, f"{time.system.replace('_', '-').upper()} ({time.form}) as UTC{offset}")
            return np.asarray(self.row_times[self.rows])
        text = time.constant
        if time.keyword is not None:
            text = self.table.keywords.get(time.keyword)
            if not text:
                self.notes.append(
                    f"The header has no {time.keyword}, so no time is known: give the time, otherwise aberration is not included."
                )
                return None
        moment = read_constant(str(text), time, self.table.name)
        self.meanings.append(Meaning("time_utc", time.keyword or "", f"{moment}Z, of the whole file"))
        return np.full(len(self.rows), moment)

    def frames(self, moments: TimeArray | None) -> tuple[IntArray, IntArray]:
        """Return (n_entries,) numbers of frames and exposures."""
        frames = self.profile.frames
        match frames.by:
            case "column":
                frame = self.wholes(frames.column or "", "frame")
            case "name":
                frame = self.by_name(frames.column or "")
            case "record":
                frame = self.table.record[self.rows]
                self.meanings.append(Meaning("frame", "", "a number for each record of the file, from 0"))
            case "file":
                frame = np.full(len(self.rows), self.number)
                self.meanings.append(Meaning("frame", "", "the whole file is one"))
            case _:
                frame = self.by_time(moments)
        if frames.exposure is not None:
            return frame, self.wholes(frames.exposure, "exposure")
        self.meanings.append(Meaning("exposure", "", "0: one exposure per frame"))
        return frame, np.zeros(len(self.rows), np.int64)

    def by_time(self, moments: TimeArray | None) -> IntArray:
        time = self.profile.time
        if moments is None or time is None:
            raise RefusedInputError(
                f"{self.table.name} has no times to number frames by: name another way in frames.by."
            )
        unknown = np.zeros(len(self.table), dtype=np.bool_)
        unknown[self.rows] = np.isnat(moments)
        self.faults.add_entries(
            unknown, time.column, lambda _: "the cell is empty, and frames are numbered by time: give it"
        )
        self.meanings.append(Meaning("frame", time.column or "", "a number for each time, from 0"))
        return np.unique(moments, return_inverse=True)[1].astype(np.int64)

    def by_name(self, column: str) -> IntArray:
        """Return (n_entries,) numbers of the names in a column, in the order in which they come."""
        found = self.find_columns(column)[0]
        cells = texts(pa.chunked_array([self.table.columns[found]])).combine_chunks()
        cells = pa.concat_arrays(cells.chunks) if isinstance(cells, pa.ChunkedArray) else cells
        coded = cells.take(pa.array(self.rows)).dictionary_encode()
        nameless = {number for number, text in enumerate(coded.dictionary.to_pylist()) if not (text or "").strip()}
        missing = np.zeros(len(self.table), dtype=np.bool_)
        missing[self.rows] = [number is None or number in nameless for number in coded.indices.to_pylist()]
        self.faults.add_entries(missing, found, lambda _: "the cell is empty: give every star the name of its frame")
        self.tell("frame", column, "a number for each name, from 0")
        return np.asarray(coded.indices.fill_null(0), np.int64)

    def wholes(self, column: str, name: str) -> IntArray:
        """Return (n_entries,) whole numbers, none of them absent."""
        found = self.find_columns(column)[0]
        values, absent = integers(pa.chunked_array([self.table.columns[found]]), found, self.faults)
        missing = np.zeros(len(self.table), dtype=np.bool_)
        missing[self.rows] = absent[self.rows]
        self.faults.add_entries(missing, found, lambda _: "the cell is empty: give every star a number here")
        self.tell(name, column, "unchanged")
        return np.asarray(values[self.rows])

    def magnitudes(self) -> FloatArray | None:
        """Return (n_entries,) magnitudes, NaN of a flux that is not positive."""
        magnitude = self.profile.magnitude
        if magnitude is None:
            return None
        values = self.taken(self.numbers(magnitude.column))
        if magnitude.kind == "magnitude":
            self.tell("magnitude", magnitude.column, "unchanged")
            return np.asarray(values)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.where(values > 0, -2.5 * np.log10(values) + magnitude.zero_point, np.nan)
        self.tell("magnitude", magnitude.column, f"-2.5 log10 of the flux, plus {magnitude.zero_point:g}")
        if dim := int(np.count_nonzero(values <= 0)):
            self.notes.append(f"{dim:,} fluxes are not positive; those stars have no magnitude.")
        return np.asarray(found)

    def sigmas(self) -> FloatArray | None:
        """Return (n_entries,) standard deviations of a coordinate, pixels."""
        sigma = self.profile.sigma
        if sigma is None:
            return None
        values = np.stack([self.taken(self.numbers(column)) for column in sigma.columns])
        variance = values if sigma.kind == "variance" else np.where(values < 0, np.nan, values**2)
        with np.errstate(invalid="ignore"):
            found = np.sqrt(np.mean(variance, axis=0))
        if sigma.unit != "px":
            found = found * _METRES[sigma.unit] / self.pitch()
        both = "root of the mean square of both axes" if len(values) > 1 else "unchanged"
        self.tell("sigma_px", sigma.columns[0], f"{both}{', of variances' if sigma.kind == 'variance' else ''}")
        none = ~(found > 0)
        if np.any(none):
            self.notes.append(
                f"{int(np.count_nonzero(none)):,} noise values are not positive; the sensor's value is used for those stars."
            )
        return np.asarray(np.where(none, np.nan, found))

    def stars(self) -> IntArray | None:
        """Return (n_entries,) Hipparcos numbers, 0 where none."""
        star = self.profile.star_id
        if star is None:
            return None
        columns, others = [], 0
        for name in self.find_columns(star.column):
            coded = texts(pa.chunked_array([self.table.columns[name]])).combine_chunks()
            coded = (
                pa.concat_arrays(coded.chunks) if isinstance(coded, pa.ChunkedArray) else coded
            ).dictionary_encode()
            numbers = np.array(
                [_star_number(text, star.unmatched) for text in coded.dictionary.to_pylist()] or [0], np.int64
            )
            found = numbers[coded.indices.to_numpy()]
            columns.append(found)
        values = self.taken(np.column_stack(columns))
        others = int(np.count_nonzero(values < 0))
        if others:
            self.notes.append(f"{others:,} stars have a name that is not a Hipparcos number; they are unmatched.")
        self.tell("star_id", star.column, "Hipparcos numbers, unchanged")
        return np.where(values > 0, values, UNMATCHED)

    def temperatures(self) -> FloatArray | None:
        """Return (n_entries,) degrees Celsius."""
        temperature = self.profile.temperature
        if temperature is None:
            return None
        values = self.taken(self.numbers(temperature.column))
        self.tell("temperature_c", temperature.column, "minus 273.15" if temperature.unit == "K" else "unchanged")
        return np.asarray(values - 273.15 if temperature.unit == "K" else values)

    def quaternions(self, moments: TimeArray | None) -> FloatArray | None:
        """Return (n_entries, 4) attitudes, from the table, its packets or a file of their own."""
        turned, attitude = self.profile.quaternion, self.added.attitude
        found = None
        if turned is not None and turned.columns and attitude is None:
            values = np.column_stack([self.numbers(column)[:, 0] for column in turned.columns])
            absent = np.asarray(np.isnan(values).any(axis=1) & ~np.isnan(values).all(axis=1))
            self.faults.add_entries(
                absent,
                self.find_columns(turned.columns[0])[0],
                lambda _: "a quaternion is given in part: give all four",
            )
            every = _turn_to_detector(
                values,
                replace(turned, columns=(self.find_columns(turned.columns[0])[0], *turned.columns[1:])),
                self.faults,
            )
            found = every[self.rows]
            self.tell("q_x", turned.columns[0], _told_quaternion(turned))
            self.note_sources(("q_y", "q_z", "q_w"), turned.columns[1:])
            packets = np.setdiff1d(np.flatnonzero(np.isfinite(every[:, 0])), self.rows)
            if (
                len(packets)
                and moments is not None
                and self.profile.time is not None
                and self.profile.time.column is not None
            ):
                attitude = _packets(self.table.name, self.row_times[packets], every[packets], turned.longest_gap_s)
        if attitude is None:
            return found
        if moments is None:
            raise RefusedInputError(
                f"{self.table.name} has no times, which are needed to look up attitudes: define them in the profile."
            )
        between = attitude.at(moments)
        found = between if found is None else np.where(np.isnan(found), between, found)
        if attitude is self.added.attitude:
            self.meanings.append(Meaning("q_x", attitude.name, "interpolated to the time of each star"))
        without = int(np.count_nonzero(np.isnan(found[:, 0])))
        if without == len(found):
            raise RefusedInputError(
                f"{attitude.name} covers none of the times of {self.table.name}: give those of the same hours.",
                code="times-do-not-overlap",
            )
        if without:
            self.notes.append(f"{without:,} of {len(found):,} stars have no attitude at their time.")
        return found

    def velocities(self, moments: TimeArray | None) -> FloatArray | None:
        """Return (n_entries, 3) metres a second, from the table or an orbit."""
        velocity, orbit = self.profile.velocity, self.added.orbit
        found = None
        if velocity is not None and orbit is None:
            values = np.column_stack([self.numbers(column)[:, 0] for column in velocity.columns])
            found = values[self.rows] * (1e3 if velocity.unit == "km/s" else 1.0)
            self.tell("vx_km_s", velocity.columns[0], f"velocity in {velocity.unit}, GCRS")
            self.note_sources(("vy_km_s", "vz_km_s"), velocity.columns[1:])
        if orbit is None:
            return found
        if moments is None:
            raise RefusedInputError(
                f"{self.table.name} has no times, which are needed to look up velocities: define them in the profile."
            )
        from_orbit, covered = orbit.velocity(moments)
        beyond = np.zeros(len(self.table), dtype=np.bool_)
        beyond[self.rows] = ~covered | np.isnan(from_orbit[:, 0])
        first, last = (str(moment)[:19] for moment in orbit.covers)
        self.faults.add_entries(
            beyond, None if self.profile.time is None else self.profile.time.column,
            lambda _: f"is outside {orbit.name}, which covers {first}Z to {last}Z: give an orbit of these hours",
        )  # fmt: skip
        self.meanings.append(Meaning("vx_km_s", orbit.name, "velocity at the time of each star, GCRS"))
        self.notes += orbit.notes
        return from_orbit

    def directions(
        self, moments: TimeArray | None, velocity_m_s: Any
    ) -> tuple[FloatArray | None, FloatArray | None, dict[str, pa.Array]]:
        """Return (n_entries,) right ascensions and declinations, radians, and columns that are kept beside."""
        directions = self.profile.directions
        if directions is None:
            return None, None, {}
        ra = self.taken(self.numbers(directions.ra)) * _RADIANS[directions.ra_unit]
        dec = self.taken(self.numbers(directions.dec)) * _RADIANS[directions.dec_unit]
        if directions.kind == "apparent":
            self.tell("ra_deg", directions.ra, "apparent direction")
            self.tell("dec_deg", directions.dec, "apparent direction")
            return np.asarray(ra), np.asarray(dec), {}
        if moments is None or np.any(np.isnat(moments)):
            self.notes.append(
                "The directions are catalogue positions and cannot be converted to apparent directions without a time. They are "
                "stored as catalogue_ra_deg and catalogue_dec_deg, and the stars must be matched again."
            )
            beside = {"catalogue_ra_deg": np.degrees(ra), "catalogue_dec_deg": np.degrees(dec)}
            return (
                None,
                None,
                {name: pa.array([f"{value:.10g}" for value in values]) for name, values in beside.items()},
            )
        for column, source in (("ra_deg", directions.ra), ("dec_deg", directions.dec)):
            self.tell(column, source, "place of a catalogue, turned by aberration")
        return *_apparent(np.asarray(ra), np.asarray(dec), moments, velocity_m_s), {}

    def take_kept_columns(self) -> dict[str, pa.Array]:
        """Return (n_entries,) texts of the columns that go along."""
        keep = self.profile.keep
        names = (
            [name for name in self.table.columns if name not in self.used]
            if keep == "all"
            else [self.table.find(name) for name in keep]
        )
        found = {}
        for name in names:
            cells = texts(pa.chunked_array([self.table.columns[name]])).cast(pa.string()).combine_chunks()
            cells = pa.concat_arrays(cells.chunks) if isinstance(cells, pa.ChunkedArray) else cells
            is_taken = name in REQUIRED_COLUMNS or name in OPTIONAL_COLUMNS
            found[f"source_{name}" if is_taken else name] = cells.take(pa.array(self.rows))
            self.used[name] = None
        return found

    def preview(self, telemetry: Telemetry, order: IntArray) -> Iterator[PreviewRow]:
        """Yield the first rows with the cells that they were made of."""
        shown = min(PREVIEW_ROWS, len(telemetry))
        table = contract_table(_first(telemetry, shown))
        for number, cells in enumerate(table.to_pylist()):
            entry = int(order[number])
            row = int(self.rows[entry])
            names = dict.fromkeys(source(entry) for source in self.sources.values())
            source = {
                name: "" if (cell := self.table.columns[name][row].as_py()) is None else str(cell) for name in names
            }
            yield PreviewRow(
                int(self.table.row[row]), source, {name: _format_cell(cell) for name, cell in cells.items()}
            )


def _first(telemetry: Telemetry, rows: int) -> Telemetry:
    from boresight.telemetry.schema import select_rows  # noqa: PLC0415 - only here

    return select_rows(telemetry, slice(0, rows))


def _format_cell(cell: Any) -> Any:
    return cell.isoformat().replace("+00:00", "Z") if hasattr(cell, "isoformat") else cell


def _told_quaternion(turned: Quaternion) -> str:
    """Return how a quaternion is read."""
    mounted = ", then turned by the mounting" if turned.mounting is not None else ""
    return f"{turned.order}, {turned.sense.replace('_', ' ')}, {turned.convention}{mounted}"


def _star_number(text: str, unmatched: tuple[str, ...]) -> int:
    """Return a Hipparcos number, 0 for no star, -1 for a name of another catalogue."""
    if not text.strip() or text.strip() in unmatched:
        return UNMATCHED
    found = _HIP.match(text)
    return int(found.group(1)) if found else -1


def _apparent(
    ra: FloatArray, dec: FloatArray, moments: TimeArray, velocity_m_s: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Turn places of a catalogue towards the velocity of the Earth and, where known, the satellite."""
    from boresight.sky.apparent import aberrated, days_since_j2000, earth_state  # noqa: PLC0415 - erfa's tables, only for these
    from boresight.sky.catalogue import unit_vectors  # noqa: PLC0415 - as these

    velocity = earth_state(days_since_j2000(moments))[1] * _AU_A_DAY_IN_C
    if velocity_m_s is not None:
        velocity = velocity + np.nan_to_num(velocity_m_s) / _LIGHT_M_S
    seen = aberrated(unit_vectors(ra, dec), velocity)
    return np.arctan2(seen[:, 1], seen[:, 0]) % (2 * np.pi), np.arcsin(np.clip(seen[:, 2], -1, 1))


def import_by_likeliest(
    file: SourceFile,
    profiles: Sequence[Profile],
    *,
    sensor: Sensor | None = None,
    orbit: SourceFile | None = None,
    time: str | None = None,
    limits: Limits = LIMITS,
) -> Imported:
    """Import a file by the likeliest profile that reads it, as `Recognised.rank` orders them; then by a draft, and by any other.

    Raises
    ------
    RefusedInputError
        When no profile reads it, or it is too large to be tried by each.
    """
    with expanded(file.path, file.name, limits) as place:
        size = place.stat().st_size
    if size > MOST_BYTES_RECOGNISED:
        raise RefusedInputError(
            f"{file.name} has more than {MOST_BYTES_RECOGNISED / 1e6:.0f} MB, too large to try every mapping profile: choose "
            "its profile yourself."
        )
    found = recognise_table(file.path, file.name)
    likely = [] if found is None else found.rank(profiles)
    drafts: list[Draft] = []
    if found is not None and not likely:
        with suppress(RefusedInputError):
            drafts.append(draft_profile(found))
    drafted = [draft.profile for draft in drafts]
    for profile in [*likely, *drafted, *(one for one in profiles if one not in likely)]:
        with suppress(RefusedInputError):
            made = import_files([file], profile, sensor=sensor, orbit=orbit, time=time, limits=limits)
            return replace(made, draft=drafts[0]) if profile in drafted else made
    raise RefusedInputError(
        f"No mapping profile reads {file.name}: save one that names its columns, or upload it without a preview if it has "
        "Boresight's own columns or is an image."
    )
