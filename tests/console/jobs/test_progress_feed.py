"""Progress over the wire: told once to everybody, again after a break, with its course to who follows the run."""

import asyncio
import json
import threading
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.console.jobs.broadcast import EventCursor, RecentProgress
from boresight.console.runs.queries import Line, write_event
from boresight.platform.db.sessions import open_writing
from tests.console.jobs.test_events import following
from tests.served import House

STREAMS = 500
KEPT = 16


def step(run_id: int, fraction: float) -> dict[str, Any]:
    points = {"after": None, "frame": [int(100 * fraction)], "parameters": [[1.0, None]]}
    return {"kind": "progress", "run_id": run_id, "attempt": 1, "fraction": fraction, "history": points}


def test_who_comes_back_is_told_the_progress_that_was_missed_and_nothing_twice(house: House) -> None:
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
        heard = [next(events) for _ in range(3)]
    assert [told["event"] for told in heard] == ["progress"] * 3
    assert [told["data"]["fraction"] for told in heard] == [0.2, 0.3, 0.4]


def test_a_course_is_told_only_to_who_follows_the_run(house: House) -> None:
    feed = house.app.state.broadcast
    for wish, follows in (({}, False), ({"history": 8}, False), ({"history": 7}, True)):
        with following(house.person("victor"), **wish) as events:
            next(events)
            feed.hear(step(7, 0.5))
            assert ("history" in next(events)["data"]) is follows


@pytest.mark.parametrize("progress", [0, 10**15])
def test_who_comes_back_with_a_place_of_another_server_is_told_that_progress_was_missed(
    house: House, progress: int
) -> None:
    with following(house.person("victor")) as events:
        rows = next(events)["id"].rpartition(".")[0]
    with following(house.person("victor"), f"{rows}.{progress}") as events:
        next(events)
        missed = next(events)
        house.app.state.broadcast.hear(step(7, 0.5))
        after = next(events)
    assert missed["event"] == "missed"
    assert EventCursor.parse(missed["id"]).progress == house.app.state.broadcast.progress - 1
    assert after["data"]["fraction"] == 0.5


def test_a_line_of_a_run_s_log_is_told_as_such(house: House) -> None:
    run = house.launched()
    with following(house.person("victor")) as events:
        next(events)
        with open_writing(house.app.state.engine) as session:
            write_event(session, run["id"], 1, Line.log("Given up on frame 3."))
        told = next(event for event in events if event["event"] == "log")
    assert (told["event"], told["data"]["message"]) == ("log", "Given up on frame 3.")


@given(st.integers(0, 40), st.integers(-3, 45))
def test_a_bounded_ring_tells_all_after_a_number_or_that_it_cannot(count: int, after: int) -> None:
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


def test_an_event_is_written_once_for_all_listeners() -> None:
    event = RecentProgress(KEPT).add({"run_id": 7}, {"frame": [0]})
    assert event.text is event.text
    assert json.loads(event.text_with_history) == {"run_id": 7, "history": {"frame": [0]}}
    assert json.loads(event.text) == {"run_id": 7}


def test_five_hundred_streams_take_no_thread_of_their_own(house: House) -> None:
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
