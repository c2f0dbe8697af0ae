"""Approvals: a second person, in person, on what was shown; one refusal blocks."""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime

import pytest
import sqlalchemy as sa

from boresight.console import list_queries as lists
from boresight.console.access import api_keys, users
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.approvals import staleness
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.jobs.heartbeat import Heartbeat
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.console.uplinks.tables import TableDefinition
from boresight.errors import (
    ConflictError,
    ForbiddenError,
    NotFoundError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
    UnauthenticatedError,
)
from boresight.platform.actors import COMMAND_LINE, POLICY, SYSTEM, Actor, Policy
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_now
from tests.console.conftest import PASSWORD
from tests.passwords import proved
from tests.refusals import has_code

People = Mapping[str, Actor]


@pytest.fixture
def submit_request(engine, people, candidate, blobs) -> Callable[..., Approval]:
    def make(submitted_by: str = "ana", launched_by: str = "ana", policy: Policy = POLICY) -> Approval:
        row = candidate(launched_by)
        with open_writing(engine) as session:
            asked = (blobs, row.id, "better", row.version)
            return approvals.submit(session, people[submitted_by], *asked, policy=policy)

    return make


@pytest.fixture
def roll_back(engine, people, blobs) -> Callable[..., Approval]:
    def make(actor: str = "dee", **given: object) -> Approval:
        with open_writing(engine) as session:
            ground = session.scalars(sa.select(ParameterSet).where(ParameterSet.number == 0)).one()
            return approvals.roll_back(session, people[actor], blobs, ground.id, "it drifts", ground.version, **given)

    return make


def _sign(engine: Engine, actor: Actor, approval: Approval, decision: str = "APPROVE", **changes: object) -> Signature:
    values = {
        "meaning": "I decide",
        "comment": "seen",
        "password": PASSWORD,
        "seen_version": approval.version,
    } | changes
    with open_writing(engine) as session:
        values["proof"] = proved(session, actor, str(values.pop("password")))
        decided = approvals.Decision(decision, values.pop("meaning"), values.pop("comment"))
        return approvals.sign(session, actor, approval.id, decided, **values)


def _states(engine: Engine, approval: Approval) -> tuple[str, str]:
    with open_reading(engine) as session:
        row = session.get_one(Approval, approval.id)
        return row.state, session.get_one(ParameterSet, row.parameter_set_id).ground_state


def test_one_approval_by_a_second_person_approves(engine, people, submit_request):
    approval = submit_request()
    signature = _sign(engine, people["cy"], approval)
    assert _states(engine, approval) == ("APPROVED", "APPROVED")
    assert (signature.printed_name, signature.decision, signature.meaning) == ("Cy", "APPROVE", "I decide")
    assert signature.shown_sha256 == staleness.compute_binding_sha256(approval)
    with open_reading(engine) as session:
        assert [row.id for row in approval_queries.list_signatures(session, approval.id)] == [signature.id]
        assert audit.verify(session).ok


def test_one_refusal_blocks(engine, people, submit_request, blobs):
    approval = submit_request()
    _sign(engine, people["cy"], approval, "REFUSE", comment="too few stars at the rim")
    assert _states(engine, approval) == ("REJECTED", "REJECTED")
    with open_reading(engine) as session:
        row = session.get_one(ParameterSet, approval.parameter_set_id)
        record = audit.find_last_change(session, f"parameter-sets/{row.id}")
    assert "too few stars at the rim" in str(record.reason)
    with (
        open_writing(engine) as session,
        pytest.raises(ConflictError, match="REJECTED: Cy", check=has_code("wrong-state")),
    ):
        approvals.submit(session, people["ana"], blobs, row.id, "once more", row.version)


def test_a_refusal_stops_even_what_another_approved(engine, people, submit_request):
    approval = submit_request()
    _sign(engine, people["cy"], approval)
    with pytest.raises(ConflictError, match="is APPROVED"):
        _sign(engine, people["bo"], approval, seen_version=2)
    _sign(engine, people["bo"], approval, "REFUSE", seen_version=2)
    assert _states(engine, approval) == ("REJECTED", "REJECTED")
    with open_writing(engine) as session, pytest.raises(ConflictError, match="not APPROVED"):
        approvals.promote(session, people["dee"], approval.parameter_set_id, 4)


def test_a_refusal_comes_too_late_after_the_promotion(engine, people, submit_request):
    approval = submit_request()
    _sign(engine, people["cy"], approval)
    _promote(engine, people["dee"], approval.parameter_set_id)
    with pytest.raises(ConflictError, match="APPROVED: Cy", check=has_code("wrong-state")):
        _sign(engine, people["bo"], approval, "REFUSE", seen_version=2)
    assert _states(engine, approval) == ("APPROVED", "BASELINE")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("ana", "role approver, but Ana has only analyst"),
        ("dee", "role approver, but Dee has only operator"),
        ("eve", "role approver, but Eve has only viewer"),
        ("root", "An administrator cannot sign"),
    ],
)
def test_who_is_no_approver_does_not_sign(engine, people, submit_request, name, says):
    approval = submit_request()
    with pytest.raises(ForbiddenError, match=says):
        _sign(engine, people[name], approval)
    assert _states(engine, approval) == ("OPEN", "SUBMITTED")


@pytest.mark.parametrize(
    ("submitted_by", "launched_by", "says"),
    [("bo", "ana", "You submitted this set"), ("robot", "ana", "You submitted"), ("ana", "bo", "You launched run 1")],
)
def test_the_first_pair_of_eyes_is_not_the_second(engine, people, submit_request, submitted_by, launched_by, says):
    with open_writing(engine) as session:
        secret = api_keys.create_key(session, people["bo"], label="robot", scopes=["parameter-sets"])[1]
        people["robot"] = api_keys.find_actor_of_key(session, secret)  # a key of bo
    approval = submit_request(submitted_by, launched_by)
    with pytest.raises(ForbiddenError, match=says):
        _sign(engine, people["bo"], approval)
    _sign(engine, people["cy"], approval)


def test_no_key_signs_whatever_its_owner_may(engine, people, submit_request):
    approval = submit_request()
    with open_writing(engine) as session:
        secret = api_keys.create_key(session, people["cy"], label="robot", scopes=["parameter-sets"])[1]
        robot = api_keys.find_actor_of_key(session, secret)
    for actor in (robot, SYSTEM, COMMAND_LINE):
        with pytest.raises(ForbiddenError, check=has_code("not-a-person")):
            _sign(engine, actor, approval)
    assert _states(engine, approval) == ("OPEN", "SUBMITTED")


def test_a_wrong_password_signs_nothing(engine, people, submit_request):
    approval = submit_request()
    with pytest.raises(UnauthenticatedError, check=has_code("wrong-password")):
        _sign(engine, people["cy"], approval, password="wrong horse battery")
    assert _states(engine, approval) == ("OPEN", "SUBMITTED")
    with open_reading(engine) as session:
        assert not approval_queries.list_signatures(session, approval.id)


@pytest.mark.parametrize(
    ("decision", "changes", "error", "says"),
    [
        ("PERHAPS", {}, RefusedInputError, "no decision 'PERHAPS'"),
        ("APPROVE", {"meaning": " "}, RefusedInputError, "what your signature means"),
        ("REFUSE", {"comment": " "}, RefusedInputError, "why you refuse"),
        ("APPROVE", {"seen_version": None}, PreconditionRequiredError, "If-Match"),
        ("APPROVE", {"seen_version": 7}, StaleError, "you saw v7, it is now v1"),
    ],
)
def test_a_signature_that_lacks_something_is_refused(engine, people, submit_request, decision, changes, error, says):
    approval = submit_request()
    with pytest.raises(error, match=says):
        _sign(engine, people["cy"], approval, decision, **changes)
    assert _states(engine, approval) == ("OPEN", "SUBMITTED")


def test_nobody_signs_twice(engine, people, submit_request):
    approval = submit_request()
    _sign(engine, people["cy"], approval)
    with pytest.raises(ConflictError, check=has_code("already-signed")):
        _sign(engine, people["cy"], approval, "REFUSE", seen_version=2)


def test_hashes_that_moved_make_the_request_stale_and_its_set_free(engine, people, submit_request):
    approval = submit_request()
    with open_writing(engine) as session:  # as if a table definition had been brought in past the services
        definition = TableDefinition(
            sensor_id=1, number=1, document={}, sha256="0" * 64, reason="", created_utc=utc_now()
        )
        session.add(definition)
        audit.append(session, people["root"], "defined", "table-definitions/1")
    with pytest.raises(StaleError, match="table definition", check=has_code("changed-since-submitted")):
        _sign(engine, people["cy"], approval)
    assert _states(engine, approval) == ("STALE", "CANDIDATE")
    with pytest.raises(StaleError, match="is STALE"):
        _sign(engine, people["cy"], approval, seen_version=2)


def test_the_reason_why_somebody_may_not_sign_is_known_beforehand(engine, people, submit_request):
    approval = submit_request()
    with open_reading(engine) as session:
        reasons = {name: approvals.explain_why_not_sign(session, actor, approval.id) for name, actor in people.items()}
    assert {name for name, reason in reasons.items() if reason is None} == {"bo", "cy"}
    _sign(engine, people["cy"], approval)
    with open_reading(engine) as session:
        assert "already" in str(approvals.explain_why_not_sign(session, people["cy"], approval.id))


def test_a_person_who_lost_the_role_meanwhile_does_not_sign(engine, people, submit_request):
    approval, cy = submit_request(), people["cy"]
    assert cy.user_id is not None
    with open_writing(engine) as session:
        users.change_roles(session, people["root"], cy.user_id, ["viewer"])
        now = users.get_actor(session, cy.user_id)
    with pytest.raises(ForbiddenError, match="role approver"):
        _sign(engine, now, approval)


def test_requests_are_listed_by_state_newest_first(engine, people, submit_request):
    first, second = submit_request(), submit_request()
    _sign(engine, people["cy"], first)
    with open_reading(engine) as session:
        assert [row.id for row in lists.list_newest(session, Approval)] == [second.id, first.id]
        assert [row.id for row in lists.list_newest(session, Approval, state="OPEN")] == [second.id]
        assert [row.id for row in lists.list_newest(session, Approval, before_id=second.id)] == [first.id]
        with pytest.raises(NotFoundError, match="no request"):
            session.get_known(Approval, 99)


def _promote(engine: Engine, actor: Actor, set_id: int, seen: int | None = None) -> ParameterSet:
    with open_writing(engine) as session:
        seen = seen or session.get_known(ParameterSet, set_id).version
        return approvals.promote(session, actor, set_id, seen)


def _ground_states(engine: Engine) -> dict[str, str]:
    with open_reading(engine) as session:
        return {row.name: row.ground_state for row in lists.list_newest(session, ParameterSet)}


@pytest.mark.parametrize("name", ["ana", "bo", "cy", "eve", "root"])
def test_only_an_operator_promotes(engine, people, approved, name):
    row = approved()
    with pytest.raises(ForbiddenError, match="role operator"):
        _promote(engine, people[name], row.id)
    assert _ground_states(engine) == {"PS-ST16-1-0": "BASELINE", row.name: "APPROVED"}


def test_promotion_supersedes_points_and_records_in_one(engine, people, approved):
    row = approved()
    promoted = _promote(engine, people["dee"], row.id)
    assert _ground_states(engine) == {"PS-ST16-1-0": "SUPERSEDED", row.name: "BASELINE"}
    with open_reading(engine) as session:
        ground = session.scalars(sa.select(ParameterSet).where(ParameterSet.number == 0)).one()
        assert ground.baseline_to_utc == promoted.baseline_from_utc
        kept = session.scalars(sa.select(Promotion).order_by(Promotion.id)).all()
        assert [entry.parameter_set_id for entry in kept] == [ground.id, row.id]
        assert kept[1].promoted_by == people["dee"].user_id
        record = audit.find_last_change(session, f"parameter-sets/{row.id}")
        assert (record.action, record.after["sha256"]) == ("promoted", row.sha256)
        assert audit.verify(session).ok


def test_a_promotion_that_fails_at_its_end_leaves_the_old_baseline(engine, people, approved, monkeypatch):
    row = approved()

    def break_down(*_: object) -> None:
        raise OSError("the disk is full")

    monkeypatch.setattr(approvals, "make_others_stale", break_down)
    with pytest.raises(OSError, match="disk"):
        _promote(engine, people["dee"], row.id)
    assert _ground_states(engine) == {"PS-ST16-1-0": "BASELINE", row.name: "APPROVED"}


def test_of_two_promotions_at_once_one_wins_and_one_baseline_is_left(engine, people, approved):
    rows = [approved() for _ in range(4)]

    def promote(row: ParameterSet) -> str:
        try:
            return _promote(engine, people["dee"], row.id, row.version).name
        except StaleError:
            return "stale"

    with ThreadPoolExecutor(4) as pool:
        outcomes = list(pool.map(promote, rows))
    states = _ground_states(engine)
    assert sorted(outcomes)[1:] == ["stale"] * 3
    assert [name for name, state in states.items() if state == "BASELINE"] == [min(outcomes)]
    assert sorted(states.values()) == ["BASELINE", "CANDIDATE", "CANDIDATE", "CANDIDATE", "SUPERSEDED"]
    with open_reading(engine) as session:
        assert audit.verify(session).ok


def test_another_promotion_makes_every_request_of_the_sensor_stale(engine, people, submitted, approved):
    waiting, signed, winner = submitted(), approved(), approved()
    _promote(engine, people["dee"], winner.id)
    with open_reading(engine) as session:
        states = {row.parameter_set_id: row.state for row in lists.list_newest(session, Approval)}
    assert states == {waiting.id: "STALE", signed.id: "STALE", winner.id: "APPROVED"}
    assert _ground_states(engine)[signed.name] == "CANDIDATE"


def test_an_incumbent_that_moved_unseen_makes_the_approval_stale_for_good(engine, people, approved, candidate):
    row, other = approved(), candidate()
    with open_writing(engine) as session:  # as if the incumbent had been exchanged past the services
        for number, state in ((1, "SUPERSEDED"), (other.id, "BASELINE")):
            session.get_one(ParameterSet, number).ground_state = state
            audit.append(session, people["root"], "exchanged", f"parameter-sets/{number}")
    with pytest.raises(StaleError, match=r"baseline.*PS-ST16-1-2: Root", check=has_code("changed-since-submitted")):
        _promote(engine, people["dee"], row.id)
    with open_reading(engine) as session:
        assert lists.list_newest(session, Approval)[0].state == "STALE"
    assert _ground_states(engine) == {"PS-ST16-1-0": "SUPERSEDED", row.name: "CANDIDATE", other.name: "BASELINE"}


def test_a_rollback_withdrawn_stays_superseded(engine, people, approved, blobs):
    _promote(engine, people["dee"], approved().id)
    with open_writing(engine) as session:
        ground = session.scalars(sa.select(ParameterSet).where(ParameterSet.number == 0)).one()
        approvals.submit(session, people["ana"], blobs, ground.id, "the new one drifts", ground.version)
        approvals.withdraw(session, people["ana"], ground.id, ground.version)
        assert ground.ground_state == "SUPERSEDED"


AT_ONCE = Policy(approval_days=0.0, rollback_days=0.0)


def _days(approval: Approval) -> float:
    until, since = (datetime.fromisoformat(text or "") for text in (approval.expires_utc, approval.submitted_utc))
    return round((until - since).total_seconds() / 86400, 3)


def test_whoever_signs_too_late_finds_the_request_expired(engine, people, submit_request):
    approval = submit_request(policy=AT_ONCE)
    with open_reading(engine) as session:
        assert "expired at" in str(approvals.explain_why_not_sign(session, people["cy"], approval.id))
    with pytest.raises(ConflictError, match=r"Request 1 .*20.*PS-ST16-1-1", check=has_code("request-expired")):
        _sign(engine, people["cy"], approval)
    assert _states(engine, approval) == ("EXPIRED", "EXPIRED")


def test_the_heartbeat_lets_expire_what_nobody_decided_and_tells_of_it_once(engine, submit_request):
    waiting, late, told = submit_request(), submit_request(policy=AT_ONCE), []
    heart = Heartbeat(engine, lambda: told.append("told"))
    heart.beat()
    heart.beat()
    assert (_states(engine, waiting), _states(engine, late)) == (
        ("OPEN", "SUBMITTED"),
        ("EXPIRED", "EXPIRED"),
    )
    assert told == ["told"]
    with open_reading(engine) as session:
        record = audit.find_last_change(session, f"approvals/{late.id}")
        assert (record.actor, record.action) == ("Boresight", "let expire")
        assert str(late.expires_utc) in str(record.reason)


def test_the_heartbeat_beats_by_itself_and_stops(engine, submit_request):
    late = submit_request(policy=AT_ONCE)
    heart = Heartbeat(engine, lambda: None)
    heart.start()
    for _ in range(2):
        heart.close()
    assert _states(engine, late) == ("EXPIRED", "EXPIRED")


def test_an_approval_that_nobody_used_in_time_promotes_nothing(engine, people, submit_request, monkeypatch):
    approval = submit_request()
    _sign(engine, people["cy"], approval)
    monkeypatch.setattr("boresight.console.approvals.staleness.utc_now", lambda: "2999-01-01T00:00:00.000000Z")
    with open_writing(engine) as session, pytest.raises(ConflictError, match="expired at"):
        approvals.promote(session, people["dee"], approval.parameter_set_id, 3)
    assert _states(engine, approval) == ("EXPIRED", "EXPIRED")


def test_what_expired_may_be_submitted_again_and_what_was_promoted_never_expires(
    engine, people, blobs, submit_request, monkeypatch
):
    late, used = submit_request(policy=AT_ONCE), submit_request()
    _sign(engine, people["cy"], used)
    with open_writing(engine) as session:
        staleness.expire_due_requests(session)
        row = session.get_known(ParameterSet, late.parameter_set_id)
        approvals.submit(session, people["ana"], blobs, row.id, "once more", row.version)
        approvals.promote(session, people["dee"], used.parameter_set_id, 3)
    monkeypatch.setattr("boresight.console.approvals.staleness.utc_now", lambda: "2999-01-01T00:00:00.000000Z")
    with open_writing(engine) as session:
        assert staleness.expire_due_requests(session) == []
    assert _states(engine, used) == ("APPROVED", "BASELINE")


def test_an_operator_asks_to_roll_back_to_a_former_baseline_in_less_time(engine, people, submit_request, roll_back):
    approval = submit_request()
    _sign(engine, people["cy"], approval)
    name = _promote(engine, people["dee"], approval.parameter_set_id).name
    with pytest.raises(ForbiddenError, match=r"analyst.*operator", check=has_code("role-missing")):
        roll_back("cy")
    back = roll_back()
    assert (approval.kind, _days(approval)) == ("PROMOTION", 30.0)
    assert (back.kind, _days(back), back.submitted_by) == ("ROLLBACK", 3.0, people["dee"].user_id)
    _sign(engine, people["cy"], back)
    _promote(engine, people["dee"], back.parameter_set_id)
    assert _ground_states(engine) == {"PS-ST16-1-0": "BASELINE", name: "SUPERSEDED"}
    with open_reading(engine) as session:
        record = audit.find_last_change(session, f"parameter-sets/{back.parameter_set_id}")
        assert (record.action, record.after["kind"]) == ("promoted", "ROLLBACK")


def test_a_roll_back_that_expired_stays_superseded(engine, people, approved, roll_back):
    _promote(engine, people["dee"], approved().id)
    back = roll_back(policy=AT_ONCE)
    with open_writing(engine) as session:
        staleness.expire_due_requests(session)
    assert _states(engine, back) == ("EXPIRED", "SUPERSEDED")


def test_there_is_no_way_back_to_what_never_was_baseline(engine, people, blobs, candidate):
    row = candidate()
    with open_writing(engine) as session, pytest.raises(ConflictError, check=has_code("never-baseline")):
        approvals.roll_back(session, people["dee"], blobs, row.id, "it drifts", row.version)
