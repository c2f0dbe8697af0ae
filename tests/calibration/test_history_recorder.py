"""A filter's history in constant memory: however it comes and wherever it is kept, it says the same."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.calibration import history_recorder as courses
from boresight.calibration.history_recorder import FilterCourse
from boresight.estimation.filters.history import FilterHistory, start
from boresight.estimation.metrics import aggregate_rms


def history(n, seed=3):
    rng = np.random.default_rng(seed)
    state = start(np.arange(8.0), 5, 2.0)
    return FilterHistory(
        rng.normal(size=(n, 8)), rng.uniform(size=(n, 5)), rng.chisquare(9, n), rng.integers(5, 20, n),
        rng.uniform(size=n), rng.integers(1, 6, n), state, finite=True,
    )  # fmt: skip


def cut(whole, first, last):
    names = ("states", "sigmas", "nis", "dof", "sum_of_squares", "linearisations")
    return FilterHistory(**{name: getattr(whole, name)[first:last] for name in names}, last=whole.last, finite=True)


def course_of(whole, seams=()):
    edges = [0, *sorted(seams), len(whole.nis)]
    found = FilterCourse(whole.last)
    for first, last in itertools.pairwise(edges):
        found.append(cut(whole, first, last), 10 * np.arange(first, last))
    return found


@given(st.lists(st.integers(0, 60), max_size=6))
def test_seams_between_its_parts_change_no_bit(seams):
    whole = history(60)
    once, parts = course_of(whole), course_of(whole, seams)
    assert (once.nis_sum, once.dof_sum, once.linearisations_sum) == (
        parts.nis_sum,
        parts.dof_sum,
        parts.linearisations_sum,
    )
    every = np.arange(60)
    assert once.taken(every).tobytes() == parts.taken(every).tobytes()


def test_it_holds_what_the_filter_gave_and_the_running_rms():
    whole = history(50)
    kept = course_of(whole, (7,))
    records = kept.taken(np.array([0, 8, 49]))
    np.testing.assert_array_equal(records["states"], whole.states[[0, 8, 49]])
    np.testing.assert_array_equal(records["frame"], [0, 80, 490])
    running = aggregate_rms(whole.sum_of_squares, whole.dof.astype(float))
    np.testing.assert_array_equal(kept.column("aggregate_rms"), running)
    assert kept.nis_sum == pytest.approx(whole.nis.sum(), rel=1e-14)


def test_a_long_one_goes_to_a_file_and_reads_the_same(monkeypatch):
    whole = history(500)
    small = course_of(whole)
    monkeypatch.setattr(courses, "IN_MEMORY_BYTES", 4000)
    monkeypatch.setattr(courses, "CHUNK", 64)
    large = course_of(whole, (100, 300))
    assert large._file._rolled
    places = np.array([0, 63, 64, 65, 499])
    assert large.taken(places).tobytes() == small.taken(places).tobytes()


@given(st.sets(st.integers(0, 99), max_size=12), st.sampled_from([7, 64, 1000]))
def test_no_peak_is_lost_between_the_points_that_are_kept(places, chunk):
    whole = history(100)
    places = np.array(sorted(places | {99}))
    kept = course_of(whole)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(courses, "CHUNK", chunk)
        peaks = kept.peaks(places)
    for k, first in enumerate([0, *(places[:-1] + 1)]):
        part = slice(first, places[k] + 1)
        worst = first + int(np.argmax(whole.nis[part] / whole.dof[part]))
        assert (peaks.nis[k], peaks.dof[k], peaks.frame[k]) == (whole.nis[worst], whole.dof[worst], 10 * worst)
        np.testing.assert_array_equal(peaks.low[k], whole.states[part].min(axis=0))
        np.testing.assert_array_equal(peaks.high[k], whole.states[part].max(axis=0))


def test_the_updates_of_some_frames_are_a_course_of_their_own():
    whole = history(40)
    part = course_of(whole).of_frames(np.array([30, 70, 390]))
    assert len(part) == 3
    np.testing.assert_array_equal(part.nis, whole.nis[[3, 7, 39]])
