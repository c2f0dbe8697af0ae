"""A sparkline stays in its box and marks the newest value."""

import re

from hypothesis import given
from hypothesis import strategies as st

from boresight.console.pages.drawings import MARGIN, SPARKLINE_HEIGHT, SPARKLINE_WIDTH, sparkline


@given(st.lists(st.floats(1e-7, 1e-2), min_size=1, max_size=40))
def test_every_point_is_inside_and_the_last_is_marked(values):
    drawn = sparkline(values)
    points = [tuple(map(float, pair)) for pair in re.findall(r"([\d.]+) ([\d.]+)", drawn.path)]
    assert len(points) == drawn.count == len(values)
    assert all(
        MARGIN <= x <= SPARKLINE_WIDTH - MARGIN + 0.05 and MARGIN <= y <= SPARKLINE_HEIGHT - MARGIN for x, y in points
    )
    assert abs(points[-1][0] - drawn.x) < 0.1
    assert abs(points[-1][1] - drawn.y) < 0.1


def test_larger_is_higher_and_nothing_is_nothing():
    drawn = sparkline([1.0, 2.0])
    assert drawn.path.startswith(f"M{MARGIN:.1f} {SPARKLINE_HEIGHT - MARGIN:.1f}")
    assert drawn.y == MARGIN
    assert sparkline([3.0, 3.0]).y == SPARKLINE_HEIGHT / 2
    assert sparkline([]) is None


def test_a_scatter_of_a_percent_does_not_fill_the_height():
    drawn = sparkline([8.2e-5, 8.28e-5, 8.2e-5, 8.28e-5])
    heights = [float(y) for _, y in re.findall(r"([\d.]+) ([\d.]+)", drawn.path)]
    assert max(heights) - min(heights) < (SPARKLINE_HEIGHT - 2 * MARGIN) / 4
    assert sparkline([0.0, 0.0]).y == SPARKLINE_HEIGHT / 2
