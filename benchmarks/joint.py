"""Passes calibrated together, beside as many single runs (part `joint`).

The same files are calibrated one after the other in one process, and together in another; each has calibrated one of them before,
so that nothing waits for an import or a compiler. Memory is what the kernel says of a process when it has ended, and is compared
with that of a quarter of the passes together. Then the joint calibration is computed by a cluster of one worker and of two, and
the estimates are compared to the last bit.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import orjson

from benchmarks import ROOT, Report, held
from benchmarks.spread import ESTIMATE, Site
from benchmarks.stars import write_synthetic
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document

TIME_LIMIT, MEMORY_LIMIT = 1.3, 1.1
#: Runs commands in one process, and tells the seconds of each.
RUNS = """
import json, sys, time
from boresight.cli import main
seconds = []
for words in json.loads(sys.argv[1]):
    began = time.monotonic()
    if code := main(words, standalone_mode=False):
        sys.exit(code)
    seconds.append(time.monotonic() - began)
print("\\n" + json.dumps(seconds))
"""


def measure(report: Report, *, passes: int = 100, frames: int = 2_000, seed: int = 1) -> dict[str, Any]:
    """Calibrate passes one by one, together, a quarter of them together, and together over one worker and two."""
    with tempfile.TemporaryDirectory(prefix="boresight-joint-") as place:
        folder = Path(place)
        (folder / "sensor.json").write_bytes(orjson.dumps(sensor_document(st16_sensor(1))))
        names = [f"pass-{k}.parquet" for k in range(passes)]
        for k, name in enumerate(names):
            report(0.1 * k / passes, f"writing pass {k + 1} of {passes}")
            write_synthetic(folder / name, frames, seed + k)
        quarter = names[: max(passes // 4, 2)]
        report(0.1, f"{passes} single runs")
        singles = _calibrated(folder, [[name] for name in (names[0], *names)])
        report(0.4, f"{passes} passes together")
        together = _calibrated(folder, [names[:1], names])
        report(0.6, f"{len(quarter)} passes together")
        few = _calibrated(folder, [names[:1], quarter])
        estimates = _over_workers(report, folder, names)
    alone_s, joint_s = sum(singles["seconds"][1:]), together["seconds"][1]
    differing = sum(estimates[0][key] != estimates[1][key] for key in ESTIMATE)
    return {
        "passes": passes,
        "frames_of_a_pass": frames,
        "singles_s": alone_s,
        "joint_s": joint_s,
        "joint_over_singles": joint_s / alone_s,
        "singles_peak_mb": singles["peak_mb"],
        "joint_peak_mb": together["peak_mb"],
        "quarter_passes": len(quarter),
        "quarter_peak_mb": few["peak_mb"],
        "limits": {
            "time over the sum of single runs": held(TIME_LIMIT, joint_s / alone_s),
            "memory over that of a quarter of the passes": held(MEMORY_LIMIT, together["peak_mb"] / few["peak_mb"]),
            "numbers that differ between one worker and two": held(0, differing),
        },
    }


def _calibrated(folder: Path, runs: Sequence[Sequence[str]]) -> dict[str, Any]:
    """Calibrate sets of files one after the other in one process: seconds of each, and the most memory that it held."""
    words = [["calibrate", *files, "--sensor", "sensor.json", "--match", "given"] for files in runs]
    with (folder / "told").open("wb") as told:
        process = subprocess.Popen(
            [sys.executable, "-c", RUNS, orjson.dumps(words).decode()],
            cwd=folder,
            stdout=told,
            env=os.environ | {"PYTHONPATH": str(ROOT / "backend")},
        )
        _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"A calibration ended with exit code {process.returncode}")
    seconds = orjson.loads((folder / "told").read_bytes().splitlines()[-1])
    return {
        "seconds": seconds,
        "peak_mb": used.ru_maxrss / (1024.0**2 if sys.platform == "darwin" else 1024.0),
    }


def _over_workers(report: Report, folder: Path, names: Sequence[str]) -> list[dict[str, Any]]:
    """Estimates of all passes together by one worker and by two."""
    place = folder / "site"
    place.mkdir()
    site = Site(place, "batch")
    tables = [site.keep(folder / name) for name in names]
    found = []
    for workers in (1, 2):
        report(0.6 + 0.15 * workers, f"{len(names)} passes over {workers} workers")
        with site.cluster(workers=workers) as client:
            document = site.run(client, *tables)["document"]
            found.append({key: document[key] for key in ESTIMATE})
    return found
