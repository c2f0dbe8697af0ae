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
from boresight.figures import theme
from boresight.figures.chart import Result, Trace
from boresight.figures.theme import RunStyle

Part = tuple[Trace, RunStyle, Any]

NOT_YET = "Trust is examined when the run ends; it is not there yet."
NEVER = "This result was made without an examination of trust: clone its run and start it again to have one."
NO_REASON = "This part of the examination could not be made for this run."


def part_of(result: Result, name: str) -> Any:
    """Read one part of `trust`; None where it is not there, or is empty."""
    return (result.get("trust") or {}).get(name) or None


def why_absent(result: Result, name: str) -> str:
    """Say in a sentence why a part is not there."""
    trust = result.get("trust")
    if not trust:
        return NEVER if result.get("status") not in {None, "running"} else NOT_YET
    return str((trust.get("unavailable") or {}).get(name) or NO_REASON)


def parts(traces: Sequence[Trace], name: str) -> list[Part]:
    """Pair every run that has the part with its style and the part itself."""
    styled = zip(traces, theme.run_styles(traces), strict=True)
    return [(trace, style, part) for trace, style in styled if (part := part_of(trace.result, name))]


def absent(title: str, traces: Sequence[Trace], name: str) -> go.Figure:
    """Draw nothing, and say why the first run has nothing."""
    return theme.missing(title, why_absent(traces[0].result, name))


def column(values: Any) -> FloatArray:
    """Read a list of numbers, (n,) or (n, m), null as NaN."""
    return np.array(values if values is not None else [], dtype=np.float64)
