"""Zoom detail: the points that thinning removed, for the visible part of the axis.

The figure is drawn with every point, so that sums and means over the run stay what they are; then each curve is cut to the
window, with its neighbours on both sides so that lines run to the edge, and thinned again to what a screen can show.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from boresight.errors import RefusedInputError
from boresight.figures.style.thinning import keep_extremes

POINT_BUDGET = 16_000  # of all curves together
FEWEST = 60  # a curve
#: Properties with one value a point, as paths.
BY_POINT = ("x", "y", "text", "customdata", "marker.size", "marker.symbol", "marker.color", "marker.line.width")


def focus(figure: go.Figure, start: float, end: float) -> go.Figure:
    """Cut every curve to a window of its x axis."""
    if not start < end:
        raise RefusedInputError("The window of a figure must begin before it ends: give x_from below x_to.")
    curves = [drawn for drawn in figure.data if drawn.type == "scatter" and _length(drawn) > 2 and _is_measured(drawn)]
    limit = max(POINT_BUDGET // max(len(curves), 1), FEWEST)
    for drawn in curves:
        _take(drawn, _chosen(drawn, start, end, limit))
    return figure


def _is_measured(drawn: Any) -> bool:
    """Whether both axes are numbers: along one of names there is no window."""
    try:
        np.asarray(drawn.x, dtype=np.float64), np.asarray(drawn.y, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return True


def _length(drawn: Any) -> int:
    return 0 if drawn.x is None or drawn.y is None else min(len(drawn.x), len(drawn.y))


def _chosen(drawn: Any, start: float, end: float, limit: int) -> NDArray[np.int64]:
    """Choose the points of a curve, or of an outline that runs there and back."""
    x, y = (np.asarray(values, dtype=np.float64) for values in (drawn.x, drawn.y))
    if drawn.fill != "toself":
        return _seen(x, [y], start, end, limit)
    half = len(x) // 2
    there = _seen(x[:half], [y[:half], y[half:][::-1]], start, end, limit)
    return np.concatenate([there, len(x) - 1 - there[::-1]])


def _seen(x: NDArray[np.float64], series: list[Any], start: float, end: float, limit: int) -> NDArray[np.int64]:
    """Return the indices within the window and one beyond at each side, thinned; x ascends."""
    inside = np.flatnonzero((x >= start) & (x <= end))
    if not len(inside):
        near = int(np.searchsorted(x, start))
        return np.arange(max(near - 1, 0), min(near + 1, len(x)))
    first, last = max(inside[0] - 1, 0), min(inside[-1] + 1, len(x) - 1)
    return np.asarray(first + keep_extremes([values[first : last + 1] for values in series], limit))


def _take(drawn: Any, chosen: NDArray[np.int64]) -> None:
    """Keep the chosen points of everything that has one value a point."""
    length = len(drawn.x)
    for path in BY_POINT:
        try:
            values = drawn[path]
        except (KeyError, ValueError):  # a kind of curve without this property
            continue
        if isinstance(values, (list, tuple, np.ndarray)) and len(values) == length:
            drawn[path] = np.asarray(values)[chosen] if isinstance(values, np.ndarray) else [values[i] for i in chosen]
