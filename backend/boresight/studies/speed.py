"""What a calibration costs a frame, beside peers in the same run: `boresight bench`.

Synthetic frames: two exposures of 12 stars, uniform over an ST-16, 0.437 px of noise, the parameters of E Table III's first sensor.
Each figure is the fastest of several repeats, kernels already compiled; a peer too slow for the whole set gets a part of it,
and its figure is still per frame. Quote ratios: they hold when the machine's speed drifts.

Matching needs a real sky: `studies.matching_speed` times it on frames of its own and says what a batch evaluation of those costs.
The update by singular values alone is timed by `studies.singular_speed`, with as many stars as W has.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray
from boresight.calibration.problem import weighed
from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.blocks import FRAMES
from boresight.estimation.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.studies import matching_speed, peers, singular_speed, speed_limits
from boresight.studies.processes import run_on_one_thread
from boresight.studies.repeats import fastest

STARS = 12
EXPOSURES_A_FRAME = 2
START_SIGMA = 10.0
#: Frames given to peers that would need minutes for more.
SLOW_PEER_FRAMES = 200
SLOWEST_PEER_FRAMES = 50
BATCH_PEER_FRAMES = 4000
UPDATE = "svd_update"


def measure(
    frames: int = 2000,
    report: Callable[[float, str], None] | None = None,
    seed: int = 1,
    thread_frames: int = 16 * FRAMES,
) -> dict[str, Any]:
    """Time the loops and their peers; returns the contract's bench document.

    Parameters
    ----------
    frames
        Size of the synthetic set.
    report
        Told the fraction done and what is timed next.
    seed
        Of the set.
    thread_frames
        Of the set that two threads evaluate: many blocks.
    """
    tell = report or (lambda _fraction, _message: None)
    sensor = st16_sensor(1)
    x_0, scale, free = sensor.initial, sensor.typical_sigma, np.arange(len(sensor.initial))
    tell(0.0, "making the synthetic set")
    arcs = synthetic(frames, np.random.default_rng(seed))
    small = arcs.frames(0, min(frames, 20))
    batch.fit(small, x_0, free, scale)
    _filter(small, x_0, free, scale)
    tell(0.1, "batch evaluation")
    evaluation = fastest(lambda: batch.normal_equations(arcs, x_0, free, scale))
    tell(0.2, "batch fit")
    fit = fastest(lambda: batch.fit(arcs, x_0, free, scale), repeats=3)
    tell(0.3, "square-root filter")
    sqrf = fastest(lambda: _filter(arcs, x_0, free, scale), repeats=3)
    tell(0.35, "filter on singular values")
    _filter(small, x_0, free, scale, "svd")
    svd = fastest(lambda: _filter(arcs, x_0, free, scale, "svd"), repeats=2)
    ours = {
        "batch_evaluation_us_per_frame": evaluation / frames * 1e6,
        "batch_fit_us_per_frame": fit / frames * 1e6,
        "sqrf_us_per_frame": sqrf / frames * 1e6,
    }
    tell(0.4, "matching")
    matching, beside = matching_speed.measure(frames, np.random.default_rng(seed))
    ours |= matching
    beside |= _peers(arcs, x_0, scale, tell)
    tell(0.93, "peer: C")
    beside_c = speed_limits.beside_c(arcs, x_0, scale, START_SIGMA)
    beside |= {
        f"{peer}_{work}_us_per_frame": seconds / frames * 1e6
        for work, times in beside_c.items()
        for peer, seconds in times.items()
        if peer != "ours"
    }
    tell(0.94, "two threads")
    gain = speed_limits.two_threads(synthetic(thread_frames, np.random.default_rng(seed)), x_0, scale)
    tell(0.95, "update by singular values")
    updates, peers_of_updates = _singular_updates()
    ours |= updates
    beside |= peers_of_updates
    tell(1.0, "done")
    return {
        "frames": frames,
        "stars_per_exposure": STARS,
        "exposures_per_frame": EXPOSURES_A_FRAME,
        **ours,
        "match_per_batch_evaluation": ours["match_us_per_frame"] / ours["match_batch_evaluation_us_per_frame"],
        "svd_us_per_frame": svd / frames * 1e6,
        "peak_rss_mb": _peak_rss_mb(),
        "peers": beside,
        "ratios": _ratios(ours, beside),
        "two_threads": gain,
        "limits": speed_limits.limits(beside_c, gain),
    }


def _ratios(ours: dict[str, float], beside: dict[str, float]) -> dict[str, float]:
    """How many times longer each peer takes than the product's loop that does its work."""
    loop = {"evaluation": "batch_evaluation", "fit": "batch_fit", "sqrf": "sqrf", "ekf": "sqrf", "match": "match"}
    ratios = {}
    for name, time in beside.items():
        peer = name.removesuffix("_us_per_frame")
        work = peer[peer.index(UPDATE) :] if UPDATE in peer else loop[peer.rsplit("_", 1)[-1]]
        ratios[peer] = time / ours[f"{work}_us_per_frame"]
    return ratios


def _singular_updates() -> tuple[dict[str, float], dict[str, float]]:
    """Time the update by singular values, and its peers, on one thread: of an exposure of so many stars, one a frame."""
    times = run_on_one_thread(singular_speed.measure, None)
    ours = {f"{UPDATE}_{stars}_stars_us_per_frame": found["compiled"] for stars, found in times.items()}
    beside = {
        f"{peer}_{UPDATE}_{stars}_stars_us_per_frame": found[way]
        for peer, way in (("numpy", "plain"), ("numpy_lean", "lean"))
        for stars, found in times.items()
    }
    return ours, beside


def _peers(arcs: ArcSet, x_0: FloatArray, scale: FloatArray, tell: Callable[[float, str], None]) -> dict[str, float]:
    """Time the peers on the same data."""
    batched = peers.EqualExposures.of(arcs.frames(0, min(arcs.n_frames, BATCH_PEER_FRAMES)), STARS)
    slow = peers.EqualExposures.of(arcs.frames(0, min(arcs.n_frames, SLOW_PEER_FRAMES)), STARS)
    n_batched, n_slow = len(batched.phi) / EXPOSURES_A_FRAME, len(slow.phi) / EXPOSURES_A_FRAME
    tell(0.5, "peer: evaluation in batched NumPy")
    evaluation = fastest(lambda: peers.numpy_evaluation(batched, x_0, scale), repeats=3)
    tell(0.55, "peer: scipy.optimize.least_squares")
    evaluations = [1]
    fit = fastest(lambda: evaluations.__setitem__(0, peers.scipy_fit(batched, x_0, scale)[1]), repeats=1)
    times = {
        "numpy_evaluation": evaluation / n_batched,
        "scipy_evaluation": fit / evaluations[0] / n_batched,
        "scipy_fit": fit / n_batched,
    }
    few = arcs.frames(0, min(arcs.n_frames, SLOWEST_PEER_FRAMES))
    filters = {
        "numpy_sqrf": (few.n_frames, lambda: _plain_filter(few, x_0, scale)),
        "numpy_lean_sqrf": (n_slow, lambda: peers.numpy_lean_square_root_filter(slow, x_0, scale, START_SIGMA)),
        "numpy_ekf": (n_slow, lambda: peers.numpy_extended_filter(slow, x_0, scale, START_SIGMA)),
    }
    for turn, (name, (n_frames, run)) in enumerate(filters.items()):
        tell(0.6 + 0.1 * turn, f"peer: {name}")
        times[name] = fastest(run, repeats=2) / n_frames
    return {f"{name}_us_per_frame": seconds * 1e6 for name, seconds in times.items()}


def synthetic(frames: int, rng: np.random.Generator) -> ArcSet:
    """Weighed arcs of random star fields with the truth of the first ST-16; attitudes are left out, for arcs do not see them."""
    sensor, truth = st16_sensor(1), st16_truth(1)
    exposures = frames * EXPOSURES_A_FRAME
    n = exposures * STARS
    row, col = rng.uniform(0, sensor.rows - 1, n), rng.uniform(0, sensor.columns - 1, n)
    s_i = INVERTED_WANG.directions(truth, row, col, sensor.pixel_pitch_m)
    star_start = np.arange(exposures + 1) * STARS
    places, _ = arcsets.order(star_start, s_i)
    noise = sensor.centroid_sigma_px * rng.normal(size=(2, n))
    arcs = ArcSet(
        model=INVERTED_WANG.kernel,
        pitch=sensor.pixel_pitch_m,
        frame=np.arange(frames),
        frame_start=np.arange(frames + 1) * EXPOSURES_A_FRAME,
        star_start=star_start,
        row_px=(row + noise[0])[places],
        col_px=(col + noise[1])[places],
        sigma_px=np.full(n, sensor.centroid_sigma_px),
        s_i=s_i[places],
        source_row=places,
        phi=np.empty(0),
        band=np.empty((0, 5)),
    )
    return arcsets.weigh(arcs, arcsets.angular_sigma(INVERTED_WANG, sensor.initial, arcs))[0]


def _filter(arcs: ArcSet, x_0: FloatArray, free: NDArray[np.int64], scale: FloatArray, method: str = "sqrf") -> None:
    """Run one of the product's filters as a sequential calibration does, taking the weights included."""
    pooled = pool_start(weighed(arcs, INVERTED_WANG, x_0), START_ARCS_PER_PARAMETER * len(free))
    FILTERS[method](pooled, start(x_0, len(free), START_SIGMA), free, scale, Tuning())


def _plain_filter(arcs: ArcSet, x_0: FloatArray, scale: FloatArray) -> None:
    """Run the same job in plain NumPy, from the same pooled start."""
    pooled = pool_start(arcs, START_ARCS_PER_PARAMETER * len(x_0))
    peers.numpy_square_root_filter(pooled, x_0, scale, START_SIGMA, Tuning().linearisations, Tuning().rest)


def _peak_rss_mb() -> float:
    """Largest resident memory of this process so far, MB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)
