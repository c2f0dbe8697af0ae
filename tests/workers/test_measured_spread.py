"""The measurement of a batch over two workers, in small: what it compares is the same to the last bit, kill or no kill."""

import time
from types import SimpleNamespace

import pytest

from benchmarks import spread
from benchmarks.stars import EXPOSURES_A_FRAME, STARS
from boresight.calibration.telemetry_pieces import LARGE_ROWS

FRAMES = 1 + LARGE_ROWS // (EXPOSURES_A_FRAME * STARS)  # the fewest that are spread
DOCUMENT = {"free": ["f_m"], "parameters": {"f_m": 1.0}, "sigma": {"f_m": 0.1}} | {
    key: 1 for key in spread.ESTIMATE if key not in {"parameters", "sigma"}
}
KILL = {"worker": "tcp://one", "happened": True, "after_s": 3.0, "groups_done": 4, "groups_in_hand": 2}


def test_one_worker_two_and_two_of_which_one_is_killed_find_the_same_bits():
    found = spread.measure(lambda *_: None, frames=FRAMES)
    runs = found["runs"]
    assert found["same_bits"] == {"one_worker": True, "two_workers": True, "one_of_two_killed": True}
    assert set(found["largest_difference_sigma"].values()) == {0.0}
    assert runs["two_workers"]["cpu_s"]["worker_2"] > 0.1  # it took part
    assert found["ratio"] == runs["one_worker"]["seconds"] / runs["two_workers"]["seconds"]


@pytest.mark.parametrize(
    ("changed", "kept"), [({}, True), ({"happened": False, "after_s": None}, False), ({"groups_in_hand": 0}, False)]
)
def test_a_kill_that_shows_nothing_keeps_no_promise_and_says_why(changed, kept):
    runs = {name: {"seconds": 2.0, "document": DOCUMENT} for name in ("one_worker", "two_workers", "one_of_two_killed")}
    runs["one_of_two_killed"]["kill"] = KILL | changed
    limit = spread._found(100, runs)["limits"]["answer_of_one_of_two_killed"]
    assert limit["kept"] is kept
    assert ("why" in limit) is not kept


class _Client:
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
    late, now = (spread.Kill(_Client(), "tcp://one", 7, began_s + after_s) for after_s in (1000.0, 0.0))
    for _ in range(3):
        late.look()
        now.look()
    assert killed == [(7, spread.signal.SIGKILL)]
    assert not late.told(began_s)["happened"]
    told = now.told(began_s)
    assert (told["worker"], told["groups_done"], told["groups_in_hand"]) == ("tcp://one", 2, 2)
