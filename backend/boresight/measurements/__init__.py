"""What `boresight bench` measures, a module a part: speed, memory, growth, clusters, servers and accuracy, each beside its peers.

A part is a module with one function,

    measure(report, **sizes) -> dict[str, Any]

where `report(fraction, message)` is told how far it is, and every size (frames, runs, clients, seconds) is a keyword argument with
the full-size default, so that the suite measures a small version of each. What it returns is ready for JSON: raw figures with their
unit in the key, the peers beside them, the ratios, and `limits`, a mapping

    name -> {"limit": 1.25, "measured": 1.21, "kept": true}

of what is promised (add `"at_least": true` where more is better, `"unit"` where the figure has one). Whoever writes a part adds
its line to `PARTS`, in the order in which the parts are measured and shown, and runs `python docs/measure.py --write`, whose page
lists it. Modules are loaded when they are measured.

A part starts servers, workers and calibrations as `sys.executable -m boresight ...`, in a temporary folder and on free ports, so
that what it measures is what a user runs. It times peers in the same run: ratios hold when a machine's speed drifts, times do not.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class Part:
    """A part of the bench.

    Parameters
    ----------
    module
        Where its `measure` is.
    shows
        What it shows, for the documentation: a phrase.
    """

    module: str
    shows: str

    def measurement(self) -> Callable[..., dict[str, Any]]:
        """Load the module and return its `measure`."""
        found: Callable[..., dict[str, Any]] = importlib.import_module(self.module).measure
        return found


PARTS: dict[str, Part] = {
    "kernels": Part("boresight.studies.speed", "the compiled loops, beside C, NumPy, SciPy and hand-written filters"),
    "whole": Part(
        "boresight.measurements.whole_calibration", "a calibration from file to file, beside the fit alone in C"
    ),
    "accuracy": Part(
        "boresight.measurements.accuracy",
        "error beside time: SciPy, filterpy, Ceres, OpenCV and tetra3rs on the same stars",
    ),
    "fresh": Part(
        "boresight.measurements.fresh_process",
        "what a fresh process pays before its first calibration, beside a warm one",
    ),
    "growth": Part("boresight.measurements.growth", "time and memory from a thousand frames to a million"),
    "spread": Part("boresight.measurements.spread", "one batch over one worker, two, and two of which one is killed"),
    "queue": Part("boresight.measurements.queue", "thousands of small runs: what the queue adds, and what kills lose"),
    "clients": Part(
        "boresight.measurements.clients", "200 clients on the list of runs, 500 that follow the feed and miss nothing"
    ),
    "fleet": Part(
        "boresight.measurements.fleet_pages", "the console's pages of ten sensors, a thousand and ten thousand"
    ),
    "footprint": Part(
        "boresight.measurements.footprint", "what one more frame, run, sensor and record costs in time, files and rows"
    ),
}


def measure(name: str, report: Report, sizes: dict[str, Any]) -> dict[str, Any]:
    """Measure one part.

    Parameters
    ----------
    name
        One of `PARTS`.
    report
        Told the fraction done and what is measured next.
    sizes
        Sizes that differ from the part's own; `sizes_of` has their names.
    """
    return PARTS[name].measurement()(report=report, **sizes)


def sizes_of(name: str) -> dict[str, Any]:
    """Sizes of a part and their defaults."""
    found = inspect.signature(PARTS[name].measurement()).parameters
    return {key: parameter.default for key, parameter in found.items() if key != "report"}


def limits_of(parts: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Every limit of every part, `part.name` by name."""
    return {f"{part}.{name}": limit for part, found in parts.items() for name, limit in found.get("limits", {}).items()}
