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
    assert 0 < calm["claims_per_run"] <= 1
    assert 0 < calm["settlements_per_run"] <= 1
    assert 0 < calm["alone_cpu_ms_per_run"] <= 1.1 * calm["alone_ms_per_run"]
    assert measured["limits"]["runs_lost_or_doubled"]["kept"]


def test_the_limit_holds_beyond_what_workers_state_and_by_either_clock_beyond_bare_processes(measured):
    for name in ("overhead_ms_per_run", "overhead_over_alone_ms_per_run", "overhead_cpu_over_alone_ms_per_run"):
        limit = measured["limits"][name]
        assert (limit["limit"], limit["measured"]) == (10.0, measured["calm"][name])


def test_what_a_run_takes_beyond_alone_is_told_of_threads_and_of_processors():
    told = queue._over_alone({"seconds": 0.1, "cpu_seconds": 0.09}, thread_s=0.16, cpu_s=0.098)
    assert told["overhead_over_alone_ms_per_run"] == pytest.approx(60.0)
    assert told["overhead_cpu_over_alone_ms_per_run"] == pytest.approx(8.0)
    assert (told["alone_ms_per_run"], told["alone_cpu_ms_per_run"]) == pytest.approx((100.0, 90.0))


def test_overhead_is_what_the_threads_did_not_compute():
    found = {"computing_s": 15.0, "computing_cpu_s": 12.0}
    told = queue._overhead(found, wall_s=8.0, used=(14.0, 1.0), threads=2, count=100)
    assert told["overhead_ms_per_run"] == pytest.approx(10.0)
    assert told["overhead_share"] == pytest.approx(1 / 15)
    assert told["overhead_cpu_ms_per_run"] == pytest.approx(20.0)
    assert told["server_cpu_ms_per_run"] == pytest.approx(10.0)
    assert told["computing_ms_per_run"] == pytest.approx(150.0)
