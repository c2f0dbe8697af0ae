"""Kills lose, double and hold up nothing: a few of those that `python -m benchmarks.kills` makes by the hundred.

They take as long as processes take to start, which is what a kill costs.
"""

import numpy as np
import pytest

from benchmarks import kills, queue

FAULTS = (*kills.FAULTS, "processes_left")


@pytest.fixture(scope="module")
def brief():
    with pytest.MonkeyPatch.context() as patched:
        for name, value in {"FRAMES": 12, "TRACKERS": 2, "LEASE_S": 1.0, "MEAN_S": 1.0}.items():
            patched.setattr(kills, name, value)
        yield


@pytest.mark.full
@pytest.mark.usefixtures("brief")
def test_a_worker_and_a_server_killed_at_random_times_lose_double_and_hold_up_no_run():
    found = kills.measured("own workers", (2, 10), np.random.default_rng(1))
    assert (found["kills"], found["runs"]) == ({"worker": 1, "server": 1}, 10)
    assert {key: found[key] for key in FAULTS} == dict.fromkeys(FAULTS, 0)


@pytest.mark.full
@pytest.mark.usefixtures("brief")
def test_every_kind_of_process_killed_at_random_times_loses_doubles_and_holds_up_no_run():
    found = kills.measure(total_runs=20, total_kills=6, seed=5)
    assert found["services"]["kills"] == {"worker": 1, "nanny": 1, "scheduler": 1, "server": 1}
    assert found["own workers"]["kills"] == {"worker": 1, "server": 1}
    assert found["runs"] == 20
    assert {key: found[key] for key in FAULTS} == dict.fromkeys(FAULTS, 0)


@pytest.mark.full
def test_no_run_is_lost_or_doubled_by_a_killed_worker_scheduler_and_server(monkeypatch):
    monkeypatch.setattr(queue, "LEASE_S", 1.0)
    found = queue.one_pass(lambda *_: None, 8, 12, 4, queue.KILLS)
    assert found["states"] == {"SUCCEEDED": 8}
    assert found["not_as_promised"] == 0
    assert found["audit"]["ok"], found["audit"]["sentence"]
    assert found["starts"]["scheduler"] == found["starts"]["server"] == 2
