"""A run's pieces on real workers: in order, to the end, whoever is killed, busy, blind or poisoned; measured to the same bits."""

from __future__ import annotations

import os
import re
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import piecework
import pytest
from services import Services, listens, wait_for

from benchmarks import spread
from benchmarks.servers import free_port
from benchmarks.stars import EXPOSURES_A_FRAME, STARS
from boresight.calibration.telemetry_pieces import LARGE_ROWS
from boresight.errors import CancelledError, RefusedInputError
from boresight.workers.cluster import SchedulerClient
from boresight.workers.dispatcher import RunDispatcher

EXPECTED = [number * number for number in range(piecework.COUNT)]


@pytest.fixture(scope="module")
def client(tmp_path_factory, catalogue_folder):
    """Connect to a scheduler with two workers, all started by the commands."""
    address = f"tcp://127.0.0.1:{free_port()}"
    services = Services(tmp_path_factory.mktemp("services"), data_folder=str(catalogue_folder.parent))
    try:
        services.start("scheduler", "--port", address.rpartition(":")[2])
        wait_for(lambda: listens(int(address.rpartition(":")[2])))
        with SchedulerClient(address, timeout=60, set_as_default=False) as connected:
            services.start("worker", "--scheduler", address, "--processes", "2")
            connected.wait_for_workers(2, timeout=120)
            yield connected
    finally:
        services.stop()


@pytest.fixture
def start(client, tmp_path):
    """Give a task to the first of two workers, as the dispatcher gives a run."""
    wait_for(lambda: len(client.nthreads()) == 2 and not any(client.processing().values()))

    def submit(function, *arguments, worker=0, **options):
        name = sorted(client.nthreads())[worker]
        key = f"run-{time.monotonic_ns()}"
        return client.submit(function, *arguments, **options, workers=[name], key=key, pure=False)

    submit.folder, submit.client = tmp_path, client
    return submit


def processes(folder: Path, kind: str = "piece") -> list[int]:
    """Who computed pieces, in order of time."""
    paths = sorted(folder.glob(f"{kind}-*"), key=lambda path: int(path.name.rpartition("-")[2]))
    return [int(path.name.split("-")[-2]) for path in paths]


@pytest.mark.full
def test_two_workers_compute_the_pieces_of_one_run_and_their_results_come_in_order(start):
    found = start(piecework.spread, start.folder).result(60)

    assert found["results"] == EXPECTED
    assert len(set(processes(start.folder))) == 2
    assert found["told"][-1] == (piecework.COUNT, piecework.COUNT)
    assert found["told"] == sorted(found["told"])


@pytest.mark.full
def test_a_piece_whose_worker_is_killed_is_computed_by_the_run_with_the_same_result(start):
    own = next(iter(start.client.run(os.getpid, workers=sorted(start.client.nthreads())[:1]).values()))
    run = start(piecework.spread, start.folder)
    wait_for(lambda: len(set(processes(start.folder))) == 2)
    (victim,) = set(processes(start.folder)) - {own}
    os.kill(victim, signal.SIGKILL)
    found = run.result(60)

    assert found["results"] == EXPECTED
    assert found["process"] == own
    assert len(processes(start.folder)) > piecework.COUNT  # what it had begun was begun again


@pytest.mark.full
def test_a_run_alone_with_a_worker_that_is_busy_computes_everything_itself(start):
    occupied = start(piecework.occupy, start.folder, 3.0, worker=1)
    wait_for(lambda: list(start.folder.glob("occupied-*")))
    found = start(piecework.spread, start.folder, count=12, seconds=0.05).result(60)
    assert not occupied.done()

    assert found["results"] == EXPECTED[:12]
    assert set(processes(start.folder)) == {found["process"]}
    occupied.result(60)


@pytest.mark.full
def test_a_run_that_is_given_to_a_worker_with_pieces_waits_for_one_group_at_most(start):
    run = start(piecework.spread, start.folder, count=60, seconds=0.1)
    wait_for(lambda: len(set(processes(start.folder))) == 2)
    begun_s = time.monotonic()
    start(piecework.occupy, start.folder, 0.0, worker=1).result(60)

    assert not run.done()
    assert time.monotonic() - begun_s < 5
    assert run.result(60)["results"] == [number * number for number in range(60)]


def test_a_run_asked_to_stop_ends_while_pieces_are_under_way(start):
    begun_s = time.monotonic()
    run = start(piecework.spread, start.folder, stop_after_s=0.5, seconds=10.0)

    with pytest.raises(CancelledError, match="of 24"):
        run.result(60)
    assert time.monotonic() - begun_s < 10.0


def test_what_the_first_failing_piece_raised_is_raised_in_the_run(start):
    with pytest.raises(RefusedInputError, match="piece 5"):
        start(piecework.spread, start.folder, piecework.refuse).result(60)


@pytest.mark.full
def test_a_worker_that_does_not_see_the_folder_is_asked_once_and_no_more(start):
    found = start(piecework.spread_unseen, start.folder).result(60)

    assert found["results"] == EXPECTED
    assert set(processes(start.folder)) == {found["process"]}


@pytest.fixture(scope="module")
def store(make_store):
    made = make_store()
    dispatcher = RunDispatcher(made.database, made.settings, calculation="piecework:calculate")
    dispatcher.start()
    yield made
    dispatcher.stop()


def marks(store, run_id: int, kind: str = "piece") -> list[int]:
    paths = sorted((store.marks / "pieces" / str(run_id)).glob(f"{kind}-*"), key=lambda path: path.stat().st_mtime_ns)
    return [int(Path(path).name.split("-")[-2]) for path in paths]


@pytest.mark.full
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
    assert re.search(r"its worker (process died|was lost)", store.run(deadly).reason)  # dask says either of a death
    assert len(marks(store, deadly, "died")) <= 2 * store.run(deadly).attempt
    assert store.states(others) == ["SUCCEEDED"] * len(others), store.run(others[0]).reason
    assert [store.log(run_id, "lost") for run_id in others] == [[]] * len(others)


FRAMES = 1 + LARGE_ROWS // (EXPOSURES_A_FRAME * STARS)  # the fewest that are spread
DOCUMENT = {"free": ["f_m"], "parameters": {"f_m": 1.0}, "sigma": {"f_m": 0.1}} | {
    key: 1 for key in spread.ESTIMATE if key not in {"parameters", "sigma"}
}
KILL = {"worker": "tcp://one", "happened": True, "after_s": 3.0, "groups_done": 4, "groups_in_hand": 2}


@pytest.mark.full
def test_one_worker_two_and_two_of_which_one_is_killed_find_the_same_bits():
    found = spread.measure(lambda *_: None, frames=FRAMES)
    runs = found["runs"]
    assert found["same_bits"] == {"one_worker": True, "two_workers": True, "one_of_two_killed": True}
    assert set(found["largest_difference_sigma"].values()) == {0.0}
    assert runs["two_workers"]["cpu_s"]["worker_2"] > 0.1  # it took part
    assert found["ratio"] == runs["one_worker"]["seconds"] / runs["two_workers"]["seconds"]


@pytest.mark.parametrize(
    ("changed", "kept"), [({}, True), ({"happened": False, "after_s": None}, False), ({"groups_in_hand": 0}, False)]
)
def test_a_kill_that_shows_nothing_keeps_no_promise_and_says_why(changed, kept):
    runs = {name: {"seconds": 2.0, "document": DOCUMENT} for name in ("one_worker", "two_workers", "one_of_two_killed")}
    runs["one_of_two_killed"]["kill"] = KILL | changed
    limit = spread._found(100, runs)["limits"]["answer_of_one_of_two_killed"]
    assert limit["kept"] is kept
    assert ("why" in limit) is not kept


class _Client:
    def __init__(self):
        self.done = 8

    def run(self, function, workers):
        self.done += 2
        state = SimpleNamespace(executed_count=self.done, executing={"a"}, ready=["b"])
        return {workers[0]: function(SimpleNamespace(state=state))}


@pytest.mark.full
def test_a_worker_is_killed_once_at_its_time_and_what_it_had_is_told(monkeypatch):
    killed = []
    monkeypatch.setattr(spread.os, "kill", lambda pid, signal: killed.append((pid, signal)))
    began_s = time.perf_counter()
    late, now = (spread.Kill(_Client(), "tcp://one", 7, began_s + after_s) for after_s in (1000.0, 0.0))
    for _ in range(3):
        late.look()
        now.look()
    assert killed == [(7, spread.signal.SIGKILL)]
    assert not late.told(began_s)["happened"]
    told = now.told(began_s)
    assert (told["worker"], told["groups_done"], told["groups_in_hand"]) == ("tcp://one", 2, 2)
