"""The server's drawings: what is drawn is proportional to what was counted."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.console.pages.drawings import detector_map, histogram, number_bars, round_steps

WORDS = {"name": "n", "title": "t", "x_title": "x", "y_title": "y"}


@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=40))
def test_bars_are_as_high_as_their_counts(counts):
    drawing = histogram(list(range(len(counts) + 1)), counts, **WORDS)
    tallest = max(drawing.bars, key=lambda bar: bar.count)
    for bar in drawing.bars:
        assert bar.height * max(tallest.count, 1) == pytest.approx(tallest.height * bar.count)
        assert bar.y + bar.height == pytest.approx(drawing.bottom)
    assert [count for _, count in drawing.rows] == counts


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_ticks_are_round_and_inside(low, span):
    steps = round_steps(low, low + span)
    assert 1 <= len(steps) <= 12
    assert all(low - 1e-6 * span <= step <= low + span + 1e-6 * span for step in steps)


def test_an_axis_reaches_the_corner_though_the_data_end_before():
    drawing = histogram([0, 10, 20], [1, 1], **WORDS, extent=40.0, mark=(20.0, "no data beyond"))
    assert drawing.bars[-1].x + drawing.bars[-1].width < drawing.right - 100
    assert drawing.mark_x == pytest.approx(drawing.bars[-1].x + drawing.bars[-1].width, abs=1.0)


def test_an_empty_cell_is_marked_and_a_full_one_is_opaque():
    coverage = {"row_edges_px": [-0.5, 9.5, 19.5], "col_edges_px": [-0.5, 9.5, 19.5], "counts": [[0, 4], [2, 1]]}
    bars = detector_map(coverage).bars
    assert [bar.opacity for bar in bars][:2] == [0.0, 1.0]
    assert bars[2].opacity > bars[3].opacity > 0
    assert bars[0].y < bars[2].y  # row 0 is on top


def test_a_number_that_never_occurs_keeps_its_place():
    drawing = number_bars({"stars": [3, 6], "exposures": [10, 20]}, **WORDS)
    assert drawing.rows == [("3", 10), ("4", 0), ("5", 0), ("6", 20)]
