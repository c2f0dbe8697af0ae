"""Example calibrations of a simulated sensor, for the gallery, the documentation and tests.

`example_calibration.json` travels with the package, because no page should wait for a calibration to show what a figure looks like.
It holds one sensor's frames, calibrated by `filter` and by `batch`, and in `weak` so few of them that directions are weak. Of the
filter, `partial` is what it had told half-way, and `nothing` is a run that has not come anywhere yet. Numbers keep seven
significant digits, which is more than a drawing shows. `python -m benchmarks.pages --figures --renew` makes the file again, from
seeds.
"""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import orjson

from boresight.calibration.calibration import Calibration, History, Shadow, parse_calibration
from boresight.figures.chart import Trace

PLACE = Path(__file__).with_name("example_calibration.json")
JUDGED_AT_THE_END = (
    "chi2", "chi2_per_dof", "evaluation", "frame_observability", "matching", "observability", "smoothed", "trust",
    "validation",
)  # fmt: skip
LABELS = {
    "filter": ("Run 2", "as frames come down"),
    "batch": ("Run 1", "all frames at once"),
    "weak": ("Run 3", "eight frames alone"),
}


@cache
def get_example_calibrations() -> dict[str, Calibration]:
    """Read the example: the calibrations `filter`, `batch`, `weak`, `partial` and `nothing`."""
    found = {name: parse_calibration(document) for name, document in orjson.loads(PLACE.read_bytes()).items()}
    return found | {"partial": _half_way(found["filter"]), "nothing": Calibration(status="running")}


def make_example_traces(names: tuple[str, ...]) -> list[Trace]:
    """Return results of the example to draw, with what a legend calls them."""
    return [
        Trace(f"{run} · {how}", get_example_calibrations()[name], run)
        for name in names
        for run, how in [LABELS.get(name, LABELS["filter"])]
    ]


def _half_way(result: Calibration) -> Calibration:
    """Return what a filter had told when half of its frames were in: no evaluation yet, half a history."""
    history = result.history
    if history is None:
        return result
    half = len(history.frame) // 2
    columns = {item.name: getattr(history, item.name) for item in fields(History)}
    kept: dict[str, Any] = {name: rows[:half] for name, rows in columns.items() if isinstance(rows, list)}
    halved = replace(history, **kept)
    done = result.frames - (len(history.frame) - half)
    judged: dict[str, Any] = dict.fromkeys(JUDGED_AT_THE_END)
    return replace(result, **judged, shadow=Shadow(), status="running", history=halved, frames_done=done)
