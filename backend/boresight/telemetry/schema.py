"""The telemetry table: one entry a detected star, as a structure of arrays in file order.

The contract's columns and their meaning::

    frame       integer, ascending          exposure    integer within the frame
    row_px      centroid, (0, 0) = centre of the top-left pixel          col_px
    time_utc    ISO 8601                    magnitude   sigma_px
    star_id     HIP; empty, 0 or -1 = unmatched
    ra_deg dec_deg            apparent direction, replaces the catalogue's
    q_x q_y q_z q_w           ICRS to detector, scalar last
    vx_km_s vy_km_s vz_km_s   satellite velocity, GCRS
    temperature_c
    psf_sigma_px              width of a star's image, one sigma

Absent columns are None; an absent cell in a present float column is NaN, in `star_id` it is 0 and in `time_utc` NaT.

Which rows belong to which exposure: runs of rows that share frame and exposure number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.site import Site

REQUIRED_COLUMNS = ("frame", "exposure", "row_px", "col_px")
OPTIONAL_COLUMNS = (
    "time_utc",
    "magnitude",
    "sigma_px",
    "star_id",
    "ra_deg",
    "dec_deg",
    "q_x",
    "q_y",
    "q_z",
    "q_w",
    "vx_km_s",
    "vy_km_s",
    "vz_km_s",
    "temperature_c",
    "psf_sigma_px",
)
#: What is kept of each star of an image beside them.
IMAGE_COLUMNS = (
    "image", "image_sha256", "flux_dn", "flux_sigma_dn", "peak_dn", "background_dn", "background_sigma_dn", "saturated",
    "variance_row_px2", "variance_col_px2", "covariance_px2",
)  # fmt: skip

INTEGER_COLUMNS = ("frame", "exposure", "star_id")
FLOAT_COLUMNS = tuple(
    column for column in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS) if column not in {*INTEGER_COLUMNS, "time_utc"}
)
#: Columns that only make sense together, in a file and in a row.
COLUMN_GROUPS = (("ra_deg", "dec_deg"), ("q_x", "q_y", "q_z", "q_w"), ("vx_km_s", "vy_km_s", "vz_km_s"))

UNMATCHED = 0
#: Between which numbers a magnitude, or a temperature in degrees Celsius, is one: 99 or -999 often stands for no measurement.
MAGNITUDES, TEMPERATURES_C = (-2.0, 20.0), (-273.15, 400.0)


@dataclass(frozen=True)
class Telemetry:
    """A telemetry set in memory; every array has the leading dimension n_rows.

    Parameters
    ----------
    frame, exposure
        (n_rows,) integers; rows of one exposure are contiguous and frames ascend.
    row_px, col_px
        (n_rows,) centroid in pixels.
    time_utc
        (n_rows,) datetime64[us], or None.
    magnitude, sigma_px, temperature_c, psf_sigma_px
        (n_rows,) or None.
    star_id
        (n_rows,) HIP number, 0 = unmatched, or None when the file names no stars.
    ra_rad, dec_rad
        (n_rows,) apparent direction in ICRS axes, or None.
    quaternion
        (n_rows, 4) x, y, z, w, ICRS to detector, or None.
    velocity_m_s
        (n_rows, 3) satellite velocity, GCRS, or None.
    unknown
        Columns the contract does not name, kept as texts, empty where absent; of repeated texts each once.
    first_row
        Row of the first entry in its file, counted as an editor does: 2 after a header line, 1 in JSON Lines.
    site
        Where on the ground it was taken, where directions from the catalogue are to be refracted; None in space.
    """

    frame: IntArray
    exposure: IntArray
    row_px: FloatArray
    col_px: FloatArray
    time_utc: NDArray[np.datetime64] | None = None
    magnitude: FloatArray | None = None
    sigma_px: FloatArray | None = None
    star_id: IntArray | None = None
    ra_rad: FloatArray | None = None
    dec_rad: FloatArray | None = None
    quaternion: FloatArray | None = None
    velocity_m_s: FloatArray | None = None
    temperature_c: FloatArray | None = None
    psf_sigma_px: FloatArray | None = None
    unknown: dict[str, pa.ChunkedArray] = field(default_factory=dict)
    first_row: int = 2
    site: Site | None = None

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.frame)


def select_rows(telemetry: Telemetry, rows: slice) -> Telemetry:
    """Return consecutive rows of a set as a set of their own."""
    if rows == slice(0, len(telemetry)):
        return telemetry
    unknown = {name: cells.slice(rows.start, rows.stop - rows.start) for name, cells in telemetry.unknown.items()}
    return replace(
        telemetry, **_arrays_at(telemetry, rows), unknown=unknown, first_row=telemetry.first_row + rows.start
    )


def take_rows(telemetry: Telemetry, rows: IntArray) -> Telemetry:
    """Return some rows (n,) of a set as a set of their own, without its further columns; their numbers in the file are lost."""
    return replace(telemetry, **_arrays_at(telemetry, rows), unknown={})


def _arrays_at(telemetry: Telemetry, rows: slice | IntArray) -> dict[str, Any]:
    """Some rows of every array of a set, by its name."""
    arrays = {item.name: getattr(telemetry, item.name) for item in fields(telemetry)}
    return {name: value[rows] for name, value in arrays.items() if isinstance(value, np.ndarray)}


def joined(parts: Sequence[Telemetry]) -> Telemetry:
    """Return consecutive parts of a set, which have the same columns, as one set."""
    if len(parts) == 1:
        return parts[0]
    names = [item.name for item in fields(Telemetry) if isinstance(getattr(parts[0], item.name), np.ndarray)]
    arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    unknown = {
        name: pa.chunked_array([chunk for part in parts for chunk in part.unknown[name].chunks], cells.type)
        for name, cells in parts[0].unknown.items()
    }
    return replace(parts[0], **arrays, unknown=unknown)


def count_bytes(telemetry: Telemetry) -> int:
    """How many bytes a set takes in memory."""
    arrays = sum(value.nbytes for value in vars(telemetry).values() if isinstance(value, np.ndarray))
    return arrays + sum(int(cells.nbytes) for cells in telemetry.unknown.values())


@dataclass(frozen=True)
class Exposures:
    """The exposures of a set in file order.

    `start`: (n_exposures,) first entry of each. `count`: (n_exposures,) entries of each. `frame`, `exposure`:
    (n_exposures,) their numbers. `of_entry`: (n_rows,) position in these arrays, for every entry of the telemetry.
    """

    start: IntArray
    count: IntArray
    frame: IntArray
    exposure: IntArray
    of_entry: IntArray

    def __len__(self) -> int:
        """Count the exposures."""
        return len(self.start)


def find_exposures(telemetry: Telemetry) -> Exposures:
    """Return the runs of rows with the same frame and exposure number."""
    rows = len(telemetry)
    first = np.ones(rows, dtype=np.bool_)
    first[1:] = (np.diff(telemetry.frame) != 0) | (np.diff(telemetry.exposure) != 0)
    start = np.flatnonzero(first)
    return Exposures(
        start=start,
        count=np.diff(start, append=rows),
        frame=telemetry.frame[start],
        exposure=telemetry.exposure[start],
        of_entry=np.cumsum(first) - 1,
    )


def within(values: FloatArray, ends: tuple[float, float]) -> FloatArray:
    """Return values (n,) that are measurements, NaN for others: one absurd number would drown what depends on the rest."""
    return np.where((values >= ends[0]) & (values <= ends[1]), values, np.nan)


def time_text(telemetry: Telemetry, row: int) -> str | None:
    """When a row was taken, ISO 8601; None where that is not known."""
    return time_texts(telemetry, np.array([row]))[0]


def time_texts(telemetry: Telemetry, rows: IntArray) -> list[str | None]:
    """The same of rows (n,)."""
    if telemetry.time_utc is None:
        return [None] * len(rows)
    texts = np.datetime_as_string(telemetry.time_utc[rows]).tolist()
    return [None if text == "NaT" else f"{text}Z" for text in texts]
