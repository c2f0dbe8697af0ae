"""A server that is stopped in order gives its runs back."""


def test_what_was_running_is_queued_again_and_not_charged(make_store, start_engine):
    store = make_store()
    (run_id,) = store.launch("endless")
    engine = start_engine(store)
    store.wait_for(lambda: store.begun(run_id))
    engine.stop()
    assert store.states([run_id]) == ["QUEUED"]
    assert not store.log(run_id, "lost")
    assert not store.alive()
