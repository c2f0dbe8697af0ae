"""The server is killed with -9 while runs compute, and started again: none is lost, none is doubled."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from boresight.console.runs.tables import TERMINAL_RUN_STATES
from tests.effort import effort

SERVER = Path(__file__).parent / "server.py"


@pytest.fixture
def start_server():
    started = []

    def start(store):
        environment = os.environ | store.environment
        started.append(subprocess.Popen([sys.executable, str(SERVER)], env=environment))
        return started[-1]

    yield start
    for process in started:
        process.terminate()
    for process in started:
        process.wait()


def test_every_run_survives_a_killed_worker_and_then_a_killed_server(make_store, start_server):
    store, some = make_store(lease_s="2"), effort(5, 99)
    (first,), early, (middle,), late = (
        store.launch(*work) for work in [("stuck",), ("brief", some), ("stuck",), ("brief", some)]
    )
    run_ids = [first, *early, middle, *late]
    server = start_server(store)
    store.wait_for(lambda: store.begun(first))
    os.kill(store.begun(first)[0], signal.SIGKILL)
    store.wait_for(lambda: store.begun(middle))
    server.send_signal(signal.SIGKILL)
    server.wait()
    store.wait_for(lambda: not store.alive())  # no orphans
    assert not set(store.states(run_ids)) <= set(TERMINAL_RUN_STATES)  # it was killed in the middle
    start_server(store)
    assert store.wait_until_ended(run_ids) == ["SUCCEEDED"] * len(run_ids)
    assert all(store.ends(run_id) == ["SUCCEEDED"] for run_id in run_ids)
    assert all(store.run(run_id).attempt > 1 for run_id in (first, middle))  # both kills hit a run that computed


@pytest.mark.full
def test_servers_that_share_a_store_compute_each_run_once(make_store, start_server):
    store = make_store(workers="1", lease_s="60")  # a starved server must not seem dead
    run_ids = store.launch("quick", effort(20, 60))
    start_server(store)
    start_server(store)
    assert store.wait_until_ended(run_ids) == ["SUCCEEDED"] * len(run_ids)
    assert all(len(store.begun(run_id)) == 1 for run_id in run_ids)
