"""Runs over REST: launched with 202 and Location, followed, stopped, read, drawn."""

import re

import pytest

from boresight.console.runs.tables import Run, RunEvent
from boresight.platform.db.sessions import open_writing, utc_now


def test_a_launch_answers_202_with_the_address_of_the_run(house):
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id, "settings": {"method": "sqrf"}, "label": "first"}
    answer = house.person("ada").post("/api/v1/runs", json=order)
    assert answer.status_code == 202
    followed = house.person("victor").get(answer.headers["location"])
    assert followed.json() == answer.json()
    expected = {"state": "QUEUED", "method": "sqrf", "label": "first"}
    assert {name: followed.json()[name] for name in expected} == expected


def test_a_joint_run_shows_its_sets_and_its_dry_run_counts_them(house):
    sensor_id, set_id = house.ready_sensor()
    client = house.person("ada")
    further = house.upload(client, sensor_id, house.telemetry_csv + b"\n", file_name="again.csv").json()["id"]
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id, "joint_set_ids": [further]}
    said = client.post("/api/v1/runs?validate_only=true", json=order).json()
    assert (said["frames"], said["joint_sets"], said["prior"], said["left_out"]) == (60, ["again.csv"], None, [])
    made = client.post("/api/v1/runs", json=order).json()
    expected = {"joint_set_ids": [further], "prior_run_id": None, "prior_set_id": None}
    assert {name: made[name] for name in expected} == expected
    assert client.get(f"/api/v1/runs/{made['id']}").json() == made
    assert "<span>2 sets</span>" in client.get(f"/runs/{made['id']}").text
    assert client.get("/api/v1/runs", params={"telemetry_set_id": further}).json()["items"] == [made]
    assert client.post("/api/v1/runs", json=order | {"joint_set_ids": [set_id]}).status_code == 422
    assert client.post("/api/v1/runs", json=order | {"prior_run_id": made["id"]}).status_code == 409
    assert client.post("/api/v1/runs", json=order | {"prior_set_id": 10**9}).status_code == 404


@pytest.mark.parametrize(
    "given",
    [
        *({member: 10**25} for member in ("sensor_id", "telemetry_set_id", "validation_set_id")),
        *(
            {"settings": one}
            for one in ({"method": "magic"}, {"colour": 1}, {"free": ["f_px"]}, {"minimum_stars": "4"})
        ),
        {"label": "a\x02b"},
    ],
    ids=str,
)
def test_an_order_that_cannot_be_is_refused_in_a_sentence(house, given):
    sensor_id, set_id = house.ready_sensor()
    answer = house.person("ada").post(
        "/api/v1/runs", json={"sensor_id": sensor_id, "telemetry_set_id": set_id, **given}
    )
    assert answer.status_code == 422
    if "label" in given:
        assert answer.json()["code"] == "control-character"
        assert re.search(r"The label .*U\+0002 .* 2", answer.json()["detail"])
    assert "settings" not in given or answer.json()["type"] == "urn:boresight:problem:refused-input"


@pytest.mark.parametrize("where", ["query", "body"])
def test_validate_only_says_what_it_would_be_and_queues_nothing(house, where):
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id}
    asked = {"validate_only": True}
    answer = house.person("ada").post(
        "/api/v1/runs", params=asked if where == "query" else {}, json=order | (asked if where == "body" else {})
    )
    assert answer.status_code == 200
    assert answer.json()["frames"] == 30
    assert answer.json()["pairs"] > 0
    assert house.person("victor").post("/api/v1/runs?validate_only=true", json=order).status_code == 403
    assert "location" not in answer.headers
    assert house.person("ada").get("/api/v1/runs", params={"sensor_id": sensor_id}).json()["items"] == []


def test_lists_filter_by_state_sensor_and_method(house):
    run = house.launched()
    client = house.person("victor")
    sensor = {"sensor_id": run["sensor_id"]}
    assert [row["id"] for row in client.get("/api/v1/runs", params=sensor).json()["items"]] == [run["id"]]
    both = client.get("/api/v1/runs", params={**sensor, "state": ["QUEUED", "FAILED"]}).json()["items"]
    assert [row["id"] for row in both] == [run["id"]]
    assert client.get("/api/v1/runs", params={**sensor, "state": "FAILED"}).json()["items"] == []
    assert client.get("/api/v1/runs", params={**sensor, "method": "ekf"}).json()["items"] == []
    assert client.get("/api/v1/runs", params={"state": "DONE"}).status_code == 422


def test_a_waiting_run_is_cancelled_at_once_and_an_ended_one_not_again(house):
    run, client = house.launched(), house.person("ada")
    address = f"/api/v1/runs/{run['id']}"
    seen = {"If-Match": client.get(address).headers["etag"]}
    answer = client.post(f"{address}:cancel", json={"reason": "wrong set"}, headers=seen)
    assert (answer.status_code, answer.json()["state"]) == (200, "CANCELLED")
    assert "wrong set" in answer.json()["reason"]
    assert client.post(f"{address}:cancel", headers=seen).status_code == 412
    again = client.post(f"{address}:cancel", headers={"If-Match": answer.headers["etag"]})
    assert again.status_code == 409
    assert "CANCELLED already" in again.json()["detail"]


def test_the_tag_of_a_run_is_weak_and_names_its_state_in_either_spelling(house):
    client = house.person("ada")
    for spelt in (lambda tag: tag, lambda tag: tag.removeprefix("W/")):
        address = f"/api/v1/runs/{house.launched()['id']}"
        tag = client.get(address).headers["etag"]
        assert tag.startswith('W/"')
        assert client.post(f"{address}:cancel", headers={"If-Match": spelt(tag)}).status_code == 200


def test_a_state_is_never_patched(house):
    run = house.launched()
    for method in ("PATCH", "PUT", "DELETE"):
        assert house.person("ada").request(method, f"/api/v1/runs/{run['id']}", json={}).status_code == 405


def test_the_result_is_the_calibration_as_it_was_computed(house):
    answer = house.person("victor").get(f"/api/v1/runs/{house.finished()}/result")
    assert answer.json() == house.result
    assert answer.json()["schema"] == "boresight.calibration/1"


def test_a_partial_result_is_shown_while_it_computes(house):
    run = house.launched()
    nothing = house.person("victor").get(f"/api/v1/runs/{run['id']}/result").json()
    assert (nothing["status"], nothing["run_state"]) == ("running", "QUEUED")
    partial = {"schema": "boresight.calibration/1", "status": "running", "frames": 3}
    with open_writing(house.app.state.engine) as session:
        session.get_one(Run, run["id"]).progress = {"fraction": 0.1, "message": "frame 3", "partial": partial}
    client = house.person("victor")
    assert client.get(f"/api/v1/runs/{run['id']}/result").json() == partial
    progress = client.get(f"/api/v1/runs/{run['id']}").json()["progress"]
    assert progress == {"fraction": 0.1, "message": "frame 3", "elapsed_s": None, "at_utc": None}


def test_the_report_is_one_file_to_keep(house):
    run_id = house.finished()
    answer = house.person("victor").get(f"/api/v1/runs/{run_id}/report")
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert answer.headers["content-disposition"] == f'attachment; filename="run-{run_id}-report.html"'
    assert house.result["sensor"] in answer.text
    assert "default-src 'none'" in answer.text


def test_a_run_without_a_result_has_no_report_and_says_its_state(house):
    run_id = house.launched()["id"]
    answer = house.person("victor").get(f"/api/v1/runs/{run_id}/report")
    assert answer.status_code == 409
    assert answer.json()["code"] == "no-result"
    assert answer.json()["detail"].startswith(f"Run {run_id} is QUEUED")


@pytest.mark.full
def test_two_hundred_launches_at_once_are_all_queued(house):
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 - only here

    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id}
    client = house.key("ada", "runs")
    with ThreadPoolExecutor(50) as pool:
        answers = list(pool.map(lambda _: client.post("/api/v1/runs", json=order), range(200)))
    assert {answer.status_code for answer in answers} == {202}
    assert len({answer.json()["id"] for answer in answers}) == 200


@pytest.fixture(scope="module")
def run_id(house) -> int:
    return house.finished()


def test_frames_come_in_pages_by_number(house, run_id):
    client, seen, cursor = house.person("victor"), [], None
    for _ in range(4):
        params = {"limit": 12, **({"cursor": cursor} if cursor else {})}
        page = client.get(f"/api/v1/runs/{run_id}/frames", params=params).json()
        seen += [line["frame"] for line in page["items"]]
        cursor = page["next"]
        if cursor is None:
            break
    assert seen == list(range(30))


def test_the_worst_come_first_with_what_makes_them_so(house, run_id):
    answer = house.person("victor").get(f"/api/v1/runs/{run_id}/frames", params={"order": "worst", "limit": 5}).json()
    deviations = [line["deviation"] for line in answer["items"]]
    assert deviations == sorted(deviations, reverse=True)
    assert [line["frame"] for line in answer["items"]] == house.result["trust"]["worst_frames"]["frame"][:5]
    assert house.person("victor").get(f"/api/v1/runs/{run_id}/frames", params={"order": "best"}).status_code == 422


def test_a_frame_s_residuals_are_those_the_result_keeps(house, run_id):
    kept = house.result["trust"]["residuals"]
    frame = house.person("victor").get(f"/api/v1/runs/{run_id}/frames/4").json()
    stars = {
        (star["star_id"], round(star["row_px"], 1)): star
        for exposure in frame["exposures"]
        for star in exposure["stars"]
    }
    places = [place for place, number in enumerate(kept["frame"]) if number == 4]
    assert len(places) > 5
    for place in places:
        star = stars[kept["star_id"][place], round(kept["row_px"][place], 1)]
        assert star["fate"] == "used"
        assert star["new"]["d_px"] == pytest.approx([kept["d_row_px"][place], kept["d_col_px"][place]], abs=1e-4)
    assert (frame["place"], frame["previous"], frame["next"]) == (5, 3, 5)


def test_a_run_without_a_result_is_shown_at_the_old_parameters(house):
    frame = house.person("victor").get(f"/api/v1/runs/{house.launched()['id']}/frames/0").json()
    assert frame["why_no_new"]
    assert frame["previous"] is None
    assert all(exposure["attitude"]["new"] is None for exposure in frame["exposures"])
    assert any(exposure["attitude"]["old"] for exposure in frame["exposures"])


@pytest.mark.parametrize(("frame", "status"), [("99", 404), ("-1", 404), ("x", 422)])
def test_a_frame_that_is_not_there_is_a_problem_with_a_sentence(house, run_id, frame, status):
    answer = house.person("victor").get(f"/api/v1/runs/{run_id}/frames/{frame}")
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    if status == 404:
        assert answer.json()["code"] == "no-such-frame"
        assert "0 to 29" in answer.json()["detail"]


def test_the_log_is_text_a_line_an_event(site):
    with open_writing(site.engine) as session:
        session.add(RunEvent(run_id=1, attempt=2, at_utc=utc_now(), kind="lost", message="dead"))
    lines = site.visitor("victor").send("GET", "/runs/1/log").text.splitlines()
    assert lines[-1].endswith(" 2 lost dead")


def test_the_sensor_file_is_the_one_of_the_launch(site):
    run_id = site.add_run(sensor_document={"name": "as it was"})
    assert site.visitor("victor").send("GET", f"/runs/{run_id}/sensor.json").json() == {"name": "as it was"}
