"""Schedulers and workers started by hand: links, a lost scheduler whose run is computed again, an unfit worker that leaves."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys

import pytest
from services import Services, listens, loops, wait_for

import boresight
from benchmarks.servers import free_port
from boresight.workers.cluster import SchedulerClient
from boresight.workers.dispatched_tasks import UNFIT_TOPIC, WorkerCheck, find_worker_fault


def test_a_scheduler_that_does_not_answer_costs_no_thread_however_often_it_is_asked():
    before = loops()
    for _ in range(2):
        with pytest.raises(OSError, match=r"[Tt]imed out|refused"):
            SchedulerClient(f"tcp://127.0.0.1:{free_port()}", timeout=0.2, set_as_default=False)
    assert loops() <= before


@pytest.mark.full
def test_a_scheduler_that_goes_away_takes_the_thread_of_its_client_along(tmp_path):
    port, before = free_port(), loops()
    services = Services(tmp_path, data_folder=str(tmp_path))
    try:
        services.start("scheduler", "--port", str(port))
        wait_for(lambda: listens(port))
        client = SchedulerClient(f"tcp://127.0.0.1:{port}", timeout=5, set_as_default=False)
        assert len(loops() - before) == 1
    finally:
        services.stop()
    wait_for(lambda: client.status == "closed")
    client.close()
    client.close()
    assert loops() <= before


@pytest.fixture
def start_cluster():
    """Start a scheduler and one worker as an administrator would; kill what is left at the end."""
    started = []

    def start(store):
        address = store.settings.scheduler
        environment = os.environ | {
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
            "PYTHONPATH": os.path.dirname(__file__),  # noqa: PTH120 - a string is wanted
        }
        port = address.rpartition(":")[2]
        commands = [
            ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"],
            ["distributed.cli.dask_worker", address, "--nworkers", "1", "--nthreads", "1", "--no-dashboard"],
        ]
        pair = [
            subprocess.Popen(
                [sys.executable, "-m", *command],
                env=environment,
                cwd=store.settings.data_folder,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            for command in commands
        ]
        started.extend(pair)
        return pair

    yield start
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.full
def test_a_run_on_a_killed_scheduler_is_computed_again_by_the_next(make_store, start_dispatcher, start_cluster):
    store = make_store(scheduler=f"tcp://127.0.0.1:{free_port()}", lease_s="600")
    (run_id,) = store.launch("stuck")
    scheduler, _ = start_cluster(store)
    dispatcher = start_dispatcher(store)
    store.wait_for(lambda: store.begun(run_id))
    scheduler.send_signal(signal.SIGKILL)
    scheduler.wait()
    store.wait_for(lambda: store.states([run_id]) == ["QUEUED"])  # long before its lease of 600 s lapses
    assert not store.log(run_id, "lost")
    start_cluster(store)
    assert store.wait_until_ended([run_id]) == ["SUCCEEDED"]
    assert store.run(run_id).attempt == 2
    assert store.ends(run_id) == ["SUCCEEDED"]
    dispatcher.stop()


def test_a_worker_of_the_same_version_that_sees_the_folder_is_fit(tmp_path):
    assert find_worker_fault("1.0", str(tmp_path), "1.0") is None
    assert find_worker_fault("1.0", "", "1.0") is None


def test_another_version_and_a_folder_out_of_sight_are_said_in_one_sentence_each(tmp_path):
    here = socket.gethostname()

    assert find_worker_fault("2.0", str(tmp_path), "1.0") == (
        f"The worker on {here} runs Boresight 1.0, but the server runs 2.0: "
        "install the same version on both; until then this worker gets no runs."
    )
    assert find_worker_fault("1.0", "/nowhere/blobs", "1.0") == (
        f"The worker on {here} does not see the server's folder /nowhere/blobs: mount it there under the same path; "
        "until then this worker gets no runs."
    )


@pytest.fixture
def services(tmp_path):
    made = Services(tmp_path, data_folder=str(tmp_path / "data"))
    yield made
    made.stop()


@pytest.mark.full
def test_a_worker_of_another_version_tells_both_sides_and_leaves_and_joins_when_it_fits(services):
    address = f"tcp://127.0.0.1:{free_port()}"
    services.start("scheduler", "--port", address.rpartition(":")[2])
    worker = services.start("worker", "--scheduler", address)
    heard = []
    with SchedulerClient(address, timeout=120, set_as_default=False) as client:
        client.subscribe_topic(UNFIT_TOPIC, lambda event: heard.append(event[1]["fault"]))
        client.wait_for_workers(1, timeout=120)
        client.register_plugin(WorkerCheck("99.0", ""))
        wait_for(lambda: not client.nthreads())
        wait_for(lambda: heard)
        assert f"runs Boresight {boresight.__version__}, but the server runs 99.0" in heard[0]
        assert heard[0] in worker.log.read_text()
        client.register_plugin(WorkerCheck(boresight.__version__, ""))
        client.wait_for_workers(1, timeout=120)
    assert worker.process.poll() is None
