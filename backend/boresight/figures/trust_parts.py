"""How a figure reads its part of `trust`, and what it says where that part is not there.

Every part of a result's `trust` may be null: a filter that was stopped has no halves, a set without temperatures no
trend over them. The result then says why under `trust.unavailable`, and that sentence is what is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from boresight.arrays import FloatArray
from boresight.figures.chart import Trace
from boresight.figures.style import theme
from boresight.figures.style.theme import RunStyle
from boresight.verdicts.verdict import read_part, why_absent

Part = tuple[Trace, RunStyle, Any]


def parts(traces: Sequence[Trace], name: str) -> list[Part]:
    """Pair every run that has the part with its style and the part itself."""
    styled = zip(traces, theme.run_styles(traces), strict=True)
    return [(trace, style, part) for trace, style in styled if (part := read_part(trace.result, name))]


def absent(title: str, traces: Sequence[Trace], name: str) -> go.Figure:
    """Draw nothing, and say why the first run has nothing."""
    return theme.missing(title, why_absent(traces[0].result, name))


def column(values: Any) -> FloatArray:
    """Read a list of numbers, (n,) or (n, m), null as NaN."""
    return np.array(values if values is not None else [], dtype=np.float64)
