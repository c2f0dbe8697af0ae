"""Filter and smoother beside each other: each free parameter over frames, as known at the time and as known in the end.

The filter's estimate at a frame has seen the frames up to it, the smoother's all of them: its band is the narrower but at the end,
where both are one. Drawn is the change from the run's initial parameters. The wide first bands of the filter are outside of the
window, which holds the smoothed bands and the filter once it has taken in a part of the set.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.calibration.calibration import Calibration
from boresight.figures.chart import Figure, Table, Trace
from boresight.figures.style import theme
from boresight.figures.style.axes import axis_title, counted, frame_grid, share_cursor
from boresight.figures.style.thinning import keep_extremes
from boresight.verdicts.history import History, free_names, parameter_names, read_history
from boresight.verdicts.numbers import change_label, quantity

TITLE = "Filter and smoother"
NONE = "Nothing was smoothed: run a filter with 'smooth' to see the parameters at every frame given all frames."
POINT_BUDGET = 7000  # of all panels and curves together
LATER = 0.5  # of the filter's updates, which the window holds
PANEL_HEIGHT_PX = 190


def draw(traces: Sequence[Trace], most_columns: int = 4) -> go.Figure:
    """Draw every free parameter of each run that was smoothed: the filter's way and the smoothed one, with their 3-sigma bands."""
    drawn = [trace for trace in traces if read_smoothed(trace.result) is not None]
    if not drawn:
        return theme.missing(TITLE, NONE)
    names = list(dict.fromkeys(name for trace in drawn for name in free_names(trace.result)))
    columns = min(most_columns, len(names))
    n_rows = -(-len(names) // columns)
    figure = make_subplots(
        n_rows, columns, shared_xaxes="all", horizontal_spacing=0.24 / columns, vertical_spacing=0.16 / n_rows
    )
    labels = [f"{trace.label} · {which}" for trace in drawn for which in ("filter", "smoothed")]
    styles = theme.label_styles(labels if len(drawn) > 1 else ["filter", "smoothed"])
    limit = max(40, POINT_BUDGET // (len(names) * len(styles)))
    for number, name in enumerate(names):
        place = {"row": number // columns + 1, "col": number % columns + 1}
        seen = [
            reach
            for k, trace in enumerate(drawn)
            for reach in _draw_run(figure, place, trace.result, name, styles[2 * k : 2 * k + 2], limit)
        ]
        low, high = (min(seen), max(seen)) if seen else (-1.0, 1.0)
        margin = 0.08 * (high - low) or 1.0
        label = change_label(quantity(name, drawn[0].result))
        figure.update_yaxes(title={"text": label, "standoff": 4}, range=[low - margin, high + margin], **place)
    theme.dress(figure, title=_headline(drawn), height_px=110 + n_rows * PANEL_HEIGHT_PX)
    figure.update_xaxes(showticklabels=True)
    frame_grid(figure, len(names), columns, axis_title("frame", drawn))
    return share_cursor(figure, counted("frame", drawn))


def _headline(drawn: Sequence[Trace]) -> str:
    smoothed = drawn[0].result.smoothed
    unsettled = "" if smoothed is None or smoothed.settled else ": it does not settle, so do not use it"
    return f"Change since the initial parameters, at the time and given all frames, bands ±3σ{unsettled}"


def _draw_run(
    figure: go.Figure,
    place: dict[str, int],
    result: Calibration,
    name: str,
    styles: Sequence[theme.RunStyle],
    limit: int,
) -> list[float]:
    """Draw both curves of a parameter; returns what the window must hold."""
    item, seen = quantity(name, result), list[float]()
    origin = result.initial.get(name) or 0.0
    for style, history in zip(styles, (read_history(result), read_smoothed(result)), strict=True):
        if history is None or name not in history.names:
            continue
        column = history.names.index(name)
        value = (history.value[:, column] - origin) * item.change_factor
        reach = 3 * history.sigma[:, column] * item.change_factor
        kept = keep_extremes([value, reach], limit)
        x, value, reach = history.x[kept], value[kept], reach[kept]
        shown = place == {"row": 1, "col": 1}
        figure.add_trace(theme.band(style, x, value - reach, value + reach, showlegend=False), **place)
        hover = f"%{{y:+.5g}} ±%{{customdata:.3g}} {item.change_unit}<extra>{style.label}</extra>"
        settings = {"customdata": theme.short(reach), "hovertemplate": hover, "showlegend": shown}
        figure.add_trace(theme.line(style, x, value, **settings), **place)
        late = slice(int(LATER * len(x)) if style is styles[0] else 0, None)
        ends = np.concatenate([value[late] - reach[late], value[late] + reach[late]])
        seen += ends[np.isfinite(ends)].tolist()
    return seen


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
    """List every kept frame: smoothed parameters and their sigmas in SI."""
    history = read_smoothed(result)
    if history is None:
        return {}
    columns: Table = {"frame": [int(frame) for frame in history.x]}
    if history.time_utc:
        columns["time_utc"] = list(history.time_utc)
    for i, name in enumerate(history.names):
        columns[name] = theme.plain(history.value[:, i])
        columns[f"sigma_{name}"] = theme.plain(history.sigma[:, i])
    return columns


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
    forms={"narrow": partial(draw, most_columns=1)},
)
