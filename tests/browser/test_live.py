"""A filter that computes draws itself: from the points that its events carry, not by fetching the figure again and again."""

import itertools
import re

import pytest

pytestmark = pytest.mark.browser

SINGLE = 1e-5


def test_curves_grow_from_the_events_without_the_figure_being_fetched_again(watched):
    pairs = itertools.pairwise(zip(watched.lengths, watched.fetched, strict=True))
    assert any(longer > shorter and later == earlier for (shorter, earlier), (longer, later) in pairs)


def test_what_was_drawn_from_events_is_what_the_server_draws(watched):
    compared = 0
    for drawn, whole in zip(watched.drawn, watched.fetched_anew, strict=True):
        half = len(drawn["x"]) // 2 if drawn["fill"] == "toself" else len(drawn["x"])
        expected = dict(zip(whole["x"], whole["y"], strict=True)) if half == len(drawn["x"]) else None
        if expected is None:  # of an outline the upper edge comes first
            expected = dict(zip(whole["x"][: len(whole["x"]) // 2], whole["y"], strict=False))
        for x, y in zip(drawn["x"][:half], drawn["y"][:half], strict=True):
            if x in expected and y is not None and len(drawn["x"]) > 2:
                assert y == pytest.approx(expected[x], rel=SINGLE, abs=1e-4, nan_ok=True)
                compared += 1
    assert compared > 10 * max(watched.lengths)


def test_a_running_filter_says_its_pace_what_is_left_and_when_it_was_last_heard_of(watched):
    said = watched.said[-1]
    assert re.search(r"\d+\.\d frames/s, about \d.* left", said)
    assert "attempt 1" in said
    assert re.search(r"last event \d+\Ws ago", said)


def test_the_log_follows_and_a_stop_keeps_its_reason(watched):
    assert re.search(r"\d+ %: frame \d+: \d+ of 100 frames", watched.log)
    assert "Cancelled by Ada Analyst: Seen enough." in watched.at_the_end
    assert "PARTIAL: It had come to" in watched.at_the_end


def test_the_log_stays_where_somebody_reads_and_rests_while_it_is_paused(watched):
    assert watched.scrolled_px == 0
    assert watched.paused_lines[0] == watched.paused_lines[1]
