"""The feed over a real connection: typed events with ids, replay after a break, a listener that is too slow."""

import asyncio
import itertools
import json
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.console.jobs.broadcast import (
    QUEUE_LENGTH,
    Broadcast,
    EventBatch,
    EventCursor,
    RecentProgress,
    list_events_after,
)
from boresight.console.runs.queries import Line, write_event
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.audit import queries as audit_rows
from boresight.platform.db.sessions import open_engine, open_reading, open_writing
from boresight.platform.jobs.worker_news import RunProgress
from tests.served import House, add_people, serving, settings_in
from tests.stores import open_migrated, url_in

Message = dict[str, Any]


@contextmanager
def following(client: httpx.Client, last_event_id: str | None = None, **params: Any) -> Iterator[Iterator[Message]]:
    headers = {"Last-Event-ID": last_event_id} if last_event_id else {}
    with client.stream("GET", "/api/v1/events", params=params, headers=headers, timeout=10) as answer:
        assert answer.status_code == 200, answer.read()
        assert answer.headers["content-type"].startswith("text/event-stream")
        yield _events(answer.iter_lines())


def _events(lines: Iterator[str]) -> Iterator[Message]:
    told: Message = {}
    for line in lines:
        name, _, value = line.partition(": ")
        if line:
            told[name or "comment"] = json.loads(value) if name == "data" else value
        elif told:
            yield told
            told = {}


def _until(events: Iterator[Message], **wanted: Any) -> Message:
    return next(told for told in events if wanted.items() <= (told.get("data") or {}).items())


def test_a_stream_begins_with_its_place_and_how_soon_to_come_back_and_silence_is_filled(house, monkeypatch):
    monkeypatch.setattr("boresight.console.jobs.routes.PING_S", 0.2)
    for place in (None, "nonsense"):
        with following(house.person("victor"), place, run=10**9) as events:
            greeting = next(events)
            assert "ping" in next(events)["comment"]
        assert re.fullmatch(r"\d+\.\d+\.\d+", greeting["id"])
        assert EventCursor.parse(greeting["id"]).record > 0
        assert greeting["retry"] == "2000"


def test_a_launch_is_told_as_a_run_event_and_an_audit_event_and_another_process_is_heard_too(house):
    engine = open_engine(house.app.state.settings.database_url)
    with following(house.person("victor")) as events:
        next(events)
        run = house.launched()
        queued = _until(events, run_id=run["id"])
        launched = _until(events, object=f"runs/{run['id']}")
        with open_writing(engine) as session:
            audit.append(session, SYSTEM, "compared", "fleet/1")
            write_event(session, run["id"], 1, Line.log("Given up on frame 3."))
        told = list(itertools.islice(events, 2))
    engine.dispose()
    kinds = {event["event"]: event["data"] for event in told}
    assert kinds["audit"]["actor"] == "Boresight"
    assert kinds["log"]["message"] == "Given up on frame 3."
    assert (queued["event"], queued["data"]["state"]) == ("run", "QUEUED")
    assert (launched["event"], launched["data"]["action"]) == ("audit", "launched")
    assert "before" not in launched["data"]


def test_who_comes_back_with_the_last_id_is_told_all_that_was_missed_in_order_under_growing_ids(house):
    with following(house.person("victor")) as events:
        place = next(events)["id"]
    runs = [house.launched()["id"] for _ in range(3)]
    house.end(runs[0], "FAILED")
    with following(house.person("victor"), place) as events:
        next(events)
        states, places = [], []
        while len(states) < 4:
            told = next(events)
            places.append(tuple(map(int, told["id"].split("."))))
            if told.get("event") == "run":
                states.append((told["data"]["run_id"], told["data"]["state"]))
    for a, b in itertools.pairwise(places):
        assert a < b
        assert all(x <= y for x, y in zip(a, b, strict=True))
    assert states == [*((run, "QUEUED") for run in runs), (runs[0], "FAILED")]


def test_nothing_is_told_twice_after_a_break(house):
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


def _until_told(house: House) -> None:
    broadcast = house.app.state.broadcast
    with open_reading(house.app.state.engine) as session:
        stored = EventCursor.now(session, broadcast.progress)
    until_s = time.monotonic() + 10
    while not broadcast.cursor.covers(stored):
        assert time.monotonic() < until_s, (broadcast.cursor, stored)
        time.sleep(0.01)


def test_a_filter_leaves_only_what_concerns_the_run(house):
    watched = house.launched()
    _until_told(house)
    with following(house.person("victor"), run=watched["id"]) as events:
        next(events)
        house.launched()
        house.app.state.broadcast.hear(step(-1, 0.1))
        house.app.state.broadcast.hear(step(watched["id"], 0.5))
        house.end(watched["id"])
        first, second = next(events), next(events)
    assert (first["event"], first["data"]) == ("progress", step(watched["id"], 0.5).to_dict())
    assert (second["event"], second["data"]["state"]) == ("run", "SUCCEEDED")


def test_a_key_may_listen_and_nobody_unknown(house):
    with following(house.key("ada")) as events:
        assert next(events)["comment"] == "connected"
    assert house.anybody().get("/api/v1/events").status_code == 401


def test_a_log_in_that_was_ended_stops_hearing(house):
    client = house.log_in("olga")
    with following(client) as events:
        next(events)
        user_id = client.get("/api/v1/sessions/current").json()["user_id"]
        assert client.post(f"/api/v1/users/{user_id}:end-sessions").status_code == 204
        house.clients.pop("olga", None)
        assert [event["event"] for event in events if event["event"] != "audit"] == ["logged-out"]


def test_stopping_the_server_ends_the_streams_at_once(tmp_path):
    settings = settings_in(tmp_path)
    add_people(settings)
    heard: list[Message] = []
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


def test_a_listener_that_is_too_slow_is_told_so_and_let_go(tmp_path):
    engine = open_migrated(url_in(tmp_path))
    broadcast = Broadcast(engine)

    async def fall_behind() -> list[EventBatch | None]:
        with broadcast.open_listener(SYSTEM) as listener:
            for k in range(QUEUE_LENGTH + 50):
                broadcast.hear(step(k, 0.5))
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


def test_pages_of_missed_records_follow_one_another_without_a_gap(tmp_path, monkeypatch):
    monkeypatch.setattr("boresight.console.jobs.broadcast.PAGE", 7)
    engine = open_migrated(url_in(tmp_path))
    with open_writing(engine) as session:
        records = [audit.append(session, SYSTEM, "did", f"thing/{k}") for k in range(20)]
    made = [record.id for record in records]
    place, heard = EventCursor(0, made[0] - 1), []
    with open_reading(engine) as session:
        while events := list_events_after(session, place):
            heard += [event.number for event in events]
            place = events[-1].move(place)
    assert heard == made
    engine.dispose()


def test_one_new_record_is_told_without_reading_those_before_it(tmp_path, monkeypatch):
    engine = open_migrated(url_in(tmp_path))
    with open_writing(engine) as session:
        records = [audit.append(session, SYSTEM, "did", f"thing/{k}") for k in range(30)]
    *_, told, new = (record.id for record in records)
    read: list[int] = []
    rows_after = audit_rows.list_heads_after

    def noted(*given: Any) -> Any:
        page = rows_after(*given)
        read.append(len(page))
        return page

    monkeypatch.setattr(audit_rows, "list_heads_after", noted)
    with open_reading(engine) as session:
        events = list_events_after(session, EventCursor(0, told))
    assert [event.number for event in events] == [new]
    assert read == [1]
    engine.dispose()


STREAMS = 500
KEPT = 16


def _of_runs(events):
    return (told for told in events if told["event"] != "audit")  # a log-in may be told late


def step(run_id: int, fraction: float) -> RunProgress:
    points = {"after": None, "frame": [int(100 * fraction)], "parameters": [[1.0, None]]}
    return RunProgress(run_id, 1, fraction, "x", 1.0, points)


def test_who_comes_back_is_told_the_progress_that_was_missed_and_nothing_twice(house):
    feed = house.app.state.broadcast
    with following(house.person("victor"), history=7) as events:
        next(events)
        feed.hear(step(7, 0.1))
        last = next(events)["id"]
    for fraction in (0.2, 0.3):
        feed.hear(step(7, fraction))
    with following(house.person("victor"), last, history=7) as events:
        next(events)
        feed.hear(step(7, 0.4))
        heard = [next(_of_runs(events)) for _ in range(3)]
    assert [told["event"] for told in heard] == ["progress"] * 3
    assert [told["data"]["fraction"] for told in heard] == [0.2, 0.3, 0.4]


def test_a_history_is_told_only_to_who_follows_the_run(house):
    feed = house.app.state.broadcast
    for wish, follows in (({}, False), ({"history": 8}, False), ({"history": 7}, True)):
        with following(house.person("victor"), **wish) as events:
            next(events)
            feed.hear(step(7, 0.5))
            assert ("history" in next(events)["data"]) is follows


@pytest.mark.parametrize("progress", [0, 10**15])
def test_who_comes_back_with_a_place_of_another_server_is_told_that_progress_was_missed(house, progress):
    with following(house.person("victor")) as events:
        rows = next(events)["id"].rpartition(".")[0]
    with following(house.person("victor"), f"{rows}.{progress}") as events:
        next(events)
        missed = next(_of_runs(events))
        house.app.state.broadcast.hear(step(7, 0.5))
        after = next(_of_runs(events))
    assert missed["event"] == "missed"
    assert EventCursor.parse(missed["id"]).progress == house.app.state.broadcast.progress - 1
    assert after["data"]["fraction"] == 0.5


@given(st.integers(0, 40), st.integers(-3, 45))
def test_a_bounded_ring_tells_all_after_a_number_or_that_it_cannot(count, after):
    ring = RecentProgress(KEPT)
    begun = ring.newest
    for k in range(count):
        ring.add({"step": k}, None)
    told = ring.after(begun + after)
    if max(0, count - KEPT) <= after <= count:
        assert told is not None
        assert [event.data["step"] for event in told] == list(range(after, count))
    else:
        assert told is None


def test_an_event_is_written_once_for_all_listeners():
    event = RecentProgress(KEPT).add({"run_id": 7}, {"frame": [0]})
    assert event.text is event.text
    assert json.loads(event.text_with_history) == {"run_id": 7, "history": {"frame": [0]}}
    assert json.loads(event.text) == {"run_id": 7}


def test_five_hundred_streams_take_no_thread_of_their_own(house):
    cookie = "; ".join(f"{name}={value}" for name, value in house.person("victor").cookies.items())
    url = httpx.URL(house.address)
    ask = f"GET /api/v1/events?history=7 HTTP/1.1\r\nHost: {url.netloc.decode()}\r\nCookie: {cookie}\r\n\r\n"

    async def listen() -> tuple[int, list[bytes]]:
        links = [await asyncio.open_connection(url.host, url.port) for _ in range(STREAMS)]
        for _, writer in links:
            writer.write(ask.encode())
        await asyncio.gather(*(reader.readuntil(b"retry: 2000\n\n") for reader, _ in links))
        threads = threading.active_count()
        house.app.state.broadcast.hear(step(7, 0.5))
        heard = await asyncio.gather(*(reader.readuntil(b"0.5") for reader, _ in links))
        for _, writer in links:
            writer.close()
        return threads, heard

    threads, heard = asyncio.run(listen())
    assert len(heard) == STREAMS
    assert threads < 100  # the framework keeps 40 for short reads, whoever asks
