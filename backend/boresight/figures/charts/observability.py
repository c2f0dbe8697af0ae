"""What the data can tell apart: singular values over their directions (E Eqs. 22 to 24).

H' = U S V^T is the whitened Jacobian in typical sigmas. Each column of the chart is one direction: above, its singular
value s, so that 1/s is its sigma in typical sigmas; below, the parameters it is made of, the column of V. The result
holds V^T, one direction a row.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray
from boresight.estimation.statistics.observability import WEAK
from boresight.figures.chart import Figure, Result, Table, Trace
from boresight.figures.style import theme
from boresight.verdicts.numbers import number
from boresight.verdicts.quantities import quantity

TITLE = "Observability"
THRESHOLD = 1.0 / WEAK


def draw(traces: Sequence[Trace]) -> go.Figure:
    """Draw singular values as bars on a log axis, over the heat map of the first run's directions."""
    drawn = [
        (trace, style)
        for trace, style in zip(traces, theme.run_styles(traces), strict=True)
        if (trace.result.get("observability") or {}).get("singular_values")
    ]
    if not drawn:
        return theme.missing(TITLE, "Observability is computed when the run ends; it is not there yet.")
    figure = make_subplots(2, 1, shared_xaxes=True, row_heights=[0.4, 0.6], vertical_spacing=0.07)
    for trace, style in drawn:
        figure.add_trace(_bars(trace.result["observability"], style, labelled=len(drawn) == 1), row=1, col=1)
    figure.add_trace(_directions(drawn[0][0].result), row=2, col=1)
    _dress(figure, drawn)
    return figure


def _modes(n_modes: int) -> list[str]:
    return [f"{i + 1}" for i in range(n_modes)]


def _bars(seen: Result, style: theme.RunStyle, *, labelled: bool) -> go.Bar:
    values = np.array(seen["singular_values"], dtype=np.float64)
    with np.errstate(divide="ignore"):
        spread = 1.0 / values
    return go.Bar(
        x=_modes(len(values)),
        y=theme.short(np.where(values > 0, values, np.nan)),
        marker={"color": style.colour},
        name=style.label,
        customdata=theme.short(spread),
        text=[number(value, 3) for value in values] if labelled else None,
        textposition="outside",
        cliponaxis=False,
        hovertemplate=f"s = %{{y:.4g}}<br>σ = %{{customdata:.3g}} typical σ<extra>{style.label}</extra>",
    )


def _directions(result: Result) -> go.Heatmap:
    """Draw V: rows are parameters, columns are directions from the best known to the weakest."""
    seen = result["observability"]
    names = _names(result)
    n_modes = len(seen["singular_values"])
    V = _vectors(result)
    if V is None:
        V = np.full((len(names), n_modes), np.nan)
    return go.Heatmap(
        x=_modes(n_modes),
        y=[quantity(name, result).markup for name in names],
        z=theme.short(V),
        zmin=-1,
        zmax=1,
        colorscale=theme.DIVERGING,
        text=[["" if abs(v) < 0.1 or not np.isfinite(v) else f"{v:+.2f}" for v in row] for row in V],
        texttemplate="%{text}",
        xgap=2,
        ygap=2,
        colorbar={"title": {"text": "share"}, "len": 0.55, "y": 0, "yanchor": "bottom", "thickness": 10},
        hovertemplate="%{y}: %{z:+.3f} of direction %{x}<extra></extra>",
    )


def _vectors(result: Result) -> FloatArray | None:
    """Read V (n_parameters, n_modes), the largest share of each direction positive; None where the result has none."""
    seen = result["observability"]
    V = np.array(seen.get("right_singular_vectors") or [], dtype=np.float64).T
    if V.shape != (len(_names(result)), len(seen["singular_values"])):
        return None
    largest = np.argmax(np.abs(V), axis=0)
    return np.asarray(V * np.where(V[largest, np.arange(V.shape[1])] < 0, -1.0, 1.0))


def _names(result: Result) -> tuple[str, ...]:
    return tuple(result["observability"].get("parameter_names") or result.get("free") or ())


def _dress(figure: go.Figure, drawn: Sequence[tuple[Trace, theme.RunStyle]]) -> None:
    """Title with the condition number, and the weakest direction in words below."""
    result = drawn[0][0].result
    condition = result["observability"].get("condition_number")
    size = f"{condition:.4g}" if condition is not None else "infinite: a direction is not determined at all"
    whose = f" ({drawn[0][1].label})" if len(drawn) > 1 else ""
    sentence = _sentence(result)
    layout: dict[str, Any] = {"hovermode": "closest", "barmode": "group", "legend": len(drawn) > 1}
    theme.dress(figure, title=f"Condition number {size}{whose}", height_px=520, **layout)
    figure.update_layout(margin={"b": 84 + 18 * sentence.count("<br>")})
    figure.update_yaxes(title_text="singular value", type="log", dtick=1, range=_window(drawn), row=1, col=1)
    _draw_threshold(figure)
    figure.update_yaxes(autorange="reversed", showgrid=False, row=2, col=1)
    figure.update_xaxes(showgrid=False, type="category")
    figure.update_xaxes(title_text="direction, best known to weakest", row=2, col=1)
    if sentence:
        figure.add_annotation(
            text=sentence, x=0, y=0, xref="paper", yref="paper", xanchor="left", yanchor="top", yshift=-42, align="left"
        )


def _draw_threshold(figure: go.Figure) -> None:
    """Draw the singular value below which a direction is weak, and say so."""
    line = {"color": theme.REFERENCE_COLOUR, "dash": "dot", "width": 1.2}
    words = {"annotation_text": f"weak below {THRESHOLD:g}", "annotation_position": "bottom right"}
    figure.add_hline(y=THRESHOLD, line=line, **words, row=1, col=1)


def _window(drawn: Sequence[tuple[Trace, theme.RunStyle]]) -> list[float]:
    """Choose the decades of the log axis: every bar can be seen, and the threshold too."""
    values = np.concatenate([trace.result["observability"]["singular_values"] for trace, _ in drawn])
    known = values[values > 0]
    low, high = float(np.min(known, initial=THRESHOLD)), float(np.max(known, initial=THRESHOLD))
    return [float(np.log10(low)) - 0.5, float(np.log10(high)) + 0.5]


def _sentence(result: Result) -> str:
    weakest = result["observability"].get("weakest") or {}
    words = theme.escape(str(weakest.get("sentence") or ""))
    return "<br>".join(textwrap.wrap(f"Weakest direction: {words}", 88)) if words else ""


def table(result: Result) -> Table:
    """List one direction a row: singular value, sigma in typical sigmas, and the parameters' shares."""
    seen = result.get("observability") or {}
    if not seen.get("singular_values"):
        return {}
    values = np.array(seen["singular_values"], dtype=np.float64)
    with np.errstate(divide="ignore"):
        spread = np.where(values > 0, 1.0 / values, np.nan)
    columns: Table = {
        "direction": list(range(1, len(values) + 1)),
        "singular_value": theme.plain(values),
        "sigma_of_direction": theme.plain(spread),
    }
    V = _vectors(result)
    if V is not None:
        columns |= {name: theme.plain(row) for name, row in zip(_names(result), V, strict=True)}
    return columns


OBSERVABILITY = Figure(
    name="observability",
    title=TITLE,
    guide=(
        "Each column is one direction in parameter space: the bar is how strongly the stars determine it, the "
        "colours below are the parameters it mixes. Short bars on the right are what these data cannot separate; "
        "a singular value below the dotted threshold leaves a direction hardly better known than the spread from unit to unit."
    ),
    draw=draw,
    table=table,
)
