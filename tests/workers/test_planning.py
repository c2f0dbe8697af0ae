"""What goes to which thread: short runs share a task; how long a run will take; a map's pieces."""

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.calibration.options import CalibrationSettings
from boresight.console.runs.dry_runs import TimedRun
from boresight.console.runs.queries import WaitingRun
from boresight.workers import dispatcher
from boresight.workers.cluster_executor import GROUP_S as PIECES_S
from boresight.workers.cluster_executor import FailedPiece, Pieces
from boresight.workers.dispatched_tasks import DispatchedTask, DispatchedTasks
from boresight.workers.dispatcher import FRESH_S, GROUP_RUNS, GROUP_S, LONG_GROUP_S, DurationModel, planned


def waiting(stars, attempts=None):
    attempts = attempts or [0] * len(stars)
    return [WaitingRun(i, attempts[i], "batch", CalibrationSettings(), 1, stars[i]) for i in range(len(stars))]


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


THREADS = {"tcp://a": 1, "tcp://b": 2}


def add_tasks(*made):
    found = DispatchedTasks()
    for task in made:
        found.add(task)
    return found


def task(worker, run_id, **more):
    return DispatchedTask(None, worker, {(run_id, 1)}, **more)


@given(st.lists(st.tuples(st.sampled_from(sorted(THREADS)), st.booleans()), max_size=8))
def test_no_thread_is_ever_given_more_than_two_tasks(offers):
    found = add_tasks()
    for run_id, (worker, short) in enumerate(offers):
        if worker in found.free(THREADS):
            found.add(task(worker, run_id, short=short))
        elif worker in found.followed(THREADS):
            found.add(task(worker, run_id, short=True, behind=True))
    for worker, threads in THREADS.items():
        of_worker = [one for one in found if one.worker == worker]
        assert sum(not one.behind for one in of_worker) <= threads
        assert sum(one.behind for one in of_worker) <= sum(one.short and not one.behind for one in of_worker)


def test_only_threads_with_short_runs_and_nothing_behind_are_followed():
    assert add_tasks(task("tcp://a", 1)).followed(THREADS) == []
    short = task("tcp://a", 1, short=True)
    assert add_tasks(short).followed(THREADS) == ["tcp://a"]
    assert add_tasks(short, task("tcp://a", 2, short=True, behind=True)).followed(THREADS) == []


def test_what_waited_behind_comes_to_the_thread_when_that_is_free_and_its_clock_begins_then():
    first, second = task("tcp://a", 1, short=True), task("tcp://a", 2, short=True, behind=True, since_s=0.0)
    found = add_tasks(first, second)
    found.advance(THREADS)
    assert second.behind
    found.remove(first)
    found.advance(THREADS)
    assert not second.behind
    assert time.monotonic() - second.since_s < 60
    assert found.held() == {(2, 1)}


def test_nothing_comes_to_the_thread_of_a_worker_that_is_gone():
    first, second = task("tcp://a", 1, short=True), task("tcp://a", 2, short=True, behind=True)
    found = add_tasks(first, second)
    found.remove(first)
    found.advance({"tcp://b": 2})
    assert second.behind


def test_what_waits_too_long_behind_another_is_overdue():
    found = add_tasks(task("tcp://a", 1, short=True), task("tcp://a", 2, short=True, behind=True, since_s=-1e6))
    assert [one.members for one in found.overdue(10.0)] == [{(2, 1)}]
    assert found.overdue(1e12) == []


def test_a_run_that_shares_its_task_has_the_time_of_its_group_to_answer():
    now_s = time.monotonic()
    alone = task("tcp://a", 1, asked_s={(1, 1): now_s}, since_s=now_s - 100)
    grouped = task("tcp://a", 1, short=True, expected_s=2.0, asked_s={(1, 1): now_s - 3}, since_s=now_s - 1)
    assert 0 <= alone.unanswered_s((1, 1)) < 1
    assert grouped.unanswered_s((1, 1)) < 0  # it came to its thread a second ago


SMALL, LARGE = TimedRun(stars=5_000, seconds=0.4), TimedRun(stars=300_000, seconds=3.0)


@pytest.fixture
def read(monkeypatch):
    asked = []
    monkeypatch.setattr(dispatcher, "list_timed_runs", lambda _session, method: asked.append(method) or [SMALL, LARGE])
    monkeypatch.setattr(dispatcher, "estimate_seconds_per_star", lambda _session, _method: 1e-5)
    return asked


def one_waiting(stars, **settings):
    return WaitingRun(1, 0, "batch", CalibrationSettings(**settings), 200, stars)


@pytest.mark.parametrize(("stars", "seconds"), [(6_000, 0.48), (250_000, 2.5), (40_000, 0.42)])
def test_runs_of_about_the_same_size_are_asked_first_and_all_only_where_there_are_none(read, stars, seconds):
    known = DurationModel()
    known.refresh(None, {"batch"})
    assert known.seconds(one_waiting(stars)) == pytest.approx(seconds)
    assert read == ["batch"]


def test_a_replay_takes_as_long_as_its_frames_whatever_others_of_its_size_took(read):
    known = DurationModel()
    known.refresh(None, {"batch"})
    assert read
    assert known.seconds(one_waiting(5_000, replay_frames_per_s=10.0)) > 20.0


def test_what_runs_took_is_read_anew_after_a_while(read, monkeypatch):
    known, clock = DurationModel(), [0.0]
    monkeypatch.setattr(dispatcher.time, "monotonic", lambda: clock[0])
    for now_s in (0.0, FRESH_S - 1, FRESH_S + 1):
        clock[0] = now_s
        known.refresh(None, {"batch"})
    assert read == ["batch", "batch"]


@given(
    count=st.integers(1, 60),
    seconds=st.sampled_from([None, 1e-4, 0.01, 0.2, 3.0]),
    fates=st.lists(st.sampled_from(["done", "lost", "late"]), max_size=80),
)
def test_every_piece_has_its_result_once_whatever_becomes_of_the_groups(count, seconds, fates):
    pieces = Pieces(count, seconds)
    late = []
    for fate in [*fates, *["done"] * 4 * count]:
        group = pieces.take(2, returned=True)
        if not group:
            break
        if fate == "done":
            pieces.settle(group, [10 * place for place in group], 0.1)
        else:
            pieces.give_back(group)
            late.extend([group] if fate == "late" else [])
    for group in late:
        pieces.settle(group, [10 * place for place in group], 0.1)
    assert pieces.complete
    assert pieces.results() == [10 * place for place in range(count)]


def test_a_group_lasts_half_a_second_and_the_last_ones_less():
    pieces = Pieces(1000, seconds=0.01)
    sizes = []
    while group := pieces.take(2):
        sizes.append(len(group))
    assert sum(sizes) == 1000
    assert sizes[0] == PIECES_S / 0.01
    assert max(sizes) == sizes[0]
    assert sizes[-1] < sizes[0] / 5


@pytest.mark.parametrize("takers", [1, 2, 3])
def test_nobody_takes_more_than_a_share_of_half_of_what_is_left(takers):
    assert len(Pieces(100, seconds=0.004).take(takers)) == math.ceil(100 / (2 * takers))


def test_the_first_group_of_something_never_timed_is_one_piece():
    assert Pieces(100).take(1) == (0,)


def test_a_piece_that_was_lost_goes_only_to_who_asks_for_such():
    pieces = Pieces(1)
    pieces.give_back(pieces.take(1))
    assert pieces.take(1) == ()
    assert pieces.take(1, returned=True) == (0,)


def test_what_the_first_broken_piece_raised_is_raised_though_a_later_one_broke_before():
    pieces = Pieces(4)
    groups = [pieces.take(1) for _ in range(4)]
    pieces.settle(groups[2], [FailedPiece(KeyError("later"))], 0.1)
    assert not pieces.complete
    pieces.settle(groups[1], [FailedPiece(ValueError("first"))], 0.1)
    pieces.settle(groups[0], [1], 0.1)
    assert pieces.complete
    with pytest.raises(ValueError, match="first"):
        pieces.results()


def test_nothing_behind_a_broken_piece_is_given_out():
    pieces = Pieces(50)
    first, second = pieces.take(1), pieces.take(1)
    pieces.settle(second, [FailedPiece(ValueError())], 0.1)
    assert pieces.take(1) == ()
    pieces.give_back(first)
    assert pieces.take(1, returned=True) == first


def test_nothing_is_given_out_when_all_is_over():
    pieces = Pieces(50)
    pieces.close()
    assert pieces.take(1, returned=True) == ()
