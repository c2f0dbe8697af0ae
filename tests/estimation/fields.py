"""Star fields with known truth: random attitudes, uniform stars; the ST-16's, and those of Wu's pinhole camera."""

from dataclasses import replace

import numpy as np

from boresight import kernels
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import ArcSet
from boresight.estimation.metrics import arc_errors

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


def drawn(rng, camera, truth, pitch, size, exposures, mean_stars, noise_px):
    starts, parts = [0], []
    for _ in range(exposures):
        n = max(4, rng.poisson(mean_stars))
        row, col = rng.uniform(0, size[0] - 1, n), rng.uniform(0, size[1] - 1, n)
        s_i = camera.directions(truth, row, col, pitch) @ rotation(rng)
        parts.append((row + noise_px * rng.normal(size=n), col + noise_px * rng.normal(size=n), s_i))
        starts.append(starts[-1] + n)
    return starts, *(np.concatenate(each) for each in zip(*parts, strict=True))


def star_field(rng, frames=200, mean_stars=10.7, noise_px=NOISE_PX, truth=TRUTH):
    starts, *stars = drawn(rng, INVERTED_WANG, truth, PITCH, (ROWS, COLUMNS), 2 * frames, mean_stars, noise_px)
    return arranged(starts, np.arange(0, 2 * frames + 1, 2), *stars, noise_px)


def arranged(starts, frame_start, row_px, col_px, s_i, noise_px):
    star_start = np.array(starts)
    places, _ = arcsets.order(star_start, s_i)
    return ArcSet(
        camera=INVERTED_WANG,
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


def joined(parts):
    """Frames of two exposures each, one after another."""
    arrays = ("row_px", "col_px", "sigma_px", "s_i", "source_row", "phi", "band")
    stars = np.concatenate([[0], *(np.diff(part.star_start) for part in parts)]).cumsum()
    return replace(
        parts[0],
        frame=np.arange(len(parts)),
        frame_start=2 * np.arange(len(parts) + 1),
        star_start=stars,
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays},
    )


def whitened(arcs, x):
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
    starts, *stars = drawn(rng, PINHOLE, WU_TRUTH, WU_PITCH, (WU_ROWS, WU_COLUMNS), frames, mean_stars, noise_px)
    return replace(arranged(starts, np.arange(frames + 1), *stars, noise_px), camera=PINHOLE, pitch=WU_PITCH)


def wu_whitened(field, x=WU_TRUTH):
    return arcsets.whiten(field, arcsets.angular_sigma(PINHOLE, x, field))[0]


def whitened_rows(arcs, x, free, scale, band=None):
    e, H = np.empty(arcs.n_arcs), np.empty((arcs.n_arcs, len(free)))
    stars = (arcs.star_start, arcs.row_px, arcs.col_px)
    kernels.whitened_rows(
        arcs.camera.kind, x, arcs.pitch, *stars, arcs.phi, arcs.band if band is None else band, free, scale, e, H
    )
    return e, H


def whitened_plainly(arcs, x):
    e, a0 = arc_errors(arcs, x), 0
    for n in 2 * np.diff(arcs.star_start) - 3:
        L = np.zeros((n, n))
        for d in range(5):
            L[np.arange(d, n), np.arange(n - d)] = arcs.band[a0 + d : a0 + n, 4 - d]
        e[a0 : a0 + n] = np.linalg.solve(L, e[a0 : a0 + n])
        a0 += n
    return e


def directions_by_definition(camera, x, row, col, pitch):
    """Direction from the camera's definition as Python, which takes complex numbers."""
    ray = np.array([*camera.star(tuple(x), pitch, row, col)[:2], 1.0])
    return ray / np.sqrt(np.sum(ray * ray))
