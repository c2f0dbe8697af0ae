"""Every parameter over the mission: calibrations at the time of their data, baselines, truth, temperature, records, annotations.

Drawn from the document of `boresight.trend/1`. A parameter is shown by its difference from the baseline of now, which is the
line at zero; where another camera model has none, from its first calibration.
"""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.figures.chart import Table
from boresight.figures.style import theme
from boresight.verdicts.numbers import change_label, quantity

Document = Mapping[str, Any]
Points = Sequence[Mapping[str, Any]]

NAME = "trend"
TITLE = "Parameters over the mission"
GUIDE = (
    "Each mark is a calibration at the time of its data with a ±3σ bar, as a difference from the baseline of now, which is "
    "the line at zero; open marks take no part in the drift test, and the table says why. A sensor that holds scatters "
    "about zero within its bars; a run of marks to one side, or a slope, is drift, unless the temperature below goes with it."
)
ROW_PX, LOW_ROW_PX = 120, 84
COUNTED, LEFT_OUT = theme.RUN_COLOURS[0], theme.RUN_COLOURS[7]
WARMTH, SAID = theme.RUN_COLOURS[1], theme.RUN_COLOURS[3]
LONGEST_LABEL = 28


def draw(trend: Document, model: str | None = None) -> go.Figure:
    """Draw a sensor over the mission, of its baseline's camera model or of another."""
    points = list_points(trend, model)
    names = _names(trend, points)
    if not names:
        return theme.missing(
            "Parameters over the mission", "No calibration has succeeded yet: launch a run, and its result stands here."
        )
    own = model in {None, trend["camera_model"]}
    warm = any(point["temperature_c"] is not None for point in points)
    rows = len(names) + warm + 1
    heights = [ROW_PX] * len(names) + [LOW_ROW_PX] * (warm + 1)
    figure = make_subplots(rows, 1, shared_xaxes=True, vertical_spacing=0.012, row_heights=heights)
    span = _span(trend, points)
    for row, name in enumerate(names, 1):
        zero = _zero(trend, points, name, own=own)
        if own:
            _baselines(figure, trend, name, zero, row, span)
        _marks(figure, points, name, zero, row)
        figure.update_yaxes(title_text=change_label(quantity(name)), row=row, col=1)
    if warm:
        _temperature(figure, points, len(names) + 1)
    _records(figure, trend, rows)
    _annotations(figure, trend)
    theme.dress(figure, title=_headline(trend, points, own=own), height_px=sum(heights) + 120, hovermode="closest")
    figure.update_layout(margin_r=40)  # half of the last date
    figure.update_xaxes(type="date", showgrid=True)
    figure.update_xaxes(title_text="Time of the data, UTC", row=rows, col=1)
    return figure


def list_points(trend: Document, model: str | None) -> Points:
    """Return the calibrations of a camera model, the baseline's where none is named."""
    if model is None or model == trend["camera_model"]:
        return list(trend["points"])
    return [point for point in trend["others"] if point["camera_model"] == model]


def _names(trend: Document, points: Points) -> list[str]:
    """Return the parameters that any calibration estimated, in the model's order."""
    found = dict.fromkeys(name for point in points for name in point["parameters"])
    return sorted(found, key=lambda name: (name not in trend["parameter_names"], _order(trend, name)))


def _order(trend: Document, name: str) -> int:
    names = list(trend["parameter_names"])
    return names.index(name) if name in names else 0


def _headline(trend: Document, points: Points, *, own: bool) -> str:
    counted = sum(point["counted"] for point in points)
    said = f"{len(points)} calibration{'s' * (len(points) != 1)}, {counted} independent"
    return (
        f"{said}; {trend['drift']['verdict'].lower()}" if own else f"{said}, of another camera model than the baseline"
    )


def _zero(trend: Document, points: Points, name: str, *, own: bool) -> float:
    if own and trend["baselines"]:
        return float(trend["baselines"][-1]["parameters"][name])
    return float(next(point["parameters"][name] for point in points if name in point["parameters"]))


def _span(trend: Document, points: Points) -> tuple[str, str]:
    """Return the first and last time of anything that is shown."""
    times = [point[key] for point in points for key in ("begins_utc", "ends_utc")]
    times += [mark["at_utc"] for mark in trend["on_board"]] + [period["from_utc"] for period in trend["baselines"]]
    return min(times), max(times)


def _marks(figure: go.Figure, points: Points, name: str, zero: float, row: int) -> None:
    factor = quantity(name).change_factor
    for counted, label in ((True, "Calibration ±3σ"), (False, "Not counted")):
        shown = [point for point in points if point["counted"] is counted and name in point["parameters"]]
        colour = COUNTED if counted else LEFT_OUT
        figure.add_scatter(
            x=[_x(point["at_utc"]) for point in shown],
            y=[(point["parameters"][name] - zero) * factor for point in shown],
            error_y=theme.error_bars([3 * point["sigma"][name] * factor for point in shown], colour),
            mode="markers",
            marker={"color": colour, "size": 8, "symbol": "circle" if counted else "circle-open"},
            name=label,
            legendgroup=label,
            showlegend=row == 1 and bool(shown),
            customdata=[[f"Run {point['run_id']}", point["left_out"] or point["said"] or ""] for point in shown],
            hovertemplate="%{customdata[0]}: %{y:.4g}<br>%{x}<br>%{customdata[1]}<extra></extra>",
            row=row,
            col=1,
        )


def _baselines(figure: go.Figure, trend: Document, name: str, zero: float, row: int, span: tuple[str, str]) -> None:
    """Draw the baseline of now over all time with its band, those of before from when to when, and the truth."""
    factor, now = quantity(name).change_factor, trend["baselines"][-1] if trend["baselines"] else None
    if now is not None:
        _level(figure, span, 0.0, f"Baseline {now['name']}", theme.REFERENCE_COLOUR, "dash", row)
        reach = 3 * (now["sigma"].get(name) or 0.0) * factor
        if now["measured"] and reach:
            band = {"fillcolor": theme.translucent(theme.REFERENCE_COLOUR, 0.16), "line_width": 0, "layer": "below"}
            figure.add_hrect(y0=-reach, y1=reach, row=row, col=1, **band)
    for period in trend["baselines"][:-1]:
        value = (period["parameters"][name] - zero) * factor
        ends = (period["from_utc"], period["to_utc"])
        _level(figure, ends, value, "Baselines before", theme.REFERENCE_COLOUR, "dot", row)
    truth = (trend["truth"] or {}).get(name)
    if truth is not None:
        _level(figure, span, (truth - zero) * factor, "Truth", theme.TRUTH_COLOUR, "longdash", row)


def _level(figure: go.Figure, ends: tuple[str, str], y: float, label: str, colour: str, dash: str, row: int) -> None:
    first = row == 1 and label not in {trace.name for trace in figure.data}
    line = theme.reference([0.0, 0.0], y, label, colour, dash, showlegend=first)
    figure.add_trace(line.update(x=[_x(end) for end in ends]), row=row, col=1)


def _temperature(figure: go.Figure, points: Points, row: int) -> None:
    shown = [point for point in points if point["temperature_c"] is not None]
    figure.add_scatter(
        x=[_x(point["at_utc"]) for point in shown],
        y=[point["temperature_c"] for point in shown],
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


def _records(figure: go.Figure, trend: Document, row: int) -> None:
    """Mark promotions and what was recorded on board, at the time of the record."""
    promoted = [(period["from_utc"], "baseline", f"{period['name']} became baseline") for period in trend["baselines"]]
    onboard = [(mark["at_utc"], "on board", f"{mark['name']} {mark['state']}") for mark in trend["on_board"]]
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


def _annotations(figure: go.Figure, trend: Document) -> None:
    """Draw what people said of a time: a line through all panels, its label at the top, the whole of it under the pointer."""
    for said in trend["annotations"]:
        x, text = _x(said["at_utc"]), html.escape(said["text"], quote=False)
        label = (
            text if len(text) <= LONGEST_LABEL else f"{html.escape(said['text'][: LONGEST_LABEL - 1], quote=False)}…"
        )
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
            hovertext=f"{text} ({html.escape(said['printed_name'], quote=False)})",
            showarrow=False,
            textangle=-90,
            xanchor="right",
            yanchor="top",
            font_size=11,
        )


def _x(at_utc: str) -> str:
    """Write a time as Plotly takes it: to the millisecond, without its zone."""
    return at_utc.rstrip("Z")[:23]


def table(trend: Document, model: str | None = None) -> Table:
    """List the calibrations by the time of their data: every estimate with its sigma, SI."""
    points = list_points(trend, model)
    columns = ("run_id", "label", "method", "telemetry", "begins_utc", "at_utc", "ends_utc", "temperature_c", "stars")
    found: Table = {column.removesuffix("_id"): [point[column] for point in points] for column in columns}
    found |= {"counted": ["yes" if point["counted"] else "no" for point in points]}
    found |= {"remark": [point["left_out"] or point["said"] for point in points]}
    for name in _names(trend, points):
        found[name] = [point["parameters"].get(name) for point in points]
        found[f"sigma_{name}"] = [point["sigma"].get(name) for point in points]
    return found
