"""Live traces: what a page needs to extend a running run's curves with the points of the event feed.

A curve of parameter p shows y = (p - p_0) f for the points (frame, p, sigma) of the history; its band is y +- 3 sigma f. Each
trace that can grow says so in `meta.follow`: `column` and `index` of the value in a point, `origin` p_0, `factor` f, and
`band`, the number of sigmas of an outline; `share` says that its sigma is that share of the value. A line of two points
at one level only grows longer: `level`. Only the figure of one running run is marked; all others carry nothing of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import plotly.graph_objects as go

from boresight.figures.chart import Trace
from boresight.verdicts.history import History, read_history
from boresight.verdicts.numbers import Quantity


@dataclass(frozen=True)
class Panel:
    """One parameter's subplot: its unit on the page, the SI value that changes are counted from, row and column from 0."""

    name: str
    item: Quantity
    origin: float
    row: int
    column: int


def find_running_history(traces: Sequence[Trace]) -> History | None:
    """Return the history of the one run of a figure that is still a filter on its way, else None."""
    if len(traces) != 1 or traces[0].result.status != "running":
        return None
    history = read_history(traces[0].result)
    return history if history is not None and history.axis == "frame" else None


def follow_parameters(figure: go.Figure, panels: Iterable[Panel], traces: Sequence[Trace]) -> None:
    """Mark the curves, bands and levels of the parameters' subplots."""
    history = find_running_history(traces)
    for panel in panels if history else ():
        if history and panel.name in history.names:
            how = {"column": "parameters", "index": history.names.index(panel.name)}
            how |= {"origin": panel.origin, "factor": panel.item.factor}
            _mark(figure.select_traces(row=panel.row + 1, col=panel.column + 1), how)


def follow_column(figure: go.Figure, place: dict[str, int], column: str, traces: Sequence[Trace]) -> None:
    """Mark the curve of a subplot (row and column from 1) that shows a column of the history as it is."""
    if find_running_history(traces):
        _mark(figure.select_traces(**place), {"column": column, "factor": 1.0})


def follow_errors(figure: go.Figure, factor: float, traces: Sequence[Trace]) -> go.Figure:
    """Mark the curves of tail and aggregate error; the tail's sigma is its share 1 / sqrt(2 n) of n pairs."""
    if find_running_history(traces):
        pairs = traces[0].result.pairs
        share = {"share": 1 / sqrt(2 * pairs)} if pairs else {}
        for trace in figure.select_traces({"type": "scatter"}):
            is_aggregate = (trace.meta or {}).get("part") == "aggregate"
            column = "aggregate_rms_rad" if is_aggregate else "tail_rms_rad"
            _mark([trace], {"column": column, "factor": factor} | share)
    return figure


def tell_place(
    figure: go.Figure, traces: Sequence[Trace], frames: int | None = None, at_utc: str | None = None
) -> None:
    """Say in the figure of a running run as of which frame of how many, or iteration, it is, and of which time."""
    history = read_history(traces[0].result) if traces[0].result.status == "running" else None
    if history is not None and len(history.x):
        of = frames if history.axis == "frame" else None
        place = {"axis": history.axis, "step": float(history.x[-1]), "of": of, "at_utc": at_utc}
        figure.layout.meta = {**(figure.layout.meta or {}), "as_of": place}


def _mark(traces: Iterable[Any], how: dict[str, Any]) -> None:
    """Say of each trace of a subplot how it grows: an outline as a band, two points of one height as a level."""
    for trace in traces:
        y = [] if trace.y is None else list(trace.y)
        is_level = len(y) == 2 and y[0] == y[1]
        said = trace.meta or {}
        grows = {"level": True} if is_level else how | ({"band": said["sigmas"]} if "sigmas" in said else {})
        trace.meta = {**said, "follow": grows}
