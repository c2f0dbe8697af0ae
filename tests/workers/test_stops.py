"""A dispatcher that begins and ends: workers known before any run, runs given back at its end, a corrupt table said once."""

import pytest
from distributed.comm import CommClosedError

from boresight.workers.dispatcher import RunDispatcher
from tests.platform.blobs.test_blobs import _flip


def test_what_was_running_is_queued_again_and_not_charged(make_store, start_dispatcher):
    store = make_store()
    (run_id,) = store.launch("endless")
    dispatcher = start_dispatcher(store)
    store.wait_for(lambda: store.begun(run_id))
    dispatcher.stop()
    assert store.states([run_id]) == ["QUEUED"]
    assert not store.log(run_id, "lost")
    assert not store.alive()


def test_a_scheduler_that_is_lost_in_the_middle_of_a_turn_is_told_in_a_line_without_a_traceback(make_store, caplog):
    store = make_store(workers="0")
    dispatcher = RunDispatcher(store.database, store.settings)
    turns = []

    def turn():
        turns.append(len(turns))
        if len(turns) == 1:
            raise CommClosedError("in a question")
        dispatcher._stopping.set()

    caplog.set_level("WARNING")
    dispatcher._turn = turn
    dispatcher._run()
    assert turns == [0, 1]  # it was tried again
    assert [(record.levelname, record.exc_info) for record in caplog.records] == [("WARNING", None)]


@pytest.mark.full
def test_workers_that_have_joined_are_known_without_any_run(make_store, start_dispatcher):
    store = make_store()
    dispatcher = start_dispatcher(store)
    store.wait_for(lambda: dispatcher.state().joined)
    assert dispatcher.state().threads > 0


def test_no_worker_has_joined_where_none_is_to_be(make_store, start_dispatcher):
    dispatcher = start_dispatcher(make_store(workers="0"))
    assert dispatcher.state().joined is False


def test_a_run_of_a_corrupt_table_fails_with_that_cause_and_is_not_tried_again(make_store, start_dispatcher) -> None:
    store, told = make_store(workers="1"), []
    start_dispatcher(store, suspect=told.append)
    sha256 = next(path.name for path in store.blobs.folder.rglob("*") if path.is_file())
    _flip(store.blobs.path(sha256), 4001)
    (run_id,) = store.launch("quick")
    assert store.wait_until_ended([run_id]) == ["FAILED"]
    run = store.run(run_id)
    assert (run.attempt, run.result_sha256, told) == (1, None, [sha256])
    assert sha256[:12] in run.reason
