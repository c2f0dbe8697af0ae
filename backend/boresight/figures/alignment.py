"""The pairs of an alignment, the three angles one below the other, over time on the left and over temperature on the right.

A pair's angle is its residual with what the alignment's terms give there, so a change with temperature or time is seen as a slope,
and the line through it is the alignment's own. Bars are one sigma of a pair; crosses were left out.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import BoolArray, FloatArray
from boresight.calibration.alignment.result import AXES, Alignment
from boresight.figures.chart import Table
from boresight.figures.style import theme

TITLE = "Angles of the pairs"
GUIDE = (
    "Each point is a pair of attitudes at the same time: its rotation about one axis of B relative to the alignment, "
    "with its own one-sigma bar. The error common to all pairs (the cameras' error) is removed. The line is the "
    "alignment's change with time and temperature; points further off than their bars, or with a trend, show a change "
    "that the alignment does not describe. Crosses were not used."
)

#: How wide the y axis is, in the largest angle of the pairs that take part: what lies beyond is told by the table.
ROOM = 1.15


def draw(found: Alignment) -> go.Figure:
    """Draw the angles of the pairs; its title says what the alignment depends on."""
    pairs = found.residuals
    kept = np.array(pairs.kept, np.bool_)
    varied = np.array(pairs.variation_arcsec, np.float64).reshape(-1, 3)
    angle = np.array(pairs.residual_arcsec, np.float64).reshape(-1, 3) + varied
    sigma = np.array(pairs.sigma_arcsec, np.float64).reshape(-1, 3)
    warmth = np.array(pairs.temperature_c, np.float64)
    with_warmth = bool(np.isfinite(warmth).any())
    columns = 2 if with_warmth else 1
    figure = make_subplots(
        3, columns, shared_xaxes="columns", shared_yaxes="rows", vertical_spacing=0.06, horizontal_spacing=0.04
    )
    places: list[list[str] | FloatArray] = [[one.rstrip("Z") for one in pairs.time_utc]]
    if with_warmth:
        places.append(warmth)
    for axis, name in enumerate(AXES):
        for column, x in enumerate(places, 1):
            _panel(figure, x, angle[:, axis], sigma[:, axis], kept, row=axis + 1, col=column)
            order = np.argsort(warmth if column == 2 else np.arange(len(kept)), kind="stable")
            figure.add_scatter(
                x=np.asarray(x, object)[order].tolist(), y=theme.short(varied[order, axis]), mode="lines", name="alignment",
                line={"color": theme.REFERENCE_COLOUR, "width": 1.4}, legendgroup="alignment",
                showlegend=axis == 0 and column == 1, hoverinfo="skip", row=axis + 1, col=column,
            )  # fmt: skip
        reach = np.abs(angle[kept, axis]).max(initial=0.0) + sigma[kept, axis].max(initial=0.0)
        figure.update_yaxes(range=[-ROOM * reach, ROOM * reach], row=axis + 1)
        figure.update_yaxes(title_text=f"{name} (arcsec)", row=axis + 1, col=1)
    figure.update_xaxes(title_text="UTC", row=3, col=1)
    if with_warmth:
        figure.update_xaxes(title_text="temperature (°C)", row=3, col=2)
    return theme.dress(figure, title=theme.escape(_answer(found)), height_px=560, hovermode="closest")


def table(found: Alignment) -> Table:
    """List every pair of the figure, arcsec."""
    pairs = found.residuals
    columns: Table = {"time_utc": list(pairs.time_utc), "temperature_c": list(pairs.temperature_c)}
    for what, values in (
        ("residual", pairs.residual_arcsec),
        ("variation", pairs.variation_arcsec),
        ("sigma", pairs.sigma_arcsec),
    ):
        columns |= {f"{what}_{axis}_arcsec": [row[k] for row in values] for k, axis in enumerate(AXES)}
    return {**columns, "probability": list(pairs.probability), "kept": ["yes" if one else "no" for one in pairs.kept]}


def _answer(found: Alignment) -> str:
    """Say what the alignment depends on."""
    if not found.terms:
        return f"No change of the alignment with {' or '.join(_tested(found)) or 'anything'} is seen"
    words = [f"{np.linalg.norm(term.value_arcsec):.3g} arcsec/{term.unit}" for term in found.terms]
    return f"The alignment changes by {' and '.join(words)}"


def _tested(found: Alignment) -> list[str]:
    return list(dict.fromkeys(one.kind or one.name for one in found.tests))


def _panel(
    figure: go.Figure, x: list[str] | FloatArray, angle: FloatArray, sigma: FloatArray, kept: BoolArray, **place: int
) -> None:
    """Add the pairs of one angle: those that take part with their bars, and those that were left out as crosses."""
    first = place == {"row": 1, "col": 1}
    colour = theme.RUN_COLOURS[0]
    for name, chosen, symbol in (("pairs", kept, "circle"), ("left out", ~kept, "x")):
        if not chosen.any():
            continue
        figure.add_scatter(
            x=np.asarray(x, object)[chosen].tolist(), y=theme.short(angle[chosen]), mode="markers", name=name, legendgroup=name,
            showlegend=first, marker={"color": colour, "size": 5, "symbol": symbol},
            error_y=theme.error_bars(theme.short(sigma[chosen]), theme.translucent(colour, 0.35)) if symbol == "circle" else None,
            hovertemplate="%{y:+.3g} arcsec<br>%{x}<extra></extra>", **place,
        )  # fmt: skip
