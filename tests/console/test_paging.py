"""Lists by cursors: everything once, in order, while rows are added."""

from itertools import chain
from typing import Any

import pytest

from tests.served import House


def _all(client: Any, path: str, **params: Any) -> list[list[int]]:
    pages, cursor = [], None
    while True:
        body = client.get(path, params={**params, **({"cursor": cursor} if cursor else {})}).json()
        pages.append([item["id"] for item in body["items"]])
        cursor = body["next"]
        if cursor is None:
            return pages


def test_pages_hold_every_run_once_newest_first(house: House) -> None:
    sensor_id, set_id = house.ready_sensor()
    client = house.person("ada")
    made = [
        client.post("/api/v1/runs", json={"sensor_id": sensor_id, "telemetry_set_id": set_id}).json()["id"]
        for _ in range(5)
    ]
    pages = _all(client, "/api/v1/runs", sensor_id=sensor_id, limit=2)
    assert [len(page) for page in pages] == [2, 2, 1]
    assert list(chain(*pages)) == made[::-1]


def test_a_full_last_page_has_no_next(house: House) -> None:
    sensor_id, set_id = house.ready_sensor()
    client = house.person("ada")
    for _ in range(2):
        client.post("/api/v1/runs", json={"sensor_id": sensor_id, "telemetry_set_id": set_id})
    assert client.get("/api/v1/runs", params={"sensor_id": sensor_id, "limit": 2}).json()["next"] is None


def test_a_row_added_meanwhile_does_not_move_the_pages(house: House) -> None:
    client, run = house.person("ada"), house.launched()
    params = {"sensor_id": run["sensor_id"], "limit": 1}
    order = {"sensor_id": run["sensor_id"], "telemetry_set_id": run["telemetry_set_id"]}
    second = client.post("/api/v1/runs", json=order).json()
    first_page = client.get("/api/v1/runs", params=params).json()
    client.post("/api/v1/runs", json=order)
    next_page = client.get("/api/v1/runs", params={**params, "cursor": first_page["next"]}).json()
    assert [first_page["items"][0]["id"], next_page["items"][0]["id"]] == [second["id"], run["id"]]


def test_a_cursor_of_other_filters_is_refused(house: House) -> None:
    client = house.person("ada")
    house.launched(), house.launched()
    cursor = client.get("/api/v1/runs", params={"limit": 1}).json()["next"]
    refused = client.get("/api/v1/runs", params={"limit": 1, "cursor": cursor, "state": "QUEUED"})
    assert refused.status_code == 422
    assert "other filters" in refused.json()["detail"]


@pytest.mark.parametrize("cursor", ["x", "%%%", "bm90aGluZw", "-1.5", "MTIz"])
def test_a_made_up_cursor_is_refused(house: House, cursor: str) -> None:
    answer = house.person("ada").get("/api/v1/runs", params={"cursor": cursor})
    assert answer.status_code == 422


@pytest.mark.parametrize("limit", ["0", "201", "many"])
def test_an_impossible_limit_is_refused(house: House, limit: str) -> None:
    assert house.person("ada").get("/api/v1/runs", params={"limit": limit}).status_code == 422


@pytest.mark.parametrize("path", ["sensors", "users", "api-keys", "audit", "parameter-sets", "telemetry-sets"])
def test_other_lists_page_by_the_same_rule(house: House, path: str) -> None:
    house.ready_sensor(), house.ready_sensor(), house.key("adele"), house.key("adele")
    client = house.person("adele")
    paged = list(chain(*_all(client, f"/api/v1/{path}", limit=3 if path != "audit" else 100)))
    whole = list(chain(*_all(client, f"/api/v1/{path}", limit=200)))
    assert len(paged) == len(set(paged)) >= 2
    assert paged == whole


def test_the_log_of_a_run_pages_forward(house: House) -> None:
    run_id = house.finished()
    pages = _all(house.person("ada"), f"/api/v1/runs/{run_id}/log", limit=1)
    assert len(pages) >= 2
    assert list(chain(*pages)) == sorted(chain(*pages))
