"""Passwords that somebody else knows: they let a person do nothing but set another, and never stand for a signature."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest

from boresight.errors import ForbiddenError, PasswordDueError, RefusedInputError
from boresight.services import approvals, audit, users
from boresight.services.actors import Actor
from boresight.store.sessions import Engine, Session, reading, writing
from boresight.store.tables import ParameterSet

from .conftest import PASSWORD

GIVEN, OWN = "given by the administrator", "known to nobody else"


@pytest.fixture
def cy(engine: Engine, people: Mapping[str, Actor]) -> Actor:
    """The approver, whose password the administrator reset."""
    with writing(engine) as session:
        users.change_password(session, people["root"], people["cy"].user_id or 0, GIVEN)
    return people["cy"]


def _epoch(session: Session, cy: Actor) -> int:
    return users.get_user(session, cy.user_id or 0).session_epoch


def test_a_reset_is_on_record_as_a_reset(engine: Engine, cy: Actor) -> None:
    with reading(engine) as session:
        record = audit.last_change(session, f"users/{cy.user_id}")
    assert record is not None
    assert (record.action, record.actor) == ("reset the password of", "Root")
    assert record.after == {"must_change_password": True}
    assert record.rows is not None


def test_whoever_comes_with_a_given_password_may_only_set_their_own(engine: Engine, cy: Actor) -> None:
    with reading(engine) as session, pytest.raises(PasswordDueError, match="set your own first"):
        users.actor_of_session(session, cy.user_id or 0, _epoch(session, cy))
    with writing(engine) as session:
        actor = users.actor_of_session(session, cy.user_id or 0, _epoch(session, cy), sets_password=True)
        users.change_password(session, actor, cy.user_id or 0, OWN, GIVEN)
    with reading(engine) as session:
        assert users.actor_of_session(session, cy.user_id or 0, _epoch(session, cy)).name == "cy"


def test_a_given_password_signs_nothing_and_ones_own_does(
    engine: Engine, cy: Actor, submitted: Callable[[], ParameterSet]
) -> None:
    row = submitted()
    with reading(engine) as session:
        approval = approvals.list_approvals(session, parameter_set_id=row.id)[0]

    def sign(password: str) -> None:
        with writing(engine) as session:
            approvals.sign(session, cy, approval.id, "APPROVE", "I approve", "", password, approval.version)

    with pytest.raises(ForbiddenError, match="set your own first"):
        sign(GIVEN)
    with writing(engine) as session:
        users.change_password(session, cy, cy.user_id or 0, OWN, GIVEN)
    sign(OWN)


def test_a_given_password_confirms_nothing_else_either(engine: Engine, cy: Actor) -> None:
    with reading(engine) as session, pytest.raises(PasswordDueError):
        users.verify_password(session, cy, GIVEN)


def test_a_password_is_not_changed_into_itself(engine: Engine, people: Mapping[str, Actor], cy: Actor) -> None:
    for actor, password in ((people["ana"], PASSWORD), (cy, GIVEN)):
        with pytest.raises(RefusedInputError, match="use another"), writing(engine) as session:
            users.change_password(session, actor, actor.user_id or 0, password, password)


def test_a_person_may_be_added_with_a_password_for_the_first_log_in_only(
    engine: Engine, people: Mapping[str, Actor]
) -> None:
    with writing(engine) as session:
        row = users.create_user(
            session,
            people["root"],
            name="fay",
            printed_name="Fay",
            password=GIVEN,
            roles=["approver"],
            must_change_password=True,
        )
        actor = users.authenticate(session, "fay", GIVEN)
        assert users.must_change_password(session, actor)
        with pytest.raises(PasswordDueError):
            users.actor_of_session(session, row.id, row.session_epoch)
