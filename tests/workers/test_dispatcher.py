"""Runs come to one good end, whatever dies on the way: one dispatcher, real processes, a real database, real kills."""

import json
import os
import signal
import time
from datetime import datetime
from types import SimpleNamespace

import dask
import pytest
from dask.utils import parse_timedelta

from boresight.platform.jobs.worker_news import RunMoved, RunProgress
from boresight.workers.cluster import DIED
from boresight.workers.dispatcher import TURN_S, RunDispatcher
from tests.effort import effort

EVENTS = []


@pytest.fixture(scope="module")
def store(make_store, start_dispatcher):
    made = make_store()
    start_dispatcher(made, EVENTS.append, cancel_grace_s=4.0)
    return made


def told(run_id):
    return [event.fraction for event in EVENTS if isinstance(event, RunProgress) and event.run_id == run_id]


@pytest.mark.full
def test_two_hundred_runs_at_once_all_succeed(store):
    run_ids = store.launch("quick", 200)
    assert store.wait_until_ended(run_ids) == ["SUCCEEDED"] * 200
    assert all(store.ends(run_id) == ["SUCCEEDED"] for run_id in run_ids)
    assert all(len(store.begun(run_id)) == 1 for run_id in run_ids)


def test_a_result_is_stored_under_its_address_with_its_summary(store):
    (run_id,) = store.launch("quick")
    store.wait_until_ended([run_id])
    run = store.run(run_id)
    result = json.loads(store.blobs.read(run.result_sha256))
    assert result["sensor"] == f"quick-{run_id}"
    assert result["rms_arc_rad"] == {"initial": 2e-4, "final": None}  # NaN is no JSON
    assert run.summary["status"] == "converged"
    assert run.summary["rms_initial_arc_rad"] == 2e-4
    assert run.summary["stars"] == 4
    assert run.summary["seconds"] > 0


def test_progress_reaches_the_row_and_the_listeners_with_a_thinned_history(store):
    (run_id,) = store.launch("endless")
    store.wait_for(lambda: len(told(run_id)) > 1)
    progress = store.run(run_id).progress
    assert 0 <= progress["fraction"] < 1
    assert progress["message"].startswith("step")
    frames = progress["partial"]["history"]["frame"]
    assert len(frames) == len(progress["partial"]["history"]["tail_rms_rad"]) == 300
    assert frames[0] == 0
    assert frames[-1] == 999
    store.cancel(run_id)
    store.wait_until_ended([run_id])
    store.wait_for(lambda: EVENTS[-1] == RunMoved(run_id, 1))
    assert next(event for event in EVENTS if event.run_id == run_id) == RunMoved(run_id, 1)
    assert told(run_id) == sorted(told(run_id))
    run = store.run(run_id)
    took = datetime.fromisoformat(run.ended_utc) - datetime.fromisoformat(run.started_utc)
    assert len(told(run_id)) <= 4 * took.total_seconds() + 1  # at most four a second


def test_a_run_whose_worker_is_killed_is_computed_again_and_ends_once(store):
    run_ids = store.launch("stuck") + store.launch("brief", 2)
    store.wait_for(lambda: store.begun(run_ids[0]))
    os.kill(store.begun(run_ids[0])[0], signal.SIGKILL)
    assert store.wait_until_ended(run_ids) == ["SUCCEEDED"] * 3
    assert all(store.ends(run_id) == ["SUCCEEDED"] for run_id in run_ids)
    assert len(store.begun(run_ids[0])) == 2


def test_a_running_run_that_is_cancelled_ends_within_two_seconds(store):
    took_s = []
    for _ in range(3):  # a busy machine may be late for one, not for all
        (run_id,) = store.launch("endless")
        store.wait_for(lambda run_id=run_id: store.begun(run_id))
        assert store.cancel(run_id) == "CANCELLING"
        asked_s = time.monotonic()
        assert store.wait_until_ended([run_id]) == ["CANCELLED"]
        took_s.append(time.monotonic() - asked_s)
        os.kill(store.begun(run_id)[0], 0)  # it stopped by itself: its process is still there
        assert store.ends(run_id) == ["CANCELLED"]
        assert store.run(run_id).reason == "Cancelled in a test."
    assert min(took_s) < 2


def test_a_run_that_does_not_answer_is_ended_by_force_and_its_worker_replaced(store):
    run_ids = []
    for _ in range(effort(1, 2)):  # one after the other, so that they share no task
        (run_id,) = store.launch("deaf")
        store.wait_for(lambda run_id=run_id: store.begun(run_id))
        run_ids.append(run_id)
    for run_id in run_ids:
        store.cancel(run_id)
    assert store.wait_until_ended(run_ids) == ["CANCELLED"] * len(run_ids)
    after = store.launch("quick", 4)
    assert store.wait_until_ended(after) == ["SUCCEEDED"] * 4
    assert all(len(store.begun(run_id)) == 1 for run_id in run_ids)


def test_a_run_that_kills_its_worker_every_time_fails_with_its_cause_and_harms_no_other(store):
    (poison, *others) = store.launch("poison") + store.launch("quick", 10)
    assert store.wait_until_ended([poison, *others]) == ["FAILED"] + ["SUCCEEDED"] * 10
    assert store.ends(poison) == ["FAILED"]
    assert DIED in store.run(poison).reason
    assert "3 lost attempts" in store.run(poison).reason
    assert len(store.log(poison, "lost")) == 3
    assert [store.log(run_id, "lost") for run_id in others] == [[]] * 10


@pytest.mark.parametrize(
    ("behaviour", "reason"),
    [
        ("refuse", "Frame 3 has too few stars; use a longer set."),
        ("crash", "The computation failed, ZeroDivisionError: a defect"),
    ],
)
def test_a_run_that_cannot_be_computed_fails_once_with_its_sentence(store, behaviour, reason):
    (run_id,) = store.launch(behaviour)
    assert store.wait_until_ended([run_id]) == ["FAILED"]
    assert store.run(run_id).reason == reason
    assert store.run(run_id).attempt == 1
    assert any("Traceback" in line for line in store.log(run_id, "log")) == (behaviour == "crash")


def test_a_worker_that_restarts_is_not_ended_because_one_of_its_name_was_lost_before(store):  # noqa: ARG001 - its dispatcher has set the cluster up
    assert parse_timedelta(dask.config.get("distributed.deploy.lost-worker-timeout")) > 365 * 86_400


def test_while_a_run_computes_and_nothing_is_told_the_engine_turns_four_times_a_second_at_most(store, monkeypatch):
    dispatcher = RunDispatcher(store.database, store.settings)
    dispatcher._tasks.add(SimpleNamespace(members=set()))
    turns = []
    monkeypatch.setattr(dispatcher, "_turn", lambda: turns.append(time.monotonic()))
    dispatcher.start()
    time.sleep(1.1)
    dispatcher.stop()
    assert TURN_S >= 0.25
    assert 1 <= len(turns) <= 1.1 / TURN_S + 2
