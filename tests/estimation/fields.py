"""Star fields with known truth: random attitudes, uniform stars; the ST-16's, and those of Wu's pinhole camera."""

from dataclasses import replace

import numpy as np

from boresight import kernels
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
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


WU_PITCH = 2.9e-6
WU_ROWS, WU_COLUMNS = 1080, 1920
#: W Table 1, in SI.
WU_TRUTH = np.array([1.0, 0.016, 970.0, 550.0, -0.5, 0.5])
PINHOLE_SCALE = np.array([1e-3, 3e-5, 10.0, 10.0, 0.02, 0.1])
#: The same lens in front of the detector of `fields`.
PINHOLE_GROUND = np.array([1.0, 0.016095, 1296.0, 972.0, -0.5, 0.5])
PINHOLE = PINHOLE_RADIAL
SIX = np.arange(6)
#: W starts at 15.5 mm, (960, 540) and no distortion; what it thinks of that start is not printed.
WU_START = np.array([1.0, 0.0155, 960.0, 540.0, 0.0, 0.0])
START_SIGMA = np.array([1e-3, 5e-4, 10.0, 10.0, 0.5, 1.0])


def wu_field(rng, frames=100, mean_stars=19.0, noise_px=0.2):
    starts, rows, cols, directions = [0], [], [], []
    for _ in range(frames):
        n = max(4, rng.poisson(mean_stars))
        row, col = rng.uniform(0, WU_ROWS - 1, n), rng.uniform(0, WU_COLUMNS - 1, n)
        directions.append(PINHOLE.directions(WU_TRUTH, row, col, WU_PITCH) @ rotation(rng))
        rows.append(row + noise_px * rng.normal(size=n))
        cols.append(col + noise_px * rng.normal(size=n))
        starts.append(starts[-1] + n)
    field = arranged(
        starts, np.arange(frames + 1), np.concatenate(rows), np.concatenate(cols), np.concatenate(directions), noise_px
    )
    return replace(field, model=PINHOLE.kernel, pitch=WU_PITCH)


def wu_weighed(field, x=WU_TRUTH):
    return arcsets.whiten(field, arcsets.angular_sigma(PINHOLE, x, field))[0]


def whitened_rows(arcs, x, free, scale, band=None):
    e, H = np.empty(arcs.n_arcs), np.empty((arcs.n_arcs, len(free)))
    stars = (arcs.star_start, arcs.row_px, arcs.col_px)
    kernels.whitened_rows(
        arcs.model, x, arcs.pitch, *stars, arcs.phi, arcs.band if band is None else band, free, scale, e, H
    )
    return e, H
