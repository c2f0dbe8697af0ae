"""tetra3rs: each view solved from nothing but its centroids and brightness, then `calibrate_camera` over all the solutions.

Rows and columns stand for its x and y, from the middle of the detector, which makes its axes the detector's. Its catalogue is
Gaia's with Hipparcos for the brightest; aberration is corrected by its own velocity of the Earth.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.measurements.peers import Answer
from boresight.measurements.views import Views
from boresight.studies.star_frames import TIME

FIELD_DEG = 21.0
TIMEOUT_MS = 1000


def radial(views: Views) -> Answer:
    """Calibrate with the radial model."""
    return _calibrated(views, "radial")


def polynomial(views: Views) -> Answer:
    """Calibrate with the polynomial model."""
    return _calibrated(views, "polynomial")


def prepare() -> Any:
    """Make the table of patterns: no part of a calibration."""
    import tetra3rs  # noqa: PLC0415 - an optional peer

    if not _TABLE:
        _TABLE.append(tetra3rs.SolverDatabase.generate_from_gaia(max_fov_deg=FIELD_DEG))
    return _TABLE[0]


_TABLE = list[Any]()


def _calibrated(views: Views, model: str) -> Answer:
    """Solve every view and calibrate."""
    import tetra3rs  # noqa: PLC0415 - an optional peer

    table, sensor = prepare(), views.sensor
    middle = np.array([(sensor.rows - 1) / 2, (sensor.columns - 1) / 2])
    velocity = tetra3rs.earth_barycentric_velocity(TIME.astype("datetime64[s]").astype(datetime).replace(tzinfo=UTC))
    ground = tetra3rs.CameraModel(sensor.initial[0] / sensor.pixel_pitch_m, sensor.rows, sensor.columns)
    centroids = [
        [
            tetra3rs.Centroid(place[0], place[1], 10 ** (-0.4 * faint))
            for place, faint in zip(view - middle, magnitude, strict=True)
        ]
        for view, magnitude in zip(views.pixels, views.magnitude, strict=True)
    ]
    solved = [
        table.solve_from_centroids(
            view, camera_model=ground, observer_velocity_km_s=velocity, solve_timeout_ms=TIMEOUT_MS
        )
        for view in centroids
    ]
    found = table.calibrate_camera(
        solved, centroids, image_width=sensor.rows, image_height=sensor.columns, model=model, max_iterations=50
    )
    camera = found.camera_model

    def directions(row: FloatArray, col: FloatArray) -> FloatArray:
        plane = np.array([camera.pixel_to_tanplane(*place) for place in np.stack([row, col], axis=-1) - middle])
        r = np.column_stack([plane, np.ones(len(plane))])
        return np.asarray(r / np.linalg.norm(r, axis=1, keepdims=True))

    notes: dict[str, float | str] = {
        "views_solved": float(sum(map(bool, solved))),
        "crpix_row_px": float(camera.crpix[0] + middle[0]),
        "crpix_col_px": float(camera.crpix[1] + middle[1]),
    }
    return Answer(
        directions,
        float(camera.focal_length_px * sensor.pixel_pitch_m),
        float(found.rmse_after_px) / np.sqrt(2),
        notes=notes,
    )
