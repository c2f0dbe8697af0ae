"""Star fields with known truth for the estimation tests: random attitudes, uniform stars, no catalogue and no files."""

import numpy as np

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import ArcSet

PITCH = 2.2e-6
ROWS, COLUMNS = 1944, 2592
SCALE = np.array(INVERTED_WANG.default_typical_sigma)
GROUND = np.array([0.016095, 972.0, 1296.0, 0.0, -1e3, 0.0, 0.0, 1.0])
# E Table III, sensor 2: the hardest start, with n0 and a1 far along their weak direction
SHIFT = np.array([-8.04, 0.71, -8.37, 1.41, -1.17, -4.96, 0.47, 5.14])
TRUTH = GROUND + SHIFT * SCALE
FREE = np.arange(8)
NOISE_PX = 0.437


def rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def star_field(rng, frames=200, mean_stars=10.7, noise_px=NOISE_PX, truth=TRUTH):
    starts, frame_start, rows, cols, directions = [0], [0], [], [], []
    for _ in range(frames):
        for _ in range(2):
            n = max(4, rng.poisson(mean_stars))
            row, col = rng.uniform(0, ROWS - 1, n), rng.uniform(0, COLUMNS - 1, n)
            directions.append(INVERTED_WANG.directions(truth, row, col, PITCH) @ rotation(rng))
            rows.append(row + noise_px * rng.normal(size=n))
            cols.append(col + noise_px * rng.normal(size=n))
            starts.append(starts[-1] + n)
        frame_start.append(len(starts) - 1)
    return arranged(
        starts, frame_start, np.concatenate(rows), np.concatenate(cols), np.concatenate(directions), noise_px
    )


def arranged(starts, frame_start, row_px, col_px, s_i, noise_px):
    star_start = np.array(starts)
    places, _ = arcsets.order(star_start, s_i)
    return ArcSet(
        model=INVERTED_WANG.kernel,
        pitch=PITCH,
        frame=np.arange(len(frame_start) - 1),
        frame_start=np.array(frame_start),
        star_start=star_start,
        row_px=row_px[places],
        col_px=col_px[places],
        sigma_px=np.full(len(row_px), max(noise_px, 0.01)),
        s_i=np.ascontiguousarray(s_i[places]),
        source_row=places,
        phi=np.empty(0),
        band=np.empty((0, 5)),
    )


def weighed(arcs, x):
    return arcsets.whiten(arcs, arcsets.angular_sigma(INVERTED_WANG, x, arcs))[0]
