"""How time and memory grow with a set, from a thousand frames to a million.

Each set is a Parquet file that `boresight calibrate` takes in a fresh process, everything counted: starting, reading, ordering,
estimating, judging, writing. Memory is what the kernel says of that process when it has ended (`ru_maxrss`: the most that was
resident, mapped files included). The exponent of growth is the slope of log time over log frames, by least squares over all sizes
and between neighbours; what a process costs before it computes makes it smaller at the small end, so it is held against its limit
three times:

    over all sizes               as a user waits, starting included
    between the two largest      where starting is a small part
    beyond starting              of t(n) - t(0), t(0) the fastest process that calibrates `EMPTY_FRAMES` frames, over the sizes
                                 that take twice as long as that or longer

The sets have directions (`given`). The default of the command finds the stars anew (`rematch`): sets of catalogue stars with times
and without directions are calibrated so as well, of fewer sizes.
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
from numpy.typing import NDArray

from boresight.measurements.synthetic_file import write_synthetic
from boresight.measurements.whole_calibration import repeated_fields
from boresight.settings import read_settings
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.readers import write_parquet
from boresight.telemetry.sensors import sensor_document

SIZES = (1_000, 10_000, 100_000, 1_000_000)
REMATCH_SIZES = (10_000, 100_000)
METHODS = ("batch", "sqrf")
EMPTY_FRAMES, EMPTY_RUNS = 24, 3
#: From how many times the empty process's seconds on a size tells what is beyond starting.
BEYOND = 2.0
EXPONENT_LIMIT = 1.05
MEMORY_LIMIT_MB = 1500.0
#: Most that memory may grow from the set of this size to the largest.
FLAT_FROM, FLAT_LIMIT = 100_000, 1.1


def measure(
    report: Callable[[float, str], None],
    *,
    sizes: Sequence[int] = SIZES,
    methods: Sequence[str] = METHODS,
    rematch_sizes: Sequence[int] = REMATCH_SIZES,
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
    rematch_sizes
        Frames of each set whose stars are found anew, ascending; the first estimator takes them.
    seed
        Of the sets.
    """
    found: dict[str, list[dict[str, Any]]] = {method: [] for method in methods}
    with tempfile.TemporaryDirectory(prefix="boresight-growth-") as folder:
        sensor = Path(folder) / "sensor.json"
        sensor.write_bytes(orjson.dumps(sensor_document(st16_sensor(1))))
        report(0.0, "a process with next to nothing to compute")
        empty = _empty(Path(folder), sensor, methods[0], seed)
        for frames in sizes:
            done = 0.8 * sum(sizes[: sizes.index(frames)]) / sum(sizes)
            report(done, f"writing {frames:,} frames")
            path = Path(folder) / f"{frames}.parquet"
            write_synthetic(path, frames, seed)
            for method in methods:
                report(done, f"calibrating {frames:,} frames, {method}")
                found[method].append(_calibrated(path, sensor, method, frames))
            path.unlink()
        matched = [
            _rematched(report, Path(folder) / f"stars-{n}.parquet", sensor, methods[0], n, seed) for n in rematch_sizes
        ]
    by_method = {method: _growth(rows, empty) for method, rows in found.items()}
    limits = _limits(found, by_method)
    if len(matched) > 1:
        limits["rematch_exponent"] = _limit(EXPONENT_LIMIT, _growth(matched)["exponent"])
    return {"empty_s": empty, "runs": found, "growth": by_method, "rematch": matched, "limits": limits}


def _empty(folder: Path, sensor: Path, method: str, seed: int) -> float:
    """Seconds of the fastest process that starts, loads everything and has next to nothing to calibrate."""
    path = folder / "empty.parquet"
    write_synthetic(path, EMPTY_FRAMES, seed)
    return min(float(_calibrated(path, sensor, method, EMPTY_FRAMES)["seconds"]) for _ in range(EMPTY_RUNS))


def _rematched(
    report: Callable[[float, str], None], path: Path, sensor: Path, method: str, frames: int, seed: int
) -> dict[str, Any]:
    """Calibrate a set of catalogue stars whose stars are found anew."""
    report(0.9, f"calibrating {frames:,} frames, matched anew")
    catalogue = load_catalogue(read_settings().catalogue_folder)
    write_parquet(repeated_fields(frames, st16_sensor(1), catalogue, seed), path)
    found = _calibrated(path, sensor, method, frames, match="rematch")
    path.unlink()
    return found


def _calibrated(path: Path, sensor: Path, method: str, frames: int, match: str = "given") -> dict[str, Any]:
    """Calibrate one file in a fresh process and say what it took."""
    answer = path.with_suffix(".json")
    words = ("calibrate", path, "--sensor", sensor, "--match", match, "--method", method, "--json", answer)
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


def _growth(rows: Sequence[dict[str, Any]], empty_s: float = 0.0) -> dict[str, Any]:
    """Exponents of time over frames: as it is, between neighbours, and of what is beyond an empty process."""
    n, t = (np.log([row[key] for row in rows]) for key in ("frames", "seconds"))
    beyond = [(row["frames"], row["seconds"] - empty_s) for row in rows if row["seconds"] > BEYOND * empty_s]
    return {
        "exponent": _slope(n, t),
        "between_neighbours": [float((t[k] - t[j]) / (n[k] - n[j])) for j, k in pairwise(range(len(rows)))],
        "exponent_beyond_start": _slope(*np.log(beyond).T) if len(beyond) > 1 else None,
    }


def _slope(n: NDArray[np.float64], t: NDArray[np.float64]) -> float | None:
    """Slope by least squares; None of one point."""
    return float(np.polyfit(n, t, 1)[0]) if len(n) > 1 else None


def _limits(found: dict[str, list[dict[str, Any]]], growth: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Hold the figures against what is promised."""
    limits: dict[str, Any] = {}
    for method, rows in found.items():
        grown, tells = growth[method], len(rows) > 1 and rows[-2]["frames"] >= FLAT_FROM
        limits[f"{method}_exponent"] = _limit(EXPONENT_LIMIT, grown["exponent"])
        limits[f"{method}_exponent_of_the_two_largest"] = _limit(
            EXPONENT_LIMIT, grown["between_neighbours"][-1] if tells else None
        )
        limits[f"{method}_exponent_beyond_start"] = _limit(EXPONENT_LIMIT, grown["exponent_beyond_start"])
        limits[f"{method}_peak"] = _limit(MEMORY_LIMIT_MB, rows[-1]["peak_mb"]) | {"unit": "MB"}
        large = [row["peak_mb"] for row in rows if row["frames"] >= FLAT_FROM]
        limits[f"{method}_peak_growth"] = _limit(FLAT_LIMIT, large[-1] / large[0] if len(large) > 1 else None)
    return limits


def _limit(limit: float, measured: float | None) -> dict[str, Any]:
    """A limit and what was measured, which is null where these sizes do not tell."""
    return {"limit": limit, "measured": measured, "kept": None if measured is None else measured <= limit}
