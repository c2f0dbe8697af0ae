"""Rounds: every step in each round whatever befalls another, at once when nudged, and none after the close."""

import threading

import pytest

from boresight.platform.jobs.periodic_thread import PeriodicThread

LONG_S = 1000.0


def test_a_step_that_fails_is_logged_and_tried_again_and_the_others_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(
        "boresight.platform.jobs.periodic_thread.log.exception", lambda words, *names: said.append(words % names)
    )
    taken: list[str] = []
    twice = threading.Event()

    def fail() -> None:
        taken.append("failed")
        raise OSError("no disk")

    def go() -> None:
        taken.append("went")
        if len(taken) > 3:
            twice.set()

    rounds = PeriodicThread("errand", [fail, go], lambda: 0.001)
    rounds.start()
    assert twice.wait(10)
    rounds.close()
    assert taken[:4] == ["failed", "went"] * 2
    assert set(said) == {"The errand failed and is tried again"}


def test_a_nudge_begins_the_next_round_at_once_and_a_close_ends_the_thread() -> None:
    taken = threading.Semaphore(0)
    rounds = PeriodicThread("errand", [taken.release], lambda: LONG_S)
    rounds.start()
    assert taken.acquire(timeout=10)
    rounds.nudge()
    assert taken.acquire(timeout=10)
    rounds.close()
    rounds.close()
    assert rounds.closing
    assert not any(thread.name == "boresight-errand" for thread in threading.enumerate())
    assert not taken.acquire(blocking=False)


def test_what_was_closed_can_start_again() -> None:
    taken = threading.Semaphore(0)
    rounds = PeriodicThread("errand", [taken.release], lambda: LONG_S)
    for _ in range(2):
        rounds.start()
        assert taken.acquire(timeout=10)
        rounds.close()
