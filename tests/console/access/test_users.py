"""People: passwords, throttled log-ins, roles that only administrators give, and always one of those left."""

from collections.abc import Mapping
from dataclasses import replace

import pytest

from boresight.console.access import sessions, users
from boresight.console.access.tables import User
from boresight.errors import (
    BoresightError,
    ConflictError,
    ForbiddenError,
    NotFoundError,
    RefusedInputError,
    SessionEndedError,
    UnauthenticatedError,
)
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from tests.passwords import new_password, proved

PASSWORD = "correct horse battery"


def _log_in(engine: Engine, name: str, password: str) -> Actor:
    with open_writing(engine) as session:
        return users.authenticate(session, proved(session, name, password))


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


def test_a_password_is_kept_as_argon2id_only(session: Session) -> None:
    user = users.list_users(session)[0]
    assert user.password_hash.startswith("$argon2id$")
    assert PASSWORD not in user.password_hash


def _create(session: Session, actor: Actor, **changes: object) -> User:
    values = {"name": "newcomer", "printed_name": "New Comer", "roles": ["viewer"]} | changes
    values.setdefault("password", new_password(PASSWORD))
    return users.create_user(session, actor, **values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "error", "says"),
    [
        ({"name": ""}, RefusedInputError, "no log-in name"),
        ({"name": "new comer"}, RefusedInputError, "no log-in name"),
        ({"name": "ana"}, ConflictError, "already"),
        ({"name": "ANA"}, ConflictError, "user 'ana' already"),
        ({"name": "\uff41na"}, ConflictError, "user 'ana' already"),
        ({"name": "a\u200bna"}, RefusedInputError, "U\\+200B"),
        ({"name": "x" * 65}, RefusedInputError, "shorten it to 64"),
        ({"printed_name": "Ana"}, ConflictError, "is that of 'ana'"),
        ({"name": "system"}, ConflictError, "own records"),
        ({"printed_name": "BORESIGHT"}, ConflictError, "own records"),
        ({"printed_name": "Command  line"}, ConflictError, "own records"),
        ({"printed_name": " ana "}, ConflictError, "is that of 'ana'"),
        ({"printed_name": "\uff21\uff4e\uff41"}, ConflictError, "is that of 'ana'"),
        ({"printed_name": "Ana\u202eb"}, RefusedInputError, "U\\+202E"),
        ({"printed_name": "A\u2066na"}, RefusedInputError, "U\\+2066"),
        ({"printed_name": "Ana\x00"}, RefusedInputError, "U\\+0000"),
        ({"printed_name": "Ana\ud800"}, RefusedInputError, "U\\+D800"),
        ({"printed_name": "Ana\u0378"}, RefusedInputError, "U\\+0378"),
        ({"printed_name": "x" * 101}, RefusedInputError, "shorten it to 100"),
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
        lambda: users.change_password(session, actor, victim, new_password(PASSWORD)),
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
        lambda: users.change_password(session, key, approver, new_password("another horse battery")),
        lambda: users.change_password(session, key, owner, new_password("x"), proved(session, key, PASSWORD)),
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
    assert users.get_actor(session, ana.user_id).roles == {"viewer"}
    record = audit.last_change(session, f"users/{ana.user_id}")
    assert record is not None
    assert (record.before, record.after) == ({"roles": ["analyst"]}, {"roles": ["viewer"]})


def test_a_disabled_person_is_out_at_once_and_stays_out(engine: Engine, people: Mapping[str, Actor]) -> None:
    ana = people["ana"]
    assert ana.user_id is not None
    with open_writing(engine) as session:
        users.disable_user(session, people["root"], ana.user_id)
    with open_reading(engine) as session, pytest.raises(SessionEndedError, match="disabled"):
        users.get_actor(session, ana.user_id)
    with pytest.raises(UnauthenticatedError, match="do not fit"):
        _log_in(engine, "ana", PASSWORD)
    with open_writing(engine) as session:
        users.enable_user(session, people["root"], ana.user_id)
    assert _log_in(engine, "ana", PASSWORD).name == "ana"


def test_names_are_stored_in_one_form_and_found_however_they_are_typed(
    engine: Engine, people: Mapping[str, Actor]
) -> None:
    with open_writing(engine) as session:
        row = _create(session, people["root"], name="\uff26ay", printed_name="Fay   Ne\u0301e")
        assert (row.name, row.printed_name) == ("Fay", "Fay N\u00e9e")
    for typed in ("Fay", "fay", " FAY ", "\uff26\uff21\uff39"):
        assert _log_in(engine, typed, PASSWORD).name == "Fay"
    for typed in ("f\u0430y", "fay\ud800", "fay\x00", "", "x" * 10_000):
        with pytest.raises(UnauthenticatedError, match="do not fit"):
            _log_in(engine, typed, PASSWORD)


def test_what_was_proven_of_a_password_that_was_changed_meanwhile_proves_nothing(
    engine: Engine, people: Mapping[str, Actor]
) -> None:
    ana = people["ana"]
    assert ana.user_id is not None
    with open_reading(engine) as session:
        proof = proved(session, "ana", PASSWORD)
    with open_writing(engine) as session:
        users.change_password(session, people["root"], ana.user_id, new_password("another horse battery"))
    with open_reading(engine) as session, pytest.raises(UnauthenticatedError, match="do not fit"):
        users.authenticate(session, proof)
    with open_reading(engine) as session:
        another = proved(session, "cy", PASSWORD)
        with pytest.raises(UnauthenticatedError, match="do not fit"):
            users.require_password(session, people["bo"], another)


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
    with pytest.raises(UnauthenticatedError), open_writing(engine) as session:
        users.change_password(session, ana, ana.user_id, new_password(new), proved(session, ana, "wrong"))
    with open_writing(engine) as session:
        token = sessions.begin(session, ana.user_id, sessions.ClientAddress())[1]
        users.change_password(session, ana, ana.user_id, new_password(new), proved(session, ana, PASSWORD))
    with open_reading(engine) as session, pytest.raises(SessionEndedError, match="password was changed"):
        sessions.find(session, token)
    assert _log_in(engine, "ana", new).name == "ana"


def test_nobody_is_not_found(session: Session) -> None:
    with pytest.raises(NotFoundError, match="no user 99"):
        users.get_user(session, 99)
