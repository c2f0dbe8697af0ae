"""One peer on several sets, in a process of its own: how long, how much memory, and how far from the truth.

The process keeps linear algebra to one thread. Before the clock starts the peer is loaded and run on the first frames, so that
neither imports nor compiling are counted; its memory is what its work adds to that. The time is that of the fastest set.
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from boresight.estimation.consistency import nees
from boresight.measurements.bound import cramer_rao
from boresight.measurements.detector_errors import detector_errors
from boresight.measurements.peers import PEERS, Answer
from boresight.measurements.views import Views

WARMING_FRAMES = 6


def trial(name: str, sets: list[Views]) -> dict[str, Any]:
    """Run a peer on every set; one that raises on a set has failed there, and says how.

    Returns
    -------
    Seconds of each set, memory in MB, and `errors`, one mapping a set that it answered, see `_judged`.
    """
    estimator = PEERS[name].estimator()
    _attempt(lambda: estimator(sets[0].first(WARMING_FRAMES)))
    before = peak_rss_mb()
    seconds, judged, failures = list[float](), list[dict[str, Any]](), list[str]()
    for views in sets:
        began = time.perf_counter()
        answer = _attempt(lambda views=views: estimator(views))
        took = time.perf_counter() - began
        if isinstance(answer, str):
            failures.append(answer)
            continue
        seconds.append(took)
        judged.append(_judged(answer, views))
    return {
        "frames": sets[0].n_frames, "sets": len(sets), "seconds": seconds, "peak_rss_mb": peak_rss_mb(),
        "work_rss_mb": peak_rss_mb() - before, "errors": judged, "failures": failures,
    }  # fmt: skip


def merged(trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Several trials of one peer in one process as one: what their work adds to it adds up, and its peak is the last."""
    lists = {key: [one for found in trials for one in found[key]] for key in ("seconds", "errors", "failures")}
    sums = {key: sum(found[key] for found in trials) for key in ("sets", "work_rss_mb")}
    return {"frames": trials[0]["frames"], "peak_rss_mb": trials[-1]["peak_rss_mb"]} | lists | sums


def _attempt(run: Any) -> Any:
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
        found |= {
            "error": error.tolist(),
            "over_bound": (error / cramer_rao(views.arcs, views.sensor, views.truth)).tolist(),
        }
        if answer.P is not None:
            found["nees"] = nees(error / views.sensor.typical_sigma, answer.P)
    return found


def peak_rss_mb() -> float:
    """Largest resident memory of this process so far, MB.

    Read from the memory map itself where the system tells: `getrusage` of a child begins with what its parent held.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text(encoding="utf-8").splitlines() if line.startswith("VmHWM"))
        return float(line.split()[1]) * 1024 / 1e6
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def root_mean_square(values: list[float]) -> float:
    """Root mean square; infinite where one value is, NaN of none."""
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")
