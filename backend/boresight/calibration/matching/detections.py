"""A telemetry set and a sensor as the detections that matching takes: directions, their errors, given stars, times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight import kernels
from boresight.arrays import FloatArray, IntArray
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.attitude import triad
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import star_directions
from boresight.telemetry.schema import Telemetry, find_exposures
from boresight.telemetry.sensors import Sensor

#: Stars move by proper motion and aberration while the catalogue stands still: margin of the field.
CONE_MARGIN_RAD = float(np.radians(0.3))
#: Where a sensor file gives no limit: this much fainter than the faintest star named in the set.
FAINTER_MAG = 0.5
#: Rows whose derivatives are taken at a time.
CHUNK_ROWS = 2_048


def given_stars(telemetry: Telemetry, catalogue: Catalogue) -> tuple[IntArray, FloatArray, NDArray[np.bool_]]:
    """Star numbers given in the file, (n_rows,), 0 = none; their directions (n_rows, 3); whether these are the file's own."""
    n = len(telemetry)
    if telemetry.star_id is None or not (telemetry.star_id > 0).any():
        return np.zeros(n, np.int64), np.full((n, 3), np.nan), np.zeros(n, np.bool_)
    own = np.zeros(n, np.bool_) if telemetry.ra_rad is None else np.isfinite(telemetry.ra_rad)
    given_s = star_directions(
        telemetry.star_id, telemetry.ra_rad, telemetry.dec_rad, telemetry.time_utc, telemetry.velocity_m_s, catalogue
    )
    return np.maximum(telemetry.star_id, 0), given_s, own & (telemetry.star_id > 0)


def measured_directions(
    telemetry: Telemetry, rows: slice, sensor: Sensor, x: FloatArray, P: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions of some rows in the right-handed triad, their derivative times P^(1/2), and their errors.

    Returns
    -------
    s
        (n, 3) unit vectors.
    G
        (n, 3, p) ds/dx P^(1/2), p the rank of P.
    sigma_rad
        (n,) isotropic direction error.
    """
    camera, pitch, n = CAMERA_MODELS[sensor.camera_model], sensor.pixel_pitch_m, rows.stop - rows.start
    root = square_root(P)
    s, G, sigma = np.empty((n, 3)), np.empty((n, 3, root.shape[1])), centroid_sigma_px(telemetry, sensor)[rows].copy()
    sign = np.array([1.0, float(sensor.parity), 1.0])[:, None]
    for begin in range(0, n, CHUNK_ROWS):
        part = slice(begin, min(begin + CHUNK_ROWS, n))
        whole = slice(rows.start + part.start, rows.start + part.stop)
        row, col = telemetry.row_px[whole], telemetry.col_px[whole]
        directions, jacobian = np.empty((len(row), 3)), np.empty((len(row), 3, len(x)))
        kernels.rays_and_jacobians(camera.kernel, x, pitch, row, col, directions, jacobian)
        s[part] = triad(directions, sensor.parity)
        G[part] = (jacobian.reshape(-1, len(x)) @ root).reshape(*jacobian.shape[:2], root.shape[1]) * sign
        sigma[part] *= np.sqrt(camera.solid_angle(x, row, col, pitch))
    return s, G, sigma


def centroid_sigma_px(telemetry: Telemetry, sensor: Sensor) -> FloatArray:
    """One-axis centroid error of every row, (n_rows,) pixels: the file's, else the sensor's."""
    common = np.full(len(telemetry), sensor.centroid_sigma_px)
    if telemetry.sigma_px is None:
        return common
    return np.where(np.isfinite(telemetry.sigma_px), telemetry.sigma_px, common)


def square_root(P: FloatArray) -> FloatArray:
    """P^(1/2), (n_parameters, p) with P = root root^T and p its rank; scaled first, for the units differ by 10^16."""
    scale = np.sqrt(np.maximum(np.diag(P), 0.0))
    free = np.flatnonzero(scale > 0)
    root = np.zeros((len(P), len(free)))
    if len(free):
        values, vectors = np.linalg.eigh(P[np.ix_(free, free)] / np.outer(scale[free], scale[free]))
        root[free] = scale[free, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def pixel_rad(sensor: Sensor, x: FloatArray) -> float:
    """Angle of a pixel in the middle of the detector, rad."""
    middle = np.array([(sensor.rows - 1) / 2]), np.array([(sensor.columns - 1) / 2])
    omega = CAMERA_MODELS[sensor.camera_model].solid_angle(x, *middle, sensor.pixel_pitch_m)
    return float(np.sqrt(omega[0]))


def cone_rad(sensor: Sensor, x: FloatArray) -> float:
    """Angle from the z axis of D to the farthest corner of the detector, with a margin, rad."""
    camera = CAMERA_MODELS[sensor.camera_model]
    return camera.cone_rad(x, sensor.rows, sensor.columns, sensor.pixel_pitch_m) + CONE_MARGIN_RAD


def magnitude_limit(telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue, given: IntArray) -> float:
    """Faintest star that may be matched, Hp: the sensor's limit, else beyond the faintest named, else by how many are detected."""
    return compute_magnitude_limit(
        sensor, catalogue, np.unique(given[given > 0]), float(np.median(find_exposures(telemetry).count))
    )


def compute_magnitude_limit(sensor: Sensor, catalogue: Catalogue, named: IntArray, typical_stars: float) -> float:
    """As `magnitude_limit`, of a set that names these stars (n,) and detects so many an exposure."""
    if sensor.magnitude_limit is not None:
        return sensor.magnitude_limit
    index = catalogue.find_index(named)
    magnitude = catalogue.magnitude[index[index >= 0]]
    if len(magnitude):
        return float(magnitude.max() + FAINTER_MAG)
    field = 2 * np.pi * (1 - np.cos(cone_rad(sensor, sensor.initial)))
    wanted = 2 * typical_stars * 4 * np.pi / field
    return float(np.sort(catalogue.magnitude)[min(int(wanted), len(catalogue) - 1)])


def seconds(times: NDArray[np.datetime64], epoch: np.datetime64 | None = None) -> FloatArray:
    """Seconds from an epoch, or from the first known time, (n,); NaN where unknown."""
    known = ~np.isnat(times)
    elapsed = np.full(len(times), np.nan)
    if known.any():
        elapsed[known] = (times[known] - (times[known].min() if epoch is None else epoch)) / np.timedelta64(1, "s")
    return elapsed
