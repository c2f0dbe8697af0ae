"""Small runs go through a real installation; whatever is killed on the way, each succeeds once with the result it must have."""

import pytest

from boresight.measurements import queue


@pytest.fixture(scope="module")
def measured():
    return queue.measure(lambda _fraction, _message: None, runs=16, frames=12, trackers=8)


def test_no_run_is_lost_or_doubled_by_a_killed_worker_scheduler_and_server(measured):
    killed = measured["killed"]
    assert killed["states"] == {"SUCCEEDED": 16}
    assert killed["not_as_promised"] == 0
    assert killed["audit"]["ok"], killed["audit"]["sentence"]
    assert killed["starts"]["scheduler"] == killed["starts"]["server"] == 2


def test_an_undisturbed_run_is_computed_once_and_its_time_is_known(measured):
    calm = measured["calm"]
    assert calm["attempts"] == {"1": 16}
    assert calm["not_as_promised"] == 0
    assert 0 < calm["computing_cpu_s"] <= 1.1 * calm["computing_s"]
    assert measured["limits"]["runs_lost_or_doubled"]["kept"]


def test_overhead_is_what_the_threads_did_not_compute():
    found = {"computing_s": 15.0, "computing_cpu_s": 12.0}
    told = queue._overhead(found, wall_s=8.0, used=(14.0, 1.0), threads=2, count=100)
    assert told["overhead_ms_per_run"] == pytest.approx(10.0)
    assert told["overhead_share"] == pytest.approx(1 / 15)
    assert told["overhead_cpu_ms_per_run"] == pytest.approx(20.0)
    assert told["server_cpu_ms_per_run"] == pytest.approx(10.0)
    assert told["computing_ms_per_run"] == pytest.approx(150.0)
