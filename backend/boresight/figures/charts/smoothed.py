"""Filter and smoother beside each other: each free parameter over frames, as known at the time and as known in the end.

The filter's estimate at a frame has seen the frames up to it, the smoother's all of them: its band is the narrower but at the end,
where both are one. A batch is what all frames say of a camera that rests: a level. Drawn is the change from the run's initial
parameters. The wide first bands of the filter are outside of the window, which holds the smoothed bands and the filter once it has
taken in a part of the set.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Calibration
from boresight.figures.chart import Figure, Table, Trace
from boresight.figures.charts.convergence import list_history, scaled_quantity
from boresight.figures.style import theme
from boresight.figures.style.axes import (
    ABOVE_NAMED_PX,
    axis_title,
    counted,
    frame_grid,
    name_panel,
    share_cursor,
    space_panels,
)
from boresight.figures.style.thinning import keep_extremes
from boresight.verdicts.history import History, free_names, parameter_names, read_history
from boresight.verdicts.numbers import Quantity, change_label

TITLE = "Filter and smoother"
NONE = "No estimate yet: the curves appear when the run has ended."
POINT_BUDGET = 5000  # of all panels and curves together
MOST_FILTERS = 3  # runs whose filters are drawn beside what was smoothed
LATER = 0.5  # of the filter's updates, which the window holds
PANEL_HEIGHT_PX = 190


def draw(traces: Sequence[Trace], most_columns: int = 4) -> go.Figure:
    """Draw every free parameter of each run: the filter's way and the smoothed one with 3-sigma bands, and a batch as a level."""
    drawn = [trace for trace in traces if trace.result.parameters]
    if not drawn:
        return theme.missing(TITLE, NONE)
    names = list(dict.fromkeys(name for trace in drawn for name in free_names(trace.result)))
    columns = min(most_columns, len(names))
    n_rows = -(-len(names) // columns)
    figure = make_subplots(n_rows, columns, shared_xaxes="all", **space_panels(columns, n_rows))
    styles, ways = theme.run_styles(drawn), [_ways(trace.result, len(drawn) <= MOST_FILTERS) for trace in drawn]
    known = [way.x for found in ways for way in found if len(way.x) > 1]
    span = (min(x.min() for x in known), max(x.max() for x in known)) if known else (0.0, 1.0)
    limit = max(20, POINT_BUDGET // (len(names) * sum(map(len, ways))))
    for number, name in enumerate(names):
        place = {"row": number // columns + 1, "col": number % columns + 1}
        seen: list[float] = []
        item = scaled_quantity(name, drawn[0].result)
        for trace, style, found in zip(drawn, styles, ways, strict=True):
            for way in found:
                seen += _draw_way(figure, place, trace.result, name, item, way.across(span), style, limit)
        low, high = (min(seen), max(seen)) if seen else (-1.0, 1.0)
        margin = 0.08 * (high - low) or 1.0
        figure.update_yaxes(range=[low - margin, high + margin], **place)
        name_panel(figure, change_label(item), **place)
    theme.dress(figure, title=_headline(drawn), height_px=130 + n_rows * PANEL_HEIGHT_PX)
    figure.update_layout(margin={"t": ABOVE_NAMED_PX})
    figure.update_xaxes(showticklabels=True)
    frame_grid(figure, len(names), columns, axis_title("frame", drawn))
    return share_cursor(figure, counted("frame", drawn))


def _headline(drawn: Sequence[Trace]) -> str:
    if len(drawn) > 1:
        return f"Change since the initial parameters, {len(drawn)} runs, bands ±3σ"
    smoothed = drawn[0].result.smoothed
    unsettled = "" if smoothed is None or smoothed.settled else ": the smoother does not settle, so do not use it"
    return f"Change since the initial parameters, at the time and given all frames, bands ±3σ{unsettled}"


@dataclass(frozen=True)
class Way:
    """One curve: what it is, its dash (the run's own where empty), and steps x (n,), values and sigmas (n, n_parameters), SI."""

    what: str
    dash: str
    x: FloatArray
    names: tuple[str, ...]
    value: FloatArray
    sigma: FloatArray

    def across(self, span: tuple[float, float]) -> Way:
        """Stretch a level over the frames of the others."""
        if len(self.x) > 1:
            return self
        return replace(self, x=np.array(span), value=np.tile(self.value, (2, 1)), sigma=np.tile(self.sigma, (2, 1)))


def _ways(result: Calibration, with_filter: bool) -> list[Way]:
    """List what is known of a run over frames: its filter, what was smoothed, or the estimate of a batch as one step."""
    history, smoothed, ways = read_history(result), read_smoothed(result), list[Way]()
    if history is not None and history.axis == "frame" and (with_filter or smoothed is None):
        ways.append(Way("filter", "dash", history.x, history.names, history.value, history.sigma))
    if smoothed is not None:
        ways.append(Way("smoothed", "", smoothed.x, smoothed.names, smoothed.value, smoothed.sigma))
    if not ways:
        names = parameter_names(result)
        value, sigma = (
            np.array([[numbers.get(name) for name in names]], np.float64)
            for numbers in (result.parameters, result.sigma)
        )
        ways.append(Way("batch", "", np.zeros(1), names, value, sigma))
    return ways


def _draw_way(
    figure: go.Figure,
    place: dict[str, int],
    result: Calibration,
    name: str,
    item: Quantity,
    way: Way,
    style: theme.RunStyle,
    limit: int,
) -> list[float]:
    """Draw a curve of one parameter with its band; returns what the window must hold."""
    if name not in way.names:
        return []
    column = way.names.index(name)
    value = (way.value[:, column] - (result.initial.get(name) or 0.0)) * item.factor
    reach = 3 * way.sigma[:, column] * item.factor
    kept = keep_extremes([value, reach], limit)
    x, value, reach = way.x[kept], value[kept], reach[kept]
    shown = place == {"row": 1, "col": 1}
    drawn = replace(style, label=f"{style.label} · {way.what}", dash=way.dash or style.dash)
    figure.add_trace(theme.band(drawn, x, value - reach, value + reach), **place)
    hover = f"%{{y:+.5g}} ±%{{customdata:.3g}} {item.unit}<extra>{drawn.label}</extra>"
    settings = {"customdata": theme.short(reach), "hovertemplate": hover, "showlegend": shown}
    figure.add_trace(theme.line(drawn, x, value, **settings), **place)
    late = slice(int(LATER * len(x)) if way.what == "filter" else 0, None)
    ends = np.concatenate([value[late] - reach[late], value[late] + reach[late]])
    return [float(end) for end in ends[np.isfinite(ends)]]


def read_smoothed(result: Calibration) -> History | None:
    """Read the smoothed parameters as a history; None where nothing was smoothed."""
    smoothed = result.smoothed
    if smoothed is None or not smoothed.frame:
        return None
    names = parameter_names(result)
    free = tuple(name for name in free_names(result) if name in names)
    return History(
        "frame", np.array(smoothed.frame, np.float64), names, free,
        np.array(smoothed.parameters, np.float64), np.array(smoothed.sigma, np.float64),
        time_utc=smoothed.time_utc,
    )  # fmt: skip


def table(result: Calibration) -> Table:
    """List every kept frame: smoothed parameters and their sigmas in SI; of a run that was not smoothed its estimate."""
    history = read_smoothed(result)
    return {name: [value] for name, value in result.parameters.items()} if history is None else list_history(history)


SMOOTHED = Figure(
    name="smoothed",
    title=TITLE,
    guide=(
        "Each panel shows the change of one parameter from its initial value, as the filter knew it at each frame and as all "
        "frames together know it, each with its ±3σ band. The smoothed curve should lie inside the filter's band; where it moves "
        "by more than its own band, the camera changed at that time."
    ),
    draw=draw,
    table=table,
    wide=True,
    forms={"medium": partial(draw, most_columns=2), "narrow": partial(draw, most_columns=1)},
)
