"""People: passwords, throttled log-ins, roles that only administrators give, and always one of those left."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
import sqlalchemy as sa

from boresight.errors import (
    BoresightError,
    ConflictError,
    ForbiddenError,
    NotFoundError,
    RefusedInputError,
    SessionEndedError,
    TooManyAttemptsError,
    UnauthenticatedError,
)
from boresight.services import audit, sessions, users
from boresight.services.actors import Actor
from boresight.store.sessions import Engine, Session, reading, utc_after, writing
from boresight.store.tables import LoginFailure

PASSWORD = "correct horse battery"


def _log_in(engine: Engine, name: str, password: str) -> Actor:
    with writing(engine) as session:
        return users.authenticate(session, name, password, attempts_per_minute=3)


def _fail(engine: Engine, name: str, times: int) -> None:
    for _ in range(times):
        with pytest.raises(UnauthenticatedError, match="do not fit"):
            _log_in(engine, name, "wrong horse battery")


def test_name_and_password_give_the_person_with_their_roles(engine: Engine) -> None:
    actor = _log_in(engine, "bo", PASSWORD)
    assert (actor.printed_name, actor.credential, actor.scopes) == ("Bo", "session", None)
    assert actor.roles == {"analyst", "approver"}


def test_a_wrong_name_and_a_wrong_password_get_the_same_answer(engine: Engine) -> None:
    answers = set()
    for name in ("ana", "nobody"):
        with pytest.raises(UnauthenticatedError) as refusal:
            _log_in(engine, name, "wrong horse battery")
        answers.add(str(refusal.value))
    assert len(answers) == 1


@pytest.mark.parametrize("name", ["ana", "nobody"])
def test_too_many_failures_make_a_name_wait_whether_it_exists_or_not(engine: Engine, name: str) -> None:
    _fail(engine, name, times=3)
    with pytest.raises(TooManyAttemptsError, match="wait a minute") as refusal:
        _log_in(engine, name, PASSWORD)
    assert 55 <= refusal.value.wait_s <= 60


def test_the_wait_ends_when_so_few_failures_count_that_another_attempt_is_allowed(engine: Engine) -> None:
    with writing(engine) as session:
        for seconds_ago in (50.0, 40.0, 30.0, 20.0, 70.0):
            session.add(LoginFailure(name="ana", at_utc=utc_after(-seconds_ago)))
    with pytest.raises(TooManyAttemptsError) as refusal:
        _log_in(engine, "ana", PASSWORD)
    assert refusal.value.wait_s in {19, 20}  # of four within the minute two must lapse: the second 40 s ago


def test_failures_of_one_name_do_not_hold_up_another(engine: Engine) -> None:
    _fail(engine, "ana", times=3)
    assert _log_in(engine, "cy", PASSWORD).name == "cy"


def test_after_a_minute_a_name_may_try_again_and_old_failures_are_forgotten(engine: Engine) -> None:
    with writing(engine) as session:
        for age_s in (61.0, 62.0, 3700.0):
            session.add(LoginFailure(name="ana", at_utc=utc_after(-age_s)))
    assert _log_in(engine, "ana", PASSWORD).name == "ana"
    _fail(engine, "ana", times=1)
    with reading(engine) as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(LoginFailure)) == 3


def test_a_password_is_kept_as_argon2id_only(session: Session) -> None:
    user = users.list_users(session)[0]
    assert user.password_hash.startswith("$argon2id$")
    assert PASSWORD not in user.password_hash


@pytest.mark.parametrize(
    ("password", "says"),
    [
        ("short", "has 5 characters; use at least 12"),
        ("a" * 300, "over 256 characters"),
        ("a" * 12, "repeats one character"),
        ("newcomernewcomer", "repeats one character or the log-in name"),
    ],
)
def test_a_password_that_is_easily_guessed_is_refused(
    session: Session, people: Mapping[str, Actor], password: str, says: str
) -> None:
    with pytest.raises(RefusedInputError, match=says):
        _create(session, people["root"], password=password)
    assert all(user.name != "newcomer" for user in users.list_users(session))


def _create(session: Session, actor: Actor, **changes: object) -> object:
    values = {"name": "newcomer", "printed_name": "New Comer", "password": PASSWORD, "roles": ["viewer"]} | changes
    return users.create_user(session, actor, **values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "error", "says"),
    [
        ({"name": ""}, RefusedInputError, "no log-in name"),
        ({"name": "new comer"}, RefusedInputError, "no log-in name"),
        ({"name": "ana"}, ConflictError, "already"),
        ({"roles": ["wizard"]}, RefusedInputError, "no role wizard; the roles are viewer"),
        ({"roles": ["administrator", "approver"]}, RefusedInputError, "administrator cannot sign"),
        ({"roles": "viewer"}, RefusedInputError, "no role viewer"),
    ],
)
def test_a_person_that_cannot_be_is_refused(
    session: Session,
    people: Mapping[str, Actor],
    changes: dict[str, object],
    error: type[BoresightError],
    says: str,
) -> None:
    with pytest.raises(error, match=says):
        _create(session, people["root"], **changes)


@pytest.mark.parametrize("name", ["ana", "bo", "cy", "dee", "eve"])
def test_only_administrators_make_and_change_people(session: Session, people: Mapping[str, Actor], name: str) -> None:
    actor, victim = people[name], people["root"].user_id
    assert victim is not None
    for act in (
        lambda: _create(session, actor),
        lambda: users.change_roles(session, actor, victim, ["viewer"]),
        lambda: users.disable_user(session, actor, victim),
        lambda: users.enable_user(session, actor, victim),
        lambda: users.change_password(session, actor, victim, PASSWORD),
        lambda: users.end_sessions(session, actor, victim),
    ):
        with pytest.raises(ForbiddenError, match="administrator"):
            act()


@pytest.mark.parametrize("scopes", [frozenset(), frozenset({"users", "api-keys"})])
def test_no_key_manages_people_not_even_its_owner(
    session: Session, people: Mapping[str, Actor], scopes: frozenset[str]
) -> None:
    key = replace(people["root"], credential="key:1234", scopes=scopes)
    approver, owner = people["cy"].user_id, people["root"].user_id
    assert approver is not None
    assert owner is not None
    for act in (
        lambda: _create(session, key, roles=["approver"]),
        lambda: users.change_roles(session, key, approver, ["viewer"]),
        lambda: users.disable_user(session, key, approver),
        lambda: users.enable_user(session, key, approver),
        lambda: users.change_password(session, key, approver, "another horse battery"),
        lambda: users.change_password(session, key, owner, "another horse battery", PASSWORD),
        lambda: users.end_sessions(session, key, approver),
        lambda: users.end_sessions(session, key, owner),
    ):
        with pytest.raises(ForbiddenError, match="API key may not"):
            act()


def test_nobody_becomes_administrator_and_approver_at_once(session: Session, people: Mapping[str, Actor]) -> None:
    approver = people["cy"].user_id
    assert approver is not None
    with pytest.raises(RefusedInputError, match="administrator cannot sign"):
        users.change_roles(session, people["root"], approver, ["approver", "administrator"])


def test_roles_take_effect_at_once_and_are_recorded(session: Session, people: Mapping[str, Actor]) -> None:
    ana = people["ana"]
    assert ana.user_id is not None
    users.change_roles(session, people["root"], ana.user_id, ["viewer", "viewer"])
    assert users.actor_of(session, ana.user_id).roles == {"viewer"}
    record = audit.last_change(session, f"users/{ana.user_id}")
    assert record is not None
    assert (record.before, record.after) == ({"roles": ["analyst"]}, {"roles": ["viewer"]})


def test_a_disabled_person_is_out_at_once_and_stays_out(engine: Engine, people: Mapping[str, Actor]) -> None:
    ana = people["ana"]
    assert ana.user_id is not None
    with writing(engine) as session:
        users.disable_user(session, people["root"], ana.user_id)
    with reading(engine) as session, pytest.raises(SessionEndedError, match="disabled"):
        users.actor_of(session, ana.user_id)
    with pytest.raises(UnauthenticatedError, match="do not fit"):
        _log_in(engine, "ana", PASSWORD)
    with writing(engine) as session:
        users.enable_user(session, people["root"], ana.user_id)
    assert _log_in(engine, "ana", PASSWORD).name == "ana"


def test_the_last_administrator_stays(session: Session, people: Mapping[str, Actor]) -> None:
    root = people["root"]
    assert root.user_id is not None
    for act in (
        lambda: users.disable_user(session, root, root.user_id),
        lambda: users.change_roles(session, root, root.user_id, ["viewer"]),
    ):
        with pytest.raises(ConflictError, match="only administrator"):
            act()


def test_a_new_password_needs_the_old_one_and_ends_every_log_in(engine: Engine, people: Mapping[str, Actor]) -> None:
    ana, new = people["ana"], "another horse battery"
    assert ana.user_id is not None
    with pytest.raises(UnauthenticatedError), writing(engine) as session:
        users.change_password(session, ana, ana.user_id, new, "wrong horse battery")
    with writing(engine) as session:
        token = sessions.begin(session, ana.user_id, sessions.Client())[1]
        users.change_password(session, ana, ana.user_id, new, PASSWORD)
    with reading(engine) as session, pytest.raises(SessionEndedError, match="password was changed"):
        sessions.find(session, token)
    assert _log_in(engine, "ana", new).name == "ana"


def test_nobody_is_not_found(session: Session) -> None:
    with pytest.raises(NotFoundError, match="no user 99"):
        users.get_user(session, 99)
