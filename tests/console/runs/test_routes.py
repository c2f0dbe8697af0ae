"""Runs over REST: launched with 202 and Location, followed, stopped, read, drawn."""

import pytest

from boresight.console.runs.tables import Run
from boresight.platform.db.sessions import open_writing
from tests.served import House


def test_a_launch_answers_202_with_the_address_of_the_run(house: House) -> None:
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id, "settings": {"method": "sqrf"}, "label": "first"}
    answer = house.person("ada").post("/api/v1/runs", json=order)
    assert answer.status_code == 202
    followed = house.person("victor").get(answer.headers["location"])
    assert followed.json() == answer.json()
    assert (followed.json()["state"], followed.json()["method"], followed.json()["label"]) == (
        "QUEUED",
        "sqrf",
        "first",
    )


@pytest.mark.parametrize("member", ["sensor_id", "telemetry_set_id", "validation_set_id"])
def test_a_body_with_a_number_that_no_row_can_have_is_refused(house: House, member: str) -> None:
    order = {"sensor_id": 1, "telemetry_set_id": 1, member: 10**25}
    assert house.person("ada").post("/api/v1/runs", json=order).status_code == 422


def test_a_label_with_a_control_character_is_refused(house: House) -> None:
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id, "label": "a\x02b"}
    answer = house.person("ada").post("/api/v1/runs", json=order)
    assert answer.status_code == 422
    assert answer.json()["detail"] == "The label has the control character U+0002 at place 2; remove it."


@pytest.mark.parametrize("where", ["query", "body"])
def test_validate_only_says_what_it_would_be_and_queues_nothing(house: House, where: str) -> None:
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id}
    asked = {"validate_only": True}
    answer = house.person("ada").post(
        "/api/v1/runs", params=asked if where == "query" else {}, json=order | (asked if where == "body" else {})
    )
    assert answer.status_code == 200
    assert answer.json()["frames"] == 30
    assert answer.json()["pairs"] > 0
    assert "location" not in answer.headers
    assert house.person("ada").get("/api/v1/runs", params={"sensor_id": sensor_id}).json()["items"] == []


def test_validate_only_needs_the_same_rights(house: House) -> None:
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id}
    assert house.person("victor").post("/api/v1/runs?validate_only=true", json=order).status_code == 403


@pytest.mark.parametrize(
    "settings", [{"method": "magic"}, {"colour": 1}, {"free": ["f_px"]}, {"minimum_stars": "four"}]
)
def test_a_setting_that_is_none_is_refused_in_a_sentence(house: House, settings: dict[str, object]) -> None:
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id, "settings": settings}
    answer = house.person("ada").post("/api/v1/runs", json=order)
    assert answer.status_code == 422
    assert answer.json()["type"] == "urn:boresight:problem:refused-input"


def test_lists_filter_by_state_sensor_and_method(house: House) -> None:
    run = house.launched()
    client = house.person("victor")
    sensor = {"sensor_id": run["sensor_id"]}
    assert [row["id"] for row in client.get("/api/v1/runs", params=sensor).json()["items"]] == [run["id"]]
    both = client.get("/api/v1/runs", params={**sensor, "state": ["QUEUED", "FAILED"]}).json()["items"]
    assert [row["id"] for row in both] == [run["id"]]
    assert client.get("/api/v1/runs", params={**sensor, "state": "FAILED"}).json()["items"] == []
    assert client.get("/api/v1/runs", params={**sensor, "method": "ekf"}).json()["items"] == []
    assert client.get("/api/v1/runs", params={"state": "DONE"}).status_code == 422


def test_a_waiting_run_is_cancelled_at_once_and_an_ended_one_not_again(house: House) -> None:
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


def test_the_tag_of_a_run_is_weak_and_names_its_state_in_either_spelling(house: House) -> None:
    client = house.person("ada")
    for spelt in (lambda tag: tag, lambda tag: tag.removeprefix("W/")):
        address = f"/api/v1/runs/{house.launched()['id']}"
        tag = client.get(address).headers["etag"]
        assert tag.startswith('W/"')
        assert client.post(f"{address}:cancel", headers={"If-Match": spelt(tag)}).status_code == 200


def test_a_state_is_never_patched(house: House) -> None:
    run = house.launched()
    for method in ("PATCH", "PUT", "DELETE"):
        assert house.person("ada").request(method, f"/api/v1/runs/{run['id']}", json={}).status_code == 405


def test_the_result_is_the_calibration_as_it_was_computed(house: House) -> None:
    answer = house.person("victor").get(f"/api/v1/runs/{house.finished()}/result")
    assert answer.json() == house.result
    assert answer.json()["schema"] == "boresight.calibration/1"


def test_a_run_with_nothing_yet_says_that_it_runs(house: House) -> None:
    body = house.person("victor").get(f"/api/v1/runs/{house.launched()['id']}/result").json()
    assert (body["status"], body["run_state"]) == ("running", "QUEUED")


def test_a_partial_result_is_shown_while_it_computes(house: House) -> None:
    run = house.launched()
    partial = {"schema": "boresight.calibration/1", "status": "running", "frames": 3}
    with open_writing(house.app.state.engine) as session:
        session.get_one(Run, run["id"]).progress = {"fraction": 0.1, "message": "frame 3", "partial": partial}
    client = house.person("victor")
    assert client.get(f"/api/v1/runs/{run['id']}/result").json() == partial
    progress = client.get(f"/api/v1/runs/{run['id']}").json()["progress"]
    assert progress == {"fraction": 0.1, "message": "frame 3", "elapsed_s": None, "at_utc": None}


def test_the_report_is_one_file_to_keep(house: House) -> None:
    run_id = house.finished()
    answer = house.person("victor").get(f"/api/v1/runs/{run_id}/report")
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert answer.headers["content-disposition"] == f'attachment; filename="run-{run_id}-report.html"'
    assert house.result["sensor"] in answer.text
    assert "default-src 'none'" in answer.text


def test_a_run_without_a_result_has_no_report_and_says_its_state(house: House) -> None:
    run_id = house.launched()["id"]
    answer = house.person("victor").get(f"/api/v1/runs/{run_id}/report")
    assert answer.status_code == 409
    assert answer.json()["detail"].startswith(f"Run {run_id} is QUEUED and has no result;")


def test_two_hundred_launches_at_once_are_all_queued(house: House) -> None:
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 - only here

    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id}
    client = house.key("ada", "runs")
    with ThreadPoolExecutor(50) as pool:
        answers = list(pool.map(lambda _: client.post("/api/v1/runs", json=order), range(200)))
    assert {answer.status_code for answer in answers} == {202}
    assert len({answer.json()["id"] for answer in answers}) == 200
