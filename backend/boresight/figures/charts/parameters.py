"""How much each parameter moved, in its own sigma and in what such sensors are known to do (E Table III)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import Calibration, Values
from boresight.figures.chart import Table
from boresight.figures.factory import Part, make_figure
from boresight.figures.style import theme
from boresight.verdicts.history import free_names
from boresight.verdicts.numbers import quantity, signed

SIGNIFICANT = 3.0
WIDER = 1.05  # a bar of noise alone is drawn inside that with misfit where it is shorter by more
FLOOR = 0.1  # the log axis starts here: a smaller change cannot be seen in the noise at all


def draw(drawn: Sequence[Part[Calibration]]) -> go.Figure:
    """Draw |delta| / sigma as bars on a log axis, and delta in typical sigmas with 3-sigma error bars."""
    figure = make_subplots(1, 2, shared_yaxes=True, horizontal_spacing=0.06)
    names = list(dict.fromkeys(name for _, _, result in drawn for name in free_names(result)))
    for _, style, result in drawn:
        shown = [name for name in names if name in free_names(result)]
        figure.add_trace(_bars(result, shown, style, labelled=len(drawn) == 1), row=1, col=1)
        figure.add_trace(_points(result, shown, style), row=1, col=2)
        if result.misfit is not None and any((one or 1.0) > WIDER for one in result.misfit.factor.values()):
            figure.add_trace(_noise(result, shown, style), row=1, col=2)
    _dress(figure, drawn, len(names))
    return figure


def _column(values: Values[float | None], names: Sequence[str]) -> FloatArray:
    return np.array([values.get(name) for name in names], dtype=np.float64)


def _change(result: Calibration, names: Sequence[str]) -> FloatArray:
    return _column(result.parameters, names) - _column(result.initial, names)


def _ratio(above: FloatArray, below: FloatArray) -> FloatArray:
    quotient = np.full(len(above), np.nan)
    usable = np.isfinite(below) & (below > 0)
    quotient[usable] = above[usable] / below[usable]
    return quotient


def _labels(result: Calibration, names: Sequence[str]) -> list[str]:
    return [quantity(name, result).markup for name in names]


def _bars(result: Calibration, names: Sequence[str], style: theme.RunStyle, *, labelled: bool) -> go.Bar:
    worth = _ratio(_change(result, names), _column(result.reliable_sigma, names))
    return go.Bar(
        y=_labels(result, names),
        x=theme.short(np.maximum(np.abs(worth), FLOOR)),
        orientation="h",
        offsetgroup=style.label,
        name=style.label,
        legendgroup=style.label,
        marker={
            "color": [style.colour if abs(w) >= SIGNIFICANT else theme.translucent(style.colour, 0.4) for w in worth],
            "line": {"color": style.colour, "width": 1},
        },
        text=[signed(w) if np.isfinite(w) else "" for w in worth] if labelled else None,
        textposition="outside",
        cliponaxis=False,
        customdata=theme.short(worth),
        hovertemplate=f"%{{y}}: Δ/σ = %{{customdata:+.4g}}<extra>{style.label}</extra>",
    )


def _points(result: Calibration, names: Sequence[str], style: theme.RunStyle) -> go.Scatter:
    typical = _column(result.typical_sigma, names)
    change = _ratio(_change(result, names), typical)
    reach = _ratio(3 * _column(result.reliable_sigma, names), typical)
    return go.Scatter(
        y=_labels(result, names),
        x=theme.short(change),
        mode="markers",
        orientation="h",
        offsetgroup=style.label,
        name=style.label,
        legendgroup=style.label,
        showlegend=False,
        marker={"color": style.colour, "size": 8},
        error_x=theme.error_bars(theme.short(reach), style.colour),
        customdata=theme.short(reach),
        hovertemplate=f"%{{y}}: %{{x:+.4g}} ±%{{customdata:.3g}} typical σ (3σ)<extra>{style.label}</extra>",
    )


def _noise(result: Calibration, names: Sequence[str], style: theme.RunStyle) -> go.Scatter:
    """Three sigma of noise alone, as a thick bar inside that with misfit."""
    typical = _column(result.typical_sigma, names)
    reach = _ratio(3 * _column(result.sigma, names), typical)
    return go.Scatter(
        y=_labels(result, names),
        x=theme.short(_ratio(_change(result, names), typical)),
        mode="markers",
        orientation="h",
        offsetgroup=style.label,
        legendgroup=style.label,
        showlegend=False,
        hoverinfo="skip",
        marker={"color": style.colour, "size": 1},
        error_x=theme.error_bars(theme.short(reach), style.colour) | {"thickness": 4, "width": 0},
    )


def _dress(figure: go.Figure, drawn: Sequence[Part[Calibration]], n_names: int) -> None:
    height = 150 + n_names * max(34, 18 * len(drawn))
    layout: dict[str, Any] = {"hovermode": "closest", "barmode": "group", "scattermode": "group"}
    theme.dress(figure, title=_headline(drawn), height_px=height, legend=len(drawn) > 1, **layout)
    figure.update_yaxes(autorange="reversed", type="category", showgrid=False)
    largest = max(SIGNIFICANT, *(_largest(result) for _, _, result in drawn))
    span = [float(np.log10(FLOOR)), float(np.log10(largest)) + 0.5]
    figure.update_xaxes(title_text="|Δ| / σ with misfit", type="log", range=span, dtick=1, row=1, col=1)
    figure.update_xaxes(title_text="Δ in typical σ, bar ±3σ", zeroline=True, row=1, col=2)
    figure.add_vline(x=SIGNIFICANT, line=theme.LEVEL, row=1, col=1)


def _largest(result: Calibration) -> float:
    names = free_names(result)
    worth = np.abs(_ratio(_change(result, names), _column(result.reliable_sigma, names)))
    return float(np.max(worth[np.isfinite(worth)], initial=SIGNIFICANT))


def _headline(drawn: Sequence[Part[Calibration]]) -> str:
    if len(drawn) > 1:
        return f"Change since the initial parameters, {len(drawn)} runs"
    result = drawn[0][2]
    names = free_names(result)
    worth = np.abs(_ratio(_change(result, names), _column(result.reliable_sigma, names)))
    moved = int(np.sum(worth >= SIGNIFICANT))
    return f"{moved} of {len(names)} parameters changed by more than 3 σ with misfit"


def table(result: Calibration) -> Table:
    """List every parameter in SI: initial, final, change, sigma of noise alone and with misfit, and the two ratios."""
    names = tuple(result.parameters)
    change, sigma = _change(result, names), _column(result.reliable_sigma, names)
    return {
        "parameter": list(names),
        "initial": list_known(_column(result.initial, names)),
        "final": list_known(_column(result.parameters, names)),
        "delta": list_known(change),
        "sigma": list_known(_column(result.sigma, names)),
        "sigma_with_misfit": list_known(sigma),
        "delta_over_sigma": list_known(_ratio(change, sigma)),
        "delta_in_typical_sigma": list_known(_ratio(change, _column(result.typical_sigma, names))),
    }


PARAMETERS = make_figure(
    draw,
    table,
    lambda result: result if result.parameters and result.initial else None,
    lambda _: "No parameters have been estimated yet.",
    name="parameters",
    title="Parameter changes",
    guide=(
        "On the left is each change in units of its own sigma (with misfit), on a log axis: changes beyond the dotted "
        "line at 3 are significant; paler bars are not. On the right is the same change in typical sigmas, the spread between "
        "sensors of this kind, with a ±3σ bar, its thick part from noise alone: a wide bar means that the data determine "
        "the parameter poorly; a large change means that you should check the sensor or the matches."
    ),
)
