"""What a fresh process pays before it calibrates: imports and the compiled loops, read from their cache.

The same calibration is run twice in one new process, by the command's own function. The first is counted from before the
interpreter starts to the answer, the second is what a warm process takes; the difference is what the user of a command waits for
besides. It is measured with the loops compiled, as `boresight warm` or any run leaves them, and told for an empty cache, where each
loop is compiled when it is first called: once an installation.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import orjson

from boresight.measurements.synthetic_file import write_synthetic
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document

#: Seconds that the first calibration of a fresh process may take beyond a warm one.
LIMIT_S = 2.0
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
    report: Callable[[float, str], None],
    *,
    frames: int = 2000,
    repeats: int = 3,
    uncompiled: bool = True,
    seed: int = 1,
) -> dict[str, Any]:
    """Calibrate twice in each of several new processes.

    Parameters
    ----------
    report
        Told the fraction done and what is measured next.
    frames
        Size of the set.
    repeats
        Processes; the fastest of each counts.
    uncompiled
        Also start with an empty cache of loops, a minute or so, and leave this installation's alone. Without it the loops come
        from that cache, and a process before the first measured one sees that they are there.
    seed
        Of the set.
    """
    with tempfile.TemporaryDirectory(prefix="boresight-fresh-") as folder:
        place = Path(folder)
        (place / "sensor.json").write_bytes(orjson.dumps(sensor_document(st16_sensor(1))))
        write_synthetic(place / "set.parquet", frames, seed)
        environment = dict(os.environ)
        if uncompiled:
            environment["NUMBA_CACHE_DIR"] = str(place / "kernels")
        report(0.05, "a process that may find nothing compiled")
        before = _twice(place, environment)
        found = []
        for turn in range(repeats):
            report(0.6 + 0.4 * turn / repeats, "a fresh process")
            found.append(_twice(place, environment))
    first, second = (min(run[key] for run in found) for key in ("first_s", "second_s"))
    processor = min(run["first_processor_s"] - run["second_processor_s"] for run in found)
    return {
        "frames": frames,
        "first_s": first,
        "warm_s": second,
        "fresh_over_warm_s": first - second,
        "fresh_over_warm_processor_s": processor,
        "uncompiled_first_s": before["first_s"] if uncompiled else None,
        "limits": {
            "fresh_over_warm": {
                "limit": LIMIT_S, "measured": first - second, "kept": first - second <= LIMIT_S, "unit": "s",
            }
        },
    }  # fmt: skip


def _twice(place: Path, environment: dict[str, str]) -> dict[str, float]:
    """Calibrate twice in a new process: seconds, and seconds of the processor, of each."""
    words = ["calibrate", "set.parquet", "--sensor", "sensor.json", "--match", "given", "--json", "out.json"]
    began = time.monotonic()
    done = subprocess.run(  # noqa: S603 - words of our own
        [sys.executable, "-c", TWICE, *words], cwd=place, env=environment, check=True, stdout=subprocess.PIPE
    )
    (first, used), (second, used_again) = orjson.loads(done.stdout.splitlines()[-1])
    return {
        "first_s": first - began,
        "second_s": second - first,
        "first_processor_s": used,
        "second_processor_s": used_again - used,
    }
