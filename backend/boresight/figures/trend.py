"""Every parameter over the mission: calibrations at the time of their data, baselines, truth, temperature, records, annotations.

Drawn from the document of `boresight.trend/1`. A parameter is shown by its difference from the baseline of now, which is the
line at zero; where another camera model has none, from its first calibration.

A panel is scaled to the newest calibrations. With values v, reaches r = 3 sigma and medians of the newest,

    m = med v,    s = max(1.4826 med |v - m|, med r),

it shows what lies within 4 s of m, and the three newest wherever they are. What lies beyond is marked at the edge with
its value, so that an old one does not press all others into a line.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.calibration.calibration import Values
from boresight.figures.chart import Table
from boresight.figures.style import theme
from boresight.verdicts.numbers import Quantity, change_label, quantity, scale_to, signed
from boresight.verdicts.trend import SHOWN_AS, Trend, TrendPoint

NAME = "trend"
TITLE = "Parameters over the mission"
GUIDE = (
    "Each mark is a calibration at the time of its data with a ±3σ bar, relative to the current baseline (the zero "
    "line); open marks are not used in the drift test, and the table says why. A stable sensor scatters about "
    "zero within its bars; a run of marks to one side, or a slope, is drift, unless the temperature below changes with it. "
    "The scale is that of the newest calibrations; a triangle at the edge marks a value off the scale and is labelled "
    "with it."
)
ROW_PX, LOW_ROW_PX = 120, 84
RECENT, NEWEST = 10, 3  # calibrations that give the scale, and those that are always on it
NEAR = 4.0  # spreads
NORMAL = 1.4826  # sigma of a normal distribution over its median absolute deviation
TALL_BAR = 2.0  # times the median reach: a longer bar does not widen the scale
MARGIN, EDGE = 0.1, 0.05  # of what a panel shows
APART = 0.5  # of the time shown, between two labels at one edge
BEYOND = "Beyond the scale"
COUNTED, LEFT_OUT = theme.RUN_COLOURS[0], theme.RUN_COLOURS[7]
WARMTH, SAID = theme.RUN_COLOURS[1], theme.RUN_COLOURS[3]
LONGEST_LABEL = 28


def draw(trend: Trend, model: str | None = None) -> go.Figure:
    """Draw a sensor over the mission, of its baseline's camera model or of another."""
    points = list_points(trend, model)
    names = _names(trend, points)
    if not names:
        return theme.missing(
            "Parameters over the mission", "No calibration has succeeded yet: launch a run to see its result here."
        )
    own = model in {None, trend.camera_model}
    warm = any(point.temperature_c is not None for point in points)
    rows = len(names) + warm + 1
    heights = [ROW_PX] * len(names) + [LOW_ROW_PX] * (warm + 1)
    figure = make_subplots(rows, 1, shared_xaxes=True, vertical_spacing=0.012, row_heights=heights)
    span = _span(trend, points)
    for row, name in enumerate(names, 1):
        zero = _zero(trend, points, name, own=own)
        item = scale_to(quantity(name), zero, *(point.parameters.get(name) for point in points))
        levels = _levels(trend, name, item, zero, span) if own else []
        for level in levels:
            _level(figure, level, row)
        _marks(figure, points, name, item, zero, row)
        _scale(figure, points, name, item, zero, levels, row, span)
        figure.update_yaxes(title_text=change_label(item), row=row, col=1)
    if warm:
        _temperature(figure, points, len(names) + 1)
    _records(figure, trend, rows)
    _annotations(figure, trend)
    theme.dress(figure, title=_headline(trend, points, own=own), height_px=sum(heights) + 120, hovermode="closest")
    figure.update_layout(margin_r=40)  # half of the last date
    figure.update_xaxes(type="date", showgrid=True)
    figure.update_xaxes(title_text="Time of the data, UTC", row=rows, col=1)
    return figure


def list_points(trend: Trend, model: str | None) -> Sequence[TrendPoint]:
    """Return the calibrations of a camera model, the baseline's where none is named."""
    if model is None or model == trend.camera_model:
        return list(trend.points)
    return [point for point in trend.others if point.camera_model == model]


def _names(trend: Trend, points: Sequence[TrendPoint]) -> list[str]:
    """Return the parameters that any calibration estimated, in the model's order."""
    found = dict.fromkeys(name for point in points for name in point.parameters)
    return sorted(found, key=lambda name: (name not in trend.parameter_names, _order(trend, name)))


def _order(trend: Trend, name: str) -> int:
    names = list(trend.parameter_names)
    return names.index(name) if name in names else 0


def _headline(trend: Trend, points: Sequence[TrendPoint], *, own: bool) -> str:
    counted = sum(point.counted for point in points)
    said = f"{len(points)} calibration{'s' * (len(points) != 1)}, {counted} of them independent"
    return (
        f"{said}; {SHOWN_AS.get(trend.drift.verdict, trend.drift.verdict)}"
        if own
        else f"{said}, of another camera model than the baseline"
    )


def _zero(trend: Trend, points: Sequence[TrendPoint], name: str, *, own: bool) -> float:
    if own and trend.baselines:
        return float(trend.baselines[-1].parameters[name])
    return float(next(point.parameters[name] for point in points if name in point.parameters))


def _span(trend: Trend, points: Sequence[TrendPoint]) -> tuple[str, str]:
    """Return the first and last time of anything that is shown."""
    times = [time for point in points for time in (point.begins_utc, point.ends_utc)]
    times += [mark.at_utc for mark in trend.on_board] + [period.from_utc for period in trend.baselines]
    return min(times), max(times)


def _marks(figure: go.Figure, points: Sequence[TrendPoint], name: str, item: Quantity, zero: float, row: int) -> None:
    factor = item.factor
    for counted, label in ((True, "Calibration ±3σ"), (False, "Not used")):
        shown = [point for point in points if point.counted is counted and name in point.parameters]
        colour = COUNTED if counted else LEFT_OUT
        figure.add_scatter(
            x=[_x(point.at_utc) for point in shown],
            y=[(point.parameters[name] - zero) * factor for point in shown],
            error_y=theme.error_bars([3 * point.sigma[name] * factor for point in shown], colour),
            mode="markers",
            marker={"color": colour, "size": 8, "symbol": "circle" if counted else "circle-open"},
            name=label,
            legendgroup=label,
            showlegend=row == 1 and bool(shown),
            customdata=[[f"Run {point.run_id}", point.left_out or point.said or ""] for point in shown],
            hovertemplate="%{customdata[0]}: %{y:.4g}<br>%{x}<br>%{customdata[1]}<extra></extra>",
            row=row,
            col=1,
        )


@dataclass(frozen=True)
class Level:
    """A value that held between two times, as it is drawn; `reach`: Of its band, 0 where none is drawn."""

    ends: tuple[str, str]
    y: float
    label: str
    short: str
    colour: str
    dash: str
    reach: float = 0.0


def _levels(trend: Trend, name: str, item: Quantity, zero: float, span: tuple[str, str]) -> list[Level]:
    """List the baseline of now over all time with its band, those of before from when to when, and the truth."""
    factor, found = item.factor, []
    if trend.baselines:
        now = trend.baselines[-1]
        reach = 3 * (now.sigma.get(name) or 0.0) * factor if now.measured else 0.0
        label = f"Baseline {now.name}"
        found.append(Level(span, 0.0, label, "baseline", theme.REFERENCE_COLOUR, "dash", reach))
    for period in trend.baselines[:-1]:
        value = (period.parameters[name] - zero) * factor
        ends = (period.from_utc, period.to_utc or span[1])
        found.append(Level(ends, value, "Earlier baselines", period.name, theme.REFERENCE_COLOUR, "dot"))
    if (truth := (trend.truth or Values()).get(name)) is not None:
        found.append(Level(span, (truth - zero) * factor, "Truth", "truth", theme.TRUTH_COLOUR, "longdash"))
    return found


def _level(figure: go.Figure, level: Level, row: int) -> None:
    first = row == 1 and level.label not in {trace.name for trace in figure.data}
    line = theme.reference([0.0, 0.0], level.y, level.label, level.colour, level.dash, showlegend=first)
    figure.add_trace(line.update(x=[_x(end) for end in level.ends]), row=row, col=1)
    if level.reach:
        band = {"fillcolor": theme.translucent(level.colour, 0.16), "line_width": 0, "layer": "below"}
        figure.add_hrect(y0=level.y - level.reach, y1=level.y + level.reach, row=row, col=1, **band)


def _scale(
    figure: go.Figure,
    points: Sequence[TrendPoint],
    name: str,
    item: Quantity,
    zero: float,
    levels: Sequence[Level],
    row: int,
    span: tuple[str, str],
) -> None:
    """Scale a panel to what is new, and mark at its edges what lies beyond."""
    factor = item.factor
    shown = sorted((point for point in points if name in point.parameters), key=lambda point: str(point.at_utc))
    values = np.array([(point.parameters[name] - zero) * factor for point in shown])
    reach = np.array([3 * point.sigma[name] * factor for point in shown])
    limits = find_limits(values, reach, [(level.y, level.reach) for level in levels])
    if limits is None:
        return
    marks = [(level.ends[level.ends == span], level.y, level.short, level.colour) for level in levels]
    for point, value in zip(shown, values.tolist(), strict=True):
        marks.append((point.at_utc, value, f"run {point.run_id}", COUNTED if point.counted else LEFT_OUT))
    figure.update_yaxes(range=list(limits), row=row, col=1)
    inset = EDGE * (limits[1] - limits[0])
    for edge, symbol, side in ((limits[1] - inset, "triangle-up", 1), (limits[0] + inset, "triangle-down", -1)):
        beyond = sorted(mark for mark in marks if (mark[1] - limits[side > 0]) * side > 0)
        if beyond:
            figure.add_trace(_beyond(beyond, edge, symbol, span), row=row, col=1)


def find_limits(values: Any, reach: Any, levels: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """Find from where to where a panel shows; None where nothing tells its scale.

    `values`, `reach`: Of the calibrations by time, (n,). `levels`: Values to compare with, each with the reach of its band.
    """
    middle, tall = np.median(values[-RECENT:]), TALL_BAR * np.median(reach[-RECENT:])
    spread = max(NORMAL * np.median(np.abs(values[-RECENT:] - middle)), tall / TALL_BAR)
    if not spread > 0:
        return None
    near = np.abs(values - middle) <= NEAR * spread
    near[-NEWEST:] = True
    bars = np.minimum(reach, tall)
    ends = [*(values - bars)[near], *(values + bars)[near]]
    ends += [y + side * band for y, band in levels if abs(y - middle) <= NEAR * spread for side in (-1, 1)]
    low, high = min(ends), max(ends)
    margin = MARGIN * (high - low)
    return float(low - margin), float(high + margin)


def _beyond(
    marks: Sequence[tuple[str, float, str, str]], edge: float, symbol: str, span: tuple[str, str]
) -> go.Scatter:
    """Mark at an edge what lies beyond it, by time, with as many labels as do not lie over each other."""
    begin, end = (datetime.fromisoformat(time).timestamp() for time in span)
    texts, sides, last = [], [], -np.inf
    for at_utc, value, what, _ in marks:
        place = (datetime.fromisoformat(at_utc).timestamp() - begin) / max(end - begin, 1.0)
        labelled = place - last >= APART
        last = place if labelled else last
        texts.append(theme.escape(f"{what} {signed(value)}") if labelled else "")
        sides.append("middle right" if place <= APART else "middle left")
    return go.Scatter(
        x=[_x(at_utc) for at_utc, _, _, _ in marks],
        y=[edge] * len(marks),
        mode="markers+text",
        marker={"symbol": symbol, "size": 9, "color": [colour for _, _, _, colour in marks]},
        text=texts,
        textposition=sides,
        textfont={"size": 11},
        customdata=[theme.escape(f"{what}: {signed(value, 4)}") for _, value, what, _ in marks],
        hovertemplate="%{customdata}<br>%{x}<extra></extra>",
        name=BEYOND,
        showlegend=False,
    )


def _temperature(figure: go.Figure, points: Sequence[TrendPoint], row: int) -> None:
    shown = [point for point in points if point.temperature_c is not None]
    figure.add_scatter(
        x=[_x(point.at_utc) for point in shown],
        y=[point.temperature_c for point in shown],
        mode="lines+markers",
        marker={"color": WARMTH, "size": 6, "symbol": "square"},
        line={"color": WARMTH, "width": 1.2, "dash": "dot"},
        name="Temperature",
        showlegend=False,
        hovertemplate="%{y:.1f} °C<br>%{x}<extra></extra>",
        row=row,
        col=1,
    )
    figure.update_yaxes(title_text="T (°C)", row=row, col=1)


def _records(figure: go.Figure, trend: Trend, row: int) -> None:
    """Mark promotions and what was recorded on board, at the time of the record."""
    promoted = [(period.from_utc, "baseline", f"{period.name} became the baseline") for period in trend.baselines]
    onboard = [(mark.at_utc, "on board", f"{mark.name} {mark.state}") for mark in trend.on_board]
    found = promoted + onboard
    figure.add_scatter(
        x=[_x(at_utc) for at_utc, _, _ in found],
        y=[kind for _, kind, _ in found],
        text=[said for _, _, said in found],
        mode="markers",
        marker={
            "color": theme.REFERENCE_COLOUR,
            "size": 9,
            "symbol": ["diamond" if kind == "baseline" else "triangle-up" for _, kind, _ in found],
        },
        showlegend=False,
        name="Records",
        hovertemplate="%{text}<br>%{x}<extra></extra>",
        row=row,
        col=1,
    )
    figure.update_yaxes(type="category", categoryarray=["on board", "baseline"], showgrid=False, row=row, col=1)


def _annotations(figure: go.Figure, trend: Trend) -> None:
    """Draw what people said of a time: a line through all panels, its label at the top, the whole of it under the pointer."""
    for said in trend.annotations:
        x, text = _x(said.at_utc), html.escape(said.text, quote=False)
        label = text if len(text) <= LONGEST_LABEL else f"{html.escape(said.text[: LONGEST_LABEL - 1], quote=False)}…"
        figure.add_shape(
            type="line",
            x0=x,
            x1=x,
            y0=0,
            y1=1,
            xref="x",
            yref="paper",
            line={"color": SAID, "width": 1.4, "dash": "dot"},
        )
        figure.add_annotation(
            x=x,
            y=1,
            xref="x",
            yref="paper",
            text=label,
            hovertext=f"{text} ({html.escape(said.printed_name, quote=False)})",
            showarrow=False,
            textangle=-90,
            xanchor="right",
            yanchor="top",
            font_size=11,
        )


def _x(at_utc: str) -> str:
    """Write a time as Plotly takes it: to the millisecond, without its zone."""
    return at_utc.rstrip("Z")[:23]


def table(trend: Trend, model: str | None = None) -> Table:
    """List the calibrations by the time of their data: every estimate with its sigma, SI."""
    points = list_points(trend, model)
    columns = ("run_id", "label", "method", "telemetry", "begins_utc", "at_utc", "ends_utc", "temperature_c", "stars")
    found: Table = {column.removesuffix("_id"): [getattr(point, column) for point in points] for column in columns}
    found |= {"counted": ["yes" if point.counted else "no" for point in points]}
    found |= {"remark": [point.left_out or point.said for point in points]}
    for name in _names(trend, points):
        found[name] = [point.parameters.get(name) for point in points]
        found[f"sigma_{name}"] = [point.sigma.get(name) for point in points]
    return found
