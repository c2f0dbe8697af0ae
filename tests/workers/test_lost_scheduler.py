"""An external scheduler is killed with -9 and another takes its place: the run on it is computed again."""

import os
import signal
import subprocess
import sys

import pytest

from benchmarks.servers import free_port


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


def test_a_run_on_a_killed_scheduler_is_computed_again_by_the_next(make_store, start_engine, start_cluster):
    store = make_store(scheduler=f"tcp://127.0.0.1:{free_port()}", lease_s="600")
    (run_id,) = store.launch("stuck")
    scheduler, _ = start_cluster(store)
    engine = start_engine(store)
    store.wait_for(lambda: store.begun(run_id))
    scheduler.send_signal(signal.SIGKILL)
    scheduler.wait()
    store.wait_for(lambda: store.states([run_id]) == ["QUEUED"])  # long before its lease of 600 s lapses
    assert not store.log(run_id, "lost")
    start_cluster(store)
    assert store.wait_until_ended([run_id]) == ["SUCCEEDED"]
    assert store.run(run_id).attempt == 2
    assert store.ends(run_id) == ["SUCCEEDED"]
    engine.stop()
