"""A run's pieces on real workers: in order, to the end, whoever is killed, busy, blind or poisoned."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import piecework
import pytest
from services import Services, listens, wait_for

from benchmarks.servers import free_port
from boresight.errors import CancelledError, RefusedInputError
from boresight.workers.cluster import SchedulerClient

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
    """Give a task to the first of two workers, as the engine gives a run."""
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


def test_two_workers_compute_the_pieces_of_one_run_and_their_results_come_in_order(start):
    found = start(piecework.spread, start.folder).result(60)

    assert found["results"] == EXPECTED
    assert len(set(processes(start.folder))) == 2
    assert found["told"][-1] == (piecework.COUNT, piecework.COUNT)
    assert found["told"] == sorted(found["told"])


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


def test_a_run_alone_with_a_worker_that_is_busy_computes_everything_itself(start):
    occupied = start(piecework.occupy, start.folder, 6.0, worker=1)
    wait_for(lambda: list(start.folder.glob("occupied-*")))
    found = start(piecework.spread, start.folder, count=12).result(60)

    assert found["results"] == EXPECTED[:12]
    assert set(processes(start.folder)) == {found["process"]}
    occupied.result(60)


def test_a_run_that_is_given_to_a_worker_with_pieces_waits_for_one_group_at_most(start):
    run = start(piecework.spread, start.folder, count=60)
    wait_for(lambda: len(set(processes(start.folder))) == 2)
    begun_s = time.monotonic()
    start(piecework.occupy, start.folder, 0.0, worker=1).result(60)

    assert not run.done()
    assert time.monotonic() - begun_s < 5
    assert run.result(60)["results"] == [number * number for number in range(60)]


def test_a_run_asked_to_stop_ends_while_pieces_are_under_way(start):
    begun_s = time.monotonic()
    run = start(piecework.spread, start.folder, stop_after_s=0.5, seconds=10.0)

    with pytest.raises(CancelledError, match="of 24 pieces"):
        run.result(60)
    assert time.monotonic() - begun_s < 10.0


def test_what_the_first_failing_piece_raised_is_raised_in_the_run(start):
    with pytest.raises(RefusedInputError, match="piece 5 is refused"):
        start(piecework.spread, start.folder, piecework.refuse).result(60)


def test_a_worker_that_does_not_see_the_folder_is_asked_once_and_no_more(start):
    found = start(piecework.spread_unseen, start.folder).result(60)

    assert found["results"] == EXPECTED
    assert set(processes(start.folder)) == {found["process"]}
