"""Overload is said at once, who watches is answered all the same, and turns come in the order of asking."""

import asyncio
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest

from benchmarks.servers import wait_until
from boresight.platform.web.concurrency_limit import COME_BACK_S, ConcurrencyLimit, RequestQueue
from tests.served import House


def get_limit(app: Any) -> ConcurrencyLimit:
    layer = app.middleware_stack
    while not isinstance(layer, ConcurrencyLimit):
        layer = layer.app
    return layer


def test_who_comes_when_too_many_are_under_way_is_told_when_to_come_back(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = house.person("ada")
    monkeypatch.setattr(get_limit(house.app).known, "most", 0)
    answer = client.get("/api/v1/presets")
    assert (answer.status_code, answer.headers["retry-after"]) == (503, str(COME_BACK_S))
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["type"] == "urn:boresight:problem:overloaded"
    page = client.get("/sensors", headers={"Accept": "text/html"})
    assert (page.status_code, page.headers["retry-after"]) == (503, str(COME_BACK_S))
    assert "try again" in page.text


def test_those_who_watch_and_the_files_of_pages_are_always_let_in(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(get_limit(house.app).known, "most", 0)
    for path in ("/healthz", "/readyz", "/metrics", "/static/shared/style.css"):
        assert house.anybody().get(path).status_code == 200, path


def test_what_is_cached_is_given_though_too_many_are_under_way(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    client = house.person("ada")
    assert client.get("/api/v1/runs").status_code == 200
    monkeypatch.setattr(get_limit(house.app).known, "most", 0)
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
    wait_until(lambda: get_limit(house.app).known.taken == 0, 5)


def test_no_more_have_a_turn_at_once_than_there_are_and_they_come_in_order() -> None:
    async def run() -> tuple[int, list[int]]:
        turns, at_once, most, order = RequestQueue(3, 60.0), 0, 0, list[int]()

        async def work(number: int) -> None:
            nonlocal at_once, most
            async with turns.turn():
                at_once += 1
                most = max(most, at_once)
                order.append(number)
                await asyncio.sleep(0.001)
                at_once -= 1

        await asyncio.gather(*(work(number) for number in range(50)))
        return most, order

    most, order = asyncio.run(run())
    assert most == 3
    assert order == list(range(50))


def test_who_takes_long_makes_room_once_and_gives_no_turn_back_twice() -> None:
    async def run() -> list[str]:
        turns, seen = RequestQueue(1, 0.02), list[str]()

        async def long() -> None:
            async with turns.turn():
                await asyncio.sleep(0.2)
                seen.append("long")

        async def short(number: int) -> None:
            async with turns.turn():
                seen.append(f"short {number}")

        await asyncio.gather(long(), short(1), short(2))
        assert turns._free == 1
        return seen

    assert asyncio.run(run()) == ["short 1", "short 2", "long"]


def test_who_leaves_while_waiting_or_fails_takes_no_turn_along() -> None:
    async def run() -> int:
        turns = RequestQueue(1, 60.0)

        async def work(*, fails: bool = False) -> None:
            async with turns.turn():
                await asyncio.sleep(0.01)
                if fails:
                    raise ValueError

        first = asyncio.create_task(work(fails=True))
        leaving = [asyncio.create_task(work()) for _ in range(5)]
        last = asyncio.create_task(work())
        await asyncio.sleep(0)
        for task in leaving:
            task.cancel()
        await asyncio.gather(first, *leaving, last, return_exceptions=True)
        return turns._free

    assert asyncio.run(run()) == 1


def test_the_next_turn_goes_to_what_was_waited_for_longest_by_all_who_wait() -> None:
    async def run() -> list[str]:
        turns, order = RequestQueue(1, 60.0), list[str]()

        async def work(name: str, waited_s: float | None = None) -> None:
            async with turns.turn(None if waited_s is None else lambda _: waited_s):
                order.append(name)
                await asyncio.sleep(0.01)

        await asyncio.gather(work("at once"), work("alone"), work("for two", 2.0), work("for many", 20.0))
        return order

    assert asyncio.run(run()) == ["at once", "for many", "for two", "alone"]
