"""Runs side by side on one axis: by frame number, by the time since their first frame, or by the count of updates.

Frame numbers are a sensor's own, so two runs of one set share them; runs of sets taken weeks apart do not, and lie over
each other only by the time since each one's first frame or by the number of updates that its filter has made. A history
keeps updates evenly spaced with the first and the last, so of n updates in all and m kept the k-th is number
round(k (n - 1) / (m - 1)) + 1. A batch run has no updates: it stays a level over whatever axis the others have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray
from boresight.errors import RefusedInputError
from boresight.figures.chart import Result, Trace

#: What the axis of frames is called under each alignment.
ALIGNMENTS = {"frame": "frame", "time": "hours since the first frame", "update": "update"}
#: Part of `trust` with one value a frame or update.
SERIES = "nis_over_time"
NO_TIMES = "A batch run keeps no times of its frames: align by frame to see its innovations."


def aligned(traces: Sequence[Trace], along: str) -> list[Trace]:
    """Give every run the axis that is asked for in place of its frame numbers."""
    if along not in ALIGNMENTS:
        raise RefusedInputError(f"{along!r} is no alignment; choose from {', '.join(ALIGNMENTS)}.")
    if along == "frame":
        return list(traces)
    move = {"time": _by_time, "update": _by_update}[along]
    return [replace(trace, result=move(trace)) for trace in traces]


def _by_update(trace: Trace) -> Result:
    """Count updates; a batch run's innovations are one a frame, and are counted so."""
    result, history = trace.result, trace.result.get("history")
    series = (result.get("trust") or {}).get(SERIES)
    total = (series or {}).get("points_in_all") or result.get("frames") or 0
    placed = None if series is None else _numbered(len(series["frame"]), total)
    numbered = None if not history else _numbered(len(history["frame"]), total)
    return _on_axis(result, numbered, placed)


def _numbered(n_kept: int, n_updates: int) -> FloatArray:
    """Number the kept updates, (n_kept,); without the count of all they are taken for all."""
    return np.linspace(0, max(n_updates, n_kept) - 1, n_kept).round() + 1


def _by_time(trace: Trace) -> Result:
    """Count hours since the run's first frame."""
    result, history = trace.result, trace.result.get("history")
    if not history or not history.get("frame"):
        trust = result.get("trust") or {}
        why = {**(trust.get("unavailable") or {}), SERIES: NO_TIMES}
        return {**result, "trust": {**trust, SERIES: None, "unavailable": why}} if trust else result
    if not history.get("time_utc"):
        raise RefusedInputError(f"{trace.label} has no times in its telemetry: align by frame or by update.")
    times = np.array([str(time).rstrip("Z") for time in history["time_utc"]], dtype="datetime64[us]")
    hours = (times - times[0]) / np.timedelta64(3600, "s")
    series = (result.get("trust") or {}).get(SERIES)
    placed = None if series is None else np.interp(series["frame"], history["frame"], hours)
    return _on_axis(result, hours, placed)


def _on_axis(result: Result, steps: FloatArray | None, placed: FloatArray | None) -> dict[str, Any]:
    """Put new steps in place of the frames of the history, and of the series of innovations."""
    moved: dict[str, Any] = dict(result)
    if steps is not None:
        moved["history"] = {**moved["history"], "frame": steps.tolist()}
    if placed is not None:
        trust: Mapping[str, Any] = moved["trust"]
        moved["trust"] = {**trust, SERIES: {**trust[SERIES], "frame": placed.tolist()}}
    return moved


def name_axis(figure: go.Figure, along: str) -> None:
    """Write on every axis of frames what it is now, and tell linked cursors the same."""
    if along == "frame":
        return
    for name in figure.layout:
        axis = figure.layout[name]
        if name.startswith("xaxis") and (axis.title.text or "").startswith("frame"):
            axis.title.text = ALIGNMENTS[along] + axis.title.text.removeprefix("frame")
    for trace in figure.data:
        if (getattr(trace, "hovertemplate", None) or "").startswith("frame %{x}"):
            trace.hovertemplate = trace.hovertemplate.replace("frame %{x}", f"{ALIGNMENTS[along]} %{{x:.5g}}", 1)
    if (figure.layout.meta or {}).get("axis") == "frame":
        figure.layout.meta = {**figure.layout.meta, "axis": along}
