"""The few figures of a calibration that lists, the fleet and its trends show, so that none opens a result file.

`level` is the verdict of the run page, `advice` the gravest sentence of the run or, where it gave none, of the verdict.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from boresight.calibration.result import trend_entry
from boresight.estimation.statistics.observability import WEAK
from boresight.verdicts.verdict import make_verdict


def summary_of(result: Mapping[str, Any]) -> dict[str, Any]:
    """Pick the figures for lists from a calibration JSON; what it does not have, or is no number there, is None."""
    judged = make_verdict(result)
    advice = [*(result.get("advice") or ()), *(judged.reasons if judged.level != "normal" else ())]
    found = {
        "status": result.get("status"),
        "level": judged.level,
        "advice": advice[0] if advice else None,
        "chi2_consistent": _within(result, "chi2", "consistent"),
        "weak_directions": _weak_directions(result),
        "rms_initial_arc_rad": _within(result, "rms_arc_rad", "initial"),
        "rms_final_arc_rad": _within(result, "rms_arc_rad", "final"),
        "chi2_per_dof": result.get("chi2_per_dof"),
        "iterations": result.get("iterations"),
        "frames": result.get("frames"),
        "stars": result.get("stars"),
        "weakest": _within(result, "observability", "weakest", "sentence"),
        "tail_rms_rad": _last(_within(result, "history", "tail_rms_rad")),
        "availability": _within(result, "validation", "availability", "final"),
        "trend": trend_entry(result),
        "validation_rms_initial_arc_rad": _within(result, "validation", "rms_arc_rad", "initial"),
        "validation_rms_final_arc_rad": _within(result, "validation", "rms_arc_rad", "final"),
    }
    return {name: _plain(value) for name, value in found.items()}


def _plain(value: Any) -> Any:
    """Return a value as JSON would give it back: no arrays, no NaN."""
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _last(values: Any) -> Any:
    """Return the last of a series; None where there is none."""
    return values[-1] if isinstance(values, list) and values else None


def _weak_directions(result: Mapping[str, Any]) -> int | None:
    """Count the directions that the data hardly determine, or not at all; None where they were not looked for."""
    spread = _within(result, "observability", "sigma_of_direction")
    return None if spread is None else sum(sigma is None or sigma > WEAK for sigma in spread)


def _within(document: Mapping[str, Any], *path: str) -> Any:
    """Follow keys down; None where the path ends early."""
    place: Any = document
    for key in path:
        place = place.get(key) if isinstance(place, Mapping) else None
    return place
