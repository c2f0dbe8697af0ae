"""Views of a figure: another axis, a band in place of many curves, a window in full.

Frame numbers are a sensor's own, so two runs of one set share them; runs of sets taken weeks apart do not, and lie over
each other only by the time since each one's first frame or by the number of updates that its filter has made. A history
keeps updates evenly spaced with the first and the last, so of n updates in all and m kept the k-th is number
round(k (n - 1) / (m - 1)) + 1. A batch run has no updates: it stays a level over whatever axis the others have.

Nobody tells twenty curves apart. Here the curves of all runs but the first become the span between the lowest and the
highest of them, per panel and kind of curve: `tail` and `aggregate` stay two bands. Between its points a curve is the
straight line that it is drawn as, so on the union of all points the band's edges are exact; beyond its ends a curve says
nothing, and the band is that of the others. Marks that are no curves (bars, maps, single stars) have no band and stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from boresight.arrays import FloatArray, parse_times
from boresight.calibration.calibration import Calibration, NisOverTime, Trust
from boresight.errors import RefusedInputError
from boresight.figures.chart import Trace
from boresight.figures.style import theme
from boresight.figures.style.axes import ALIGNMENTS
from boresight.figures.style.thinning import keep_extremes

NO_TIMES = "A batch run stores no frame times: align by frame to see its innovations."


def aligned(traces: Sequence[Trace], along: str) -> list[Trace]:
    """Give every run the axis that is asked for in place of its frame numbers."""
    if along not in ALIGNMENTS:
        raise RefusedInputError(
            f"{along!r} is not an alignment; choose from {', '.join(ALIGNMENTS)}.", code="unknown-alignment"
        )
    if along == "frame":
        return list(traces)
    move = {"time": _by_time, "update": _by_update}[along]
    return [replace(trace, result=move(trace), along=along) for trace in traces]


def _by_update(trace: Trace) -> Calibration:
    """Count updates; a batch run's innovations are one a frame, and are counted so."""
    result, history, series = trace.result, trace.result.history, _innovations(trace.result)
    total = (series.points_in_all if series else 0) or result.frames
    placed = None if series is None else _numbered(len(series.frame), total)
    numbered = None if history is None else _numbered(len(history.frame), total)
    return _on_axis(result, numbered, placed)


def _innovations(result: Calibration) -> NisOverTime | None:
    """Return the part of `trust` with one value a frame or update."""
    return result.trust.nis_over_time if result.trust else None


def _numbered(n_kept: int, n_updates: int) -> FloatArray:
    """Number the kept updates, (n_kept,); without the count of all they are taken for all."""
    return np.linspace(0, max(n_updates, n_kept) - 1, n_kept).round() + 1


def _by_time(trace: Trace) -> Calibration:
    result, history, trust = trace.result, trace.result.history, trace.result.trust
    if history is None or not history.frame:
        return replace(result, trust=_without_innovations(trust)) if trust else result
    if not history.time_utc:
        raise RefusedInputError(
            f"{trace.label} has no times in its telemetry: align by frame or by update.", code="no-times"
        )
    times = parse_times(history.time_utc)
    hours = (times - times[0]) / np.timedelta64(3600, "s")
    series = _innovations(result)
    placed = None if series is None else np.interp(series.frame, history.frame, hours)
    return _on_axis(result, hours, placed)


def _without_innovations(trust: Trust) -> Trust:
    return replace(trust, nis_over_time=None, unavailable={**trust.unavailable, "nis_over_time": NO_TIMES})


def _on_axis(result: Calibration, steps: FloatArray | None, placed: FloatArray | None) -> Calibration:
    """Put new steps in place of the frames of the history, and of the series of innovations; hours are not whole."""
    if steps is not None and result.history is not None:
        frame = result.history.frame
        result = replace(result, history=replace(result.history, frame=steps.tolist()))
        if result.smoothed is not None:
            moved: Any = np.interp(result.smoothed.frame, frame, steps).tolist()
            result = replace(result, smoothed=replace(result.smoothed, frame=moved))
    if placed is not None and result.trust is not None and result.trust.nis_over_time is not None:
        series = replace(result.trust.nis_over_time, frame=placed.tolist())
        result = replace(result, trust=replace(result.trust, nis_over_time=series))
    return result


CurveKey = tuple[str, str, str]

BAND_POINTS = 600  # a band


def as_band(figure: go.Figure, traces: Sequence[Trace]) -> go.Figure:
    """Replace the curves of all runs but the first by their lowest and highest; fewer than three runs stay as they are."""
    others = {theme.escape(trace.label) for trace in traces[1:]}
    if len(others) < 2:
        return figure
    curves: dict[CurveKey, list[Any]] = {}
    kept = []
    for drawn in figure.data:
        said = drawn.meta or {}
        if said.get("run") not in others:
            kept.append(drawn)
        elif drawn.fill is None:  # a filled one is a run's own band, or its histogram
            curves.setdefault((drawn.xaxis or "x", drawn.yaxis or "y", said["part"]), []).append(drawn)
    if not curves:
        return figure
    figure.data = kept
    for number, (key, found) in enumerate(curves.items()):
        _draw_band(figure, key, found, named=number == 0, runs=len(others))
    return figure


def find_span(curves: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the places (n,) of all curves, the lowest and the highest value there.

    `curves`: x and y of each, (n_points,), x ascending.
    """
    known = [(x[np.isfinite(y)], y[np.isfinite(y)]) for x, y in curves]
    known = [(x, y) for x, y in known if len(x)]
    places = np.unique(np.concatenate([x for x, _ in known])) if known else np.zeros(0)
    if not len(places):
        return places, places, places
    values = np.stack([np.interp(places, x, y, left=np.nan, right=np.nan) for x, y in known])
    return places, np.nanmin(values, axis=0), np.nanmax(values, axis=0)


def _draw_band(figure: go.Figure, key: CurveKey, found: Sequence[Any], *, named: bool, runs: int) -> None:
    """Add one band in grey, the colour of everything that is not a run."""
    curves = [(np.asarray(one.x, dtype=np.float64), np.asarray(one.y, dtype=np.float64)) for one in found]
    x, low, high = find_span(curves)
    if not len(x):
        return
    kept = keep_extremes([low, high], BAND_POINTS)
    x, low, high = x[kept], low[kept], high[kept]
    name = f"lowest to highest of {runs} runs"
    band = go.Scatter(
        x=theme.short(np.concatenate([x, x[::-1]])),
        y=theme.short(np.concatenate([high, low[::-1]])),
        mode="lines",
        fill="toself",
        fillcolor=theme.translucent(theme.REFERENCE_COLOUR, 0.22),
        line={"color": theme.translucent(theme.REFERENCE_COLOUR, 0.7), "width": 0.8},
        name=name,
        legendgroup=name,
        showlegend=named,
        hoverinfo="skip",
        xaxis=key[0],
        yaxis=key[1],
    )
    figure.add_trace(band)


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
