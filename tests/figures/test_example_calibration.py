"""The specimen is small, travels with the package, and has something to draw for every figure."""

import pytest

from benchmarks.pages.drawings import _shortened
from boresight.figures import FIGURES
from boresight.figures.example_calibration import PLACE, get_example_calibrations, make_example_traces

EVERY_FIGURE = pytest.mark.parametrize("figure", FIGURES.values(), ids=FIGURES.keys())
MOST_BYTES = 400_000


def test_the_specimen_is_small_and_inside_the_package():
    assert PLACE.parent.name == "figures"
    assert PLACE.stat().st_size < MOST_BYTES


@EVERY_FIGURE
@pytest.mark.parametrize("names", [("filter",), ("batch",), ("filter", "batch")], ids="-".join)
def test_every_figure_has_something_to_draw_of_it(figure, names):
    drawn = figure.draw(make_example_traces(names))
    assert drawn.data, (
        f"make the specimen again with `python -m benchmarks.pages --figures --renew`: {figure.name} lacks its data"
    )
    assert figure.table(get_example_calibrations()[names[0]])


@EVERY_FIGURE
def test_where_nothing_is_known_every_figure_says_so(figure):
    drawn = figure.draw(make_example_traces(("nothing",)))
    assert not drawn.data
    assert drawn.layout.annotations


def test_half_way_a_filter_has_half_a_history_and_no_judgement():
    whole, half = get_example_calibrations()["filter"], get_example_calibrations()["partial"]
    assert len(half["history"]["frame"]) == len(half["history"]["parameters"]) == len(whole["history"]["frame"]) // 2
    assert half["status"] == "running"
    assert half["frames_done"] < half["frames"]
    assert half["trust"] is None
    assert whole["trust"] is not None


def test_numbers_keep_seven_digits_wherever_they_stand():
    assert _shortened({"a": [1.23456789e-5, (2.0, 3)], "b": "1.23456789", "c": None}) == {
        "a": [1.234568e-5, [2.0, 3]],
        "b": "1.23456789",
        "c": None,
    }
