"""Which parameters the data cannot tell apart: their correlations, rho_pq = P_pq / (sigma_p sigma_q).

A pair near +-1 is known as a sum or a difference only: each sigma on its own then says little, and the radial difference
or the directions of observability say more. P is the covariance of the estimate; with n degrees of freedom it is exact in
the noise that was assumed, so no band belongs to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from boresight.arrays import FloatArray, list_known
from boresight.calibration.calibration import Calibration
from boresight.figures.chart import Table, Trace
from boresight.figures.factory import Part, make_figure
from boresight.figures.style import theme
from boresight.verdicts.numbers import quantity, signed

STRONG = 0.9  # from here on two parameters are read together
MAX_MAPS = 3
ROW_PX, LEAST_PX = 34, 200
#: Names (n,), rho and P (n, n) each.
Correlations = tuple[list[str], FloatArray, FloatArray]


def draw(found: Sequence[Part[Correlations]], beside: int = MAX_MAPS, *, numbers: bool = True) -> go.Figure:
    """Draw one map a run, up to three, so many beside each other; without numbers where cells have no room, as of several maps."""
    drawn = found[:MAX_MAPS]
    columns = min(beside, len(drawn))
    rows = -(-len(drawn) // columns)
    titles = [style.short for _, style, _ in drawn] if len(drawn) > 1 else None
    figure = make_subplots(rows, columns, subplot_titles=titles, horizontal_spacing=0.08, vertical_spacing=0.12 / rows)
    for place, (trace, _, (names, rho, _)) in enumerate(drawn):
        row, column = divmod(place, columns)
        figure.add_trace(_map(trace, names, rho, scale=place == len(drawn) - 1), row=row + 1, col=column + 1)
    if not numbers or columns > 1:
        figure.update_traces(texttemplate=None)
    height = LEAST_PX + rows * ROW_PX * max(len(one[2][0]) for one in drawn)
    theme.dress(figure, title=_headline(drawn[0]), height_px=height, legend=False, hovermode="closest")
    figure.update_xaxes(showgrid=False, type="category", side="bottom")
    figure.update_yaxes(showgrid=False, type="category", autorange="reversed")
    return figure


def correlations(result: Calibration) -> Correlations | None:
    """Read names, rho and P out of a result's covariance; None where it has none."""
    names, P = result.covariance.names, np.array(result.covariance.matrix, dtype=np.float64)
    if not names or P.shape != (len(names), len(names)):
        return None
    sigma = np.sqrt(np.where(np.diag(P) > 0, np.diag(P), np.nan))
    return names, P / np.outer(sigma, sigma), P


def strongest(names: Sequence[str], rho: FloatArray) -> tuple[str, str, float] | None:
    """Return the pair with the largest correlation, and its size with sign; None where there is no pair."""
    rows, columns = np.triu_indices(len(names), 1)
    sizes = rho[rows, columns]
    if not np.isfinite(sizes).any():
        return None
    worst = int(np.nanargmax(np.abs(sizes)))
    return names[rows[worst]], names[columns[worst]], float(sizes[worst])


def _map(trace: Trace, names: Sequence[str], rho: FloatArray, *, scale: bool) -> go.Heatmap:
    labels = [quantity(name, trace.result).markup for name in names]
    own = np.eye(len(names), dtype=bool)
    between = np.where(own, np.nan, rho)
    return theme.signed_map(
        labels, labels, between, 0.0,
        showscale=scale,
        colorbar={"title": {"text": "ρ"}, "thickness": 10},
        hovertemplate=f"%{{y}} and %{{x}}: ρ = %{{z:+.4f}}<extra>{theme.escape(trace.label)}</extra>",
        hoverongaps=False,
    )  # fmt: skip


def _headline(one: Part[Correlations]) -> str:
    trace, _, (names, rho, _) = one
    pair = strongest(names, rho)
    if pair is None:
        return "One parameter was estimated: there is no correlation"
    first, second = (quantity(name, trace.result).markup for name in pair[:2])
    advice = "use them together" if abs(pair[2]) >= STRONG else "each can be used alone"
    return f"Strongest: {first} and {second}, ρ = {signed(pair[2])}: {advice}"


def table(found: Correlations) -> Table:
    """List one pair a row: the two parameters, their correlation and their covariance in SI."""
    names, rho, P = found
    rows, columns = np.triu_indices(len(names), 0)
    return {
        "parameter": [names[i] for i in rows],
        "with": [names[j] for j in columns],
        "correlation": list_known(rho[rows, columns]),
        "covariance_si": list_known(P[rows, columns]),
    }


CORRELATION = make_figure(
    draw,
    table,
    correlations,
    lambda _: "Correlations need a covariance, which is available when the run ends.",
    name="correlation",
    title="Parameter correlations",
    guide=(
        "Each cell shows how the errors of two parameters are correlated: blue in the same direction, orange in opposite "
        "directions, blank for none. A pair near ±1 is known only as a sum or a difference: do not use the two sigmas "
        "separately; look at the distortion and at the weakest direction."
    ),
    advanced=True,
    forms={"narrow": partial(draw, beside=1, numbers=False)},
)
