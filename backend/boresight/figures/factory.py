"""Makes figures of what they read in results, each with what it says where that is not there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray
from boresight.calibration.result import Result
from boresight.figures.chart import Figure, Table, Trace
from boresight.figures.style import theme
from boresight.verdicts.verdict import read_part, why_absent

Part = tuple[Trace, theme.RunStyle, Any]  # a run, how it is drawn, and what a figure reads of its result


def make_figure(
    draw: Callable[[Sequence[Part]], go.Figure],
    table: Callable[[Any], Table],
    read: Callable[[Result], Any],
    why: Callable[[Result], str],
    *,
    name: str,
    title: str,
    guide: str,
    wide: bool = False,
) -> Figure:
    """Make a figure of what `read` finds in results; where the first run has nothing, `why` says so in its place."""

    def draw_runs(traces: Sequence[Trace]) -> go.Figure:
        drawn = [(trace, style, part) for trace, style in theme.styled(traces) if (part := read(trace.result))]
        return draw(drawn) if drawn else theme.missing(title, why(traces[0].result))

    def list_run(result: Result) -> Table:
        return table(part) if (part := read(result)) else {}

    return Figure(name, title, guide, draw_runs, list_run, wide)


def part_figure(
    draw: Callable[[Sequence[Part]], go.Figure], table: Callable[[Any], Table], part: str, **named: Any
) -> Figure:
    """Make a figure of one part of `trust`."""
    return make_figure(
        draw, table, lambda result: read_part(result, part), lambda result: why_absent(result, part), **named
    )


def column(values: Any) -> FloatArray:
    """Read a list of numbers, (n,) or (n, m), null as NaN."""
    return np.array(values if values is not None else [], dtype=np.float64)
