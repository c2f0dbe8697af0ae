"""Passes together beside single runs, small: what is told, and one worker and two the same."""

import pytest

from benchmarks import joint


@pytest.mark.full
def test_a_small_joint_calibration_is_measured_and_one_worker_and_two_say_the_same():
    found = joint.measure(lambda *_: None, passes=4, frames=60)
    assert found["limits"]["numbers that differ between one worker and two"]["kept"]
    assert found["joint_peak_mb"] > 50.0
    assert found["joint_s"] > 0.0
    assert found["singles_s"] > 0.0
    assert (found["passes"], found["quarter_passes"]) == (4, 2)
