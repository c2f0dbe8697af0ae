"""Approvals: a second person, in person, on what was shown; one refusal blocks."""

from collections.abc import Callable, Mapping

import pytest

from boresight.console import transitions
from boresight.console.access import api_keys, users
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.approvals import staleness
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks.tables import TableDefinition
from boresight.errors import (
    BoresightError,
    ConflictError,
    ForbiddenError,
    NotFoundError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
    UnauthenticatedError,
)
from boresight.platform.actors import COMMAND_LINE, SYSTEM, Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_now
from tests.passwords import proved

PASSWORD = "correct horse battery"
People = Mapping[str, Actor]


@pytest.fixture
def request_of(
    engine: Engine, people: People, candidate: Callable[..., ParameterSet], blobs: BlobStore
) -> Callable[..., Approval]:
    def make(submitted_by: str = "ana", launched_by: str = "ana") -> Approval:
        row = candidate(launched_by)
        with open_writing(engine) as session:
            return approvals.submit(session, people[submitted_by], blobs, row.id, "better", row.version)

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
        return approvals.sign(session, actor, approval.id, decision, **values)  # type: ignore[arg-type]


def _states(engine: Engine, approval: Approval) -> tuple[str, str]:
    with open_reading(engine) as session:
        row = session.get_one(Approval, approval.id)
        return row.state, session.get_one(ParameterSet, row.parameter_set_id).ground_state


def test_one_approval_by_a_second_person_approves(
    engine: Engine, people: People, request_of: Callable[..., Approval]
) -> None:
    approval = request_of()
    signature = _sign(engine, people["cy"], approval)
    assert _states(engine, approval) == ("APPROVED", "APPROVED")
    assert (signature.printed_name, signature.decision, signature.meaning) == ("Cy", "APPROVE", "I decide")
    assert signature.shown_sha256 == staleness.compute_binding_sha256(approval)
    with open_reading(engine) as session:
        assert [row.id for row in approval_queries.signatures(session, approval.id)] == [signature.id]
        assert audit.verify(session).ok


def test_one_refusal_blocks(
    engine: Engine, people: People, request_of: Callable[..., Approval], blobs: BlobStore
) -> None:
    approval = request_of()
    _sign(engine, people["cy"], approval, "REFUSE", comment="too few stars at the rim")
    assert _states(engine, approval) == ("REJECTED", "REJECTED")
    with open_reading(engine) as session:
        row = session.get_one(ParameterSet, approval.parameter_set_id)
        record = audit.last_change(session, f"parameter-sets/{row.id}")
    assert record is not None
    assert "too few stars at the rim" in str(record.reason)
    with open_writing(engine) as session, pytest.raises(ConflictError, match="is REJECTED: Cy refused it"):
        approvals.submit(session, people["ana"], blobs, row.id, "once more", row.version)


def test_a_refusal_stops_even_what_another_approved(
    engine: Engine, people: People, request_of: Callable[..., Approval]
) -> None:
    approval = request_of()
    _sign(engine, people["cy"], approval)
    with pytest.raises(ConflictError, match="is APPROVED"):
        _sign(engine, people["bo"], approval, seen_version=2)
    _sign(engine, people["bo"], approval, "REFUSE", seen_version=2)
    assert _states(engine, approval) == ("REJECTED", "REJECTED")
    with open_writing(engine) as session, pytest.raises(ConflictError, match="not APPROVED"):
        approvals.promote(session, people["dee"], approval.parameter_set_id, 4)


def test_a_refusal_comes_too_late_after_the_promotion(
    engine: Engine, people: People, request_of: Callable[..., Approval]
) -> None:
    approval = request_of()
    _sign(engine, people["cy"], approval)
    with open_writing(engine) as session:
        approvals.promote(session, people["dee"], approval.parameter_set_id, 3)
    with pytest.raises(ConflictError, match="is APPROVED: Cy approved it"):
        _sign(engine, people["bo"], approval, "REFUSE", seen_version=2)
    assert _states(engine, approval) == ("APPROVED", "BASELINE")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("ana", "role approver; Ana has analyst"),
        ("dee", "role approver; Dee has operator"),
        ("eve", "role approver; Eve has viewer"),
        ("root", "An administrator cannot sign"),
    ],
)
def test_who_is_no_approver_does_not_sign(
    engine: Engine, people: People, request_of: Callable[..., Approval], name: str, says: str
) -> None:
    approval = request_of()
    with pytest.raises(ForbiddenError, match=says):
        _sign(engine, people[name], approval)
    assert _states(engine, approval) == ("OPEN", "SUBMITTED")


@pytest.mark.parametrize(
    ("submitted_by", "launched_by", "says"),
    [("bo", "ana", "You submitted this set"), ("ana", "bo", "You launched run 1")],
)
def test_the_first_pair_of_eyes_is_not_the_second(
    engine: Engine,
    people: People,
    request_of: Callable[..., Approval],
    submitted_by: str,
    launched_by: str,
    says: str,
) -> None:
    approval = request_of(submitted_by, launched_by)
    with pytest.raises(ForbiddenError, match=says):
        _sign(engine, people["bo"], approval)
    _sign(engine, people["cy"], approval)


def test_a_set_submitted_by_a_key_is_submitted_by_its_owner(
    engine: Engine, people: People, candidate: Callable[..., ParameterSet], blobs: BlobStore
) -> None:
    row = candidate()
    with open_writing(engine) as session:
        secret = api_keys.create_key(session, people["bo"], label="robot", scopes=["parameter-sets"])[1]
    with open_writing(engine) as session:
        robot = api_keys.actor_of_key(session, secret)
        approval = approvals.submit(session, robot, blobs, row.id, "better", row.version)
    with pytest.raises(ForbiddenError, match="You submitted this set"):
        _sign(engine, people["bo"], approval)


def test_no_key_signs_whatever_its_owner_may(
    engine: Engine, people: People, request_of: Callable[..., Approval]
) -> None:
    approval = request_of()
    with open_writing(engine) as session:
        secret = api_keys.create_key(session, people["cy"], label="robot", scopes=["parameter-sets"])[1]
        robot = api_keys.actor_of_key(session, secret)
    for actor in (robot, SYSTEM, COMMAND_LINE):
        with pytest.raises(ForbiddenError, match="Only a person"):
            _sign(engine, actor, approval)
    assert _states(engine, approval) == ("OPEN", "SUBMITTED")


def test_a_wrong_password_signs_nothing(engine: Engine, people: People, request_of: Callable[..., Approval]) -> None:
    approval = request_of()
    with pytest.raises(UnauthenticatedError, match="do not fit"):
        _sign(engine, people["cy"], approval, password="wrong horse battery")
    assert _states(engine, approval) == ("OPEN", "SUBMITTED")
    with open_reading(engine) as session:
        assert not approval_queries.signatures(session, approval.id)


@pytest.mark.parametrize(
    ("decision", "changes", "error", "says"),
    [
        ("PERHAPS", {}, RefusedInputError, "APPROVE or REFUSE, not 'PERHAPS'"),
        ("APPROVE", {"meaning": " "}, RefusedInputError, "what your signature means"),
        ("REFUSE", {"comment": " "}, RefusedInputError, "why you refuse"),
        ("APPROVE", {"seen_version": None}, PreconditionRequiredError, "If-Match"),
        ("APPROVE", {"seen_version": 7}, StaleError, "you saw v7, it is v1"),
    ],
)
def test_a_signature_that_lacks_something_is_refused(
    engine: Engine,
    people: People,
    request_of: Callable[..., Approval],
    decision: str,
    changes: dict[str, object],
    error: type[BoresightError],
    says: str,
) -> None:
    approval = request_of()
    with pytest.raises(error, match=says):
        _sign(engine, people["cy"], approval, decision, **changes)
    assert _states(engine, approval) == ("OPEN", "SUBMITTED")


def test_nobody_signs_twice(engine: Engine, people: People, request_of: Callable[..., Approval]) -> None:
    approval = request_of()
    _sign(engine, people["cy"], approval)
    with pytest.raises(ConflictError, match="You signed this request already"):
        _sign(engine, people["cy"], approval, "REFUSE", seen_version=2)


def test_hashes_that_moved_make_the_request_stale_and_its_set_free(
    engine: Engine, people: People, request_of: Callable[..., Approval]
) -> None:
    approval = request_of()
    with open_writing(engine) as session:  # as if a table definition had been brought in past the services
        definition = TableDefinition(
            sensor_id=1, number=1, document={}, sha256="0" * 64, reason="", created_utc=utc_now()
        )
        session.add(definition)
        audit.append(session, people["root"], "defined", "table-definitions/1")
    with pytest.raises(StaleError, match=r"The table definition moved .* Submit it again"):
        _sign(engine, people["cy"], approval)
    assert _states(engine, approval) == ("STALE", "CANDIDATE")
    with pytest.raises(StaleError, match="is STALE"):
        _sign(engine, people["cy"], approval, seen_version=2)


def test_the_reason_why_somebody_may_not_sign_is_known_beforehand(
    engine: Engine, people: People, request_of: Callable[..., Approval]
) -> None:
    approval = request_of()
    with open_reading(engine) as session:
        reasons = {name: approvals.why_not_sign(session, actor, approval.id) for name, actor in people.items()}
    assert {name for name, reason in reasons.items() if reason is None} == {"bo", "cy"}
    _sign(engine, people["cy"], approval)
    with open_reading(engine) as session:
        assert "already" in str(approvals.why_not_sign(session, people["cy"], approval.id))


def test_a_person_who_lost_the_role_meanwhile_does_not_sign(
    engine: Engine, people: People, request_of: Callable[..., Approval]
) -> None:
    approval, cy = request_of(), people["cy"]
    assert cy.user_id is not None
    with open_writing(engine) as session:
        users.change_roles(session, people["root"], cy.user_id, ["viewer"])
        now = users.get_actor(session, cy.user_id)
    with pytest.raises(ForbiddenError, match="role approver"):
        _sign(engine, now, approval)


def test_requests_are_listed_by_state_newest_first(
    engine: Engine, people: People, request_of: Callable[..., Approval]
) -> None:
    first, second = request_of(), request_of()
    _sign(engine, people["cy"], first)
    with open_reading(engine) as session:
        assert [row.id for row in approvals.list_approvals(session)] == [second.id, first.id]
        assert [row.id for row in approvals.list_approvals(session, state="OPEN")] == [second.id]
        assert [row.id for row in approvals.list_approvals(session, before_id=second.id)] == [first.id]
        with pytest.raises(NotFoundError, match="no request"):
            transitions.get_approval(session, 99)
