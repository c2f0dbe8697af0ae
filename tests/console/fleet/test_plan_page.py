"""The page of a sensor's plan: the form with the baseline as what is known, the plan with its forecast, its CSV, its refusals."""

import re

import pytest

from boresight.console.fleet import pointings
from tests.console.fleet.test_pointings import ASKED, FEW
from tests.console.ingest.test_pages import _post, _read

LINES = "ra_deg,dec_deg,roll_deg\n" + "\n".join(";".join(map(str, row)) for row in FEW) + "\n"
TYPED = {"start_utc": ASKED["start_utc"], "minutes": "5", "sun_deg": "0", "moon_deg": "0", "candidates": LINES}


@pytest.fixture
def sensor(house):
    run = house.converged()
    return house.person("victor").get(f"/api/v1/runs/{run}").json()["sensor_id"], run


def planned(house, sensor_id, **typed):
    return _post(house, "victor", f"/sensors/{sensor_id}/plan", **TYPED | typed)


def test_the_form_offers_what_is_known_and_the_sensor_s_page_leads_to_it(house, sensor):
    number, run = sensor
    assert f'href="/sensors/{number}/plan"' in _read(house, "victor", f"/sensors/{number}")
    page = _read(house, "victor", f"/sensors/{number}/plan")
    assert f'<option value="run {run}">' in page
    assert 'name="format"' not in page
    for name in ("minutes", "dwell_s", "sun_deg", "altitude_km", "candidates"):
        assert f'name="{name}"' in page


def test_a_plan_shows_the_pointings_and_sigmas_of_the_rest_answer(house, sensor):
    number, run = sensor
    answer = planned(house, number, known=f"run {run}")
    assert answer.status_code == 200, answer.text[-2000:]
    expected = house.person("victor").post(f"/api/v1/sensors/{number}:plan", json=ASKED | {"prior_run_id": run}).json()
    rows = re.findall(r'<tr><th scope="row" class="num">(\d+)</th>(.*?)</tr>', answer.text, re.DOTALL)
    assert len(rows) == len(expected["pointings"]) > 1
    for (_, row), one in zip(rows, expected["pointings"], strict=True):
        assert [f"{one['ra_deg']:.2f}" in row, f">{one['stars']}<" in row] == [True, True]
        assert ("within" in row) == (one["weakest"] <= 0.5)
    assert all(f'<code class="quiet">{name}</code>' in answer.text for name in expected["sigma_after"])
    assert f'<option value="run {run}" selected>' in answer.text
    assert 'name="format"' in answer.text


def test_the_csv_is_that_of_the_library(house, sensor):
    number, _ = sensor
    answer = planned(house, number, format="csv")
    assert answer.headers["content-disposition"] == f'attachment; filename="pointings-{number}.csv"'
    lines = answer.text.replace('"', "").splitlines()
    assert lines[0].split(",")[:6] == ["start_utc", "slew_s", "dwell_s", "ra_deg", "dec_deg", "roll_deg"]
    angles = {tuple(round(float(one), 9) for one in line.split(",")[3:6]) for line in lines[1:]}
    assert 0 < len(angles) <= len(angles & {tuple(row) for row in FEW})


@pytest.mark.parametrize(
    ("typed", "status", "named"),
    [
        ({"minutes": "ten"}, 422, "Minutes"),
        ({"minutes": "1440"}, 422, "dwells"),
        ({"visits": "1.5"}, 422, "whole number"),
        ({"start_utc": "now"}, 422, "start_utc"),
        ({"altitude_km": "570"}, 422, "Inclination"),
        ({"altitude_km": "1", "inclination_deg": "98", "node_hour": "10"}, 422, "altitude_km"),
        ({"candidates": "1,2\n"}, 422, "Line 1"),
        ({"candidates": "1 95 0\n"}, 422, "dec_deg"),
        ({"criterion": "E"}, 422, "criterion"),
        ({"known": "run 1000000000"}, 404, "1000000000"),
        ({"known": "set x"}, 422, "calibration"),
    ],
)
def test_what_makes_no_plan_is_said_above_the_form_that_keeps_what_was_typed(house, sensor, typed, status, named):
    answer = planned(house, sensor[0], **typed)
    assert (answer.status_code, named in answer.text) == (status, True), answer.text[-1500:]
    if status == 422 and "minutes" in typed:
        assert f'value="{typed["minutes"]}"' in answer.text


def test_who_comes_while_another_plan_is_computed_is_told_when_to_come_back(house, sensor, monkeypatch):
    monkeypatch.setattr(pointings, "PATIENCE_S", 0.01)
    with pointings._computing:
        answer = planned(house, sensor[0])
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "5")
    assert ">Plan</button>" in answer.text
