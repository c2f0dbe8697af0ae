"""The feed over a real connection: typed events with ids, replay after a break, a listener that is too slow."""

import asyncio
import itertools
import json
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from boresight.console.jobs.broadcast import QUEUE_LENGTH, Broadcast, EventBatch, EventCursor, events_after
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_engine, open_reading, open_writing
from tests.served import House, add_people, serving, settings_in
from tests.stores import open_migrated, url_in

Told = dict[str, Any]


@contextmanager
def following(client: httpx.Client, last_event_id: str | None = None, **params: Any) -> Iterator[Iterator[Told]]:
    headers = {"Last-Event-ID": last_event_id} if last_event_id else {}
    with client.stream("GET", "/api/v1/events", params=params, headers=headers, timeout=10) as answer:
        assert answer.status_code == 200, answer.read()
        assert answer.headers["content-type"].startswith("text/event-stream")
        yield _events(answer.iter_lines())


def _events(lines: Iterator[str]) -> Iterator[Told]:
    told: Told = {}
    for line in lines:
        name, _, value = line.partition(": ")
        if line:
            told[name or "comment"] = json.loads(value) if name == "data" else value
        elif told:
            yield told
            told = {}


def _until(events: Iterator[Told], **wanted: Any) -> Told:
    return next(told for told in events if wanted.items() <= (told.get("data") or {}).items())


def test_a_stream_begins_with_its_place_and_how_soon_to_come_back(house: House) -> None:
    with following(house.person("victor")) as events:
        greeting = next(events)
    assert re.fullmatch(r"\d+\.\d+\.\d+", greeting["id"])
    assert greeting["retry"] == "2000"


def test_a_launch_is_told_as_a_run_event_and_an_audit_event(house: House) -> None:
    with following(house.person("victor")) as events:
        next(events)
        run = house.launched()
        queued = _until(events, run_id=run["id"])
        launched = _until(events, object=f"runs/{run['id']}")
    assert (queued["event"], queued["data"]["state"]) == ("run", "QUEUED")
    assert (launched["event"], launched["data"]["action"]) == ("audit", "launched")
    assert "before" not in launched["data"]


def test_what_another_process_writes_is_told_too(house: House) -> None:
    engine = open_engine(house.app.state.settings.database_url)
    with following(house.person("victor")) as events:
        next(events)
        with open_writing(engine) as session:
            audit.append(session, SYSTEM, "compared", "fleet/1")
        assert _until(events, object="fleet/1")["data"]["actor"] == "Boresight"
    engine.dispose()


def test_who_comes_back_with_the_last_id_is_told_all_that_was_missed_in_order(house: House) -> None:
    with following(house.person("victor")) as events:
        place = next(events)["id"]
    runs = [house.launched()["id"] for _ in range(3)]
    house.end(runs[0], "FAILED")
    with following(house.person("victor"), place) as events:
        states = []
        while len(states) < 4:
            told = next(events)
            if told.get("event") == "run":
                states.append((told["data"]["run_id"], told["data"]["state"]))
    assert states == [*((run, "QUEUED") for run in runs), (runs[0], "FAILED")]


def test_nothing_is_told_twice_after_a_break(house: House) -> None:
    with following(house.person("victor")) as events:
        next(events)
        run = house.launched()
        last = _until(events, object=f"runs/{run['id']}")["id"]
    other = house.launched()
    with following(house.person("victor"), last) as events:
        heard = []
        while not any(told.get("data", {}).get("object") == f"runs/{other['id']}" for told in heard):
            heard.append(next(events))
    assert not any((told.get("data") or {}).get("run_id") == run["id"] for told in heard)


def test_ids_only_grow(house: House) -> None:
    with following(house.person("victor"), "0.0") as events:
        next(events)
        house.app.state.broadcast.hear({"kind": "progress", "run_id": -1, "fraction": 0.1})
        places = [tuple(map(int, next(events)["id"].split("."))) for _ in range(20)]
    assert all(a <= b and a != b for (a, b) in itertools.pairwise(places))
    assert all(x <= y for a, b in itertools.pairwise(places) for x, y in zip(a, b, strict=True))


def test_an_id_that_is_none_begins_now(house: House) -> None:
    with following(house.person("victor"), "nonsense") as events:
        begun = next(events)["id"]
    assert EventCursor.parse(begun).record > 0


def _until_told(house: House) -> None:
    broadcast = house.app.state.broadcast
    with open_reading(house.app.state.engine) as session:
        stored = EventCursor.now(session, broadcast.progress)
    until_s = time.monotonic() + 10
    while not broadcast.place.covers(stored):
        assert time.monotonic() < until_s, (broadcast.place, stored)
        time.sleep(0.01)


def test_a_filter_leaves_only_what_concerns_the_run(house: House) -> None:
    watched = house.launched()
    _until_told(house)
    with following(house.person("victor"), run=watched["id"]) as events:
        next(events)
        house.launched()
        house.app.state.broadcast.hear({"kind": "progress", "run_id": -1, "fraction": 0.1})
        house.app.state.broadcast.hear({"kind": "progress", "run_id": watched["id"], "fraction": 0.5, "message": "x"})
        house.end(watched["id"])
        first, second = next(events), next(events)
    assert (first["event"], first["data"]) == ("progress", {"run_id": watched["id"], "fraction": 0.5, "message": "x"})
    assert (second["event"], second["data"]["state"]) == ("run", "SUCCEEDED")


def test_a_key_may_listen_and_nobody_unknown(house: House) -> None:
    with following(house.key("ada")) as events:
        assert next(events)["comment"] == "connected"
    assert house.anybody().get("/api/v1/events").status_code == 401


def test_silence_is_filled_with_comments(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("boresight.console.jobs.routes.PING_S", 0.2)
    with following(house.person("victor"), run=10**9) as events:
        next(events)
        assert "ping" in next(events)["comment"]


def test_a_log_in_that_was_ended_stops_hearing(house: House) -> None:
    client = house.log_in("olga")
    with following(client) as events:
        next(events)
        user_id = client.get("/api/v1/sessions/current").json()["user_id"]
        assert client.post(f"/api/v1/users/{user_id}:end-sessions").status_code == 204
        house.clients.pop("olga", None)
        assert [event["event"] for event in events if event["event"] != "audit"] == ["logged-out"]


def test_stopping_the_server_ends_the_streams_at_once(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    add_people(settings)
    heard: list[Told] = []
    with serving(settings) as (address, app):
        client = House(address, app, b"", {}).log_in("victor")
        begun = threading.Event()

        def listen() -> None:
            with following(client) as events:
                for told in events:
                    heard.append(told)
                    begun.set()

        listener = threading.Thread(target=listen)
        listener.start()
        assert begun.wait(10)
        stopping_s = time.monotonic()
    listener.join(10)
    assert time.monotonic() - stopping_s < 8
    assert heard[-1]["event"] == "closing"
    client.close()


def test_a_listener_that_is_too_slow_is_told_so_and_let_go(tmp_path: Path) -> None:
    engine = open_migrated(url_in(tmp_path))
    broadcast = Broadcast(engine)

    async def fall_behind() -> list[EventBatch | None]:
        with broadcast.listening(SYSTEM) as listener:
            for k in range(QUEUE_LENGTH + 50):
                broadcast.hear({"kind": "progress", "run_id": k})
                if k % 100 == 0:
                    await asyncio.sleep(0.001)
            await asyncio.sleep(0.05)
            assert listener.dropped
            return list(await listener.next(0.05))

    *heard, end = asyncio.run(fall_behind())
    told = [one.event.data["run_id"] for telling in heard for one in telling.told]
    assert told == list(range(len(told)))
    assert 0 < len(told) <= QUEUE_LENGTH
    assert end is None
    assert broadcast.listeners == 0
    engine.dispose()


def test_pages_of_missed_records_follow_one_another_without_a_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("boresight.console.jobs.broadcast.PAGE", 7)
    engine = open_migrated(url_in(tmp_path))
    with open_writing(engine) as session:
        records = [audit.append(session, SYSTEM, "did", f"thing/{k}") for k in range(20)]
    made = [record.id for record in records]
    place, heard = EventCursor(0, made[0] - 1), []
    with open_reading(engine) as session:
        while events := events_after(session, place):
            heard += [event.number for event in events]
            place = events[-1].move(place)
    assert heard == made
    engine.dispose()
