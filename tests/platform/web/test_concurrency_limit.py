"""Overload is said at once, and those who watch the server are answered all the same."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest

from boresight.platform.web.concurrency_limit import COME_BACK_S, ConcurrencyLimit
from tests.served import House


def gate_of(app: Any) -> ConcurrencyLimit:
    layer = app.middleware_stack
    while not isinstance(layer, ConcurrencyLimit):
        layer = layer.app
    return layer


def test_who_comes_when_too_many_are_under_way_is_told_when_to_come_back(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = house.person("ada")
    monkeypatch.setattr(gate_of(house.app).known, "most", 0)
    answer = client.get("/api/v1/presets")
    assert (answer.status_code, answer.headers["retry-after"]) == (503, str(COME_BACK_S))
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["type"] == "urn:boresight:problem:overloaded"
    page = client.get("/sensors", headers={"Accept": "text/html"})
    assert (page.status_code, page.headers["retry-after"]) == (503, str(COME_BACK_S))
    assert "ask again" in page.text


def test_those_who_watch_and_the_files_of_pages_are_always_let_in(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate_of(house.app).known, "most", 0)
    for path in ("/healthz", "/readyz", "/metrics", "/static/shared/style.css"):
        assert house.anybody().get(path).status_code == 200, path


def test_what_stands_ready_is_given_though_too_many_are_under_way(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = house.person("ada")
    assert client.get("/api/v1/runs").status_code == 200
    monkeypatch.setattr(gate_of(house.app).known, "most", 0)
    assert client.get("/api/v1/runs").status_code == 200


def test_health_is_told_while_every_thread_is_taken(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    free = threading.Event()
    monkeypatch.setattr("boresight.console.runs.presets.list_presets", lambda *_, **__: free.wait(20) and [])
    client = house.person("ada")
    with ThreadPoolExecutor(30) as pool:
        waiting = [pool.submit(client.get, "/api/v1/presets") for _ in range(30)]
        time.sleep(0.3)
        try:
            answers = {
                path: httpx.get(house.address + path, timeout=15).status_code for path in ("/healthz", "/readyz")
            }
        finally:
            free.set()
        assert all(one.result().status_code == 200 for one in waiting)
    assert answers == {"/healthz": 200, "/readyz": 200}


def test_whoever_was_let_in_is_counted_out_again(house: House) -> None:
    client = house.person("ada")
    for path in ("/api/v1/presets", "/api/v1/sensors/999999", "/nowhere"):
        client.get(path)
    deadline_s = time.monotonic() + 5
    while gate_of(house.app).known.taken and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert gate_of(house.app).known.taken == 0
