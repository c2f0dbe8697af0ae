"""Small drawings that the server makes, as coordinates for an SVG template: histograms, a map of the detector, sparklines.

x is to the right and y down. An empty cell of the map is marked, for there a calibration extrapolates. The height of a
sparkline is the range of its values, and at least a twentieth of the value, so that scatter does not pass for a change.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from boresight.telemetry.quality.report import DetectorCoverage, Distribution
from boresight.verdicts.numbers import grouped

WIDTH, HEIGHT = 560.0, 200.0
LEFT, RIGHT, TOP, BOTTOM = 52.0, 10.0, 22.0, 34.0
HEADROOM = 1.08  # height of an axis over its highest bar
LEAST_OPACITY = 0.12
TICKS = 5


@dataclass(frozen=True)
class ChartBar:
    """One bar or cell, with what its tooltip says."""

    x: float
    y: float
    width: float
    height: float
    count: int
    opacity: float
    title: str


@dataclass(frozen=True)
class AxisTick:
    """A mark on an axis."""

    at: float
    label: str


@dataclass(frozen=True)
class Drawing:
    """A drawing ready for its template."""

    name: str
    title: str
    x_title: str
    y_title: str
    bars: Sequence[ChartBar]
    x_ticks: Sequence[AxisTick]
    y_ticks: Sequence[AxisTick]
    width: float
    height: float
    right: float
    bottom: float
    rows: Sequence[tuple[str, int]]
    mark_x: float | None = None
    mark_title: str = ""
    is_map: bool = False


def round_steps(low: float, high: float, ticks: int = TICKS) -> list[float]:
    """Return about so many round numbers from `low` to `high`: steps of 1, 2 or 5 times a power of ten."""
    if not high > low:
        return [low]
    rough = (high - low) / ticks
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= rough)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def histogram(
    edges: Sequence[float],
    counts: Sequence[int],
    *,
    name: str,
    title: str,
    x_title: str,
    y_title: str,
    mark: tuple[float, str] | None = None,
    extent: float | None = None,
) -> Drawing:
    """Lay out a histogram.

    `edges`, `counts`: (n + 1,) and (n,).
    """
    low, high = edges[0], max(edges[-1], extent or edges[-1])
    largest = HEADROOM * max([*counts, 1])
    plot_width, plot_height = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def scale_x(value: float) -> float:
        return LEFT + plot_width * (value - low) / ((high - low) or 1.0)

    bars, rows = [], []
    for left, right, count in zip(edges, edges[1:], counts, strict=False):
        height = plot_height * count / largest
        label = f"{grouped(f'{left:.4g}')} to {grouped(f'{right:.4g}')}"
        x, width = scale_x(left) + 0.5, max(scale_x(right) - scale_x(left) - 1.0, 0.5)
        bars.append(
            ChartBar(x, TOP + plot_height - height, width, height, count, 1.0, f"{label}: {grouped(str(count))}")
        )
        rows.append((label, count))
    return Drawing(
        name=name,
        title=title,
        x_title=x_title,
        y_title=y_title,
        bars=bars,
        x_ticks=[AxisTick(scale_x(value), grouped(f"{value:g}")) for value in round_steps(low, high, 8)],
        y_ticks=[
            AxisTick(TOP + plot_height * (1.0 - value / largest), grouped(f"{value:.0f}"))
            for value in round_steps(0.0, largest, 3)
            if value == round(value)
        ],
        width=WIDTH,
        height=HEIGHT,
        right=WIDTH - RIGHT,
        bottom=HEIGHT - BOTTOM,
        rows=rows,
        mark_x=scale_x(mark[0]) if mark else None,
        mark_title=mark[1] if mark else "",
    )


def _range(edges_px: Sequence[float]) -> str:
    """Write where a part of the detector begins and ends; its first row's edge is half a pixel before 0."""
    return " to ".join(grouped(f"{max(edge, 0.0):.0f}") for edge in edges_px)


def detector_map(coverage: DetectorCoverage) -> Drawing:
    """Lay out the map of the detector: a cell is the darker the fewer usable stars it has seen."""
    row_edges, col_edges, counts = coverage.row_edges_px, coverage.col_edges_px, coverage.counts
    rows_px, cols_px = row_edges[-1] - row_edges[0], col_edges[-1] - col_edges[0]
    scale = (WIDTH - LEFT - RIGHT) / cols_px
    largest = max((count for line in counts for count in line), default=0) or 1
    bottom = TOP + rows_px * scale
    bars, rows = [], []
    for i, line in enumerate(counts):
        for j, count in enumerate(line):
            label = f"rows {_range(row_edges[i : i + 2])}, columns {_range(col_edges[j : j + 2])}"
            bars.append(
                ChartBar(
                    x=LEFT + (col_edges[j] - col_edges[0]) * scale + 0.5,
                    y=TOP + (row_edges[i] - row_edges[0]) * scale + 0.5,
                    width=(col_edges[j + 1] - col_edges[j]) * scale - 1.0,
                    height=(row_edges[i + 1] - row_edges[i]) * scale - 1.0,
                    count=count,
                    opacity=LEAST_OPACITY + (1.0 - LEAST_OPACITY) * count / largest if count else 0.0,
                    title=f"{label}: {grouped(str(count))} stars",
                )
            )
            rows.append((label, count))
    return Drawing(
        name="detector-coverage",
        title="Detector coverage",
        x_title="column (px)",
        y_title="row (px)",
        bars=bars,
        x_ticks=[
            AxisTick(LEFT + (v - col_edges[0]) * scale, grouped(f"{v:g}"))
            for v in round_steps(max(col_edges[0], 0), col_edges[-1])
        ],
        y_ticks=[
            AxisTick(TOP + (v - row_edges[0]) * scale, grouped(f"{v:g}"))
            for v in round_steps(max(row_edges[0], 0), row_edges[-1])
        ],
        width=WIDTH,
        height=bottom + BOTTOM,
        right=WIDTH - RIGHT,
        bottom=bottom,
        rows=rows,
        is_map=True,
    )


def number_bars(distribution: Distribution, **words: str) -> Drawing:
    """Lay out how often each whole number occurs: bars centred on the numbers."""
    values, times = distribution.stars, distribution.exposures
    seen = dict(zip(values, times, strict=True))
    numbers = range(min(values), max(values) + 1)
    edges = [value - 0.5 for value in numbers] + [max(values) + 0.5]
    drawing = histogram(edges, [seen.get(value, 0) for value in numbers], **words)  # type: ignore[arg-type]
    rows = [(str(value), seen.get(value, 0)) for value in numbers]
    bars = [
        ChartBar(b.x, b.y, b.width, b.height, b.count, b.opacity, f"{label}: {grouped(str(b.count))}")
        for b, (label, _) in zip(drawing.bars, rows, strict=True)
    ]
    return Drawing(**{**drawing.__dict__, "bars": bars, "rows": rows})


SPARKLINE_WIDTH, SPARKLINE_HEIGHT, MARGIN = 132.0, 30.0, 4.0
LEAST_SPAN = 0.05  # of the middle value


@dataclass(frozen=True)
class Sparkline:
    """Coordinates for the template."""

    path: str
    x: float
    y: float
    first: float
    last: float
    count: int


def sparkline(values: Sequence[float]) -> Sparkline | None:
    """Draw a series; None where there is nothing to draw."""
    if not values:
        return None
    middle = (min(values) + max(values)) / 2
    span = max(max(values) - min(values), LEAST_SPAN * abs(middle))
    step = (SPARKLINE_WIDTH - 2 * MARGIN) / max(len(values) - 1, 1)
    share = [0.5 + (value - middle) / span if span > 0 else 0.5 for value in values]
    points = [
        (MARGIN + step * i, SPARKLINE_HEIGHT - MARGIN - (SPARKLINE_HEIGHT - 2 * MARGIN) * y)
        for i, y in enumerate(share)
    ]
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    return Sparkline(path, *points[-1], values[0], values[-1], len(values))
