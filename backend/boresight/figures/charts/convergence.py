"""How each free parameter found its value: small multiples over frames or iterations (E Fig. 3).

Drawn is x_k - x_0, the change from the initial parameters of the first run, so that a live run keeps its axis while it
moves and two runs of one sensor share it. The band is +-3 sigma_k. E Eq. 31 subtracts the batch result instead: in a
comparison with frames on the axis a batch run is drawn as a level with its band, and the eye does the subtraction.

The first bands are the a-priori ones and would flatten all that follows, so the window of each panel holds what
follows the first steps, the median band, the truth, and the initial level where that is near; a double click shows all.

The dash-dotted line is where a run settled, and the last two panels judge it as a whole: its cost, and how far it still steps.
A batch run has its cost, half of chi-square, a filter its normalised innovation squared, sum nis / sum dof of the frames so
far, which is 1 where the covariance is honest. The step norm is the root mean square over the n free parameters of
(x_k - x_{k-1}) / sigma, in sigmas of the end for a batch and of the moment for a filter: a batch at rest steps by nothing, a
filter by about 1 / sqrt(k).

A run is settled from the step on after which every free parameter stays within three final sigmas of its end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import Calibration
from boresight.figures.chart import Figure, Table, Trace
from boresight.figures.live_traces import Panel, follow_column, follow_parameters
from boresight.figures.style import theme
from boresight.figures.style.axes import (
    ABOVE_NAMED_PX,
    axis_title,
    counted,
    frame_grid,
    grid_place,
    name_panel,
    offer_log,
    share_cursor,
    space_panels,
)
from boresight.figures.style.thinning import keep_extremes
from boresight.verdicts.history import History, free_names, read_history, settled_step
from boresight.verdicts.numbers import Quantity, change_label, grouped, quantity, scale_to

PANELS = 2
POINT_BUDGET = 1200  # a panel, of all runs together
MOST_MARKED = 3  # runs whose settling is marked; more lines than that hide the curves
Subplot = dict[str, int]  # row and column, from 1


def draw_panels(
    figure: go.Figure, places: Sequence[Subplot], histories: Sequence[History | None], traces: Sequence[Trace]
) -> None:
    """Add both panels in their places; a history that is None is another axis's."""
    for history, style in zip(histories, theme.run_styles(traces), strict=True):
        if history is not None:
            judged = history.cost if history.axis == "iteration" else innovations(history)
            _draw(figure, places[0], history, judged, style, POINT_BUDGET // len(traces))
            _draw(figure, places[1], history, step_norm(history), style, POINT_BUDGET // len(traces))
    cost, step = places
    log = {"type": "log", "exponentformat": "power", "nticks": 3}
    figure.update_yaxes(**log, **step)
    name_panel(figure, "step (σ)", **step)
    names = [_axis_name(figure, step)]
    if any(history is not None and history.axis == "frame" for history in histories):
        figure.add_hline(y=1, line=theme.LEVEL, **cost)
        name_panel(figure, "NIS / dof, so far", **cost)
    else:
        figure.update_yaxes(**log, **cost)
        name_panel(figure, "cost", **cost)
        names.append(_axis_name(figure, cost))
    offer_log(figure, names)


def _draw(
    figure: go.Figure, place: Subplot, history: History, y: FloatArray, style: theme.RunStyle, limit: int
) -> None:
    kept = keep_extremes([y], limit)
    settings = {"hovertemplate": f"%{{y:.4g}}<extra>{style.label}</extra>", "showlegend": False}
    figure.add_trace(theme.line(style, history.x[kept], y[kept], **settings), **place)


def _axis_name(figure: go.Figure, place: Subplot) -> str:
    """Return the layout's name of a subplot's y axis."""
    return str(next(iter(figure.select_yaxes(**place))).plotly_name)


def innovations(history: History) -> FloatArray:
    """Average the normalised innovation squared over the frames so far, per degree of freedom."""
    nis, dof = (np.nancumsum(values) for values in (history.nis, history.nis_dof))
    return np.where(dof > 0, nis / np.maximum(dof, 1), np.nan)


def step_norm(history: History) -> FloatArray:
    """Return the root mean square step in sigmas, (n_steps,); the first, which has none before it, is NaN."""
    free = [history.names.index(name) for name in history.free]
    sigma = history.sigma[-1:, free] if history.axis == "iteration" else history.sigma[1:, free]
    steps = np.diff(history.value[:, free], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        norm = np.sqrt(np.mean((steps / sigma) ** 2, axis=1))
    norm[~(norm > 0)] = np.nan  # a log axis has no place for nothing
    return np.concatenate([[np.nan], norm])


def mark_settled(
    figure: go.Figure, histories: Sequence[History | None], traces: Sequence[Trace], n_panels: int
) -> None:
    """Draw a vertical line in every panel where a run had settled, and name it in the legend."""
    if len(traces) > MOST_MARKED:
        return
    shapes: list[dict[str, Any]] = []
    for trace, history, style in zip(traces, histories, theme.run_styles(traces), strict=True):
        first = settled_step(trace.result)
        if history is None or first is None or not first < len(history.x):
            continue
        x = float(history.x[first])
        line = {"color": style.colour, "dash": "dashdot", "width": 1.2}
        shapes += [
            {"type": "line", "x0": x, "x1": x, "y0": 0, "y1": 1, "line": line, "xref": f"x{n}", "yref": f"y{n} domain"}
            for n in ["", *range(2, n_panels + 1)]
        ]
        named = go.Scatter(x=[None], y=[None], mode="lines", line=line, name=_words(style, x, len(traces)))
        figure.add_trace(named, row=1, col=1)
    figure.update_layout(shapes=[*figure.layout.shapes, *shapes])


def _words(style: theme.RunStyle, x: float, n_runs: int) -> str:
    whose = f"{style.label} · " if n_runs > 1 else ""
    return f"{whose}settled at {grouped(format(x, '.5g'))}"


TITLE = "Convergence"
FEW_PANELS = 9  # up to so many stand in three columns, more in four
PANEL_HEIGHT_PX = 190
TRANSIENT_SHARE = 0.05  # of the steps, which the window need not hold
CONVERGENCE_POINT_BUDGET = 7000  # estimates of all panels and runs together
REFERENCES = {
    "initial": (theme.REFERENCE_COLOUR, "dot"),
    "baseline": (theme.RUN_COLOURS[2], "dash"),
    "truth": (theme.TRUTH_COLOUR, "longdashdot"),
}


@dataclass(frozen=True)
class ConvergencePanel(Panel):
    """One parameter's subplot, and what its window must hold."""

    seen: list[float]

    def change(self, value: FloatArray | float) -> FloatArray:
        """Turn SI values into changes in display units."""
        return np.asarray((np.asarray(value, dtype=np.float64) - self.origin) * self.item.factor)


def draw(traces: Sequence[Trace], most_columns: int = 4) -> go.Figure:
    """Draw every free parameter's change with its 3-sigma band."""
    histories = [read_history(trace.result) for trace in traces]
    found = [history for history in histories if history is not None]
    if not found:
        return theme.missing(
            TITLE, "No frame or iteration has been recorded yet: the curves appear as the run proceeds."
        )
    axis = "frame" if any(history.axis == "frame" for history in found) else "iteration"
    panels = _panels(traces, found, most_columns)
    n_panels = len(panels) + PANELS
    columns = _columns(n_panels, most_columns)
    n_rows = -(-n_panels // columns)
    figure = make_subplots(n_rows, columns, shared_xaxes="all", **space_panels(columns, n_rows))
    span = _span([history for history in found if history.axis == axis])
    limit = CONVERGENCE_POINT_BUDGET // (len(panels) * len(found))
    for history, style in zip(histories, theme.run_styles(traces), strict=True):
        if history is not None:
            _draw_run(figure, panels, history if history.axis == axis else _level(history, span), style, limit)
    if len(traces) > MOST_MARKED:
        figure.for_each_trace(lambda band: band.update(showlegend=False), {"fill": "toself"})
    for panel in panels:
        _draw_references(figure, panel, traces, span)
        _frame_panel(figure, panel)
    _dress(figure, traces, axis, n_panels, columns)
    along = [history if history and history.axis == axis else None for history in histories]
    judges = [grid_place(number, columns) for number in (n_panels - 2, n_panels - 1)]
    draw_panels(figure, judges, along, traces)
    follow_parameters(figure, panels, traces)
    follow_column(figure, judges[0], "nis_per_dof", traces)
    mark_settled(figure, along, traces, n_panels)
    return share_cursor(figure, counted(axis, traces))


def _columns(n_panels: int, most: int) -> int:
    return min(most, 3 if n_panels <= FEW_PANELS else 4)


def _dress(figure: go.Figure, traces: Sequence[Trace], axis: str, n_panels: int, columns: int) -> None:
    height_px = 130 - (-n_panels // columns) * PANEL_HEIGHT_PX
    theme.dress(figure, title=_headline(traces), height_px=height_px)
    figure.update_layout(margin={"t": ABOVE_NAMED_PX})
    figure.update_xaxes(showticklabels=True)
    frame_grid(figure, n_panels, columns, axis_title(axis, traces))


def _headline(traces: Sequence[Trace]) -> str:
    result = traces[0].result
    if len(traces) > 1:
        return f"Change since the initial parameters, {len(traces)} runs, bands ±3σ"
    state = "" if result.status != "running" else ", still running"
    return f"Change since the initial parameters, band ±3σ{state}"


def _panels(traces: Sequence[Trace], histories: Sequence[History], most_columns: int) -> list[ConvergencePanel]:
    """Lay out one panel a parameter that any run estimates."""
    names = list(dict.fromkeys(name for trace in traces for name in free_names(trace.result)))
    names = [name for name in names if any(name in history.names for history in histories)]
    return [
        ConvergencePanel(
            name,
            scaled_quantity(name, traces[0].result),
            _origin(name, traces, histories),
            *divmod(i, _columns(len(names) + PANELS, most_columns)),
            [],
        )
        for i, name in enumerate(names)
    ]


def scaled_quantity(name: str, result: Calibration) -> Quantity:
    """Return a parameter on the scale of its typical sigma, so that the unit is the same however far a run has come."""
    return scale_to(quantity(name, result), result.typical_sigma.get(name))


def _origin(name: str, traces: Sequence[Trace], histories: Sequence[History]) -> float:
    """Choose what changes are counted from: the first run's initial value, or its first estimate."""
    for trace in traces:
        if (initial := trace.result.initial.get(name)) is not None:
            return initial
    return next(float(c.value[0, c.names.index(name)]) for c in histories if name in c.names)


def _span(histories: Sequence[History]) -> tuple[float, float]:
    return min(float(c.x.min()) for c in histories), max(float(c.x.max()) for c in histories)


def _level(history: History, span: tuple[float, float]) -> History:
    """Stretch a batch run's last estimate over the frames of the sequential runs beside it."""
    value, sigma = (np.tile(last, (2, 1)) for last in (history.value[-1], history.sigma[-1]))
    return replace(history, axis="frame", x=np.array(span), value=value, sigma=sigma)


def _draw_run(
    figure: go.Figure, panels: list[ConvergencePanel], history: History, style: theme.RunStyle, limit: int
) -> None:
    """Add one run's curve and band to every panel it has a parameter for."""
    shown = False
    for panel in panels:
        if panel.name not in history.free:
            continue
        column = history.names.index(panel.name)
        value = panel.change(history.value[:, column])
        reach = 3 * history.sigma[:, column] * panel.item.factor
        kept = keep_extremes([value, reach], max(limit, 40))
        x, value, reach = history.x[kept], value[kept], reach[kept]
        place = {"row": panel.row + 1, "col": panel.column + 1}
        band = theme.band(style, x, value - reach, value + reach, showlegend=not shown)
        figure.add_trace(band, **place)
        hover = f"%{{y:+.5g}} ±%{{customdata:.3g}} {panel.item.unit}<extra>{style.label}</extra>"
        settings = {"customdata": theme.short(reach), "hovertemplate": hover, "showlegend": not shown}
        figure.add_trace(theme.line(style, x, value, **settings), **place)
        shown = True
        panel.seen.extend(_seen(value, reach))


def _seen(value: FloatArray, reach: FloatArray) -> list[float]:
    """List what the window must hold: the estimates after the first steps, and the last one within the median band."""
    value, reach = value[np.isfinite(value)], reach[np.isfinite(reach)]
    if not len(value):
        return []
    half = float(np.median(reach)) if len(reach) else 0.0
    settled = value[int(TRANSIENT_SHARE * len(value)) :]
    return [float(settled.min()), float(settled.max()), float(value[-1]) - half, float(value[-1]) + half]


def _known(trace: Trace) -> dict[str, Mapping[str, float | None] | None]:
    """Return the parameters that a run is compared with, by what they are."""
    return {"initial": trace.result.initial, "baseline": trace.baseline, "truth": trace.result.truth}


def _draw_references(
    figure: go.Figure, panel: ConvergencePanel, traces: Sequence[Trace], span: tuple[float, float]
) -> None:
    """Add the initial level, the baseline's where it is another, and the true one where a simulation knows it.

    Where runs have different ones, as those of several sensors, each has the colour of its run.
    """
    apart = {key for key in REFERENCES if len({str(values) for trace in traces if (values := _known(trace)[key])}) > 1}
    levels: dict[tuple[str, float], tuple[str, str]] = {}
    for trace, style in theme.styled(traces):
        for key, values in _known(trace).items():
            value = values.get(panel.name) if values else None
            if value is not None:
                colour, dash = REFERENCES[key]
                levels.setdefault((key, float(panel.change(value))), (style.colour if key in apart else colour, dash))
    first, shown = panel.row == panel.column == 0, set[str]()
    height = max(panel.seen, default=0.0) - min(panel.seen, default=0.0)
    for (key, level), (colour, dash) in levels.items():
        settings = {"showlegend": first and key not in shown, "hoverinfo": "skip", "hovertemplate": None}
        shown.add(key)
        name = f"{key}, in its run's colour" if key in apart else key
        drawn = theme.reference(span, level, name, colour, dash, **settings)
        figure.add_trace(drawn, row=panel.row + 1, col=panel.column + 1)
        if key == "truth" or min(abs(level - seen) for seen in panel.seen or [level]) <= height:
            panel.seen.append(level)


def _frame_panel(figure: go.Figure, panel: ConvergencePanel) -> None:
    low, high = (min(panel.seen), max(panel.seen)) if panel.seen else (-1.0, 1.0)
    margin = 0.08 * (high - low) or 1.0
    place = {"row": panel.row + 1, "col": panel.column + 1}
    figure.update_yaxes(range=[low - margin, high + margin], **place)
    name_panel(figure, change_label(panel.item), **place)


SMALL_COLUMNS = 5  # at most
SMALL_POINTS = 160
SMALL_REACH = 12.0  # final sigmas: what one axis for all parameters shows


def draw_small(traces: Sequence[Trace]) -> go.Figure:
    """Draw each parameter's way to its end in units of its last sigma, so that all share one axis."""
    trace, history = traces[0], read_history(traces[0].result)
    if history is None:
        return theme.missing(TITLE, "No frame or iteration has been recorded yet.")
    style, names = theme.run_styles(traces[:1])[0], history.free
    n_rows = 1 if len(names) <= SMALL_COLUMNS - 1 else 2
    columns = -(-len(names) // n_rows)
    figure = make_subplots(
        n_rows, columns, shared_xaxes="all", shared_yaxes="all", horizontal_spacing=0.02, vertical_spacing=0.09
    )
    panels = [_draw_way(figure, trace.result, history, name, place, columns, style) for place, name in enumerate(names)]
    theme.shrink(figure)
    figure.update_yaxes(range=[-SMALL_REACH, SMALL_REACH], tickvals=[-9, 0, 9], zeroline=True)
    figure.update_xaxes(nticks=3, showticklabels=False)
    figure.update_xaxes(showticklabels=True, row=n_rows)
    words = {"xref": "paper", "yref": "paper", "showarrow": False, "font": {"size": 10}}
    title = f"{axis_title(history.axis, traces)}; band ±3σ"
    figure.add_annotation(text=title, x=1, y=0, xanchor="right", yanchor="top", yshift=-16, **words)
    figure.add_annotation(text="from final value (σ)", x=0, y=0.5, xanchor="right", xshift=-26, textangle=-90, **words)
    follow_parameters(figure, [panel for panel in panels if panel], traces)
    return share_cursor(figure, counted(history.axis, traces))


def _draw_way(
    figure: go.Figure, result: Calibration, history: History, name: str, place: int, columns: int, style: theme.RunStyle
) -> Panel | None:
    """Draw one parameter in its small panel; None where its last sigma is not known."""
    column, (row, col) = history.names.index(name), divmod(place, columns)
    value, sigma = history.value[:, column], history.sigma[:, column]
    item, where = quantity(name, result), {"row": row + 1, "col": col + 1}
    letter = {"x": 0.04, "y": 1, "xref": "x domain", "yref": "y domain", "xanchor": "left", "yanchor": "top"}
    figure.add_annotation(text=f"<b>{item.markup}</b>", showarrow=False, **letter, **where)
    if not np.isfinite(sigma[-1]) or sigma[-1] <= 0:
        return None
    y, reach = (value - value[-1]) / sigma[-1], 3 * sigma / sigma[-1]
    kept = keep_extremes([y, reach], SMALL_POINTS)
    x, y, reach = history.x[kept], y[kept], reach[kept]
    figure.add_trace(theme.band(style, x, y - reach, y + reach), **where)
    figure.add_trace(theme.line(style, x, y, hoverinfo="skip"), **where)
    return Panel(name, replace(item, factor=1 / float(sigma[-1])), float(value[-1]), row, col)


def table(result: Calibration) -> Table:
    """List every step: parameters and sigmas in SI."""
    history = read_history(result)
    return {} if history is None else list_history(history)


def list_history(history: History) -> Table:
    """List one step of a history a row: its parameters and their sigmas, SI."""
    columns: Table = {history.axis: [int(step) for step in history.x]}
    if history.time_utc:
        columns["time_utc"] = list(history.time_utc)
    for i, name in enumerate(history.names):
        columns[name] = list_known(history.value[:, i])
        columns[f"sigma_{name}"] = list_known(history.sigma[:, i])
    return columns


CONVERGENCE = Figure(
    name="convergence",
    title=TITLE,
    guide=(
        "Each panel shows the change of one parameter from its initial value (dotted line at zero), with its own ±3σ "
        "band, the last two panels show the cost and the step; double-click a panel to see the full range of the first "
        "bands. A trustworthy run settles (dash-dotted upright line), its band narrows around the curve, and the curve "
        "stays inside its earlier bands."
    ),
    draw=draw,
    table=table,
    wide=True,
    forms={"small": draw_small, "medium": partial(draw, most_columns=2), "narrow": partial(draw, most_columns=1)},
)
