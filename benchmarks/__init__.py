"""What measures Boresight: speed, memory, growth, clusters, servers and accuracy, each beside its peers. No part of the wheel.

    python -m benchmarks [--part NAME|all] [--frames N] [--size PART.SIZE=VALUE] [--json FILE]
    python -m benchmarks.pages                         measure, and write docs/benchmarks.md and docs/capacity.md

A part is a function

    measure(report, **sizes) -> dict[str, Any]

where `report(fraction, message)` is told how far it is, and every size (frames, runs, clients, seconds) is a keyword argument with
the full-size default, so that the suite measures a small version of each. What it returns is ready for JSON: raw figures with
their unit in the key, the peers beside them, the ratios, and `limits`, what is promised by name, each as `held` tells it. Whoever
writes a part adds its line to `PARTS`, in the order in which the parts are measured and shown. Modules are loaded when they are
measured.

Servers, workers and calibrations run as `python -m boresight ...`, in a temporary folder and on free ports, so that what is
measured is what a user runs. Peers are timed in the same run: ratios hold when a machine's speed drifts, times do not.
"""

from __future__ import annotations

import importlib
import inspect
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# before NumPy loads: commands and workers have it so, and its threads on small matrices cost more time than they save
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

Report = Callable[[float, str], None]

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Part:
    """A part: the module and function that measure it, and what it shows, a phrase for the documentation."""

    function: str
    shows: str

    def measurement(self) -> Callable[..., dict[str, Any]]:
        """Load the module and return its function."""
        module, _, name = self.function.partition(":")
        found: Callable[..., dict[str, Any]] = getattr(importlib.import_module(f"benchmarks.{module}"), name)
        return found

    @property
    def sizes(self) -> dict[str, Any]:
        """Its sizes and their defaults."""
        found = inspect.signature(self.measurement()).parameters
        return {key: parameter.default for key, parameter in found.items() if key != "report"}


PARTS: dict[str, Part] = {
    "kernels": Part("kernels:measure", "the compiled loops, beside C, NumPy, SciPy and hand-written filters"),
    "whole": Part("whole:measure", "a calibration from file to file, beside the fit alone in C"),
    "start": Part("start:measure", "what starting costs: help, the library, five frames, and the first calibration of all"),
    "accuracy": Part(
        "accuracy:measure", "error beside time: SciPy, filterpy, Ceres, OpenCV and tetra3rs on the same stars"
    ),
    "efficiency": Part(
        "efficiency:measure", "batch and filter beside a plain maximum-likelihood fit, with tangential, sixth-order and wide lenses"
    ),
    "choice": Part(
        "choice:measure", "the camera chosen for lenses of every camera, by sensors of every camera: false choices, held-out error"
    ),
    "images": Part(
        "images:measure", "three extractors beside truth, and from hard night images to a calibration"
    ),
    "trust": Part(
        "trust.measure:measure", "what is told of clean sets, of known cases and of thirty faults, each before it matters or not"
    ),
    "causes": Part(
        "causes:measure", "what the first advice names in sets spoiled by seventeen causes, and false alarms over clean sets"
    ),
    "ground": Part(
        "ground:measure", "cameras on the ground at 20 to 80 degrees with the air and without, and the real field: bias and finding"
    ),
    "diagnosis": Part(
        "diagnosis:measure", "what is named of wrong inputs, each mistake alone and in pairs, and what is mended wrongly"
    ),
    "pointings": Part(
        "pointings:measure", "how soon planned pointings pass the gate of observability, beside chance and the paper's sets"
    ),
    "joint": Part("joint:measure", "passes calibrated together, beside as many single runs, and over one worker and two"),
    "recovery": Part("recovery:measure", "f(T) and drift that are put into sets of passes and found again: bias and coverage"),
    "mission": Part("mission:measure", "three years of sensors that change: the newest pass beside all passes"),
    "requests": Part("requests:measure", "what a policy asks of people over three years, and how much of it is false"),
    "fresh": Part("growth:measure_fresh", "what a fresh process pays before its first calibration, beside a warm one"),
    "growth": Part("growth:measure", "time and memory from a thousand frames to a million"),
    "spread": Part("spread:measure", "one batch over one worker, two, and two of which one is killed"),
    "queue": Part("queue:measure", "thousands of small runs: what the queue adds, and what kills lose"),
    "clients": Part(
        "clients:measure", "200 clients on the list of runs, 500 that follow the feed and miss nothing"
    ),
    "fleet": Part("clients:measure_fleet", "the console's pages of ten sensors, a thousand and ten thousand"),
    "footprint": Part(
        "footprint:measure", "what one more frame, run, sensor and record costs in time, files and rows"
    ),
}  # fmt: skip


def held(limit: float, measured: float | None, unit: str | None = None, *, at_least: bool = False) -> dict[str, Any]:
    """Hold a figure against what is promised; of one that was not measured nothing is known."""
    kept = None if measured is None else measured >= limit if at_least else measured <= limit
    words: dict[str, Any] = {"limit": limit, "measured": measured, "kept": kept}
    return words | ({"at_least": True} if at_least else {}) | ({} if unit is None else {"unit": unit})


def collect_limits(parts: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Every limit of every part, `part.name` by name."""
    return {f"{part}.{name}": limit for part, found in parts.items() for name, limit in found.get("limits", {}).items()}
