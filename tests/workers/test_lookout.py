"""What finished runs found is looked at beside the queue, some runs at a time, and whatever fails there costs no result."""

import pytest

from boresight.console.runs.queries import RunEnd
from boresight.workers import dispatcher as lookout
from boresight.workers.dispatcher import RUNS, AlarmCheck


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
    monkeypatch.setattr(lookout, "update_alarms", lambda _session, sensor_ids: written.append(sensor_ids))
    for changed in ([], [1]):
        monkeypatch.setattr(
            lookout, "find_changed_sensors", lambda _session, sensor_ids, changed=changed: changed and sensor_ids
        )
        looking = look(1)
        looking.look()
        assert not looking
    assert written == [[1]]


def test_a_long_list_is_looked_at_in_parts_so_that_no_turn_is_long(look, monkeypatch):
    asked = []
    monkeypatch.setattr(lookout, "list_sensors", lambda _session, run_ids: asked.append(len(run_ids)) or [])
    looking = look(RUNS + 1)
    looking.look()
    assert looking
    looking.look()
    assert not looking
    assert asked == [RUNS, 1]


def test_runs_without_a_result_are_not_looked_at(look):
    assert not look(2, state="FAILED")


def test_a_watch_that_fails_is_logged_and_left_to_the_upkeep(look, monkeypatch):
    def broken(*_):
        raise ArithmeticError("no drift can be told")

    said = []
    monkeypatch.setattr(lookout.log, "exception", said.append)
    monkeypatch.setattr(lookout, "find_changed_sensors", broken)
    looking = look(1)
    looking.look()
    assert not looking
    assert len(said) == 1
    assert "The watch failed after a run" in said[0]
