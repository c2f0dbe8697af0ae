"""A thread computes one task, may have one more behind it, and only what it computed is suspected when it dies."""

import time

from hypothesis import given
from hypothesis import strategies as st

from boresight.workers.dispatched_tasks import DispatchedTask, DispatchedTasks

THREADS = {"tcp://a": 1, "tcp://b": 2}


def flights(*made):
    found = DispatchedTasks()
    for flight in made:
        found.add(flight)
    return found


def flight(worker, run_id, **more):
    return DispatchedTask(None, worker, {(run_id, 1)}, **more)


@given(st.lists(st.tuples(st.sampled_from(sorted(THREADS)), st.booleans()), max_size=8))
def test_no_thread_is_ever_given_more_than_two_tasks(offers):
    found = flights()
    for run_id, (worker, short) in enumerate(offers):
        if worker in found.free(THREADS):
            found.add(flight(worker, run_id, short=short))
        elif worker in found.followed(THREADS):
            found.add(flight(worker, run_id, short=True, behind=True))
    for worker, threads in THREADS.items():
        of_worker = [one for one in found if one.worker == worker]
        assert sum(not one.behind for one in of_worker) <= threads
        assert sum(one.behind for one in of_worker) <= sum(one.short and not one.behind for one in of_worker)


def test_only_threads_with_short_runs_and_nothing_behind_are_followed():
    assert flights(flight("tcp://a", 1)).followed(THREADS) == []
    short = flight("tcp://a", 1, short=True)
    assert flights(short).followed(THREADS) == ["tcp://a"]
    assert flights(short, flight("tcp://a", 2, short=True, behind=True)).followed(THREADS) == []


def test_what_waited_behind_comes_to_the_thread_when_that_is_free_and_its_clock_begins_then():
    first, second = flight("tcp://a", 1, short=True), flight("tcp://a", 2, short=True, behind=True, since_s=0.0)
    found = flights(first, second)
    found.advance(THREADS)
    assert second.behind
    found.remove(first)
    found.advance(THREADS)
    assert not second.behind
    assert time.monotonic() - second.since_s < 60
    assert found.held() == {(2, 1)}


def test_nothing_comes_to_the_thread_of_a_worker_that_is_gone():
    first, second = flight("tcp://a", 1, short=True), flight("tcp://a", 2, short=True, behind=True)
    found = flights(first, second)
    found.remove(first)
    found.advance({"tcp://b": 2})
    assert second.behind


def test_what_waits_too_long_behind_another_is_overdue():
    found = flights(flight("tcp://a", 1, short=True), flight("tcp://a", 2, short=True, behind=True, since_s=-1e6))
    assert [one.members for one in found.overdue(10.0)] == [{(2, 1)}]
    assert found.overdue(1e12) == []


def test_a_run_that_shares_its_task_has_the_time_of_its_group_to_answer():
    now_s = time.monotonic()
    alone = flight("tcp://a", 1, asked_s={(1, 1): now_s}, since_s=now_s - 100)
    grouped = flight("tcp://a", 1, short=True, expected_s=2.0, asked_s={(1, 1): now_s - 3}, since_s=now_s - 1)
    assert 0 <= alone.unanswered_s((1, 1)) < 1
    assert grouped.unanswered_s((1, 1)) < 0  # it came to its thread a second ago
