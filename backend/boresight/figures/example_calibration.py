"""Example calibrations of a simulated sensor, for the gallery, the documentation and tests.

`specimen.json` travels with the package, because no page should wait for a calibration to show what a figure looks like.
It holds one sensor's frames, calibrated by `filter` and by `batch`. Of the filter, `partial` is what it had told
half-way, and `nothing` is a run that has not come anywhere yet. Numbers keep seven significant digits, which is more
than a drawing shows. `make_example_calibration` makes the file again, from seeds.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.figures.chart import Result, Trace
from boresight.simulation.scenes import calibration_scenario, simulate, validation_scenario
from boresight.sky.catalogue import Catalogue

PLACE = Path(__file__).with_name("specimen.json")
FRAMES, HELD_OUT_FRAMES = 60, 30
SEEDS = (1, 2)
DIGITS = 7
JUDGED_AT_THE_END = (
    "chi2", "chi2_per_dof", "evaluation", "frame_observability", "matching", "observability", "shadow", "trust", "validation",
)  # fmt: skip
LABELS = {"filter": "Run 2 · as frames come down", "batch": "Run 1 · all frames at once"}


@cache
def get_example_calibrations() -> dict[str, Result]:
    """Read the specimen: the results `filter`, `batch`, `partial` and `nothing`."""
    found: dict[str, Result] = orjson.loads(PLACE.read_bytes())
    return found | {"partial": _half_way(found["filter"]), "nothing": {"status": "running"}}


def make_example_traces(names: tuple[str, ...]) -> list[Trace]:
    """Return results of the example to draw, with what a legend calls them."""
    return [Trace(LABELS.get(name, LABELS["filter"]), get_example_calibrations()[name]) for name in names]


def make_example_calibration(catalogue: Catalogue) -> bytes:
    """Calibrate a simulated sensor anew and return the text of `specimen.json`."""
    scenario = dataclasses.replace(calibration_scenario(1), frames=FRAMES)
    held_out = dataclasses.replace(validation_scenario(1), frames=HELD_OUT_FRAMES)
    sets = [simulate(s, np.random.default_rng(k), catalogue) for s, k in zip((scenario, held_out), SEEDS, strict=True)]
    made = {
        name: calibrate(sets[0], scenario.sensor, catalogue, CalibrationSettings(method=method), validation=sets[1])
        for name, method in (("batch", "batch"), ("filter", "sqrf"))
    }
    return orjson.dumps(_shortened(made)) + b"\n"


def _half_way(result: Result) -> Result:
    """Return what a filter had told when half of its frames were in: no judgement yet, half a history."""
    history = result["history"]
    half = len(history["frame"]) // 2
    halved = {key: value[:half] if isinstance(value, list) else value for key, value in history.items()}
    done = result["frames"] - (len(history["frame"]) - half)
    judged = dict.fromkeys(JUDGED_AT_THE_END)
    return {**result, **judged, "status": "running", "history": halved, "frames_done": done}


def _shortened(value: Any) -> Any:
    """Keep seven digits of every number in a document."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {key: _shortened(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_shortened(item) for item in value]
    return value
