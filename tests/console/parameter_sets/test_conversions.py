"""A parameter set in another camera model, on its page and in the API."""

import pytest

from boresight.console.parameter_sets import pages as conversions
from boresight.console.transitions import get_parameter_set
from boresight.platform.db.sessions import open_reading

STRAIGHT = "/parameter-sets/1"  # the ground calibration: no decentring


def test_a_set_that_the_other_model_can_say_shows_values_sigmas_and_misfit(site, read):
    page = site.visitor("victor").get(STRAIGHT)
    text = read(page)
    assert "In the camera model pinhole_radial" in text
    assert "Misfit over the detector" in text
    assert "1 % of the sensor’s centroid error" in text
    assert "Uncertainty left out" in text
    assert "/api/v1/parameter-sets/1/conversion?to=pinhole_radial" in page


def test_a_set_with_decentring_shows_why_it_has_no_values(site, read):
    ada = site.visitor("ada")
    text = read(ada.get(ada.post("/runs/1/parameter-set").headers["location"]))
    assert "cannot be written in pinhole_radial" in text
    assert "only inverted_wang has decentring" in text
    assert "Misfit over the detector" not in text


def test_the_page_and_the_api_give_the_same_numbers(site):
    with open_reading(site.engine) as session:
        (shown,) = conversions.list_conversions(session, get_parameter_set(session, 1))
    answer = site.visitor("victor").send("GET", "/api/v1/parameter-sets/1/conversion", params={"to": "pinhole_radial"})
    assert answer.status_code == 200
    assert answer.json() == shown.document


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ({"to": "fisheye"}, "There is no camera model"),
        ({"to": "inverted_wang"}, "choose pinhole_radial"),
        ({"to": "pinhole_radial", "allow_px": "-1"}, "allow_px"),
        ({"to": "pinhole_radial", "allow_px": "nan"}, "allow_px"),
    ],
)
def test_what_cannot_be_converted_is_refused_with_422(site, query, said):
    answer = site.visitor("victor").send("GET", "/api/v1/parameter-sets/1/conversion", params=query)
    assert answer.status_code == 422
    assert said in answer.text
