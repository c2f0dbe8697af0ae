"""A server that is stopped in order gives its runs back."""

from distributed.comm import CommClosedError

from boresight.workers.dispatcher import RunDispatcher


def test_what_was_running_is_queued_again_and_not_charged(make_store, start_engine):
    store = make_store()
    (run_id,) = store.launch("endless")
    engine = start_engine(store)
    store.wait_for(lambda: store.begun(run_id))
    engine.stop()
    assert store.states([run_id]) == ["QUEUED"]
    assert not store.log(run_id, "lost")
    assert not store.alive()


def test_a_scheduler_that_is_lost_in_the_middle_of_a_turn_is_told_in_a_line_without_a_traceback(make_store, caplog):
    store = make_store(workers="0")
    engine = RunDispatcher(store.database, store.settings)
    turns = []

    def turn():
        turns.append(len(turns))
        if len(turns) == 1:
            raise CommClosedError("in a question")
        engine._stopping.set()

    caplog.set_level("WARNING")
    engine._turn = turn
    engine._run()
    assert turns == [0, 1]  # it was tried again
    assert [(record.levelname, record.exc_info) for record in caplog.records] == [("WARNING", None)]
