"""What a run's page says of its state: what it waits for, who stopped it and when, what ended it, what to do next."""

import re
from dataclasses import asdict, replace

import pytest

from boresight.console.runs.queries import Line
from boresight.console.runs.tables import RunEvent
from boresight.platform.db.sessions import open_writing, utc_after, utc_now

FREE = {"turns": True, "connected": True, "threads": 2, "tasks": 1}
HALF = {"fraction": 0.43, "message": "frame 17: 17 of 40 frames", "elapsed_s": 8.6}


@pytest.fixture
def tell(site):
    def write(run_id, line, *, at_utc=None):
        with open_writing(site.engine) as session:
            session.add(RunEvent(run_id=run_id, attempt=1, at_utc=at_utc or utc_now(), **asdict(line)))

    return write


@pytest.mark.parametrize(
    ("workers", "said"),
    [
        ({}, "This server computes nothing itself"),
        (FREE | {"turns": False}, "This server computes nothing itself"),
        (FREE | {"connected": False}, "No worker is there yet"),
        (FREE | {"threads": 0}, "No worker is there yet"),
        (FREE, "A worker is free: it starts at once."),
        (FREE | {"tasks": 2}, "All 2 workers are busy with run #{busy}; it starts when one is free."),
        (FREE | {"tasks": 1, "threads": 1}, "The only worker is busy with run #{busy}"),
    ],
)
def test_a_queued_run_says_what_it_waits_for(site, read, workers, said):
    busy = site.add_run(state="RUNNING", started_utc=utc_now())
    run_id = site.add_run()
    site.app.state.workers.state = lambda: workers
    text = read(site.visitor("victor").get(f"/runs/{run_id}"))
    assert "Next in the queue." in text
    assert said.format(busy=busy) in text


def test_a_run_that_is_computed_again_says_why(site, read, tell):
    run_id = site.add_run(state="RUNNING", attempt=2, started_utc=utc_now())
    tell(run_id, replace(Line.queued_again("its server host/1 was not heard of any more"), message="in other words"))
    text = read(site.visitor("victor").get(f"/runs/{run_id}"))
    assert "Attempt 1 ended without a result: its server host/1 was not heard of any more." in text
    assert "attempt 2" in text


def test_a_filter_says_its_pace_and_what_is_left_and_a_batch_only_its_time(site, read):
    columns = {"state": "RUNNING", "progress": HALF | {"at_utc": utc_now()}, "attempt": 1, "started_utc": utc_now()}
    filtered, batch = (site.add_run(method, **columns) for method in ("sqrf", "batch"))
    victor = site.visitor("victor")
    assert "2.0 frames/s, about 11 s left" in read(victor.get(f"/runs/{filtered}"))
    text = read(victor.get(f"/runs/{batch}"))
    assert "for 8.6 s" in text
    assert "frames/s" not in text


def test_a_silent_worker_is_said_to_be_silent(site, read):
    progress = HALF | {"at_utc": utc_after(-45.0)}
    run_id = site.add_run("sqrf", state="RUNNING", progress=progress, started_utc=utc_after(-90.0), attempt=1)
    text = read(site.visitor("victor").get(f"/runs/{run_id}"))
    assert re.search(r"The worker has not reported for (4[5-9]|5\d) s\.", text)


def test_a_run_that_is_being_stopped_says_since_when(site, read, tell):
    run_id = site.add_run(state="CANCELLING", reason="Cancelled by Ada Analyst: wrong set.", started_utc=utc_now())
    tell(run_id, Line.moved("CANCELLING", "Cancelled by Ada Analyst: wrong set."), at_utc=utc_after(-12.0))
    text = read(site.visitor("victor").get(f"/runs/{run_id}"))
    assert "Stopping: Cancelled by Ada Analyst: wrong set. Asked at" in text
    assert re.search(r"\b1[2-9] s ago", text)


def test_a_lost_run_says_when_it_was_last_heard_of_and_offers_to_run_it_again(site, read):
    progress = HALF | {"at_utc": "2026-11-21T03:04:05.000000Z"}
    run_id = site.add_run("sqrf", state="LOST", progress=progress, reason="Given up after 3 lost attempts.")
    page = site.visitor("ada").get(f"/runs/{run_id}")
    text = read(page)
    assert "The worker stopped reporting at 2026-11-21 03:04:05Z; no result is trusted. Given up after" in text
    assert "PARTIAL: It had come to 43 % (frame 17: 17 of 40 frames)." in text
    assert f'href="/runs/new?clone={run_id}">Run it again</a>' in page


def test_a_failed_run_shows_its_cause_the_end_of_its_log_and_the_next_step(site, read, tell):
    run_id = site.add_run(state="FAILED", reason="Its telemetry is gone.")
    for k in range(9):
        tell(run_id, Line.log(f"step {k}"))
    tell(run_id, Line.moved("FAILED", "Its telemetry is gone."))
    page = site.visitor("ada").get(f"/runs/{run_id}")
    text = read(page)
    assert '<p role="alert">Its telemetry is gone.</p>' in page
    assert [f"step {k}" in text for k in range(9)] == [False] * 4 + [True] * 5
    assert f'href="/runs/{run_id}?part=log"' in page
    assert 'href="/telemetry/1">Quality report' in page


def test_who_stops_a_run_may_say_why_and_it_is_kept(site, read):
    run_id, ada = site.add_run(), site.visitor("ada")
    assert 'name="reason" form="cancel-run"' in ada.get(f"/runs/{run_id}")
    ada.post(f"/runs/{run_id}/cancel", reason="Wrong set.")
    assert "Cancelled by Ada Analyst: Wrong set." in read(ada.get(f"/runs/{run_id}"))


def test_the_page_carries_how_long_ago_the_run_was_heard_of(site):
    run_id = site.add_run(state="RUNNING", progress=HALF | {"at_utc": utc_after(-7.0)}, started_utc=utc_after(-9.0))
    page = site.visitor("victor").get(f"/runs/{run_id}")
    heard_s = float(page.partition('data-heard="')[2].partition('"')[0])
    assert 7.0 <= heard_s < 17.0
