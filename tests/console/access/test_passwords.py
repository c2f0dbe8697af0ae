"""Passwords that somebody else knows: they let a person do nothing but set another, and never stand for a signature."""

import re
from collections.abc import Callable, Mapping

import pytest

from boresight.console.access import users
from boresight.console.access.passwords import password_by
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.errors import ForbiddenError, PasswordDueError
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from tests.console.conftest import PASSWORD
from tests.passwords import add_person, approve, new_password, proved

GIVEN, OWN = "given by the administrator", "known to nobody else"


@pytest.fixture
def cy(engine: Engine, people: Mapping[str, Actor]) -> Actor:
    with open_writing(engine) as session:
        users.change_password(session, people["root"], people["cy"].user_id or 0, new_password(GIVEN))
    return people["cy"]


def _epoch(session: Session, cy: Actor) -> int:
    return users.get_user(session, cy.user_id or 0).session_epoch


def test_a_reset_is_on_record_as_a_reset(engine: Engine, cy: Actor) -> None:
    with open_reading(engine) as session:
        record = audit.last_change(session, f"users/{cy.user_id}")
    assert record is not None
    assert (record.action, record.actor) == ("reset the password of", "Root")
    assert record.after == {"must_change_password": True}
    assert record.rows is not None


def test_whoever_comes_with_a_given_password_may_only_set_their_own(engine: Engine, cy: Actor) -> None:
    with open_reading(engine) as session, pytest.raises(PasswordDueError, match="set your own first"):
        users.get_actor(session, cy.user_id or 0)
    with open_writing(engine) as session:
        actor = users.get_actor(session, cy.user_id or 0, sets_password=True)
        users.change_password(session, actor, cy.user_id or 0, new_password(OWN), proved(session, cy, GIVEN))
    with open_reading(engine) as session:
        assert users.get_actor(session, cy.user_id or 0).name == "cy"


def test_a_given_password_signs_nothing_and_ones_own_does(
    engine: Engine, cy: Actor, submitted: Callable[[], ParameterSet]
) -> None:
    row = submitted()
    with open_reading(engine) as session:
        approval = approvals.list_approvals(session, parameter_set_id=row.id)[0]

    def sign(password: str) -> None:
        with open_writing(engine) as session:
            approve(session, cy, approval, password=password)

    with pytest.raises(ForbiddenError, match="set your own first"):
        sign(GIVEN)
    with open_writing(engine) as session:
        users.change_password(session, cy, cy.user_id or 0, new_password(OWN), proved(session, cy, GIVEN))
    sign(OWN)


def test_a_given_password_confirms_nothing_else_either(engine: Engine, cy: Actor) -> None:
    with open_reading(engine) as session, pytest.raises(PasswordDueError):
        users.require_password(session, cy, proved(session, cy, GIVEN))


def test_a_person_may_be_added_with_a_password_for_the_first_log_in_only(
    engine: Engine, people: Mapping[str, Actor]
) -> None:
    with open_writing(engine) as session:
        row = users.create_user(
            session,
            people["root"],
            name="fay",
            printed_name="Fay",
            password=new_password(GIVEN),
            roles=["approver"],
            must_change_password=True,
        )
        actor = users.authenticate(session, proved(session, "fay", GIVEN))
        assert users.must_change_password(session, actor)
        with pytest.raises(PasswordDueError):
            users.get_actor(session, row.id)


AT = "given by Command line at 2026-11-20 12:00:00 UTC"
RESET = "reset by Root at 2026-11-20 18:00:00 UTC"


def _told(engine: Engine, root: Actor, monkeypatch: pytest.MonkeyPatch, *events: tuple[str, str]) -> str | None:
    def at(time: str) -> None:
        monkeypatch.setattr("boresight.platform.audit.chain.utc_now", lambda: f"{time}.000000Z")

    at("2026-11-20T12:00:00")
    with open_writing(engine) as session:
        row = add_person(session, "new", "approver")
        new_id, current = row.id, PASSWORD
        for number, (who, time) in enumerate(events):
            at(time)
            fresh, own = f"{OWN} {number}", who == "new"
            actor = Actor(new_id, "new", "New", frozenset({"approver"}), "session") if own else root
            users.change_password(session, actor, new_id, new_password(fresh), proved(session, actor, current))
            current = fresh
        return password_by(session, new_id)


@pytest.mark.parametrize(
    ("events", "told"),
    [
        ((), f"{AT}, not changed since"),
        ((("new", "2026-11-20T12:00:40"),), f"{AT}, set anew 40 s later"),
        ((("new", "2026-11-20T12:03:00"),), f"{AT}, set anew 3 min later"),
        ((("new", "2026-11-21T11:59:59"),), f"{AT}, set anew 24 h later"),
        ((("new", "2026-11-21T12:00:00"),), None),
        ((("root", "2026-11-20T18:00:00"),), f"{RESET}, not changed since"),
        ((("root", "2026-11-20T18:00:00"), ("new", "2026-11-20T18:03:00")), f"{RESET}, set anew 3 min later"),
        (
            (("root", "2026-11-20T18:00:00"), ("new", "2026-11-20T18:03:00"), ("new", "2026-11-20T20:00:00")),
            f"{RESET}, set anew 2 h later",
        ),
        ((("new", "2026-11-22T12:00:00"), ("new", "2026-11-22T12:01:00")), None),
    ],
)
def test_who_else_gave_a_password_is_told_until_it_is_long_ones_own(
    engine: Engine,
    people: Mapping[str, Actor],
    monkeypatch: pytest.MonkeyPatch,
    events: tuple[tuple[str, str], ...],
    told: str | None,
) -> None:
    assert _told(engine, people["root"], monkeypatch, *events) == told


def test_a_person_whom_no_record_made_has_a_password_of_nobody_on_record(session: Session) -> None:
    assert password_by(session, 4711) == "given by nobody on record"


def test_a_signature_through_a_puppet_says_so_in_its_row_and_on_record(
    engine: Engine, submitted: Callable[[], ParameterSet], cy: Actor
) -> None:
    row = submitted()
    with open_writing(engine) as session:  # by who reset it, logged in as Cy
        puppet = users.get_actor(session, cy.user_id or 0, sets_password=True)
        users.change_password(session, puppet, cy.user_id or 0, new_password(OWN), proved(session, puppet, GIVEN))
    with open_writing(engine) as session:
        approval = approvals.list_approvals(session, parameter_set_id=row.id)[0]
        signature = approve(session, puppet, approval, password=OWN)
        record = audit.last_change(session, f"approvals/{approval.id}")
    assert re.fullmatch(r"reset by Root at \S+ \S+ UTC, set anew \d+ s later", str(signature.password_by))
    assert record is not None
    assert (record.after or {})["password_by"] == signature.password_by
    with open_reading(engine) as session:
        assert approval_queries.signatures(session, approval.id)[0].password_by == signature.password_by
        assert audit.verify(session).ok
