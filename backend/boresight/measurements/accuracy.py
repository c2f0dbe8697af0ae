"""Accuracy beside time: Boresight and its peers on the same simulated stars (`boresight bench --part accuracy`).

Every estimator starts from the ground calibration of the first ST-16 of E Table III and gets the same centroids of the same known
stars, several sets of them; `peers` says what problem each solves. Three figures tell how right it is:

- `error_over_bound`: root mean square over the sets of each parameter's error over its Cramér-Rao bound, and of these the
  geometric mean over the eight parameters. One is perfection. Only for those that estimate the same parameters;
- `detector_px`, `corner_px`: how far the calibrated camera puts a star from where it falls, over the detector and in the worst
  corner, whatever its parameters are called (`detector_errors`);
- `focal_over_claimed`: the focal length's error over the standard deviation that the estimator claims for it. One is honest, a
  hundred is confidently wrong; NEES says the same of all parameters together, and should lie near eight.

`rms_px` is the residual that each is left with: by it alone the right and the wrong cannot be told apart.

A peer and the batch take turns, set by set, each in a process of its own, so that what else the machine does meets both: the
ratio `us_per_frame_over_ours` is over `ours_us_per_frame` of that peer's row, the batch on the same frames in the same minutes.
A slow peer solves fewer sets: no more once it has had `BUDGET_S`, and three at least; `sets` says how many.

`growth` is how time grows from one length of set to another: the exponent log(t_2/t_1) / log(n_2/n_1), both lengths taking turns
and the fastest of each. A peer that is fast enough gets `more_frames`, and its memory there; any other a quarter of its frames.
With fewer than `LEAST_GROWTH_FRAMES` on the short side constants decide, and nothing is said.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
from scipy.stats import chi2

from boresight.estimation.cameras import CAMERA_MODELS
from boresight.measurements import Report
from boresight.measurements.peers import PEERS
from boresight.measurements.peers.trial import merged, root_mean_square, trial
from boresight.measurements.views import Views, simulated_views
from boresight.simulation.sensors import ST16_CENTROID_SIGMA_PX
from boresight.sky.catalogue import load_catalogue
from boresight.studies.processes import THREADS

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


def measure(
    report: Report, frames: int = 200, sets: int = 12, more_frames: int = 2000, peers: list[str] | None = None
) -> dict[str, Any]:
    """Run every installed peer on the same sets.

    Parameters
    ----------
    report
        Told the fraction done and what is measured next.
    frames
        Frames a set; a peer that cannot bear so many gets the first of them, and Boresight the same once more.
    sets
        Simulated sets; slow peers solve fewer.
    more_frames
        Frames of the one longer set.
    peers
        Names of those to run, all by default.
    """
    chosen = [OURS, *(name for name in peers or PEERS if name != OURS)]
    report(0.0, "simulating the sets")
    catalogue = load_catalogue(None)
    views = [simulated_views(frames, seed, catalogue) for seed in range(sets)]
    longer = simulated_views(more_frames, sets, catalogue)
    found = dict[str, dict[str, Any]]()
    for turn, name in enumerate(chosen):
        report(0.05 + 0.95 * turn / len(chosen), PEERS[name].title)
        if not PEERS[name].installed:
            found[name] = _described(name) | {
                "missing": f"{_package(name)} is not installed (pip install boresight[bench])"
            }
            continue
        size = min(frames, PEERS[name].frames)
        part = [one.first(size) for one in views]
        summary, ours = _taking_turns(name, part)
        found[name] = _described(name) | summary | _beside(summary, ours) | _growth(name, summary, part[0], longer)
    return {
        "frames": frames, "sets": sets, "centroid_sigma_px": ST16_CENTROID_SIGMA_PX,
        "parameters": list(CAMERA_MODELS["inverted_wang"].parameter_names), "estimators": found, "limits": _limits(found, sets),
    }  # fmt: skip


def _described(name: str) -> dict[str, Any]:
    peer = PEERS[name]
    return {"title": peer.title, "problem": peer.problem, "unfair": peer.unfair}


def _package(name: str) -> str:
    needs = PEERS[name].needs
    return needs[1] if needs else name


def _taking_turns(name: str, sets: list[Views]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Summaries of a peer and of the batch, which take turns on the same sets; the peer's time decides how many."""
    names = list(dict.fromkeys((name, OURS)))
    trials: dict[str, list[dict[str, Any]]] = {one: [] for one in names}
    with ExitStack() as stack:
        processes = {one: stack.enter_context(_a_process()) for one in names}
        for views in sets:
            for one in names:
                trials[one].append(processes[one].submit(trial, one, [views]).result())
            spent_s = sum(sum(done["seconds"]) for done in trials[name])
            if spent_s > BUDGET_S and len(trials[name]) >= FEWEST_SETS:
                break
    return _summary(merged(trials[name])), _summary(merged(trials[OURS]))


@contextmanager
def _a_process() -> Iterator[ProcessPoolExecutor]:
    """Open a process for trials, whose linear algebra keeps to one thread."""
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


def _summary(found: dict[str, Any]) -> dict[str, Any]:
    """Root mean squares over the sets that were answered."""
    errors, size = found["errors"], found["frames"]
    summary: dict[str, Any] = {key: found[key] for key in ("frames", "sets", "peak_rss_mb", "work_rss_mb")}
    summary["failures"] = found["failures"]
    if not errors:
        return summary
    summary["us_per_frame"] = min(found["seconds"]) / size * 1e6
    for key in ("detector_px", "corner_px", "focal_error_m", "focal_over_claimed", "rms_px"):
        if errors[0][key] is not None:
            value = root_mean_square([one[key] for one in errors])
            summary[key] = value if np.isfinite(value) else None
    if "error" in errors[0]:
        over = np.sqrt(np.mean(np.square([one["over_bound"] for one in errors]), axis=0))
        summary["error"] = np.sqrt(np.mean(np.square([one["error"] for one in errors]), axis=0)).tolist()
        summary["error_over_bound"] = float(np.exp(np.mean(np.log(over))))
        summary["each_over_bound"] = over.tolist()
    if "nees" in errors[0]:
        summary["nees"] = float(np.mean([one["nees"] for one in errors]))
    return summary | {"notes": errors[-1]["notes"]}


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
    turns: tuple[list[dict[str, Any]], list[dict[str, Any]]] = ([], [])
    with _a_process() as process:
        for _ in range(GROWTH_REPEATS):
            for done, one in zip(turns, lengths, strict=True):
                done.append(process.submit(trial, name, [one]).result())
    small, large = (_summary(merged(done)) for done in turns)
    if "us_per_frame" not in small or "us_per_frame" not in large:
        return {}
    n = large["frames"] / small["frames"]
    exponent = 1 + float(np.log(large["us_per_frame"] / small["us_per_frame"]) / np.log(n))
    return {
        "growth": {
            "from_frames": small["frames"], "to_frames": large["frames"], "exponent": exponent,
            "us_per_frame": large["us_per_frame"], "work_rss_mb": large["work_rss_mb"],
        }
    }  # fmt: skip


def _limits(found: dict[str, dict[str, Any]], sets: int) -> dict[str, dict[str, Any]]:
    """What is promised of the batch: it meets the bound, claims what it errs, and no peer is nearer to the truth."""
    batch = found[OURS]
    most_nees = float(chi2.ppf(NEES_CHANCE, 8 * sets) / sets)
    beside = (row for name, row in found.items() if not name.startswith("boresight"))
    nearer = [1 / row["detector_px_over_ours"] for row in beside if "detector_px_over_ours" in row]
    limits = {
        "batch error over the Cramér-Rao bound": _limit(OVER_BOUND, batch["error_over_bound"]),
        "batch NEES of eight parameters": _limit(most_nees, batch["nees"]),
    }
    if nearer:
        limits["batch error over the best peer's"] = _limit(OVER_BEST_PEER, max(nearer))
    return limits


def _limit(limit: float, measured: float) -> dict[str, Any]:
    return {"limit": limit, "measured": measured, "kept": measured <= limit}
