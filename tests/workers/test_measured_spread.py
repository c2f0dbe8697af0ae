"""The measurement of a batch over two workers, in small: what it compares is the same to the last bit, kill or no kill."""

from __future__ import annotations

import pytest

from boresight.calibration.source import LARGE_ROWS
from boresight.measurements.spread import measure
from boresight.measurements.synthetic_file import EXPOSURES, STARS

FRAMES = 1 + LARGE_ROWS // (EXPOSURES * STARS)  # the fewest that are spread


@pytest.fixture(scope="module")
def measured():
    """Measure once."""
    told = []
    found = measure(lambda fraction, message: told.append((fraction, message)), frames=FRAMES)
    assert told == sorted(told)
    return found


def test_one_worker_two_and_two_of_which_one_is_killed_find_the_same_bits(measured):
    assert measured["same_bits"] == {"one_worker": True, "two_workers": True, "one_of_two_killed": True}
    assert set(measured["largest_difference_sigma"].values()) == {0.0}


def test_the_second_worker_took_part(measured):
    assert measured["runs"]["two_workers"]["cpu_s"]["worker_2"] > 0.1


def test_the_ratio_is_that_of_the_times_and_the_promise_is_held_against_it(measured):
    runs = measured["runs"]

    assert measured["ratio"] == runs["one_worker"]["seconds"] / runs["two_workers"]["seconds"]
    assert measured["limits"]["two_workers_over_one"]["kept"] == (measured["ratio"] >= 1.6)
