"""Requests that wait too long, and the way back: a request of its own kind with less time."""

from collections.abc import Callable, Mapping
from datetime import datetime

import pytest

from boresight.console import transitions
from boresight.console.approvals import service as approvals
from boresight.console.approvals import staleness
from boresight.console.approvals.tables import Approval
from boresight.console.jobs.heartbeat import Heartbeat
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.errors import ConflictError, ForbiddenError
from boresight.platform.actors import POLICY, Actor, Policy
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.passwords import approve

PASSWORD = "correct horse battery"
AT_ONCE = Policy(approval_days=0.0, rollback_days=0.0)
People = Mapping[str, Actor]
Ask = Callable[..., Approval]


@pytest.fixture
def ask(engine: Engine, people: People, blobs: BlobStore, candidate: Callable[..., ParameterSet]) -> Ask:
    def make(policy: Policy = POLICY) -> Approval:
        row = candidate()
        with open_writing(engine) as session:
            return approvals.submit(session, people["ana"], blobs, row.id, "better", row.version, policy=policy)

    return make


def _sign(engine: Engine, actor: Actor, approval: Approval) -> None:
    with open_writing(engine) as session:
        approve(session, actor, approval)


def _states(engine: Engine, approval: Approval) -> tuple[str, str]:
    with open_reading(engine) as session:
        row = transitions.get_approval(session, approval.id)
        return row.state, transitions.get_parameter_set(session, row.parameter_set_id).ground_state


def _days(approval: Approval) -> float:
    until, since = (datetime.fromisoformat(text or "") for text in (approval.expires_utc, approval.submitted_utc))
    return round((until - since).total_seconds() / 86400, 3)


def test_whoever_signs_too_late_finds_the_request_expired(engine: Engine, people: People, ask: Ask) -> None:
    approval = ask(AT_ONCE)
    with open_reading(engine) as session:
        assert "expired at" in str(approvals.why_not_sign(session, people["cy"], approval.id))
    with pytest.raises(ConflictError, match=r"Request 1 expired at 20.* Submit PS-ST16-1-1 again"):
        _sign(engine, people["cy"], approval)
    assert _states(engine, approval) == ("EXPIRED", "EXPIRED")


def test_the_heartbeat_lets_expire_what_nobody_decided_and_tells_of_it_once(engine: Engine, ask: Ask) -> None:
    waiting, late, told = ask(), ask(AT_ONCE), []
    heart = Heartbeat(engine, lambda: told.append("told"))
    heart.beat()
    heart.beat()
    assert (_states(engine, waiting), _states(engine, late)) == (("OPEN", "SUBMITTED"), ("EXPIRED", "EXPIRED"))
    assert told == ["told"]
    with open_reading(engine) as session:
        record = audit.last_change(session, f"approvals/{late.id}")
        assert record is not None
        assert (record.actor, record.action) == ("Boresight", "let expire")
        assert str(late.expires_utc) in str(record.reason)


def test_the_heartbeat_beats_by_itself_and_stops(engine: Engine, ask: Ask) -> None:
    late = ask(AT_ONCE)
    heart = Heartbeat(engine, lambda: None)
    heart.start()
    heart.close()
    heart.close()
    assert _states(engine, late) == ("EXPIRED", "EXPIRED")


def test_an_approval_that_nobody_used_in_time_promotes_nothing(
    engine: Engine, people: People, ask: Ask, monkeypatch: pytest.MonkeyPatch
) -> None:
    approval = ask()
    _sign(engine, people["cy"], approval)
    monkeypatch.setattr("boresight.console.approvals.staleness.utc_now", lambda: "2999-01-01T00:00:00.000000Z")
    with open_writing(engine) as session, pytest.raises(ConflictError, match="expired at"):
        approvals.promote(session, people["dee"], approval.parameter_set_id, 3)
    assert _states(engine, approval) == ("EXPIRED", "EXPIRED")


def test_what_expired_may_be_submitted_again_and_what_was_promoted_never_expires(
    engine: Engine, people: People, blobs: BlobStore, ask: Ask, monkeypatch: pytest.MonkeyPatch
) -> None:
    late, used = ask(AT_ONCE), ask()
    _sign(engine, people["cy"], used)
    with open_writing(engine) as session:
        staleness.expire_due_requests(session)
        row = transitions.get_parameter_set(session, late.parameter_set_id)
        approvals.submit(session, people["ana"], blobs, row.id, "once more", row.version)
        approvals.promote(session, people["dee"], used.parameter_set_id, 3)
    monkeypatch.setattr("boresight.console.approvals.staleness.utc_now", lambda: "2999-01-01T00:00:00.000000Z")
    with open_writing(engine) as session:
        assert staleness.expire_due_requests(session) == []
    assert _states(engine, used) == ("APPROVED", "BASELINE")


def test_an_operator_asks_to_roll_back_to_a_former_baseline_in_less_time(
    engine: Engine, people: People, blobs: BlobStore, ask: Ask
) -> None:
    approval = ask()
    _sign(engine, people["cy"], approval)
    with open_writing(engine) as session:
        approvals.promote(session, people["dee"], approval.parameter_set_id, 3)
        ground = parameter_sets.list_parameter_sets(session, ground_state="SUPERSEDED")[0]
        back = approvals.roll_back(session, people["dee"], blobs, ground.id, "it drifts", ground.version)
    assert (approval.kind, _days(approval)) == ("PROMOTION", 30.0)
    assert (back.kind, _days(back), back.submitted_by) == ("ROLLBACK", 3.0, people["dee"].user_id)
    _sign(engine, people["cy"], back)
    with open_writing(engine) as session:
        row = transitions.get_parameter_set(session, ground.id)
        assert approvals.promote(session, people["dee"], row.id, row.version).ground_state == "BASELINE"
        record = audit.last_change(session, f"parameter-sets/{ground.id}")
        assert record is not None
        assert (record.action, (record.after or {})["kind"]) == ("promoted", "ROLLBACK")


def test_a_roll_back_that_expired_stays_superseded(engine: Engine, people: People, blobs: BlobStore, ask: Ask) -> None:
    approval = ask()
    _sign(engine, people["cy"], approval)
    with open_writing(engine) as session:
        approvals.promote(session, people["dee"], approval.parameter_set_id, 3)
        ground = parameter_sets.list_parameter_sets(session, ground_state="SUPERSEDED")[0]
        asked = (blobs, ground.id, "it drifts", ground.version)
        back = approvals.roll_back(session, people["dee"], *asked, policy=AT_ONCE)
        staleness.expire_due_requests(session)
    assert _states(engine, back) == ("EXPIRED", "SUPERSEDED")


def test_there_is_no_way_back_to_what_never_was_baseline(
    engine: Engine, people: People, blobs: BlobStore, candidate: Callable[..., ParameterSet]
) -> None:
    row = candidate()
    with open_writing(engine) as session, pytest.raises(ConflictError, match="was never baseline"):
        approvals.roll_back(session, people["dee"], blobs, row.id, "it drifts", row.version)
    with open_writing(engine) as session, pytest.raises(ForbiddenError, match="analyst or operator"):
        approvals.roll_back(session, people["cy"], blobs, row.id, "it drifts", row.version)
