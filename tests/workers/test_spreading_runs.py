"""Runs that spread their pieces, among others on one engine: who is guilty pays, nobody else."""

import os
import re
import signal
from pathlib import Path

import pytest

from boresight.workers.dispatcher import RunDispatcher


@pytest.fixture(scope="module")
def store(make_store):
    made = make_store()
    engine = RunDispatcher(made.database, made.settings, calculation="piecework:calculate")
    engine.start()
    yield made
    engine.stop()


def marks(store, run_id: int, kind: str = "piece") -> list[int]:
    paths = sorted((store.marks / "pieces" / str(run_id)).glob(f"{kind}-*"), key=lambda path: path.stat().st_mtime_ns)
    return [int(Path(path).name.split("-")[-2]) for path in paths]


def test_a_run_whose_own_worker_is_killed_while_pieces_are_lent_is_computed_again_as_the_next_attempt(store):
    (run_id,) = store.launch("spreading")
    store.wait_for(lambda: len(set(marks(store, run_id))) == 2)
    for process in set(marks(store, run_id)):
        os.kill(process, signal.SIGKILL)
    assert store.wait_until_ended([run_id]) == ["SUCCEEDED"]
    assert store.run(run_id).attempt >= 2
    assert store.ends(run_id) == ["SUCCEEDED"]


@pytest.mark.full
def test_a_run_with_a_deadly_piece_fails_with_its_cause_after_so_many_deaths_and_no_other_is_charged(store):
    (deadly,) = store.launch("deadly")
    others = []
    while store.states([deadly])[0] not in {"FAILED", "SUCCEEDED"}:
        others += store.launch("quick")
        store.wait_until_ended(others[-1:])
    assert store.states([deadly]) == ["FAILED"]
    assert "3 lost attempts" in store.run(deadly).reason
    assert re.search(r"its worker (process died|was gone)", store.run(deadly).reason)  # dask says either of a death
    assert len(marks(store, deadly, "died")) <= 2 * store.run(deadly).attempt
    assert store.states(others) == ["SUCCEEDED"] * len(others)
    assert [store.log(run_id, "lost") for run_id in others] == [[]] * len(others)
