"""What a figure is: a name, a guide in words, and two pure functions of a calibration.

A figure never reads a file, a database or a clock, so the page, the report, a notebook and a test draw the same thing.
A run that is still computing gives a calibration with members missing; the figure then says what is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import orjson

from boresight.calibration.calibration import Calibration
from boresight.verdicts.numbers import typeset

if TYPE_CHECKING:
    import plotly.graph_objects as go

Table = dict[str, list[Any]]


@dataclass(frozen=True)
class Trace:
    """One run to draw; several make a comparison.

    `short`: What stands for the label over a narrow map. `along`: What the axis of frames counts, one of `ALIGNMENTS`.
    `baseline`: The parameters in force now, SI, where the run did not start from them. `tail_from`: Where a reader wants the
    tail of the RMS to begin, on the axis of the run.
    """

    label: str
    result: Calibration
    short: str = ""
    along: str = "frame"
    baseline: Mapping[str, float | None] | None = None
    tail_from: float | None = None


def tailed(traces: Sequence[Trace], tail_from: float | None) -> list[Trace]:
    """Tell every run where a reader wants its tail to begin."""
    return [replace(trace, tail_from=tail_from) for trace in traces]


def labelled(traces: Sequence[Trace], size: str) -> list[Trace]:
    """Name every run as a legend of this size has room for."""
    return [replace(trace, label=trace.short or trace.label) if size == "narrow" else trace for trace in traces]


@dataclass(frozen=True)
class Figure:
    """One chart of the registry.

    `table`: One calibration to the columns of its CSV: complete, in SI, never thinned. `wide`: It takes a page's width.
    `advanced`: For research; a run's page folds it away. `forms`: What else than `draw` draws it: `small` in a view of about
    430 by 200 px, `medium` in half of a page and `narrow` on a phone, where those are
    laid out otherwise.
    """

    name: str
    title: str
    guide: str
    draw: Callable[[Sequence[Trace]], go.Figure]
    table: Callable[[Calibration], Table]
    wide: bool = False
    advanced: bool = False
    forms: Mapping[str, Callable[[Sequence[Trace]], go.Figure]] = field(default_factory=dict)

    def draw_for(self, size: str, traces: Sequence[Trace]) -> go.Figure | None:
        """Draw the form for a size, `large`, `medium`, `narrow` or `small`; None where there is no small one."""
        drawing = self.forms.get(size) or (None if size == "small" else self.draw)
        return drawing(traces) if drawing else None


def figure_json(figure: go.Figure) -> bytes:
    """Encode a figure for `Plotly.react`, its sentences with numbers as on a page; NaN and infinities become null."""
    document = figure.to_plotly_json()
    layout = document.get("layout", {})
    for words in (layout.get("title") or {}, *(layout.get("annotations") or ())):
        if words.get("text"):
            words["text"] = typeset(words["text"])
    return orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY)
