"""What a kill shows is said: a run that ended before it, or that lost no pieces by it, keeps no promise."""

import time
from types import SimpleNamespace

import pytest

from boresight.measurements import spread

DOCUMENT = {"free": ["f_m"], "parameters": {"f_m": 1.0}, "sigma": {"f_m": 0.1}} | {
    key: 1 for key in spread.ESTIMATE if key not in {"parameters", "sigma"}
}
KILL = {"worker": "tcp://one", "happened": True, "after_s": 3.0, "groups_done": 4, "groups_in_hand": 2}


def _held(**changed):
    runs = {name: {"seconds": 2.0, "document": DOCUMENT} for name in ("one_worker", "two_workers", "one_of_two_killed")}
    runs["one_of_two_killed"]["kill"] = KILL | changed
    return spread._found(100, runs)["limits"]["answer_of_one_of_two_killed"]


def test_an_answer_after_a_kill_whose_pieces_were_taken_over_keeps_its_promise():
    assert _held()["kept"]
    assert "why" not in _held()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"happened": False, "after_s": None}, "ended before its worker was to be killed"),
        ({"groups_in_hand": 0}, "no pieces when it was killed"),
    ],
)
def test_a_kill_that_shows_nothing_keeps_no_promise_and_says_why(changed, words):
    assert _held(**changed)["kept"] is False
    assert words in _held(**changed)["why"]


class _Client:
    """A cluster whose worker has computed ten groups, and two more each time it is asked."""

    def __init__(self):
        self.done = 8

    def run(self, function, workers):
        self.done += 2
        state = SimpleNamespace(executed_count=self.done, executing={"a"}, ready=["b"])
        return {workers[0]: function(SimpleNamespace(state=state))}


def test_a_worker_is_killed_once_at_its_time_and_what_it_had_is_told(monkeypatch):
    killed = []
    monkeypatch.setattr(spread.os, "kill", lambda pid, signal: killed.append((pid, signal)))
    began_s = time.perf_counter()
    late = spread.Kill(_Client(), "tcp://one", 7, began_s + 1000.0)
    now = spread.Kill(_Client(), "tcp://one", 7, began_s)
    for _ in range(3):
        late.look()
        now.look()

    assert killed == [(7, spread.signal.SIGKILL)]
    assert not late.told(began_s)["happened"]
    told = now.told(began_s)
    assert (told["worker"], told["groups_done"], told["groups_in_hand"]) == ("tcp://one", 2, 2)
    assert 0 <= told["after_s"] < 100
