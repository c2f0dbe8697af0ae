"""Runs over REST: launched with 202 and Location, followed, stopped, read, drawn."""

from __future__ import annotations

import csv
import io

import pytest

from boresight.figures import FIGURES
from boresight.store.sessions import writing
from boresight.store.tables import Run

from .conftest import House


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
    answer = client.post(f"/api/v1/runs/{run['id']}:cancel", json={"reason": "wrong set"})
    assert (answer.status_code, answer.json()["state"]) == (200, "CANCELLED")
    assert "wrong set" in answer.json()["reason"]
    again = client.post(f"/api/v1/runs/{run['id']}:cancel")
    assert again.status_code == 409
    assert "CANCELLED already" in again.json()["detail"]


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
    with writing(house.app.state.engine) as session:
        session.get_one(Run, run["id"]).progress = {"fraction": 0.1, "message": "frame 3", "partial": partial}
    client = house.person("victor")
    assert client.get(f"/api/v1/runs/{run['id']}/result").json() == partial
    assert client.get(f"/api/v1/runs/{run['id']}").json()["progress"] == {"fraction": 0.1, "message": "frame 3"}


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_drawn_alone_compared_and_with_nothing_to_draw(house: House, name: str) -> None:
    client, first, second, waiting = (
        house.person("victor"),
        house.finished(),
        house.finished(),
        house.launched()["id"],
    )
    alone = client.get(f"/api/v1/runs/{first}/figures/{name}")
    assert alone.status_code == 200
    assert alone.json()["data"]
    both = client.get(f"/api/v1/runs/{first}/figures/{name}", params={"compare": f"{second},{first}"})
    assert f"Run {second}" in both.text
    assert f"Run {second}" not in alone.text
    nothing = client.get(f"/api/v1/runs/{waiting}/figures/{name}")
    assert nothing.status_code == 200
    assert "layout" in nothing.json()


@pytest.mark.parametrize("name", FIGURES)
def test_the_numbers_behind_every_figure_come_as_csv(house: House, name: str) -> None:
    run_id = house.finished()
    answer = house.person("victor").get(f"/api/v1/runs/{run_id}/figures/{name}/data")
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    assert f'filename="run-{run_id}-{name}.csv"' in answer.headers["content-disposition"]
    rows = list(csv.reader(io.StringIO(answer.text)))
    table = FIGURES[name].table(house.result)
    assert rows[0] == list(table)
    assert len(rows) == 1 + max(len(column) for column in table.values())


def test_figures_are_listed_with_how_to_read_them(house: House) -> None:
    run_id = house.finished()
    items = house.person("victor").get(f"/api/v1/runs/{run_id}/figures").json()["items"]
    assert [item["name"] for item in items] == list(FIGURES)
    assert all(house.person("victor").get(item["href"]).status_code == 200 for item in items)


def test_an_unknown_figure_names_the_ones_there_are(house: House) -> None:
    answer = house.person("victor").get(f"/api/v1/runs/{house.finished()}/figures/pie")
    assert answer.status_code == 404
    assert "convergence" in answer.json()["detail"]


@pytest.mark.parametrize("compare", ["a", "1;2", ",".join(["1"] * 30)])
def test_runs_to_compare_that_are_none_are_refused(house: House, compare: str) -> None:
    answer = house.person("victor").get(f"/api/v1/runs/{house.finished()}/figures/rms", params={"compare": compare})
    assert answer.status_code == 422


def test_two_hundred_launches_at_once_are_all_queued(house: House) -> None:
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 - only here

    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id}
    client = house.key("ada", "runs")
    with ThreadPoolExecutor(50) as pool:
        answers = list(pool.map(lambda _: client.post("/api/v1/runs", json=order), range(200)))
    assert {answer.status_code for answer in answers} == {202}
    assert len({answer.json()["id"] for answer in answers}) == 200
