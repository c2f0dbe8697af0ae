"""What starting costs: a command's help, the library, five frames, and the first calibration of all, which compiles (part `start`).

Every figure is of new processes, with those that they start, and of processor time beside the wall clock, for other work on the
machine stretches the latter. Their modules are compiled to byte code in a folder of their own, as an installation's are. `checkout`
is another checkout of this repository to start beside this one: they take turns, so that both are measured in the same minutes.

The set is of catalogue stars as in part `whole`, as CSV and matched again, as the command does when nothing else is said. The
folder of compiled loops is empty before the first calibration (`cold`); the later ones find what it left there.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import orjson

from benchmarks import ROOT, Report, held
from benchmarks.stars import repeated_fields
from boresight.settings import read_settings
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_csv

COLD_LIMIT_S, HELP_LIMIT_S, IMPORT_LIMIT_S, CALIBRATION_LIMIT_S = 12.0, 0.2, 0.15, 0.9
CALIBRATE = ["-m", "boresight", "calibrate", "set.csv", "--sensor", "sensor.json"]
#: What is started again and again, by its name among the figures.
STARTS = {"help": ["-m", "boresight", "--help"], "import": ["-c", "import boresight"], "calibration": CALIBRATE}


def measure(
    report: Report, *, frames: int = 5, repeats: int = 5, cold: bool = True, checkout: str = "", seed: int = 1
) -> dict[str, Any]:
    """Start commands of this checkout, and of another beside it where one is given."""
    trees = {"here": ROOT} | ({"checkout": Path(checkout).resolve()} if checkout else {})
    with tempfile.TemporaryDirectory(prefix="boresight-start-") as folder:
        place = Path(folder)
        sensor = st16_sensor(1)
        (place / "sensor.json").write_bytes(orjson.dumps(sensor_document(sensor)))
        write_csv(
            repeated_fields(frames, sensor, load_catalogue(read_settings().catalogue_folder), seed), place / "set.csv"
        )
        environments = {name: _environment(place / name, tree, cold) for name, tree in trees.items()}
        found: dict[str, Any] = {name: {} for name in trees}
        for turn, (name, environment) in enumerate(environments.items()):
            report(0.5 * turn / len(trees), f"the first calibration ({name})")
            first = _started(CALIBRATE, place, environment)
            if cold:
                found[name]["cold_s"], found[name]["cold_processor_s"] = first
        for turn, (key, words) in enumerate(STARTS.items()):
            report(0.5 + 0.5 * turn / len(STARTS), f"starting {key}")
            runs = [{name: _started(words, place, environments[name]) for name in trees} for _ in range(1 + repeats)]
            for name in trees:
                wall, processor = zip(*(run[name] for run in runs[1:]), strict=True)  # the first makes byte code
                found[name] |= {f"{key}_s": median(wall), f"{key}_processor_s": median(processor)}
    return {"frames": frames, "repeats": repeats, **found, "limits": _limits(found["here"])}


def _limits(here: dict[str, float]) -> dict[str, Any]:
    return {
        "cold": held(COLD_LIMIT_S, here.get("cold_s"), "s"),
        "help": held(HELP_LIMIT_S, here["help_processor_s"], "s"),
        "import": held(IMPORT_LIMIT_S, here["import_processor_s"], "s"),
        "calibration": held(CALIBRATION_LIMIT_S, here["calibration_processor_s"], "s"),
    }


def _environment(own: Path, tree: Path, cold: bool) -> dict[str, str]:
    """Variables of a checkout's processes: its modules, byte code of its own, and where nothing is compiled yet, a new folder."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    kernels = {"NUMBA_CACHE_DIR": str(own / "kernels")} if cold else {}
    return kept | {"PYTHONPATH": str(tree / "backend"), "PYTHONPYCACHEPREFIX": str(own / "bytecode")} | kernels


def _started(words: list[str], place: Path, environment: dict[str, str]) -> tuple[float, float]:
    """Run Python with these words to its end: seconds, and seconds of the processor with all that it started."""
    began = time.perf_counter()
    with (place / "output").open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, *words], cwd=place, env=environment, stdout=output, stderr=subprocess.STDOUT
        )
        _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise RuntimeError((place / "output").read_text(encoding="utf-8"))
    return time.perf_counter() - began, used.ru_utime + used.ru_stime
