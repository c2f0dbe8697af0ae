"""What a figure is: a name, a guide in words, and two pure functions of calibration JSON.

A figure never reads a file, a database or a clock, so the page, the report, a notebook and a test draw the same thing.
A run that is still computing gives a JSON with keys missing; the figure then says what is missing instead of failing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import orjson

from boresight.calibration.result import Result

if TYPE_CHECKING:
    import plotly.graph_objects as go

Table = dict[str, list[Any]]


@dataclass(frozen=True)
class Trace:
    """One run to draw; several make a comparison.

    `short`: What stands for the label over a narrow map. `along`: What the axis of frames counts, one of `ALIGNMENTS`.
    """

    label: str
    result: Result
    short: str = ""
    along: str = "frame"


@dataclass(frozen=True)
class Figure:
    """One chart of the registry.

    `table`: One calibration result to the columns of its CSV: complete, in SI, never thinned. `wide`: It takes a page's width.
    """

    name: str
    title: str
    guide: str
    draw: Callable[[Sequence[Trace]], go.Figure]
    table: Callable[[Result], Table]
    wide: bool = False


def figure_json(figure: go.Figure) -> bytes:
    """Encode a figure for `Plotly.react`; NaN and infinities become null."""
    return orjson.dumps(figure.to_plotly_json(), option=orjson.OPT_SERIALIZE_NUMPY)
