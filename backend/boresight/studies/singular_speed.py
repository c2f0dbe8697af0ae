"""What taking in one exposure's singular values costs, compiled and without: the update alone, like against like.

W's sensor with its mean numbers of stars in an image, Model 4 with {2, 3} and the full R, at the truth. Rays and their derivatives
are given to all, so the times hold decompositions, covariance, choice of rows, whitening and the update of the information. The
works take turns, in processor time of one thread; see `singular_peer` for the two peers. Times are microseconds an exposure.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from boresight import kernels
from boresight.arrays import FloatArray
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import ArcSet
from boresight.estimation.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation.filters.information import Frame
from boresight.estimation.filters.singular import SingularValues
from boresight.estimation.singular_values import CHOSEN
from boresight.simulation.sensors import (
    WU_COLUMNS,
    WU_IMPLIED_SIGMA_PX,
    WU_PIXEL_PITCH_M,
    WU_ROWS,
    WU_TRUTH,
    WU_TYPICAL_SIGMA,
)
from boresight.studies.singular_peer import Known, Seen, lean_update, plain_update

#: W Table 4's mean numbers of stars, rounded.
STARS = (31, 19, 8)
EXPOSURES, REPEATS = 30, 7
FREE = np.arange(len(WU_TRUTH))
SCALE = np.asarray(WU_TYPICAL_SIGMA, dtype=np.float64)
#: Information before the exposure: a start within ten typical sigmas.
PRIOR = 0.01 * np.eye(len(WU_TRUTH))

Update = Callable[[], tuple[FloatArray, FloatArray]]


def measure(_catalogue_folder: Path | None = None, seed: int = 1) -> dict[int, dict[str, float]]:
    """Time the updates by number of stars: `compiled`, `plain` and `lean`, microseconds an exposure."""
    rng = np.random.default_rng(seed)
    return {stars: _times(updates(star_field(stars, EXPOSURES, rng))) for stars in STARS}


def star_field(stars: int, exposures: int, rng: np.random.Generator) -> ArcSet:
    """Weighed arcs of exposures of so many stars each, spread over W's detector, one a frame, with its 0.2 px of noise."""
    n = exposures * stars
    row, col = rng.uniform(0, WU_ROWS - 1, n), rng.uniform(0, WU_COLUMNS - 1, n)
    s_i = PINHOLE_RADIAL.directions(WU_TRUTH, row, col, WU_PIXEL_PITCH_M)
    star_start = np.arange(exposures + 1) * stars
    places, _ = arcsets.order(star_start, s_i)
    noise = WU_IMPLIED_SIGMA_PX * rng.normal(size=(2, n))
    arcs = ArcSet(
        model=PINHOLE_RADIAL.kernel,
        pitch=WU_PIXEL_PITCH_M,
        frame=np.arange(exposures),
        frame_start=np.arange(exposures + 1),
        star_start=star_start,
        row_px=(row + noise[0])[places],
        col_px=(col + noise[1])[places],
        sigma_px=np.full(n, WU_IMPLIED_SIGMA_PX),
        s_i=np.ascontiguousarray(s_i[places]),
        source_row=places,
        phi=np.empty(0),
        band=np.empty((0, 5)),
    )
    return arcsets.weigh(arcs, arcsets.angular_sigma(PINHOLE_RADIAL, WU_TRUTH, arcs))[0]


def updates(arcs: ArcSet) -> dict[str, list[Update]]:
    """The update of each exposure in each way, rays computed beforehand."""
    sigma_rad = arcsets.angular_sigma(PINHOLE_RADIAL, WU_TRUTH, arcs)
    frames = [Frame(arcs, k, sigma_rad) for k in range(arcs.n_frames)]
    made: dict[str, list[Update]] = {"compiled": [_compiled(frame) for frame in frames], "plain": [], "lean": []}
    for frame in frames:
        s, D = PINHOLE_RADIAL.directions_and_jacobian(WU_TRUTH, frame.row_px, frame.col_px, arcs.pitch)
        known, seen = (frame.s_i, frame.sigma_rad), (s, D[..., FREE] * SCALE)
        made["plain"].append(_by_numpy(plain_update, known, seen))
        made["lean"].append(_by_numpy(lean_update, known, seen))
    return made


def _compiled(frame: Frame) -> Update:
    reference, (s, D) = SingularValues(CHOSEN, FREE, SCALE), frame.directions(WU_TRUTH)

    def update() -> tuple[FloatArray, FloatArray]:
        z, posterior, P = np.zeros(len(FREE)), np.empty_like(PRIOR), np.empty_like(PRIOR)
        reference.weigh(frame.star_start, frame.s_i, frame.sigma_rad)
        kernels.information_update(
            PRIOR, np.zeros(len(FREE)), np.zeros(len(FREE)), *reference.rows(s, D), z, posterior, P
        )
        return z, posterior

    return update


def _by_numpy(
    update: Callable[[Known, Seen, FloatArray, FloatArray], tuple[FloatArray, FloatArray]], known: Known, seen: Seen
) -> Update:
    return lambda: update(known, seen, np.zeros(len(FREE)), PRIOR)


def _times(ways: dict[str, list[Update]]) -> dict[str, float]:
    """Fastest of several turns of each way, microseconds an exposure; all are run once before."""
    best = dict.fromkeys(ways, np.inf)
    for turn in range(REPEATS + 1):
        for way, each in ways.items():
            began = time.process_time()
            for update in each:
                update()
            taken = (time.process_time() - began) / len(each) * 1e6
            best[way] = min(best[way], taken) if turn else np.inf
    return best
