"""Short runs share a task, long ones and suspects go alone, and no more tasks are made than there are threads."""

from hypothesis import given
from hypothesis import strategies as st

from boresight.store.runs import Waiting
from boresight.workers.planning import GROUP_RUNS, GROUP_S, planned


def waiting(stars, attempts=None):
    """Make waiting runs; a star takes a millisecond."""
    attempts = attempts or [0] * len(stars)
    return [Waiting(i, attempts[i], "batch", {}, 1, stars[i]) for i in range(len(stars))]


def seconds(run):
    """Predict a millisecond a star."""
    return run.stars * 1e-3


queues = st.lists(st.tuples(st.integers(1, 3000), st.integers(0, 2)), max_size=100)


@given(queues, st.integers(1, 8))
def test_the_oldest_runs_go_first_each_once_and_no_task_is_too_much(queue, slots):
    runs = waiting([stars for stars, _ in queue], [attempt for _, attempt in queue])
    groups = planned(runs, slots, seconds)
    chosen = [run_id for group in groups for run_id in group]
    assert chosen == list(range(len(chosen)))
    assert len(groups) <= slots
    assert bool(groups) == bool(queue)
    for group in groups:
        assert 1 <= len(group) <= GROUP_RUNS
        if len(group) > 1:
            assert sum(seconds(runs[run_id]) for run_id in group) <= GROUP_S + 1e-9
            assert not any(runs[run_id].attempt for run_id in group)


def test_few_runs_are_spread_over_the_threads_rather_than_grouped():
    assert planned(waiting([10, 10]), 4, seconds) == [[0], [1]]


def test_many_short_runs_fill_their_tasks():
    groups = planned(waiting([20] * 200), 2, seconds)
    assert [len(group) for group in groups] == [GROUP_RUNS, GROUP_RUNS]


def test_a_run_that_was_tried_before_goes_alone():
    assert planned(waiting([10, 10, 10], [0, 1, 0]), 3, seconds) == [[0], [1], [2]]


def test_nothing_is_planned_without_a_free_thread():
    assert planned(waiting([10]), 0, seconds) == []
