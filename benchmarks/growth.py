"""Fresh processes of `boresight calibrate`: how time and memory grow with a set, and what a process pays before it computes.

**Growth** (part `growth`). Each set is a Parquet file that is calibrated in a fresh process, everything counted: starting,
reading, ordering, estimating, judging, writing. Memory is what the kernel says of that process when it has ended (`ru_maxrss`: the
most that was resident, mapped files included). The exponent of growth is the slope of log time over log frames, by least squares
over all sizes and between neighbours; what a process costs before it computes makes it smaller at the small end, so it is held
against its limit three times:

    over all sizes               as a user waits, starting included
    between the two largest      where starting is a small part
    beyond starting              of t(n) - t(0), t(0) the fastest process that calibrates `EMPTY_FRAMES` frames, over the sizes
                                 that take twice as long as that or longer

The sets have directions (`given`). The default of the command finds the stars again (`rematch`): sets of catalogue stars with times
and without directions are calibrated so as well, of fewer sizes.

**Fresh** (part `fresh`). The same calibration is run twice in one new process. The first is counted from before the interpreter
starts to the answer, the second is what a warm process takes; the difference is what the user of a command waits for besides. It is
measured with the loops compiled, as `boresight warm` or any run leaves them, and told for an empty cache: once an installation.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from benchmarks import Report, held
from benchmarks.servers import COMMAND
from benchmarks.stars import repeated_fields, write_synthetic
from boresight.arrays import FloatArray
from boresight.settings import read_settings
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_parquet

SIZES, REMATCH_SIZES = (1_000, 10_000, 100_000, 1_000_000), (10_000, 100_000)
METHODS = ("batch", "sqrf")
EMPTY_FRAMES, EMPTY_RUNS = 24, 3
#: From how many times the empty process's seconds on a size tells what is beyond starting.
BEYOND = 2.0
EXPONENT_LIMIT = 1.05
MEMORY_LIMIT_MB = 1500.0
#: Most that memory may grow from the set of this size to the largest.
FLAT_FROM, FLAT_LIMIT = 100_000, 1.1
#: Seconds that the first calibration of a fresh process may take beyond a warm one.
FRESH_LIMIT_S = 2.0
#: Runs a command twice in one process, and reads the clocks of the machine and of the process after each.
TWICE = """
import json, sys, time
from boresight.cli import main
marks = []
for _ in range(2):
    main(sys.argv[1:], standalone_mode=False)
    marks.append((time.monotonic(), time.process_time()))
print("\\n" + json.dumps(marks))
"""


def measure(
    report: Report,
    *,
    sizes: Sequence[int] = SIZES,
    methods: Sequence[str] = METHODS,
    rematch_sizes: Sequence[int] = REMATCH_SIZES,
    seed: int = 1,
) -> dict[str, Any]:
    """Calibrate sets of ascending sizes, each in a fresh process; the first method takes those that are matched again."""
    found: dict[str, list[dict[str, Any]]] = {method: [] for method in methods}
    matched = []
    with tempfile.TemporaryDirectory(prefix="boresight-growth-") as place:
        path = Path(place) / "set.parquet"
        (path.parent / "sensor.json").write_bytes(orjson.dumps(sensor_document(st16_sensor(1))))
        report(0.0, "a process with next to nothing to compute")
        write_synthetic(path, EMPTY_FRAMES, seed)
        empty_s = min(_calibrated(path, methods[0], EMPTY_FRAMES)["seconds"] for _ in range(EMPTY_RUNS))
        for frames in sizes:
            done = 0.8 * sum(sizes[: sizes.index(frames)]) / sum(sizes)
            report(done, f"writing {frames:,} frames")
            write_synthetic(path, frames, seed)
            for method in methods:
                report(done, f"calibrating {frames:,} frames, {method}")
                found[method].append(_calibrated(path, method, frames))
        for frames in rematch_sizes:
            report(0.9, f"calibrating {frames:,} frames, matched again")
            catalogue = load_catalogue(read_settings().catalogue_folder)
            write_parquet(repeated_fields(frames, st16_sensor(1), catalogue, seed), path)
            matched.append(_calibrated(path, methods[0], frames, match="rematch"))
    grown = {method: growth(rows, empty_s) for method, rows in found.items()}
    limits = limits_of_growth(found, grown)
    if len(matched) > 1:
        limits["rematch_exponent"] = held(EXPONENT_LIMIT, growth(matched)["exponent"])
    return {"empty_s": empty_s, "runs": found, "growth": grown, "rematch": matched, "limits": limits}


def _calibrated(path: Path, method: str, frames: int, match: str = "given") -> dict[str, Any]:
    """Calibrate one file in a fresh process and say what it took."""
    answer = path.with_suffix(".json")
    words = [
        "calibrate",
        path.name,
        "--sensor",
        "sensor.json",
        "--match",
        match,
        "--method",
        method,
        "--json",
        answer.name,
    ]
    began = time.perf_counter()
    process = subprocess.Popen([*COMMAND, *words], stdout=subprocess.DEVNULL, cwd=path.parent)
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


def growth(rows: Sequence[dict[str, Any]], empty_s: float = 0.0) -> dict[str, Any]:
    """Exponents of time over frames: as it is, between neighbours, and of what is beyond an empty process."""
    n, t = (np.log([row[key] for row in rows]) for key in ("frames", "seconds"))
    beyond = [(row["frames"], row["seconds"] - empty_s) for row in rows if row["seconds"] > BEYOND * empty_s]
    return {
        "exponent": _slope(n, t),
        "between_neighbours": [float((t[k] - t[j]) / (n[k] - n[j])) for j, k in pairwise(range(len(rows)))],
        "exponent_beyond_start": _slope(*np.log(beyond).T) if len(beyond) > 1 else None,
    }


def _slope(n: FloatArray, t: FloatArray) -> float | None:
    return float(np.polyfit(n, t, 1)[0]) if len(n) > 1 else None


def limits_of_growth(found: dict[str, list[dict[str, Any]]], grown: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Hold the figures against what is promised; what these sizes do not tell is null."""
    limits: dict[str, Any] = {}
    for method, rows in found.items():
        of, tells = grown[method], len(rows) > 1 and rows[-2]["frames"] >= FLAT_FROM
        large = [row["peak_mb"] for row in rows if row["frames"] >= FLAT_FROM]
        last = of["between_neighbours"][-1] if tells else None
        limits |= {
            f"{method}_exponent": held(EXPONENT_LIMIT, of["exponent"]),
            f"{method}_exponent_of_the_two_largest": held(EXPONENT_LIMIT, last),
            f"{method}_exponent_beyond_start": held(EXPONENT_LIMIT, of["exponent_beyond_start"]),
            f"{method}_peak": held(MEMORY_LIMIT_MB, rows[-1]["peak_mb"], "MB"),
            f"{method}_peak_growth": held(FLAT_LIMIT, large[-1] / large[0] if len(large) > 1 else None),
        }
    return limits


def measure_fresh(
    report: Report, *, frames: int = 2000, repeats: int = 3, uncompiled: bool = True, seed: int = 1
) -> dict[str, Any]:
    """Calibrate twice in each of several new processes; the fastest of each counts.

    With `uncompiled` it also starts with an empty cache of loops, a minute or so, and leaves this installation's alone. Without
    it the loops come from that cache, and a process before the first measured one sees that they are there.
    """
    with tempfile.TemporaryDirectory(prefix="boresight-fresh-") as folder:
        place = Path(folder)
        (place / "sensor.json").write_bytes(orjson.dumps(sensor_document(st16_sensor(1))))
        write_synthetic(place / "set.parquet", frames, seed)
        environment = os.environ | ({"NUMBA_CACHE_DIR": str(place / "kernels")} if uncompiled else {})
        report(0.05, "a process that may find nothing compiled")
        before, found = _twice(place, environment), []
        for turn in range(repeats):
            report(0.6 + 0.4 * turn / repeats, "a fresh process")
            found.append(_twice(place, environment))
    first, second = (min(run[key] for run in found) for key in ("first_s", "second_s"))
    return {
        "frames": frames,
        "first_s": first,
        "warm_s": second,
        "fresh_over_warm_s": first - second,
        "fresh_over_warm_processor_s": min(run["first_processor_s"] - run["second_processor_s"] for run in found),
        "uncompiled_first_s": before["first_s"] if uncompiled else None,
        "limits": {"fresh_over_warm": held(FRESH_LIMIT_S, first - second, "s")},
    }


def _twice(place: Path, environment: dict[str, str]) -> dict[str, float]:
    """Calibrate twice in a new process: seconds, and seconds of the processor, of each."""
    words = ["calibrate", "set.parquet", "--sensor", "sensor.json", "--match", "given", "--json", "out.json"]
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", TWICE, *words], cwd=place, env=environment, check=True, stdout=subprocess.PIPE
    )
    (first, used), (second, used_again) = orjson.loads(done.stdout.splitlines()[-1])
    return {
        "first_s": first - began,
        "second_s": second - first,
        "first_processor_s": used,
        "second_processor_s": used_again - used,
    }
