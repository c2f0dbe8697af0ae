"""Makes figures of what they read in calibrations, each with what it says where that is not there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Calibration, Trust
from boresight.figures.chart import Figure, Table, Trace
from boresight.figures.style import theme
from boresight.verdicts.verdict import why_absent

P = TypeVar("P")
Part = tuple[Trace, theme.RunStyle, P]  # a run, how it is drawn, and what a figure reads of its calibration


def make_figure(
    draw: Callable[[Sequence[Part[P]]], go.Figure],
    table: Callable[[P], Table],
    read: Callable[[Calibration], P | None],
    why: Callable[[Calibration], str],
    *,
    name: str,
    title: str,
    guide: str,
    forms: Mapping[str, Callable[[Sequence[Part[P]]], go.Figure]] = MappingProxyType({}),
    **looks: bool,
) -> Figure:
    """Make a figure of what `read` finds in calibrations; where the first run has nothing, `why` says so in its place."""

    def draw_with(drawing: Callable[[Sequence[Part[P]]], go.Figure], traces: Sequence[Trace]) -> go.Figure:
        drawn = [(trace, style, part) for trace, style in theme.styled(traces) if (part := read(trace.result))]
        return drawing(drawn) if drawn else theme.missing(title, why(traces[0].result))

    def list_run(result: Calibration) -> Table:
        return table(part) if (part := read(result)) else {}

    others = {form: partial(draw_with, drawing) for form, drawing in forms.items()}
    return Figure(name, title, guide, partial(draw_with, draw), list_run, forms=others, **looks)


def part_figure(
    draw: Callable[[Sequence[Part[P]]], go.Figure], table: Callable[[P], Table], part: str, **named: Any
) -> Figure:
    """Make a figure of one part of `trust`."""

    def read(result: Calibration) -> P | None:
        found: P | None = getattr(result.trust or Trust(), part)
        return found

    return make_figure(draw, table, read, lambda result: why_absent(result, part), **named)


def column(values: Any) -> FloatArray:
    """Read a list of numbers, (n,) or (n, m), null as NaN."""
    return np.array(values if values is not None else [], dtype=np.float64)
