"""What a waiting run will take is foreseen from runs of its size, and read anew only every few seconds."""

import pytest

from boresight.console.runs.dry_runs import TimedRun
from boresight.console.runs.queries import WaitingRun
from boresight.workers import dispatcher as paces
from boresight.workers.dispatcher import FRESH_S, DurationModel

SMALL, LARGE = TimedRun(stars=5_000, seconds=0.4), TimedRun(stars=300_000, seconds=3.0)


@pytest.fixture
def read(monkeypatch):
    asked = []
    monkeypatch.setattr(paces, "list_timed_runs", lambda _session, method: asked.append(method) or [SMALL, LARGE])
    monkeypatch.setattr(paces, "estimate_seconds_per_star", lambda _session, _method: 1e-5)
    return asked


def waiting(stars, **settings):
    return WaitingRun(1, 0, "batch", settings, 200, stars)


@pytest.mark.parametrize(("stars", "seconds"), [(6_000, 0.48), (250_000, 2.5), (40_000, 0.42)])
def test_runs_of_about_the_same_size_are_asked_first_and_all_only_where_there_are_none(read, stars, seconds):
    known = DurationModel()
    known.refresh(None, {"batch"})
    assert known.seconds(waiting(stars)) == pytest.approx(seconds)
    assert read == ["batch"]


def test_a_replay_takes_as_long_as_its_frames_whatever_others_of_its_size_took(read):
    known = DurationModel()
    known.refresh(None, {"batch"})
    assert read
    assert known.seconds(waiting(5_000, replay_frames_per_s=10.0)) > 20.0


def test_what_runs_took_is_read_anew_after_a_while(read, monkeypatch):
    known, clock = DurationModel(), [0.0]
    monkeypatch.setattr(paces.time, "monotonic", lambda: clock[0])
    for now_s in (0.0, FRESH_S - 1, FRESH_S + 1):
        clock[0] = now_s
        known.refresh(None, {"batch"})
    assert read == ["batch", "batch"]
