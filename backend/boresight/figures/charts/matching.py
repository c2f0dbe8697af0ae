"""How the matches came to rest: fit, match again with the new parameters, fit again, until nothing changes.

Both counts of each cycle are drawn: the stars that are matched, and the matches that are new, gone or of another star.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Calibration, Cycle
from boresight.figures.chart import Table
from boresight.figures.factory import Part, column, make_figure
from boresight.figures.style import theme
from boresight.figures.style.axes import BETWEEN_PANELS, grid_place, stacked_px
from boresight.verdicts.numbers import count, number

PANELS: dict[str, Callable[[Cycle], float | None]] = {
    "matched stars": lambda cycle: cycle.matched,
    "changed matches": lambda cycle: cycle.changed,
    "RMS arc (µrad)": lambda cycle: None if cycle.rms_arc_rad is None else 1e6 * cycle.rms_arc_rad,
}
LEAST_CYCLES = 3  # the axis has room for so many, that one alone is no wall
GIVEN = "This run used the given matches without the removed stars: nothing was matched again."
NOT_YET = "Not yet: matching is reported when the run ends."
NO_CYCLES = "This run matched its stars without cycles."


def draw(drawn: Sequence[Part[list[Cycle]]], beside: int = len(PANELS)) -> go.Figure:
    """Draw matched stars, changed matches and RMS by cycle, a bar a run."""
    rows = len(PANELS) // beside
    figure = make_subplots(rows, beside, horizontal_spacing=0.1, vertical_spacing=BETWEEN_PANELS / rows)
    for place, read in enumerate(PANELS.values()):
        for _, style, cycles in drawn:
            values = column([read(cycle) for cycle in cycles])
            figure.add_trace(_bars(style, cycles, values, labelled=len(drawn) == 1), **grid_place(place, beside))
    many, most = len(drawn) > 1, max(len(cycles) for _, _, cycles in drawn)
    room = [0.4, max(most, LEAST_CYCLES) + 0.6]
    theme.dress(
        figure,
        title=_headline(drawn),
        height_px=stacked_px(340, rows, beside),
        legend=many,
        hovermode="closest",
        barmode="group",
    )
    for place, title in enumerate(PANELS):
        where = grid_place(place, beside)
        figure.update_xaxes(title_text="cycle", dtick=1, range=room, showgrid=False, **where)
        figure.update_yaxes(title_text=title, rangemode="tozero", nticks=5, **where)
    figure.update_traces(showlegend=False, selector=lambda trace: trace.xaxis != "x")
    return figure


def read_cycles(result: Calibration) -> list[Cycle]:
    """Read the cycles of a run, first first; none where nothing was matched again."""
    return result.matching.cycles if result.matching else []


def why_no_matching(result: Calibration) -> str | None:
    """Say why a result has nothing to tell of matching, or None where it has."""
    if result.matching:
        return None
    awaited = result.status == "running" and result.inputs.settings.match != "given"
    return NOT_YET if awaited else GIVEN


def _bars(style: theme.RunStyle, cycles: Sequence[Cycle], values: FloatArray, *, labelled: bool) -> go.Bar:
    words = [count(value) if value >= 1000 or value == int(value) else number(value) for value in np.nan_to_num(values)]
    numbers = [cycle.cycle for cycle in cycles]
    more = {"text": words if labelled else None, "offsetgroup": style.label}
    return theme.bars(style, numbers, values, "cycle %{x}: %{y:,.5g}", **more)


def _headline(drawn: Sequence[Part[list[Cycle]]]) -> str:
    if len(drawn) > 1:
        return f"Matching cycles of {len(drawn)} runs"
    matching = drawn[0][0].result.matching
    n_cycles = len(drawn[0][2])
    said = f"{n_cycles} cycle{'s' * (n_cycles != 1)}"
    return (
        f"The matches settled after {said}"
        if matching and matching.rested
        else f"The matches had not settled after {said}"
    )


def table(cycles: Sequence[Cycle]) -> Table:
    """List one cycle a row: stars matched, matches changed, RMS in rad."""
    return {
        "cycle": [cycle.cycle for cycle in cycles],
        "matched": [cycle.matched for cycle in cycles],
        "changed": [cycle.changed for cycle in cycles],
        "rms_arc_rad": [cycle.rms_arc_rad for cycle in cycles],
    }


MATCHING = make_figure(
    draw,
    table,
    read_cycles,
    lambda result: why_no_matching(result) or NO_CYCLES,
    name="matching",
    title="Matching cycles",
    guide=(
        "Each bar is one cycle of fitting and matching again: how many stars are matched, how many matches changed since the "
        "previous cycle, and the remaining error. Changes that fall to zero are good; matches that never settle alternate "
        "between two stars, and the parameters with them."
    ),
    wide=True,
    advanced=True,
    forms={"narrow": partial(draw, beside=1)},
)
