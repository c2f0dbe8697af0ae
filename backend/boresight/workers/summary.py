"""The few figures of a calibration that a list of runs shows, so that a list opens no result files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def summary_of(result: Mapping[str, Any]) -> dict[str, Any]:
    """Pick the figures for lists from a calibration JSON; what the result does not have is None."""
    return {
        "status": result.get("status"),
        "rms_initial_arc_rad": _within(result, "rms_arc_rad", "initial"),
        "rms_final_arc_rad": _within(result, "rms_arc_rad", "final"),
        "chi2_per_dof": result.get("chi2_per_dof"),
        "iterations": result.get("iterations"),
        "frames": result.get("frames"),
        "stars": result.get("stars"),
        "weakest": _within(result, "observability", "weakest", "sentence"),
        "validation_rms_initial_arc_rad": _within(result, "validation", "rms_arc_rad", "initial"),
        "validation_rms_final_arc_rad": _within(result, "validation", "rms_arc_rad", "final"),
    }


def _within(document: Mapping[str, Any], *path: str) -> Any:
    """Follow keys down; None where the path ends early."""
    place: Any = document
    for key in path:
        place = place.get(key) if isinstance(place, Mapping) else None
    return place
