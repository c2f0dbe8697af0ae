"""A small version of the measurement tells every step, and its limit is judged at full size only."""

from __future__ import annotations

import pytest

from boresight.measurements.whole_calibration import measure


@pytest.fixture(scope="module")
def found():
    heard = []
    return measure(lambda fraction, message: heard.append((fraction, message)), frames=60, small_frames=20), heard


def test_every_step_is_told_and_they_add_up_to_the_whole(found):
    for name in ("given", "small", "rematch"):
        part = found[0][name]
        assert part["status"] == "converged"
        assert set(part["steps_s"]) == {"reading", "arcs", "fit", "judging", "writing"}
        assert sum(part["steps_s"].values()) == pytest.approx(part["total_s"], rel=0.2)


def test_the_fit_in_c_counts_the_evaluations_of_the_fit_alone(found):
    given = found[0]["given"]
    assert 4 <= given["evaluations"] <= 40
    if "c_fit_s" in given:
        assert given["over_c_fit"] == pytest.approx(given["total_s"] / given["c_evaluation_s"] / given["evaluations"])


def test_one_weighing_and_one_thread_are_told_beside_the_whole_and_rematch_has_its_figure(found):
    given, rematch = found[0]["given"], found[0]["rematch"]
    assert 2 <= given["evaluations_of_one_weighing"] < given["evaluations"]
    assert given["threads"] >= 1
    assert given["one_thread_s"] > 0
    if "c_fit_s" in given:
        assert given["over_one_weighing"] > given["over_c_fit"]
        assert rematch["over_c_fit"] == pytest.approx(rematch["total_s"] / given["c_fit_s"])
    assert set(found[0]["limits"]) == {"over_c_fit"}


def test_a_small_set_is_not_held_against_the_limit(found):
    assert found[0]["limits"]["over_c_fit"]["kept"] is None
    assert found[1][-1] == (1.0, "done")
