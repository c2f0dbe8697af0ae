"""A run of a table that was altered on the disk ends FAILED with that cause, once, and whoever raises alarms is told which file."""

from tests.platform.blobs.test_corrupt_files import _flip


def test_a_run_of_a_corrupt_table_fails_with_that_cause_and_is_not_tried_again(make_store, start_engine) -> None:
    store, told = make_store(workers="1"), []
    start_engine(store, suspect=told.append)
    sha256 = next(path.name for path in store.blobs.folder.rglob("*") if path.is_file())
    _flip(store.blobs.path(sha256), 4001)
    (run_id,) = store.launch("quick")
    assert store.wait_until_ended([run_id]) == ["FAILED"]
    run = store.run(run_id)
    assert (run.attempt, run.result_sha256, told) == (1, None, [sha256])
    assert "was altered on the disk" in run.reason
