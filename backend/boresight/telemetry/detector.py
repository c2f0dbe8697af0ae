"""Telemetry on the detector it is said to come from: rows off it, and how well the rest covers it.

The detector's edge lies half a pixel beyond the centres of its outermost pixels. A matched star beyond it, by more than the
pixel or two that the centroid of a cut star may run past it, cannot have been measured there: rows and columns are
exchanged, the pixel origin is another, or the sensor is. Such a set is refused before use (`check_against_sensor`). An
unmatched detection beyond it is only junk: it is reported.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.telemetry.refusals import Faults
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

#: How far past the edge the centroid of a star cut by it may be fitted, pixels; such a row is left out, not refused.
_CUT_STAR_PX = 2.0
_GRID_ROWS = 8
_RADIAL_BINS = 20


def matched_rows(telemetry: Telemetry) -> BoolArray:
    """Return (n_rows,) whether the file says which star a row is, by its number or, without numbers, its direction."""
    if telemetry.star_id is not None:
        return telemetry.star_id > 0
    if telemetry.ra_rad is not None:
        return np.isfinite(telemetry.ra_rad)
    return np.zeros(len(telemetry), dtype=np.bool_)


def on_detector(telemetry: Telemetry, sensor: Sensor) -> BoolArray:
    """Return (n_rows,) whether the centroid lies on the detector."""
    row_px, col_px = telemetry.row_px, telemetry.col_px
    on_rows = (row_px >= -0.5) & (row_px <= sensor.rows - 0.5)
    return on_rows & (col_px >= -0.5) & (col_px <= sensor.columns - 0.5)


def check_against_sensor(telemetry: Telemetry, sensor: Sensor) -> None:
    """Refuse telemetry whose matched stars lie off the sensor's detector.

    Raises
    ------
    RefusedInputError
        Names the first twenty rows.
    """
    faults = detector_faults()
    find_off_detector(telemetry, sensor, faults)
    faults.refuse()


def detector_faults() -> Faults:
    """Return an empty collection of what `check_against_sensor` refuses, for a set that comes in parts."""
    return Faults("The telemetry does not fit the sensor")


def find_off_detector(telemetry: Telemetry, sensor: Sensor, faults: Faults) -> None:
    """Collect what `check_against_sensor` refuses, of a set or of its parts one after the other."""
    faults.first_row = telemetry.first_row
    _check_axis("row_px", telemetry.row_px, sensor.rows, telemetry, faults)
    _check_axis("col_px", telemetry.col_px, sensor.columns, telemetry, faults)


def _check_axis(column: str, values: FloatArray, size: int, telemetry: Telemetry, faults: Faults) -> None:
    """Find matched stars beyond the edges of one axis of `size` pixels."""
    off = matched_rows(telemetry) & ((values < -0.5 - _CUT_STAR_PX) | (values > size - 0.5 + _CUT_STAR_PX))
    faults.add_entries(
        off,
        column,
        lambda entry: (
            f"{values[entry]:g} is off the detector (-0.5 to {size - 0.5:g}): choose the right sensor, exchange rows and "
            "columns, or delete the row"
        ),
    )


def detector_coverage(telemetry: Telemetry, sensor: Sensor, rows: BoolArray) -> dict[str, Any]:
    """Count stars in cells of the detector.

    Parameters
    ----------
    telemetry, sensor
        The set and the detector it lies on.
    rows
        (n_rows,) which rows count.

    Returns
    -------
    `row_edges_px` (n + 1), `col_edges_px` (m + 1) and `counts` (n, m), as lists; cells are about square.
    """
    columns = max(1, round(_GRID_ROWS * sensor.columns / sensor.rows))
    row_edges = np.linspace(-0.5, sensor.rows - 0.5, _GRID_ROWS + 1)
    col_edges = np.linspace(-0.5, sensor.columns - 0.5, min(columns, 64) + 1)
    counts, _, _ = np.histogram2d(telemetry.row_px[rows], telemetry.col_px[rows], bins=(row_edges, col_edges))
    return {
        "row_edges_px": row_edges.tolist(),
        "col_edges_px": col_edges.tolist(),
        "counts": counts.astype(np.int64).tolist(),
    }


def radial_coverage(telemetry: Telemetry, sensor: Sensor, rows: BoolArray) -> dict[str, Any]:
    """Count stars by their distance from the detector's centre.

    Returns
    -------
    `edges_px` (n + 1) up to the corner, `counts` (n), `largest_radius_px` (None without stars), `corner_radius_px`.
    """
    centre_row, centre_col = (sensor.rows - 1) / 2.0, (sensor.columns - 1) / 2.0
    radius = np.hypot(telemetry.row_px[rows] - centre_row, telemetry.col_px[rows] - centre_col)
    corner = float(np.hypot(sensor.rows, sensor.columns)) / 2.0
    counts, edges = np.histogram(radius, bins=_RADIAL_BINS, range=(0.0, corner))
    return {
        "edges_px": edges.tolist(),
        "counts": counts.tolist(),
        "largest_radius_px": float(radius.max()) if len(radius) else None,
        "corner_radius_px": corner,
    }
