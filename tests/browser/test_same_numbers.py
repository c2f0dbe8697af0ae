"""One calibration, three doors: the page, REST with an API key, and the command line give the same numbers."""

import json

import httpx
import pytest

from benchmarks.servers import wait_until

pytestmark = pytest.mark.browser

SAME = 1e-9
ENDED_WITHIN_S = 60


@pytest.fixture(scope="module")
def page_result(people, batch_run):
    with people.seat("analyst") as window:
        return window.result(batch_run)


def same(one, other):
    for name in ("parameters", "sigma", "initial", "rms_arc_rad"):
        assert one[name] == pytest.approx(other[name], rel=SAME)
    for name in ("chi2_per_dof", "status", "free", "frames", "stars", "pairs"):
        assert one[name] == pytest.approx(other[name], rel=SAME) if isinstance(one[name], float) else other[name]
    values = [result["observability"]["singular_values"] for result in (one, other)]
    assert values[0] == pytest.approx(values[1], rel=SAME)
    assert one["validation"]["rms_arc_rad"] == pytest.approx(other["validation"]["rms_arc_rad"], rel=SAME)


def test_rest_with_an_api_key_gives_the_numbers_of_the_page(installation, key, batch_run, page_result):
    with httpx.Client(base_url=installation.address, headers={"Authorization": f"Bearer {key}"}, timeout=60) as client:
        run = client.get(f"/api/v1/runs/{batch_run}").json()
        names = ("sensor_id", "telemetry_set_id", "validation_set_id", "settings")
        order = {name: run[name] for name in names} | {"label": "Over REST"}
        answer = client.post("/api/v1/runs", json=order)
        assert answer.status_code == httpx.codes.ACCEPTED, answer.text
        address = answer.headers["Location"]
        wait_until(lambda: client.get(address).json()["state"] == "SUCCEEDED", ENDED_WITHIN_S)
        same(client.get(f"{address}/result").json(), page_result)


def test_the_command_line_gives_the_numbers_of_the_page(installation, files, page_result):
    words = ["calibrate", str(files / "calibration.csv"), "--sensor", str(files / "sensor.json")]
    words += ["--validate", str(files / "validation.csv"), "--json", str(files / "result.json")]
    installation.command(*words)
    same(json.loads((files / "result.json").read_text()), page_result)


def test_a_key_cannot_sign_and_says_so(installation, key, promoted):
    answer = httpx.post(
        f"{installation.address}/api/v1/approvals/{promoted.request_id}:approve",
        headers={"Authorization": f"Bearer {key}", "If-Match": '"v1"'},
        json={"meaning": "I have read it", "password": "whatever it is", "comment": ""},
        timeout=60,
    )
    assert answer.status_code == httpx.codes.FORBIDDEN
    assert "key" in answer.json()["detail"]
