"""How time and memory grow with a set, from a thousand frames to a million.

Each set is a Parquet file that `boresight calibrate` takes in a fresh process, everything counted: starting, reading, ordering,
estimating, judging, writing. Memory is what the kernel says of that process when it has ended (`ru_maxrss`: the most that was
resident, mapped files included). The exponent of growth is the slope of log time over log frames, by least squares over all sizes
and between neighbours; what a process costs before it computes makes it smaller at the small end, so the neighbours at the large
end are the ones to look at.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from boresight.measurements.synthetic_file import write_synthetic
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document

SIZES = (1_000, 10_000, 100_000, 1_000_000)
METHODS = ("batch", "sqrf")
EXPONENT_LIMIT = 1.05
MEMORY_LIMIT_MB = 1500.0
#: Most that memory may grow from the set of this size to the largest.
FLAT_FROM, FLAT_LIMIT = 100_000, 1.1


def measure(
    report: Callable[[float, str], None],
    *,
    sizes: Sequence[int] = SIZES,
    methods: Sequence[str] = METHODS,
    seed: int = 1,
) -> dict[str, Any]:
    """Calibrate sets of several sizes, each in a fresh process.

    Parameters
    ----------
    report
        Told the fraction done and what is measured next.
    sizes
        Frames of each set, ascending.
    methods
        Estimators.
    seed
        Of the sets.
    """
    found: dict[str, list[dict[str, Any]]] = {method: [] for method in methods}
    with tempfile.TemporaryDirectory(prefix="boresight-growth-") as folder:
        sensor = Path(folder) / "sensor.json"
        sensor.write_bytes(orjson.dumps(sensor_document(st16_sensor(1))))
        for frames in sizes:
            done = sum(sizes[: sizes.index(frames)]) / sum(sizes)
            report(done, f"writing {frames:,} frames")
            path = Path(folder) / f"{frames}.parquet"
            write_synthetic(path, frames, seed)
            for method in methods:
                report(done, f"calibrating {frames:,} frames, {method}")
                found[method].append(_calibrated(path, sensor, method, frames))
            path.unlink()
    by_method = {method: _growth(rows) for method, rows in found.items()}
    return {"runs": found, "growth": by_method, "limits": _limits(found, by_method)}


def _calibrated(path: Path, sensor: Path, method: str, frames: int) -> dict[str, Any]:
    """Calibrate one file in a fresh process and say what it took."""
    answer = path.with_suffix(".json")
    words = ("calibrate", path, "--sensor", sensor, "--match", "given", "--method", method, "--json", answer)
    began = time.perf_counter()
    process = subprocess.Popen(  # noqa: S603 - words of our own
        [sys.executable, "-m", "boresight", *map(str, words)], stdout=subprocess.DEVNULL, cwd=path.parent
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    seconds = time.perf_counter() - began
    document = orjson.loads(answer.read_bytes())
    answer.unlink()
    return {
        "frames": frames,
        "seconds": seconds,
        "processor_s": used.ru_utime + used.ru_stime,
        "peak_mb": used.ru_maxrss / (1024.0**2 if sys.platform == "darwin" else 1024.0),
        "status": document["status"],
        "timing_s": document["timing_s"],
    }


def _growth(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Exponents of time over frames."""
    n, t = (np.log([row[key] for row in rows]) for key in ("frames", "seconds"))
    return {
        "exponent": float(np.polyfit(n, t, 1)[0]) if len(rows) > 1 else None,
        "between_neighbours": [float((t[k] - t[j]) / (n[k] - n[j])) for j, k in pairwise(range(len(rows)))],
    }


def _limits(found: dict[str, list[dict[str, Any]]], growth: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Hold the figures against what is promised."""
    limits: dict[str, Any] = {}
    for method, rows in found.items():
        limits[f"{method}_exponent"] = _limit(EXPONENT_LIMIT, growth[method]["exponent"])
        limits[f"{method}_peak"] = _limit(MEMORY_LIMIT_MB, rows[-1]["peak_mb"]) | {"unit": "MB"}
        large = [row["peak_mb"] for row in rows if row["frames"] >= FLAT_FROM]
        limits[f"{method}_peak_growth"] = _limit(FLAT_LIMIT, large[-1] / large[0] if len(large) > 1 else None)
    return limits


def _limit(limit: float, measured: float | None) -> dict[str, Any]:
    """A limit and what was measured, which is null where these sizes do not tell."""
    return {"limit": limit, "measured": measured, "kept": None if measured is None else measured <= limit}
