"""Star fields at random attitudes: what a sensor sees without an orbit, so without time, motion or aberration.

Boresights are uniform over the part of the sky within a Galactic latitude, and the roll about them is uniform. A
third of the bright stars lie within 20 degrees of the Milky Way, so the band sets how many stars a field holds.

    boresight z = cos(b) (cos(l) e_1 + sin(l) e_2) + sin(b) e_3,        sin(b) and l uniform,

e_1 and e_2 any two axes across the north Galactic pole e_3. Catalogue directions are taken at their epoch: nothing here has a date.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import corners
from boresight.sky.catalogue import Catalogue, unit_vectors
from boresight.telemetry.sensors import Sensor

#: North Galactic pole, ICRS, degrees (ESA SP-1200, 1.5.3).
GALACTIC_POLE_DEG = (192.85948, 27.12825)
#: Fields drawn at a time.
BLOCK = 200


@dataclass(frozen=True)
class StarFields:
    """Star fields as a structure of arrays, without noise.

    `star_start`: (n_fields + 1,) first star of each field. `s_i`: (n_stars, 3) catalogue directions, ICRS. `row_px`, `col_px`:
    (n_stars,) where the true camera shows them.
    """

    star_start: IntArray
    s_i: FloatArray
    row_px: FloatArray
    col_px: FloatArray

    def __len__(self) -> int:
        """Count the fields."""
        return len(self.star_start) - 1


def directions(catalogue: Catalogue) -> FloatArray:
    """Unit vectors (n_stars, 3) at the catalogue's epoch."""
    return unit_vectors(catalogue.ra_rad, catalogue.dec_rad)


def random_fields(
    sensor: Sensor,
    truth: FloatArray,
    s_i: FloatArray,
    n_fields: int,
    rng: np.random.Generator,
    *,
    galactic_latitude_deg: float = 90.0,
    minimum_stars: int = 4,
) -> StarFields:
    """Draw star fields.

    `sensor`, `truth`: detector, and its true parameters (n_parameters,). `s_i`: (n, 3) directions of the stars that the sensor
    sees. `n_fields`: how many; those with too few stars are drawn again. `rng`: source of randomness. `galactic_latitude_deg`:
    boresights lie no farther from the Galactic plane. `minimum_stars`: of a field. Returns the fields in the order drawn.
    """
    counts: list[IntArray] = []
    stars, rows, columns = list[IntArray](), list[FloatArray](), list[FloatArray]()
    while sum(len(count) for count in counts) < n_fields:
        field, star, row_px, col_px = _block(sensor, truth, s_i, galactic_latitude_deg, rng)
        count = np.bincount(field, minlength=BLOCK)
        kept = (count >= minimum_stars)[field]
        counts.append(count[count >= minimum_stars])
        stars.append(star[kept])
        rows.append(row_px[kept])
        columns.append(col_px[kept])
    star_start = np.concatenate([[0], np.cumsum(np.concatenate(counts)[:n_fields])]).astype(np.int64)
    seen = slice(0, int(star_start[-1]))
    return StarFields(
        star_start, s_i[np.concatenate(stars)[seen]], np.concatenate(rows)[seen], np.concatenate(columns)[seen]
    )


def _block(
    sensor: Sensor, truth: FloatArray, s_i: FloatArray, latitude_deg: float, rng: np.random.Generator
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Draw `BLOCK` fields; returns the field, star, row and column of every star on the detector."""
    C = _attitudes(latitude_deg, rng)
    camera = CAMERA_MODELS[sensor.camera_model]
    nearest = camera.directions(truth, *corners(sensor.rows, sensor.columns), sensor.pixel_pitch_m)[:, 2].min()
    field, star = np.nonzero(C[:, 2] @ s_i.T >= nearest)
    s_d = np.einsum("nij,nj->ni", C[field], s_i[star])
    s_d[:, 1] *= sensor.parity
    row_px, col_px = camera.project(truth, s_d, sensor.pixel_pitch_m)
    on = (np.abs(row_px - (sensor.rows - 1) / 2) <= sensor.rows / 2) & (
        np.abs(col_px - (sensor.columns - 1) / 2) <= sensor.columns / 2
    )
    return field[on], star[on], row_px[on], col_px[on]


def _attitudes(latitude_deg: float, rng: np.random.Generator) -> FloatArray:
    """Draw `BLOCK` rotations C (n, 3, 3) from ICRS whose third rows, the boresights, lie in the band."""
    pole = unit_vectors(*np.radians(GALACTIC_POLE_DEG))
    sine = rng.uniform(-1, 1, BLOCK) * np.sin(np.radians(latitude_deg))
    across = _perpendicular(np.broadcast_to(pole, (BLOCK, 3)), rng)
    z = np.sqrt(1 - sine**2)[:, None] * across + sine[:, None] * pole
    x = _perpendicular(z, rng)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _perpendicular(z: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw unit vectors (n, 3) uniformly across unit vectors z (n, 3)."""
    drawn = rng.normal(size=z.shape)
    drawn -= np.sum(drawn * z, axis=1, keepdims=True) * z
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))
