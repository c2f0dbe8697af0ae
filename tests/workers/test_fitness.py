"""A worker that may not compute for a server says so in one sentence and leaves."""

from __future__ import annotations

import socket

import pytest
from services import Services, wait_for

import boresight
from benchmarks.servers import free_port
from boresight.workers.cluster import SchedulerClient
from boresight.workers.dispatched_tasks import UNFIT_TOPIC, WorkerCheck, find_worker_fault


def test_a_worker_of_the_same_version_that_sees_the_folder_is_fit(tmp_path):
    assert find_worker_fault("1.0", str(tmp_path), "1.0") is None
    assert find_worker_fault("1.0", "", "1.0") is None


def test_another_version_and_a_folder_out_of_sight_are_said_in_one_sentence_each(tmp_path):
    here = socket.gethostname()

    assert find_worker_fault("2.0", str(tmp_path), "1.0") == (
        f"The worker on {here} is Boresight 1.0 and the server is 2.0: "
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
        assert f"is Boresight {boresight.__version__} and the server is 99.0" in heard[0]
        assert heard[0] in worker.log.read_text()
        client.register_plugin(WorkerCheck(boresight.__version__, ""))
        client.wait_for_workers(1, timeout=120)
    assert worker.process.poll() is None
