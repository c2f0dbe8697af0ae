"""The correction table: what the camera model leaves of the lens, as a grid of displacements with their sigmas.

It stands in a package beside the parameters it belongs to, where their calibration found a displacement that its camera model does
not have; no flight software need read it. `correction_table.json` says what it is and carries the spline itself besides the grid,
`correction_table.csv` has a place a row.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from boresight.calibration.calibration import to_plain
from boresight.calibration.residual_spline import ResidualSplineFit, read_residual_spline
from boresight.uplink.archive import csv_bytes, json_bytes
from boresight.uplink.parameter_files import read_document

SCHEMA = "boresight.correction-table/1"
NAMES = ("correction_table.json", "correction_table.csv")
COLUMNS = ("row_px", "col_px", "d_row_px", "sigma_row_px", "d_col_px", "sigma_col_px")
USE = (
    "A star is measured at the place that the camera model gives with these parameters, plus the displacement there. Before "
    "a centroid (row_px, col_px) is used in the camera's equations, subtract d_row_px and d_col_px. A rotation of all directions "
    "belongs to C_SD and is not included. The table is valid only with these parameters."
)
INTERPOLATION = (
    "Between grid points, interpolate bilinearly, or evaluate the spline exactly: d = sum over i, j of c_ij B_i(row) B_j(col), "
    "with B the cubic B-splines on the knots."
)


def correction_files(subject: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the files of a set's correction table by name; none where its calibration found nothing left over."""
    found = read_document(subject).residual_spline
    if found is None:
        return {}
    spline = read_residual_spline(found)
    table = {
        "schema": SCHEMA,
        "what": "displacement left by the calibrated camera model, estimated from the same stars",
        "use": USE,
        "parameter_set": {"name": subject["name"], "sha256": subject["sha256"]},
        "camera_model": spline.camera_model,
        "units": {"places": "px", "displacements": "px", "sigma": "px, one standard deviation"},
        "pixel_origin": "the centre of the top-left pixel is row 0, column 0; rows count down, columns to the right",
        "interpolation": INTERPOLATION,
        **{
            name: getattr(found, name)
            for name in ("row_px", "col_px", "d_row_px", "d_col_px", "sigma_row_px", "sigma_col_px")
        },
        "spline": {
            name: to_plain(getattr(found, name)) for name in ("degree", "row_knots_px", "col_knots_px", "coefficients")
        },
        "test": to_plain(found.test),
        "noise": found.noise,
        "stars": spline.stars,
        "sentence": spline.sentence,
    }
    return dict(zip(NAMES, (json_bytes(table), csv_bytes(COLUMNS, _rows(spline))), strict=True))


def _rows(spline: ResidualSplineFit) -> Iterator[list[float]]:
    """One place a row."""
    (d_row, d_col), (s_row, s_col) = spline.displacement_px.tolist(), spline.sigma_px.tolist()
    for i, row in enumerate(spline.row_px.tolist()):
        for j, col in enumerate(spline.col_px.tolist()):
            yield [row, col, d_row[i][j], s_row[i][j], d_col[i][j], s_col[i][j]]


def describe_correction(subject: Mapping[str, Any]) -> dict[str, Any]:
    """Say in the manifest that a table is there, and what it is; nothing for a set without one."""
    found = read_document(subject).residual_spline
    return {} if found is None else {"correction_table": {"files": list(NAMES), "sentence": found.sentence}}
