"""An engine knows its workers before it has anything for them to do, and whether any ever came."""


def test_workers_that_have_joined_are_known_without_any_run(make_store, start_engine):
    store = make_store()
    engine = start_engine(store)
    store.wait_for(lambda: engine.state()["joined"])
    assert engine.state()["threads"] > 0


def test_no_worker_has_joined_where_none_is_to_be(make_store, start_engine):
    engine = start_engine(make_store(workers="0"))
    assert engine.state()["joined"] is False
