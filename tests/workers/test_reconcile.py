"""The rows stay true under leases, attempts and fences, and what finished runs found is looked at beside the queue."""

import re
from dataclasses import replace
from itertools import count

import pytest

from boresight.console.runs import queries as runs
from boresight.console.runs.queries import Line, RunEnd
from boresight.platform.db.sessions import open_writing
from boresight.workers import dispatcher
from boresight.workers.dispatcher import RUNS, AlarmCheck, Reconciler
from boresight.workers.link import Report

NUMBERS = count()


@pytest.fixture(scope="module")
def store(make_store):
    return make_store()


@pytest.fixture
def make_rows(store):
    def make(lease_s=30.0, max_attempts=3):
        return Reconciler(store.database, f"owner-{next(NUMBERS)}", lease_s, max_attempts)

    return make


def take_one(rows, run_id):
    with open_writing(rows.database) as session:
        claimed = runs.claim(session, rows.owner, rows.lease_s, 1, [run_id])
    return [(run.run_id, run.attempt) for run in claimed]


def success(held):
    address = f"{held[0]:032x}{held[1]:032x}"
    return RunEnd(*held, "SUCCEEDED", None, address, {"status": "converged"}, 2, [Line.log("done")])


def test_a_run_is_claimed_by_one_owner_only(store, make_rows):
    (run_id,) = store.launch("quick")
    assert take_one(make_rows(), run_id) == [(run_id, 1)]
    assert take_one(make_rows(), run_id) == []


def test_an_end_that_no_row_can_hold_fails_its_own_run_and_no_other(store, make_rows):
    rows = make_rows()
    good, bad = (take_one(rows, run_id)[0] for run_id in store.launch("quick", 2))
    rows.settle([replace(success(bad), summary={"rms": float("nan")}), success(good)])
    assert store.states([good[0], bad[0]]) == ["SUCCEEDED", "FAILED"]
    assert store.ends(bad[0]) == ["FAILED"]


def test_a_lapsed_lease_gives_the_run_back_and_the_late_result_writes_nothing(store, make_rows):
    (run_id,) = store.launch("quick")
    gone, next_owner = make_rows(lease_s=-1.0), make_rows()
    (old,) = take_one(gone, run_id)
    next_owner.renew([])
    assert store.states([run_id]) == ["QUEUED"]
    (new,) = take_one(next_owner, run_id)
    assert new == (run_id, 2)
    gone.settle([success(old)])
    late = Report(*old, 0.9, "late", 1.0)
    gone.record({old: late}, {old: late.line()})
    assert store.states([run_id]) == ["RUNNING"]
    assert store.run(run_id).progress is None
    assert store.run(run_id).result_sha256 is None
    assert not {"done", "90 %: late"} & set(store.log(run_id, "log"))
    next_owner.settle([success(new)])
    assert store.run(run_id).result_sha256.endswith("2")
    assert store.ends(run_id) == ["SUCCEEDED"]


def test_an_owner_learns_that_a_run_is_no_longer_its_own(store, make_rows):
    (run_id,) = store.launch("quick")
    gone, next_owner = make_rows(lease_s=-1.0), make_rows()
    (old,) = take_one(gone, run_id)
    next_owner.renew([])
    (new,) = take_one(next_owner, run_id)
    assert gone.renew([old]) == {old}
    assert next_owner.renew([new]) == set()


def test_a_run_whose_servers_are_lost_every_time_is_lost_itself(store, make_rows):
    (run_id,) = store.launch("quick")
    gone = make_rows(lease_s=-1.0, max_attempts=2)
    for _ in range(2):
        assert take_one(gone, run_id)
        gone.renew([])
    assert store.states([run_id]) == ["LOST"]
    assert "stopped reporting" in store.run(run_id).reason
    assert store.ends(run_id) == ["LOST"]


def test_a_run_lost_in_company_is_not_charged_but_one_lost_alone_is(store, make_rows):
    first, second = store.launch("quick", 2)
    rows = make_rows(max_attempts=1)
    held = take_one(rows, first) + take_one(rows, second)
    rows.give_up(held, "its worker process died")
    assert store.states([first, second]) == ["QUEUED", "QUEUED"]
    (alone,) = take_one(rows, first)
    rows.give_up([alone], "its worker process died")
    assert store.states([first]) == ["FAILED"]
    assert re.search(" 1 lost attempt; .* its worker process died", store.run(first).reason)


def test_a_run_whose_worker_was_gone_beforehand_is_not_charged_until_it_goes_on_so(store, make_rows):
    (run_id,) = store.launch("quick")
    rows = make_rows(max_attempts=1)
    for _ in range(2):
        rows.put_back_or_give_up(take_one(rows, run_id), "its worker was gone")
        assert store.states([run_id]) == ["QUEUED"]
    assert store.log(run_id, "lost") == []
    rows.put_back_or_give_up(take_one(rows, run_id), "its worker was gone")
    assert store.states([run_id]) == ["FAILED"]


def test_a_terminal_state_is_written_once(store, make_rows):
    (run_id,) = store.launch("quick")
    rows = make_rows()
    (held,) = take_one(rows, run_id)
    rows.settle([success(held)])
    rows.settle([replace(success(held), state="FAILED", reason="again")])
    rows.give_up([held], "its worker process died")
    rows.put_back([held], "its server was stopped")
    rows.end_cancelled(held)
    assert store.cancel(run_id) == "SUCCEEDED"
    assert store.ends(run_id) == ["SUCCEEDED"]
    assert store.states([run_id]) == ["SUCCEEDED"]


def test_a_queued_run_is_cancelled_at_once_and_never_claimed(store, make_rows):
    (run_id,) = store.launch("quick")
    assert store.cancel(run_id) == "CANCELLED"
    assert take_one(make_rows(), run_id) == []
    assert store.run(run_id).ended_utc is not None


@pytest.mark.parametrize("way", ["settle", "put_back", "give_up", "lapse"])
def test_a_run_that_was_asked_to_stop_ends_cancelled_whichever_way_it_ends(store, make_rows, way):
    (run_id,) = store.launch("quick")
    rows = make_rows(lease_s=-1.0 if way == "lapse" else 30.0)
    (held,) = take_one(rows, run_id)
    assert store.cancel(run_id) == "CANCELLING"
    assert rows.stops([held]) == {held}
    {
        "settle": lambda: rows.settle([success(held)]),
        "put_back": lambda: rows.put_back([held], "its server was stopped"),
        "give_up": lambda: rows.give_up([held], "its worker process died"),
        "lapse": lambda: make_rows().renew([]),
    }[way]()
    assert store.ends(run_id) == ["CANCELLED"]
    assert store.run(run_id).reason == "Cancelled in a test."
    assert store.run(run_id).result_sha256 is None


def test_progress_is_dropped_when_the_result_is_there(store, make_rows):
    (run_id,) = store.launch("quick")
    rows = make_rows()
    (held,) = take_one(rows, run_id)
    report = Report(*held, 0.5, "half", 2.0, b'{"status": "running"}')
    rows.record({held: report}, {held: report.line()})
    assert store.run(run_id).progress["partial"] == {"status": "running"}
    assert "50 %: half" in store.log(run_id, "log")
    rows.settle([success(held)])
    assert store.run(run_id).progress is None


def test_ends_written_together_are_each_written_or_left_as_one_alone_would_be(store, make_rows):
    rows = make_rows()
    done, failed, stopped, late = (take_one(rows, run_id)[0] for run_id in store.launch("quick", 4))
    rows.settle([success(late)])
    store.cancel(stopped[0])
    crash = replace(success(failed), state="FAILED", reason="a defect", result_sha256=None, summary=None)
    rows.settle([success(done), crash, success(stopped), replace(success(late), state="FAILED"), success((done[0], 7))])
    ids = [held[0] for held in (done, failed, stopped, late)]
    assert store.states(ids) == ["SUCCEEDED", "FAILED", "CANCELLED", "SUCCEEDED"]
    assert [store.ends(run_id) for run_id in ids] == [[state] for state in store.states(ids)]
    assert [store.run(run_id).reason for run_id in ids] == [None, "a defect", "Cancelled in a test.", None]
    assert store.log(failed[0], "state")[-1] == "FAILED: a defect"
    assert store.run(stopped[0]).summary is None


@pytest.fixture
def look(make_store):
    store = make_store()

    def make(count, state="SUCCEEDED"):
        made = AlarmCheck(store.database)
        made.note([RunEnd(run_id, 1, state) for run_id in store.launch("quick", count)])
        return made

    return make


def test_the_sensors_of_runs_that_succeeded_are_watched_and_written_only_where_something_changed(look, monkeypatch):
    written = []
    monkeypatch.setattr(dispatcher, "update_alarms", lambda _session, sensor_ids: written.append(sensor_ids))
    for changed in ([], [1]):
        monkeypatch.setattr(
            dispatcher, "find_changed_sensors", lambda _session, sensor_ids, changed=changed: changed and sensor_ids
        )
        looking = look(1)
        looking.look()
        assert not looking
    assert written == [[1]]


def test_a_long_list_is_looked_at_in_parts_so_that_no_turn_is_long(look, monkeypatch):
    asked = []
    monkeypatch.setattr(dispatcher, "list_sensors", lambda _session, run_ids: asked.append(len(run_ids)) or [])
    looking = look(RUNS + 1)
    looking.look()
    assert looking
    looking.look()
    assert not looking
    assert asked == [RUNS, 1]


def test_runs_without_a_result_are_not_looked_at(look):
    assert not look(2, state="FAILED")


def test_an_alarm_check_that_fails_is_logged_and_left_to_the_maintenance(look, monkeypatch):
    def broken(*_):
        raise ArithmeticError("no drift can be told")

    said = []
    monkeypatch.setattr(dispatcher.log, "exception", said.append)
    monkeypatch.setattr(dispatcher, "find_changed_sensors", broken)
    looking = look(1)
    looking.look()
    assert not looking
    assert len(said) == 1
    assert "The alarm check failed after a run" in said[0]
