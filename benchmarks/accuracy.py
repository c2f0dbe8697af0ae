"""Accuracy beside time: Boresight and its peers on the same simulated stars (part `accuracy`).

Every estimator starts from the ground calibration of the first ST-16 of E Table III and gets the same centroids of the same known
stars, several sets of them; `estimators` says what problem each solves. Three figures tell how right it is:

- `error_over_bound`: root mean square over the sets of each parameter's error over its Cramér-Rao bound, and of these the
  geometric mean over the eight parameters. One is perfection. Only for those that estimate the same parameters;
- `detector_px`, `corner_px`: how far the calibrated camera puts a star from where it falls, over the detector and in the worst
  corner, whatever its parameters are called (`detector_errors`);
- `focal_over_claimed`: the focal length's error over the standard deviation that the estimator claims for it. One is honest, a
  hundred is confidently wrong; NEES says the same of all parameters together, and should lie near eight.

`rms_px` is the residual that each is left with: by it alone the right and the wrong cannot be told apart.

A peer and the batch take turns, set by set, each in a process of its own whose linear algebra keeps to one thread: the ratio
`us_per_frame_over_ours` is over `ours_us_per_frame` of that peer's row. Before the clock starts the peer is loaded and run on the
first frames; its memory is what its work adds to that, its time that of the fastest set. A slow peer solves fewer sets: no more
once it has had `BUDGET_S`, and three at least; `sets` says how many.

`growth` is how time grows from one length of set to another: the exponent log(t_2/t_1) / log(n_2/n_1), both lengths taking turns
and the fastest of each. A peer that is fast enough gets `more_frames`, and its memory there; any other a quarter of its frames.
With fewer than `LEAST_GROWTH_FRAMES` on the short side constants decide, and nothing is said.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from benchmarks import Report, held
from benchmarks.estimators import PEERS, Answer, Directions
from benchmarks.stars import Views, simulated_views
from boresight.arrays import FloatArray
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import corners
from boresight.estimation.arcs import ArcSet
from boresight.estimation.statistics.consistency import nees
from boresight.estimation.statistics.cramer_rao import centroid_rows
from boresight.papers.processes import THREADS
from boresight.simulation.sensors import ST16_CENTROID_SIGMA_PX
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.sensors import Sensor

OURS = "boresight_batch"
#: Most that the batch may err over the bound: with a dozen sets the figure itself scatters by a tenth.
OVER_BOUND = 1.25
#: Most that it may err over the best of the peers on the same frames.
OVER_BEST_PEER = 1.1
NEES_CHANCE = 0.999
#: A peer that has computed so long solves no more sets, when it has solved the fewest that say something.
BUDGET_S, FEWEST_SETS = 10.0, 3
#: Longest that a peer may be expected to take over the longer set, all repeats together.
PATIENCE_S = 10.0
SHORTER, GROWTH_REPEATS = 4, 3
#: Fewest frames of the shorter set from which on an exponent is told.
LEAST_GROWTH_FRAMES = 100
WARMING_FRAMES = 6
GRID_ROWS, GRID_COLUMNS = 13, 17


def measure(
    report: Report, *, frames: int = 200, sets: int = 12, more_frames: int = 2000, peers: list[str] | None = None
) -> dict[str, Any]:
    """Run every installed peer on the same sets, or those named.

    A peer that cannot bear so many frames gets the first of them, and Boresight the same once more; a slow one solves fewer sets.
    """
    chosen = [OURS, *(name for name in peers or PEERS if name != OURS)]
    report(0.0, "simulating the sets")
    catalogue = load_catalogue(None)
    views = [simulated_views(frames, seed, catalogue) for seed in range(sets)]
    longer = simulated_views(more_frames, sets, catalogue)
    found = dict[str, dict[str, Any]]()
    for turn, name in enumerate(chosen):
        peer = PEERS[name]
        report(0.05 + 0.95 * turn / len(chosen), peer.title)
        described = {"title": peer.title, "problem": peer.problem, "unfair": peer.unfair}
        if not peer.installed:
            found[name] = described | {"missing": f"{peer.package} is not installed (pip install boresight[bench])"}
            continue
        part = [one.first(min(frames, peer.frames)) for one in views]
        summary, ours = _taking_turns(name, part)
        found[name] = described | summary | _beside(summary, ours) | _growth(name, summary, part[0], longer)
    return {
        "frames": frames, "sets": sets, "centroid_sigma_px": ST16_CENTROID_SIGMA_PX,
        "parameters": list(CAMERA_MODELS["inverted_wang"].parameter_names), "estimators": found, "limits": _limits(found, sets),
    }  # fmt: skip


def _limits(found: dict[str, dict[str, Any]], sets: int) -> dict[str, dict[str, Any]]:
    """What is promised of the batch: it meets the bound, claims what it errs, and no peer is nearer to the truth."""
    batch = found[OURS]
    beside = (row for name, row in found.items() if not name.startswith("boresight"))
    nearer = [1 / row["detector_px_over_ours"] for row in beside if "detector_px_over_ours" in row]
    limits = {
        "batch error over the Cramér-Rao bound": held(OVER_BOUND, batch["error_over_bound"]),
        "batch NEES of eight parameters": held(float(chi2.ppf(NEES_CHANCE, 8 * sets) / sets), batch["nees"]),
    }
    return limits | ({"batch error over the best peer's": held(OVER_BEST_PEER, max(nearer))} if nearer else {})


def _taking_turns(name: str, sets: list[Views]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Summaries of a peer and of the batch, which take turns on the same sets; the peer's time decides how many."""
    names = list(dict.fromkeys((name, OURS)))
    trials: dict[str, list[dict[str, Any]]] = {one: [] for one in names}
    with ExitStack() as stack:
        processes = {one: stack.enter_context(_a_process()) for one in names}
        for views in sets:
            for one in names:
                trials[one].append(processes[one].submit(trial, one, views).result())
            spent_s = sum(done["seconds"] or 0.0 for done in trials[name])
            if spent_s > BUDGET_S and len(trials[name]) >= FEWEST_SETS:
                break
    return _summary(trials[name]), _summary(trials[OURS])


@contextmanager
def _a_process() -> Iterator[ProcessPoolExecutor]:
    before = {key: os.environ.get(key) for key in (*THREADS, "NUMBA_NUM_THREADS")}
    os.environ |= dict.fromkeys(before, "1")
    try:
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            yield pool
    finally:
        for key, value in before.items():
            if value is None:
                del os.environ[key]
            else:
                os.environ[key] = value


def trial(name: str, views: Views) -> dict[str, Any]:
    """Run a peer on a set: seconds, memory in MB, and its errors; one that raises has failed, and says how."""
    estimator = PEERS[name].estimate
    _attempt(lambda: estimator(views.first(WARMING_FRAMES)))
    before, began = peak_rss_mb(), time.perf_counter()
    answer = _attempt(lambda: estimator(views))
    took, failed = time.perf_counter() - began, isinstance(answer, str)
    return {
        "frames": views.n_frames, "seconds": None if failed else took, "peak_rss_mb": peak_rss_mb(),
        "work_rss_mb": peak_rss_mb() - before, "errors": None if failed else _judged(answer, views),
        "failure": answer if failed else None,
    }  # fmt: skip


def _attempt(run: Callable[[], Any]) -> Any:
    """Result of a peer, or in words what it raised: libraries of others raise what they like."""
    try:
        return run()
    except Exception as error:  # noqa: BLE001 - a peer that fails is a finding, and stops no measurement
        return f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else 'no message'}"


def _judged(answer: Answer, views: Views) -> dict[str, Any]:
    """Errors of one answer: in pixels over the detector, of the focal length, and of the eight parameters where it has them."""
    detector_px, corner_px = detector_errors(answer.directions, views)
    focal_error_m = answer.focal_length_m - views.truth[0]
    found: dict[str, Any] = {
        "detector_px": detector_px, "corner_px": corner_px, "rms_px": answer.rms_px, "focal_error_m": focal_error_m,
        "focal_over_claimed": None if answer.focal_sigma_m is None else focal_error_m / answer.focal_sigma_m,
        "notes": answer.notes,
    }  # fmt: skip
    if answer.x is not None:
        error = answer.x - views.truth
        bound = cramer_rao(views.arcs, views.sensor, views.truth)
        found |= {"error": error.tolist(), "over_bound": (error / bound).tolist()}
        if answer.P is not None:
            found["nees"] = nees(error / views.sensor.typical_sigma, answer.P)
    return found


def peak_rss_mb(process: int | str = "self") -> float:
    """Largest resident memory of a process so far, MB.

    Read from the memory map itself where the system tells: `getrusage` of a child begins with what its parent held.
    """
    status = Path(f"/proc/{process}/status")
    if status.exists():
        line = next(line for line in status.read_text(encoding="utf-8").splitlines() if line.startswith("VmHWM"))
        return float(line.split()[1]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def _summary(trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Root mean squares over the sets that were answered; what the trials' work adds to their one process adds up."""
    errors = [done["errors"] for done in trials if done["errors"] is not None]
    summary: dict[str, Any] = {
        "frames": trials[0]["frames"],
        "sets": len(trials),
        "peak_rss_mb": trials[-1]["peak_rss_mb"],
        "work_rss_mb": sum(done["work_rss_mb"] for done in trials),
        "failures": [done["failure"] for done in trials if done["failure"] is not None],
    }
    if not errors:
        return summary
    fastest_s = min(done["seconds"] for done in trials if done["seconds"] is not None)
    summary["us_per_frame"] = fastest_s / summary["frames"] * 1e6
    for key in ("detector_px", "corner_px", "focal_error_m", "focal_over_claimed", "rms_px"):
        if errors[0][key] is not None:
            value = float(_root_mean_square(errors, key))
            summary[key] = value if np.isfinite(value) else None
    if "error" in errors[0]:
        over = _root_mean_square(errors, "over_bound")
        summary["error"] = _root_mean_square(errors, "error").tolist()
        summary["error_over_bound"] = float(np.exp(np.mean(np.log(over))))
        summary["each_over_bound"] = over.tolist()
    if "nees" in errors[0]:
        summary["nees"] = float(np.mean([one["nees"] for one in errors]))
    return summary | {"notes": errors[-1]["notes"]}


def _root_mean_square(errors: list[dict[str, Any]], key: str) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(np.square([one[key] for one in errors]), axis=0)))


def _beside(summary: dict[str, Any], ours: dict[str, Any]) -> dict[str, Any]:
    """The batch on the same frames, and ratios to it."""
    keys = ("us_per_frame", "detector_px", "work_rss_mb")
    ratios = {f"{key}_over_ours": summary[key] / ours[key] for key in keys if summary.get(key) and ours.get(key)}
    return {"ours_us_per_frame": ours["us_per_frame"]} | ratios


def _growth(name: str, summary: dict[str, Any], views: Views, longer: Views) -> dict[str, Any]:
    """Exponent of time between two lengths of set; nothing of a peer that failed or bears too few frames."""
    if "us_per_frame" not in summary:
        return {}
    expected_s = GROWTH_REPEATS * summary["us_per_frame"] * 1e-6 * longer.n_frames
    patient = expected_s < PATIENCE_S and PEERS[name].frames >= longer.n_frames
    lengths = (views, longer) if patient else (views.first(max(1, views.n_frames // SHORTER)), views)
    if lengths[0].n_frames < LEAST_GROWTH_FRAMES or lengths[0].n_frames >= lengths[1].n_frames:
        return {}
    with _a_process() as process:
        turns = [[process.submit(trial, name, one).result() for one in lengths] for _ in range(GROWTH_REPEATS)]
    small, large = (_summary(list(done)) for done in zip(*turns, strict=True))
    if "us_per_frame" not in small or "us_per_frame" not in large:
        return {}
    grown = np.log(large["us_per_frame"] / small["us_per_frame"]) / np.log(large["frames"] / small["frames"])
    return {
        "growth": {
            "from_frames": small["frames"], "to_frames": large["frames"], "exponent": 1 + float(grown),
            "us_per_frame": large["us_per_frame"], "work_rss_mb": large["work_rss_mb"],
        }
    }  # fmt: skip


def cramer_rao(arcs: ArcSet, sensor: Sensor, truth: FloatArray) -> FloatArray:
    """Standard deviations (n_parameters,) that no unbiased estimate from these centroids can beat, SI, all parameters free.

    The bound knows nothing of arcs: it is the Fisher information of the centroids with each exposure's attitude as nuisance.
    """
    scale = sensor.typical_sigma
    rows = centroid_rows(CAMERA_MODELS[sensor.camera_model], truth, arcs, np.arange(len(truth)), scale)
    return np.asarray(scale * np.sqrt(np.diag(np.linalg.inv(rows.information))))


def detector_errors(directions: Directions, views: Views) -> tuple[float, float]:
    """Root mean square error over the detector and the worst corner's, pixels; infinite where the estimate sees nothing.

    What a camera says of a pixel is a direction, and an attitude is estimated with every exposure: so the directions d^ of a grid
    of pixels under the estimate are turned by the one rotation C that brings them nearest to the true ones (Wahba, even weights),
    and what is left is projected by the truth,

        error = project(truth, C d^) - pixel.

    That is what a star tracker with this calibration would have wrong, noise apart.
    """
    sensor = views.sensor
    side = [np.linspace(-0.5, n - 0.5, m) for n, m in ((sensor.rows, GRID_ROWS), (sensor.columns, GRID_COLUMNS))]
    inside = (each.ravel() for each in np.meshgrid(*side, indexing="ij"))
    row, col = (np.concatenate(each) for each in zip(inside, corners(sensor.rows, sensor.columns), strict=True))
    found = directions(row, col)
    if not np.isfinite(found).all():
        return np.inf, np.inf
    true = views.camera.directions(views.truth, row, col, sensor.pixel_pitch_m)
    U, _, Vt = np.linalg.svd(true.T @ found)
    C = U @ np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt
    again = views.camera.project(views.truth, found @ C.T, sensor.pixel_pitch_m)
    error = np.hypot(again[0] - row, again[1] - col)
    error = np.where(np.isfinite(error), error, np.inf)
    return float(np.sqrt(np.mean(error[:-4] ** 2))), float(error[-4:].max())
