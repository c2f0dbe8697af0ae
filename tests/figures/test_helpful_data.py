"""Which data would help: named by what the weakest direction mixes, by coverage, and by the square-root law."""

import pytest

from boresight.estimation.statistics.observability import WEAK
from boresight.figures.charts.observability import helpful_data, weakest_words


def seen(direction, sigma, frames=200, **rest):
    weakest = {"direction": direction, "sentence": "Said elsewhere."}
    observed = {"singular_values": [9.0, 1.0], "sigma_of_direction": [0.1, sigma], "weakest": weakest}
    return {"observability": observed, "frames": frames, **rest}


def test_the_weakest_direction_is_a_sum_of_the_parameters_that_matter_in_it():
    assert weakest_words(seen({"m0_px": 0.82, "a2_rad": -0.55, "f_m": 0.05}, 0.4)) == "0.82 m0 − 0.55 a2"
    assert weakest_words({"observability": None}) == ""


@pytest.mark.parametrize(
    ("direction", "wanted"),
    [
        ({"f_m": 0.7, "b2_per_m2": 0.7}, "at all radii"),
        ({"m0_px": 0.8, "a2_rad": 0.6}, "on opposite sides"),
        ({"g_y": 1.0}, "along rows and along columns"),
        ({"s": 1.0}, "along rows and along columns"),
    ],
)
def test_what_is_mixed_says_which_stars_would_part_it(direction, wanted):
    (first, *_) = helpful_data(seen(direction, 0.1))
    assert wanted in first


def test_so_many_times_the_frames_as_the_square_of_what_is_missing():
    assert "About 800 frames like these, in place of 200" in helpful_data(seen({"f_m": 1.0}, 2 * WEAK))[-1]
    assert "alone would not do" in helpful_data(seen({"f_m": 1.0}, 20 * WEAK))[-1]
    assert "as open as it is" in helpful_data(seen({"f_m": 1.0}, None))[-1]
    assert "Every direction is known" in helpful_data(seen({"f_m": 1.0}, WEAK))[-1]


def test_corners_and_cells_without_stars_are_named():
    thin = {
        "radial": {"radius_px": [0.0, 1000.0], "data_radius_px": 600.0},
        "coverage": {"counts": [[3, 0], [0, 2]]},
    }
    said = " ".join(helpful_data(seen({"f_m": 1.0}, 0.1, **thin)))
    assert "60\u202f% of the way" in said
    assert "2 of 4 cells" in said


def test_nothing_is_said_where_observability_is_not_known(sequential_result):
    assert helpful_data(sequential_result | {"observability": None}) == []
    assert helpful_data(sequential_result)
