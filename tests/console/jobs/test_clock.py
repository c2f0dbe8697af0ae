"""A jump of the clock lets no request expire before a person has seen it; the clocks are injected, nobody sleeps."""

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from boresight.console import list_queries as lists
from boresight.console import transitions
from boresight.console.alarms import rules as clock
from boresight.console.alarms import service as alarms
from boresight.console.alarms.tables import Alarm
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval
from boresight.console.jobs.heartbeat import Heartbeat
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.platform.actors import Actor, Policy
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.passwords import approve

AT_ONCE = Policy(approval_days=0.0, rollback_days=0.0)
DAY_S = 86_400.0
PASSWORD = "correct horse battery"


class Hands:
    def __init__(self) -> None:
        self.wall_s, self.steady_s = 1.8e9, 1000.0

    def pass_by(self, seconds: float) -> None:
        self.wall_s += seconds
        self.steady_s += seconds


@pytest.fixture
def hands(monkeypatch: pytest.MonkeyPatch) -> Hands:
    hands = Hands()
    monkeypatch.setattr(clock, "OURS", clock.Clock(lambda: hands.wall_s, lambda: hands.steady_s))
    return hands


@pytest.fixture
def due(
    engine: Engine, people: Mapping[str, Actor], blobs: BlobStore, candidate: Callable[..., ParameterSet]
) -> Approval:
    row = candidate()
    with open_writing(engine) as session:
        return approvals.submit(session, people["ana"], blobs, row.id, "better", row.version, policy=AT_ONCE)


def _state(engine: Engine, approval: Approval) -> str:
    with open_reading(engine) as session:
        return transitions.get_approval(session, approval.id).state


def _alarm(engine: Engine) -> Alarm | None:
    with open_reading(engine) as session:
        return next((row for row in alarms.list_alarms(session) if row.kind == "CLOCK"), None)


@pytest.mark.parametrize("jump_s", [40 * DAY_S, -40 * DAY_S])
def test_a_jump_expires_no_request_before_somebody_has_acknowledged_it(
    engine: Engine, people: Mapping[str, Actor], due: Approval, hands: Hands, jump_s: float
) -> None:
    heart = Heartbeat(engine, lambda: None)
    hands.wall_s += jump_s
    for _ in range(3):
        heart.beat()
        hands.pass_by(5.0)
    row = _alarm(engine)
    assert row is not None
    assert (_state(engine, due), row.level, row.version) == ("OPEN", "serious", 1)
    with open_writing(engine) as session:
        alarms.acknowledge(session, people["ana"], row.id, "GPS was lost; the clock is right.", row.version)
    heart.beat()
    heart.beat()
    assert (_state(engine, due), _alarm(engine)) == ("EXPIRED", None)


def test_whoever_signs_between_the_jump_and_the_next_beat_finds_the_request_open(
    engine: Engine, people: Mapping[str, Actor], due: Approval, hands: Hands
) -> None:
    hands.wall_s += 40 * DAY_S
    with open_writing(engine) as session:
        approve(session, people["cy"], due)
    assert _state(engine, due) == "APPROVED"


@pytest.mark.usefixtures("due")
def test_a_request_that_a_jump_would_let_expire_still_waits_for_who_may_sign_it(
    engine: Engine, people: Mapping[str, Actor], hands: Hands
) -> None:
    def waiting() -> int:
        with open_reading(engine) as session:
            return lists.count(session, "approvals", {"open_to": approvals.signatory(session, people["cy"])})

    assert waiting() == 0
    hands.wall_s += 40 * DAY_S
    assert waiting() == 1


def test_time_that_passes_and_small_corrections_are_no_jump(engine: Engine, due: Approval, hands: Hands) -> None:
    hands.pass_by(40 * DAY_S)
    hands.wall_s += 2.0
    Heartbeat(engine, lambda: None).beat()
    assert (_state(engine, due), _alarm(engine)) == ("EXPIRED", None)


def test_a_server_that_was_last_seen_long_ago_asks_before_anything_expires(
    engine: Engine, due: Approval, hands: Hands, tmp_path: Path
) -> None:
    seen = tmp_path / "last-seen"
    seen.write_text(str(hands.wall_s - 2 * DAY_S))
    Heartbeat(engine, lambda: None, seen).beat()
    assert (_state(engine, due), _alarm(engine) is not None) == ("OPEN", True)


def test_a_restart_after_a_short_while_asks_nothing(
    engine: Engine, due: Approval, hands: Hands, tmp_path: Path
) -> None:
    seen = tmp_path / "last-seen"
    seen.write_text(str(hands.wall_s - 3600.0))
    Heartbeat(engine, lambda: None, seen).beat()
    assert (_state(engine, due), _alarm(engine)) == ("EXPIRED", None)
