"""What a calibration costs a frame, beside peers in the same run (part `kernels`).

Each figure is the fastest of several repeats on synthetic frames, kernels already compiled; a peer too slow for the whole set gets
a part of it, and its figure is still per frame. Quote ratios: they hold when the machine's speed drifts. Ours and C's take turns
on the whole set, so that what else the machine does meets both.

Matching has frames of real stars with half of their names taken away, matched from the ground calibration, the hard case: ten
typical sigmas of parameter uncertainty; the batch evaluation beside it is of the same frames with all names.

The update by singular values is that of one exposure with W's mean numbers of stars, Model 4 with {2, 3} and the full R, at the
truth: rays and their derivatives are given to all, so the times hold decompositions, covariance, choice of rows, whitening and the
update of the information, in processor time of one thread.
"""

from __future__ import annotations

import os
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import Report, held, peers
from benchmarks.stars import EXPOSURES_A_FRAME, STARS, TIME, star_frames, synthetic, wu_field
from boresight import kernels
from boresight.arrays import FloatArray, IntArray
from boresight.calibration.matching import rematch
from boresight.calibration.matching.rematch import Rematcher, ground_covariance
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem, whiten_at
from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.blocks import FRAMES, computing_on
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.filters.information import Frame
from boresight.estimation.filters.singular import SingularValues
from boresight.estimation.singular_values import CHOSEN
from boresight.papers.processes import run_on_one_thread
from boresight.simulation.sensors import ST16_MAGNITUDE_LIMIT, WU_TRUTH, WU_TYPICAL_SIGMA, st16_sensor, st16_truth
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.schema import Telemetry, select_rows
from boresight.telemetry.sensors import Sensor

Update = Callable[[], tuple[FloatArray, FloatArray]]

START_SIGMA = 10.0
#: Frames given to peers that would need minutes for more.
BATCH_PEER_FRAMES, SLOW_PEER_FRAMES, SLOWEST_PEER_FRAMES = 4000, 200, 50
MATCHED_FRAMES, MATCHED_PEER_FRAMES, MATCHING_TURNS = 1000, 100, 10
#: Of the matching peer, rad: a ground calibration puts stars a dozen pixels off.
PEER_TOLERANCE_RAD = 2e-3
#: Times C's at most, and how many times faster two threads are at least.
OVER_C, TWO_THREADS = 1.25, 1.6
EVALUATION_TURNS, FILTER_TURNS, THREAD_TURNS = 40, 15, 20
#: W Table 4's mean numbers of stars, rounded; of each so many exposures, taken in so often.
WU_STARS, WU_EXPOSURES, WU_TURNS = (31, 19, 8), 30, 7
WU_FREE, WU_SCALE = np.arange(len(WU_TRUTH)), np.asarray(WU_TYPICAL_SIGMA, dtype=np.float64)
#: Information before the exposure: a start within ten typical sigmas.
PRIOR = 0.01 * np.eye(len(WU_TRUTH))
UPDATE = "svd_update"
#: The product's loop that does a peer's work.
LOOPS = {"evaluation": "batch_evaluation", "fit": "batch_fit", "sqrf": "sqrf", "ekf": "sqrf", "match": "match"}


def fastest(*runs: Callable[[], object], repeats: int) -> list[float]:
    """Seconds of the fastest repeat of each of several works, taken in turn so that a drift of the machine meets them all."""
    return [min(times) for times in zip(*([_seconds(run) for run in runs] for _ in range(repeats)), strict=True)]


def _seconds(run: Callable[[], object]) -> float:
    began = time.perf_counter()
    run()
    return time.perf_counter() - began


def measure(report: Report, *, frames: int = 2000, seed: int = 1, thread_frames: int = 16 * FRAMES) -> dict[str, Any]:
    """Time the loops and their peers on a synthetic set; two threads evaluate `thread_frames`, many blocks."""
    sensor = st16_sensor(1)
    x_0, scale, free = sensor.initial, sensor.typical_sigma, np.arange(len(sensor.initial))
    report(0.0, "making the synthetic set")
    arcs = synthetic(frames, np.random.default_rng(seed))
    small = arcs.frames(0, min(frames, 20))
    batch.fit(small, x_0, free, scale)
    for method in ("sqrf", "svd"):
        _filter(small, x_0, free, scale, method)
    ours, svd = {}, 0.0
    for fraction, name, repeats, work in (
        (0.1, "batch_evaluation", 5, partial(batch.normal_equations, arcs, x_0, free, scale)),
        (0.2, "batch_fit", 3, partial(batch.fit, arcs, x_0, free, scale)),
        (0.3, "sqrf", 3, partial(_filter, arcs, x_0, free, scale, "sqrf")),
        (0.35, "svd", 2, partial(_filter, arcs, x_0, free, scale, "svd")),
    ):
        report(fraction, name.replace("_", " "))
        ours[f"{name}_us_per_frame"] = fastest(work, repeats=repeats)[0] / frames * 1e6
    svd = ours.pop("svd_us_per_frame")
    report(0.4, "matching")
    matching, beside = _matching(frames, np.random.default_rng(seed))
    ours |= matching
    beside |= _peers(arcs, x_0, scale, report)
    report(0.93, "peer: C")
    in_c = _beside_c(arcs, x_0, scale)
    for work_name, times in in_c.items():
        for peer, seconds in times.items():
            if peer != "ours":
                beside[f"{peer}_{work_name}_us_per_frame"] = seconds / frames * 1e6
    report(0.94, "two threads")
    gain = _two_threads(synthetic(thread_frames, np.random.default_rng(seed)), x_0, scale)
    report(0.95, "update by singular values")
    for stars, found in run_on_one_thread(singular_updates, None).items():
        ours[f"{UPDATE}_{stars}_stars_us_per_frame"] = found["compiled"]
        beside[f"numpy_{UPDATE}_{stars}_stars_us_per_frame"] = found["plain"]
        beside[f"numpy_lean_{UPDATE}_{stars}_stars_us_per_frame"] = found["lean"]
    report(1.0, "done")
    return {
        "frames": frames,
        "stars_per_exposure": STARS,
        "exposures_per_frame": EXPOSURES_A_FRAME,
        **ours,
        "match_per_batch_evaluation": ours["match_us_per_frame"] / ours["match_batch_evaluation_us_per_frame"],
        "svd_us_per_frame": svd,
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3),
        "peers": beside,
        "ratios": _ratios(ours, beside),
        "two_threads": gain,
        "limits": limits(in_c, gain),
    }


def _ratios(ours: dict[str, float], beside: dict[str, float]) -> dict[str, float]:
    """How many times longer each peer takes than the product's loop that does its work."""
    ratios = {}
    for name, seconds in beside.items():
        peer = name.removesuffix("_us_per_frame")
        work = peer[peer.index(UPDATE) :] if UPDATE in peer else LOOPS[peer.rsplit("_", 1)[-1]]
        ratios[peer] = seconds / ours[f"{work}_us_per_frame"]
    return ratios


def limits(times: dict[str, dict[str, float]], gain: float | None) -> dict[str, dict[str, Any]]:
    """Hold the figures against what is promised, the faster variant of C where there are two; null where nothing was measured."""
    found: dict[str, dict[str, Any]] = {}
    for work, seconds in times.items():
        in_c = [one for name, one in seconds.items() if name != "ours"]
        found[f"{work}_over_c"] = held(OVER_C, seconds["ours"] / min(in_c) if in_c else None)
    return found | {"two_threads": held(TWO_THREADS, gain, at_least=True)}


def _filter(arcs: ArcSet, x_0: FloatArray, free: IntArray, scale: FloatArray, method: str) -> None:
    """Run one of the product's filters as a sequential calibration does, taking the weights included."""
    pooled = pool_start(whiten_at(arcs, INVERTED_WANG, x_0), START_ARCS_PER_PARAMETER * len(free))
    FILTERS[method](pooled, start(x_0, len(free), START_SIGMA), free, scale, Tuning())


def _plain_filter(arcs: ArcSet, x_0: FloatArray, scale: FloatArray) -> None:
    pooled = pool_start(arcs, START_ARCS_PER_PARAMETER * len(x_0))
    peers.numpy_square_root_filter(pooled, x_0, scale, START_SIGMA, Tuning().linearisations, Tuning().rest)


def _peers(arcs: ArcSet, x_0: FloatArray, scale: FloatArray, report: Report) -> dict[str, float]:
    few, batched, slow = (
        arcs.frames(0, min(arcs.n_frames, most)) for most in (SLOWEST_PEER_FRAMES, BATCH_PEER_FRAMES, SLOW_PEER_FRAMES)
    )
    data, slow_data = (peers.EqualExposures.of(part, STARS) for part in (batched, slow))
    report(0.5, "peer: evaluation in batched NumPy")
    evaluation = fastest(lambda: peers.numpy_evaluation(data, x_0, scale), repeats=3)[0]
    report(0.55, "peer: scipy.optimize.least_squares")
    began = time.perf_counter()
    evaluations = peers.scipy_fit(data, x_0, scale)[1]
    fit = time.perf_counter() - began
    times = {
        "numpy_evaluation": evaluation / batched.n_frames,
        "scipy_evaluation": fit / evaluations / batched.n_frames,
        "scipy_fit": fit / batched.n_frames,
    }
    filters: dict[str, tuple[ArcSet, Callable[[], object]]] = {
        "numpy_sqrf": (few, lambda: _plain_filter(few, x_0, scale)),
        "numpy_lean_sqrf": (slow, lambda: peers.numpy_lean_square_root_filter(slow_data, x_0, scale, START_SIGMA)),
        "numpy_ekf": (slow, lambda: peers.numpy_extended_filter(slow_data, x_0, scale, START_SIGMA)),
    }
    for turn, (name, (part, run)) in enumerate(filters.items()):
        report(0.6 + 0.1 * turn, f"peer: {name}")
        times[name] = fastest(run, repeats=2)[0] / part.n_frames
    return {f"{name}_us_per_frame": seconds * 1e6 for name, seconds in times.items()}


def _beside_c(arcs: ArcSet, x_0: FloatArray, scale: FloatArray) -> dict[str, dict[str, float]]:
    """Time the evaluation and the filter with their C peers, seconds: `ours` and every variant of C that compiles."""
    free, pooled = np.arange(len(scale)), pool_start(arcs, START_ARCS_PER_PARAMETER * len(scale))
    begin = start(x_0, len(scale), START_SIGMA)
    with peers.compiled() as in_c:
        evaluation: dict[str, Callable[[], object]] = {
            "ours": partial(batch.normal_equations, arcs, x_0, free, scale),
            **{name: partial(peer.normal_equations, arcs, x_0, scale) for name, peer in in_c.items()},
        }
        sqrf: dict[str, Callable[[], object]] = {
            "ours": partial(FILTERS["sqrf"], pooled, begin, free, scale, Tuning()),
            **{name: partial(peer.square_root_filter, pooled, begin, scale, Tuning()) for name, peer in in_c.items()},
        }
        return {
            name: dict(zip(works, fastest(*works.values(), repeats=turns), strict=True))
            for name, works, turns in (("evaluation", evaluation, EVALUATION_TURNS), ("sqrf", sqrf, FILTER_TURNS))
        }


def _two_threads(arcs: ArcSet, x_0: FloatArray, scale: FloatArray) -> float | None:
    """How many times faster two threads evaluate a set of many blocks; None on one core."""
    if (os.cpu_count() or 1) < 2:
        return None
    alone = partial(batch.normal_equations, arcs, x_0, np.arange(len(scale)), scale)

    def together() -> None:
        with computing_on(2):
            alone()

    one, two = fastest(alone, together, repeats=THREAD_TURNS)
    return one / two


def _matching(frames: int, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """Time matching and one batch evaluation of `MATCHED_FRAMES` frames at most: microseconds a frame, ours and the peer's."""
    sensor, catalogue, n = st16_sensor(1), load_catalogue(None), min(frames, MATCHED_FRAMES)
    named = star_frames(n, sensor, st16_truth(1), catalogue, rng)
    names = np.zeros(len(named), np.int64) if named.star_id is None else named.star_id
    half = replace(named, star_id=np.where(rng.random(len(named)) < 0.5, 0, names))
    x, P = sensor.initial, ground_covariance(sensor, 10.0)
    matcher = Rematcher(half, sensor, catalogue, CalibrationSettings())
    matcher(x, P, slice(0, 2))
    arcs, free = build_problem(named, sensor, catalogue).whitened(x).whole(), np.arange(len(x))
    evaluation = partial(batch.normal_equations, arcs, x, free, sensor.typical_sigma)
    times = fastest(lambda: matcher(x, P), evaluation, repeats=MATCHING_TURNS)
    few = min(n, MATCHED_PEER_FRAMES)
    peer = _scipy_matching(select_rows(half, slice(0, few * EXPOSURES_A_FRAME * STARS)), sensor, catalogue)
    ours = {"match_us_per_frame": times[0] / n * 1e6, "match_batch_evaluation_us_per_frame": times[1] / n * 1e6}
    return ours, {"scipy_match_us_per_frame": peer / few * 1e6}


def _scipy_matching(telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue) -> float:
    """Seconds that the peer needs for a set; its directions are included, as they are in ours, its catalogue is not."""
    given = np.zeros(len(telemetry), np.int64) if telemetry.star_id is None else telemetry.star_id
    bright = np.flatnonzero(catalogue.magnitude <= ST16_MAGNITUDE_LIMIT)
    s_i = apparent_directions(catalogue, bright, np.full(len(bright), TIME), None)
    row_start, x = np.arange(0, len(telemetry) + 1, STARS), sensor.initial
    cone, camera = rematch.cone_rad(sensor, x), CAMERA_MODELS[sensor.camera_model]

    def run() -> None:
        s_d = camera.directions(x, telemetry.row_px, telemetry.col_px, sensor.pixel_pitch_m)
        peers.scipy_match(row_start, s_d, given, catalogue.hip[bright], s_i, cone, PEER_TOLERANCE_RAD)

    return fastest(run, repeats=2)[0]


def singular_updates(_catalogue_folder: Path | None = None, seed: int = 1) -> dict[int, dict[str, float]]:
    """Time the updates by number of stars: `compiled`, `plain` and `lean`, microseconds an exposure."""
    rng, found = np.random.default_rng(seed), {}
    for stars in WU_STARS:
        ways = updates(wu_field(np.full(WU_EXPOSURES, stars), rng))
        best = dict.fromkeys(ways, np.inf)
        for turn in range(WU_TURNS + 1):
            for way, each in ways.items():
                began = time.process_time()
                for update in each:
                    update()
                taken = (time.process_time() - began) / len(each) * 1e6
                best[way] = min(best[way], taken) if turn else np.inf  # the first turn loads what is needed
        found[stars] = best
    return found


def updates(arcs: ArcSet) -> dict[str, list[Update]]:
    """The update of each exposure in each way, rays computed beforehand."""
    sigma_rad = arcsets.angular_sigma(PINHOLE_RADIAL, WU_TRUTH, arcs)
    made: dict[str, list[Update]] = {"compiled": [], "plain": [], "lean": []}
    for k in range(arcs.n_frames):
        frame = Frame(arcs, k, sigma_rad)
        made["compiled"].append(_compiled(frame))
        s, D = PINHOLE_RADIAL.directions_and_jacobian(WU_TRUTH, frame.row_px, frame.col_px, arcs.pitch)
        given = ((frame.s_i, frame.sigma_rad), (s, D[..., WU_FREE] * WU_SCALE), np.zeros(len(WU_FREE)), PRIOR)
        made["plain"].append(partial(peers.plain_update, *given))
        made["lean"].append(partial(peers.lean_update, *given))
    return made


def _compiled(frame: Frame) -> Update:
    reference, (s, D) = SingularValues(CHOSEN, WU_FREE, WU_SCALE), frame.directions(WU_TRUTH)
    n = len(WU_FREE)

    def update() -> tuple[FloatArray, FloatArray]:
        z, posterior, P = np.zeros(n), np.empty_like(PRIOR), np.empty_like(PRIOR)
        reference.whiten(frame.star_start, frame.s_i, frame.sigma_rad)
        kernels.information_update(PRIOR, np.zeros(n), np.zeros(n), *reference.rows(s, D), z, posterior, P)
        return z, posterior

    return update
