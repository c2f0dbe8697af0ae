"""A sparkline that the server draws: the last values of a quantity as one small SVG path, the newest marked.

The range of the values is the height of the box, and at least a twentieth of the value, so that scatter does not pass for a
change; a flat series is a line in its middle. x is the order, not the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

WIDTH, HEIGHT, MARGIN = 132.0, 30.0, 4.0
LEAST_SPAN = 0.05  # of the value in the middle


@dataclass(frozen=True)
class Sparkline:
    """Coordinates for the template.

    Parameters
    ----------
    path
        Of the line, in the view box of WIDTH by HEIGHT.
    x, y
        Of the newest value.
    first, last
        The oldest and the newest value.
    count
        How many there are.
    """

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
    step = (WIDTH - 2 * MARGIN) / max(len(values) - 1, 1)
    share = [0.5 + (value - middle) / span if span > 0 else 0.5 for value in values]
    points = [(MARGIN + step * i, HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * y) for i, y in enumerate(share)]
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    return Sparkline(path, *points[-1], values[0], values[-1], len(values))
