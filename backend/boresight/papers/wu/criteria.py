"""The paper's two criteria (W 4.1): how well calibrated directions keep the angles between the stars of an image.

For each image the root mean square over all pairs of stars of the measured minus the catalogue angle; over the images its mean and
standard deviation. Criterion A takes the centroids without noise, so only the parameters count; criterion B the noisy ones.
At the truth B is the noise alone, about sqrt(2) sigma_px Delta / f: an angle has two ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation.angular import all_pairs
from boresight.simulation.fields import StarFields
from boresight.simulation.sensors import WU_PIXEL_PITCH_M

ARCSEC_PER_RAD = 180 * 3600 / np.pi


@dataclass(frozen=True)
class Judges:
    """The images that judge a calibration.

    `row_px`, `col_px`: (n_stars,) the same with noise. `pair`: (n_pairs, 2) stars of every pair of an image. `image`:
    (n_pairs,) whose they are. `angle`: (n_pairs,) of the catalogue, rad.
    """

    fields: StarFields
    row_px: FloatArray
    col_px: FloatArray
    pair: IntArray
    image: IntArray
    angle: FloatArray

    @classmethod
    def of(cls, fields: StarFields, sigma_px: float, rng: np.random.Generator) -> Judges:
        """Add noise to fields and list their pairs."""
        noise = sigma_px * rng.normal(size=(2, len(fields.row_px)))
        counts = np.diff(fields.star_start)
        found = [first + all_pairs(int(n)) for first, n in zip(fields.star_start[:-1], counts, strict=True)]
        pair, image = np.concatenate(found), np.repeat(np.arange(len(fields)), list(map(len, found)))
        return cls(fields, fields.row_px + noise[0], fields.col_px + noise[1], pair, image, _angles(fields.s_i, pair))

    def criterion_a(self, x: FloatArray) -> tuple[float, float]:
        """Mean and standard deviation of criterion A, arcseconds, at parameters x (6,)."""
        return self._judge(x, self.fields.row_px, self.fields.col_px)

    def criterion_b(self, x: FloatArray) -> tuple[float, float]:
        """Mean and standard deviation of criterion B, arcseconds, at parameters x (6,)."""
        return self._judge(x, self.row_px, self.col_px)

    def _judge(self, x: FloatArray, row_px: FloatArray, col_px: FloatArray) -> tuple[float, float]:
        s = PINHOLE_RADIAL.directions(x, row_px, col_px, WU_PIXEL_PITCH_M)
        squared = (_angles(s, self.pair) - self.angle) ** 2
        rms = np.sqrt(np.bincount(self.image, squared) / np.bincount(self.image)) * ARCSEC_PER_RAD
        return float(rms.mean()), float(rms.std())


def _angles(s: FloatArray, pair: IntArray) -> FloatArray:
    """Angles (n,) of pairs of directions, from chords, which keep small angles exact."""
    chord = np.linalg.norm(s[pair[:, 0]] - s[pair[:, 1]], axis=1)
    return np.asarray(2 * np.arcsin(chord / 2))
