"""Short runs share a task, long ones and suspects go alone, and only groups of short runs are put behind others."""

from hypothesis import given
from hypothesis import strategies as st

from boresight.console.runs.queries import WaitingRun
from boresight.workers.dispatcher import GROUP_RUNS, GROUP_S, LONG_GROUP_S, planned


def waiting(stars, attempts=None):
    attempts = attempts or [0] * len(stars)
    return [WaitingRun(i, attempts[i], "batch", {}, 1, stars[i]) for i in range(len(stars))]


def seconds(run):
    return run.stars * 1e-3


def ids(groups):
    return [group.run_ids for group in groups]


queues = st.lists(st.tuples(st.integers(1, 5000), st.integers(0, 2)), max_size=100)


@given(queues, st.integers(1, 8), st.integers(0, 4))
def test_the_oldest_runs_go_first_each_once_and_no_task_is_too_much(queue, free, followed):
    threads = free + followed
    runs = waiting([stars for stars, _ in queue], [attempt for _, attempt in queue])
    groups = planned(runs, free, followed, threads, seconds)
    chosen = [run_id for group in groups for run_id in group.run_ids]
    assert chosen == list(range(len(chosen)))
    assert len(groups) <= free + followed
    assert bool(groups) == bool(queue)
    assert all(group.short for group in groups[free:])
    for group in groups:
        assert 1 <= len(group.run_ids) <= GROUP_RUNS
        if len(group.run_ids) > 1 or group.short:
            quarter_s = sum(map(seconds, runs)) / threads / 4
            assert group.seconds <= min(LONG_GROUP_S, max(GROUP_S, quarter_s)) + 1e-9
            assert all(seconds(runs[run_id]) <= GROUP_S for run_id in group.run_ids)
            assert abs(sum(seconds(runs[run_id]) for run_id in group.run_ids) - group.seconds) < 1e-9
            assert not any(runs[run_id].attempt for run_id in group.run_ids)


def test_few_runs_are_spread_over_the_threads_rather_than_grouped():
    assert ids(planned(waiting([10, 10]), 4, 0, 4, seconds)) == [[0], [1]]


def test_many_short_runs_fill_their_tasks():
    groups = planned(waiting([20] * 200), 2, 0, 2, seconds)
    assert [len(group.run_ids) for group in groups] == [GROUP_RUNS, GROUP_RUNS]


def test_a_long_queue_is_taken_in_longer_groups_and_a_short_one_in_short_ones():
    of_a_second = [planned(waiting([1000] * count), 1, 0, 2, seconds) for count in (4, 40, 400)]
    assert [len(groups[0].run_ids) for groups in of_a_second] == [2, 5, 8]


def test_a_run_that_was_tried_before_goes_alone():
    assert ids(planned(waiting([10, 10, 10], [0, 1, 0]), 3, 0, 3, seconds)) == [[0], [1], [2]]


def test_nothing_is_planned_without_a_thread_for_it():
    assert planned(waiting([10]), 0, 0, 1, seconds) == []


def test_neither_a_long_run_nor_a_suspect_is_put_behind_others_nor_overtaken_by_younger_ones():
    for runs in (waiting([10, 9000, 10]), waiting([10, 10, 10], [0, 1, 0])):
        assert ids(planned(runs, 1, 2, 3, seconds)) == [[0]]
