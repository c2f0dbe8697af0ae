"""A frame on the detector as coordinates for an SVG: every detection by its fate, residuals so many times longer than life.

The view box is the detector in pixels, columns to the right and rows down. A residual starts at the measured centroid and points
from the predicted place to it, as in the figures; around it stands a circle of three of its sigmas, drawn to the same scale, so
that what ends inside is noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

SCALES: tuple[int, ...] = tuple(step * 10**power for power in range(5) for step in (1, 2, 5))
TYPICAL_SHARE = 0.03  # of the detector's width: the length of the typical residual
BAR_SHARE = 0.1  # of the detector's width: about the length of the scale bar
CIRCLE_SIGMA = 3.0
MARGIN_SHARE = 0.06  # of the width, for the axes
TICKS = 6


@dataclass(frozen=True)
class Vector:
    """A residual: under which parameters, its components and the mean of its two sigmas, px (x along columns)."""

    name: str
    dx: float
    dy: float
    sigma: float


@dataclass(frozen=True)
class Mark:
    """A detection: its place (x along columns), its fate, what its tooltip says, and its residuals."""

    row: int
    x: float
    y: float
    fate: str
    title: str
    vectors: tuple[Vector, ...]


@dataclass(frozen=True)
class FrameDrawing:
    """Everything that the template draws, px of the detector.

    Parameters
    ----------
    width, height
        Columns and rows.
    margin
        For the axes, on the left and below.
    scale
        How many times longer than life residuals are drawn.
    bar_px
        What the scale bar stands for.
    marks, missed
        Detections, and catalogue stars that were not detected.
    x_ticks, y_ticks
        Round columns and rows.
    names
        Under which parameters residuals are drawn.
    """

    width: int
    height: int
    margin: float
    scale: int
    bar_px: float
    marks: Sequence[Mark]
    missed: Sequence[Mapping[str, Any]]
    x_ticks: Sequence[int]
    y_ticks: Sequence[int]
    names: Sequence[str]


def draw_frame(view: Mapping[str, Any], exposure: Mapping[str, Any], names: Sequence[str], scale: int) -> FrameDrawing:
    """Lay an exposure out.

    Parameters
    ----------
    view, exposure
        Of `services.frames.get_frame`.
    names
        Which of `old` and `new` to draw residuals of.
    scale
        How many times longer than life.
    """
    return FrameDrawing(
        width=view["columns"],
        height=view["rows"],
        margin=MARGIN_SHARE * view["columns"],
        scale=scale,
        bar_px=round_down(BAR_SHARE * view["columns"] / scale),
        marks=[_mark(star, names) for star in exposure["stars"]],
        missed=exposure["undetected"],
        x_ticks=_ticks(view["columns"]),
        y_ticks=_ticks(view["rows"]),
        names=names,
    )


def usual_scale(stars: Sequence[Mapping[str, Any]], names: Sequence[str], columns: int) -> int:
    """Choose the scale at which the typical residual of the used stars is easy to see."""
    lengths: list[float] = [
        math.hypot(*star[name]["d_px"]) for star in stars for name in names if star[name] and star["fate"] == "used"
    ]
    typical = median(lengths) if lengths else 0.0
    wanted: float = TYPICAL_SHARE * columns / typical if typical > 0 else 1.0
    return max((scale for scale in SCALES if scale <= wanted), default=SCALES[0])


def round_down(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, not above the value, which is positive."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-9))


def _ticks(size: int) -> list[int]:
    """Round pixel numbers along an axis."""
    step = max(1, int(round_down(2 * size / TICKS)))
    return list(range(0, size, step))


def _mark(star: Mapping[str, Any], names: Sequence[str]) -> Mark:
    """Lay a detection out."""
    vectors = tuple(
        Vector(name, star[name]["d_px"][1], star[name]["d_px"][0], sum(star[name]["sigma_px"]) / 2)
        for name in names
        if star[name]
    )
    return Mark(star["row"], star["col_px"], star["row_px"], star["fate"].replace(" ", "-"), _title(star), vectors)


def _title(star: Mapping[str, Any]) -> str:
    """What a detection's tooltip says."""
    number = star["star_id"] or star["given_star_id"]
    said = [f"HIP {number}" if number else "no star", star["fate"]]
    if star["reason"]:
        said.append(star["reason"])
    for name in ("old", "new"):
        if star[name]:
            row, col = star[name]["d_px"]
            said.append(f"{name}: rows {row:+.3f} px, columns {col:+.3f} px")
    return "; ".join(said)
