"""What to observe next, over REST: the library's plan, from what a run knows, within budgets, one at a time."""

import pytest

import boresight as bs
from boresight.console.fleet import pointings

FEW = [[10.0, 5.0, 0.0], [120.0, -40.0, 30.0], [200.0, 60.0, 90.0], [300.0, 20.0, 45.0]]
ASKED = {"start_utc": "2026-10-01T00:00:00Z", "minutes": 5.0, "candidates": FEW, "sun_deg": 0.0, "moon_deg": 0.0}


def test_a_plan_over_rest_is_the_library_s_from_what_a_run_knows(house, tmp_path):
    run = house.converged()
    client = house.person("victor")
    sensor_id = client.get(f"/api/v1/runs/{run}").json()["sensor_id"]
    answer = client.post(f"/api/v1/sensors/{sensor_id}:plan", json=ASKED | {"prior_run_id": run})
    assert answer.status_code == 200, answer.text
    (tmp_path / "few.csv").write_text("ra_deg,dec_deg,roll_deg\n" + "\n".join(",".join(map(str, row)) for row in FEW))
    expected = bs.plan(
        client.get(f"/api/v1/sensors/{sensor_id}").json()["document"],
        ASKED["start_utc"],
        5.0,
        calibration=client.get(f"/api/v1/runs/{run}/result").json(),
        candidates=tmp_path / "few.csv",
        sun_deg=0.0,
        moon_deg=0.0,
        progress=False,
    )
    assert answer.json() == expected.to_dict()
    assert all(answer.json()["sigma_before"].values())


@pytest.mark.parametrize(
    ("given", "status", "named"),
    [
        ({"minutes": 1440.0}, 422, "dwells"),
        ({"minutes": "NaN"}, 422, "minutes"),
        ({"candidates": [[0.0, 95.0, 0.0]]}, 422, "candidates[0]: dec_deg"),
        ({"candidates": [[0.0, 5.0, 0.0]] * (pointings.MOST_CANDIDATES + 1)}, 422, "candidates"),
        ({"candidates": []}, 422, "candidates"),
        ({"orbit": {"altitude_km": 1.0, "inclination_deg": 90.0, "node_hour": 1.0}}, 422, "altitude_km"),
        ({"start_utc": "now"}, 422, "start_utc"),
        ({"sun": 4.0}, 422, "sun"),
        ({"prior_run_id": 10**9}, 404, "1000000000"),
    ],
)
def test_what_makes_no_plan_is_refused_with_its_cause(house, given, status, named):
    answer = house.person("victor").post(f"/api/v1/sensors/{house.new_sensor()['id']}:plan", json=ASKED | given)
    assert (answer.status_code, named in answer.text) == (status, True), answer.text
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_plan_that_would_wait_too_long_is_told_when_to_come_back(house, monkeypatch):
    monkeypatch.setattr(pointings, "PATIENCE_S", 0.01)
    with pointings._computing:
        answer = house.person("victor").post(f"/api/v1/sensors/{house.new_sensor()['id']}:plan", json=ASKED)
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "5")
