"""How the matches came to rest: fit, match again with the new parameters, fit again, until nothing changes.

Both counts of each cycle are drawn: the stars that are matched, and the matches that are new, gone or of another star.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.calibration.result import Result
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, make_figure
from boresight.figures.style import theme

PANELS = (
    ("matched", "matched stars", 1.0),
    ("changed", "changed matches", 1.0),
    ("rms_arc_rad", "RMS arc (µrad)", 1e6),
)
LEAST_CYCLES = 3  # the axis has room for so many, that one alone is no wall
GIVEN = "This run used the matches it was given: nothing was matched again."
NOT_YET = "Matching is reported when the run ends; it is not there yet."
NO_CYCLES = "This run matched its stars without cycles."


def draw(drawn: Sequence[Part]) -> go.Figure:
    """Draw matched stars, changed matches and RMS by cycle, a bar a run."""
    figure = make_subplots(1, len(PANELS), horizontal_spacing=0.1)
    for place, (key, _, factor) in enumerate(PANELS, start=1):
        for _, style, cycles in drawn:
            values = factor * column([cycle.get(key) for cycle in cycles])
            figure.add_trace(_bars(style, cycles, values, labelled=len(drawn) == 1), row=1, col=place)
    many, most = len(drawn) > 1, max(len(cycles) for _, _, cycles in drawn)
    room = [0.4, max(most, LEAST_CYCLES) + 0.6]
    theme.dress(figure, title=_headline(drawn), height_px=340, legend=many, hovermode="closest", barmode="group")
    for place, (_, title, _) in enumerate(PANELS, start=1):
        figure.update_xaxes(title_text="cycle", dtick=1, range=room, showgrid=False, row=1, col=place)
        figure.update_yaxes(title_text=title, rangemode="tozero", nticks=5, row=1, col=place)
    figure.update_traces(showlegend=False, selector=lambda trace: trace.xaxis != "x")
    return figure


def read_cycles(result: Result) -> list[Result]:
    """Read the cycles of a run, first first; none where nothing was matched again."""
    return list((result.get("matching") or {}).get("cycles") or ())


def why_no_matching(result: Result) -> str | None:
    """Say why a result has nothing to tell of matching, or None where it has."""
    if result.get("matching"):
        return None
    chosen = ((result.get("inputs") or {}).get("settings") or {}).get("match")
    if chosen == "given":
        return GIVEN
    return NOT_YET if result.get("status") in {None, "running"} else GIVEN


def _bars(style: theme.RunStyle, cycles: Sequence[Result], values: FloatArray, *, labelled: bool) -> go.Bar:
    words = [
        f"{value:,.0f}" if value >= 1000 or value == int(value) else f"{value:.4g}" for value in np.nan_to_num(values)
    ]
    numbers = [cycle.get("cycle", i) for i, cycle in enumerate(cycles, start=1)]
    more = {"text": words if labelled else None, "offsetgroup": style.label}
    return theme.bars(style, numbers, values, "cycle %{x}: %{y:,.5g}", **more)


def _headline(drawn: Sequence[Part]) -> str:
    if len(drawn) > 1:
        return f"Matching cycles of {len(drawn)} runs"
    matching = drawn[0][0].result["matching"]
    n_cycles = len(drawn[0][2])
    said = f"{n_cycles} cycle{'s' * (n_cycles != 1)}"
    return f"The matches rested after {said}" if matching.get("rested") else f"The matches had not rested after {said}"


def table(cycles: Sequence[Result]) -> Table:
    """List one cycle a row: stars matched, matches changed, RMS in rad."""
    return {key: [cycle.get(key) for cycle in cycles] for key in ("cycle", "matched", "changed", "rms_arc_rad")}


MATCHING = make_figure(
    draw,
    table,
    read_cycles,
    lambda result: why_no_matching(result) or NO_CYCLES,
    name="matching",
    title="Matching cycles",
    guide=(
        "Each bar is one cycle of fitting and matching again: how many stars are matched, how many matches changed since "
        "the cycle before, and the error that is left. Changes that fall to zero are good; matches that never rest "
        "hang between two stars, and the parameters with them."
    ),
    wide=True,
)
