"""People: passwords, throttled log-ins, roles that only administrators give, and always one of those left."""

import re
from dataclasses import replace

import pytest

from boresight.console.access import api_keys, confirmations, sessions, users
from boresight.console.access.tables import ApiKey, User
from boresight.console.approvals import service as approvals
from boresight.errors import (
    ConflictError,
    ForbiddenError,
    NotFoundError,
    RefusedInputError,
    SessionEndedError,
    UnauthenticatedError,
)
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_after
from tests.console.conftest import PASSWORD
from tests.passwords import new_password, proved
from tests.refusals import has_code
from tests.sites import codes


def _log_in(engine: Engine, name: str, password: str) -> Actor:
    with open_writing(engine) as session:
        return users.authenticate(session, proved(session, name, password))


def test_a_password_is_kept_as_argon2id_only(session):
    user = users.list_users(session)[0]
    assert user.password_hash.startswith("$argon2id$")
    assert PASSWORD not in user.password_hash


def _create(session: Session, actor: Actor, **changes: object) -> User:
    values = {"name": "newcomer", "printed_name": "New Comer", "roles": ["viewer"]} | changes
    values.setdefault("password", new_password(PASSWORD))
    return users.create_user(session, actor, **values)


@pytest.mark.parametrize(
    ("changes", "error", "says"),
    [
        ({"name": ""}, RefusedInputError, "not a log-in name"),
        ({"name": "new comer"}, RefusedInputError, "not a log-in name"),
        ({"name": "ana"}, ConflictError, "already"),
        ({"name": "ANA"}, ConflictError, "log-in name 'ana' exists already"),
        ({"name": "\uff41na"}, ConflictError, "log-in name 'ana' exists already"),
        ({"name": "a\u200bna"}, RefusedInputError, "U\\+200B"),
        ({"name": "x" * 65}, RefusedInputError, "shorten it to 64"),
        ({"printed_name": "Ana"}, ConflictError, "belongs to 'ana'"),
        ({"name": "system"}, ConflictError, "own records"),
        ({"printed_name": "BORESIGHT"}, ConflictError, "own records"),
        ({"printed_name": "Command  line"}, ConflictError, "own records"),
        ({"printed_name": " ana "}, ConflictError, "belongs to 'ana'"),
        ({"printed_name": "\uff21\uff4e\uff41"}, ConflictError, "belongs to 'ana'"),
        ({"printed_name": "Ana\u202eb"}, RefusedInputError, "U\\+202E"),
        ({"printed_name": "A\u2066na"}, RefusedInputError, "U\\+2066"),
        ({"printed_name": "Ana\x00"}, RefusedInputError, "U\\+0000"),
        ({"printed_name": "Ana\ud800"}, RefusedInputError, "U\\+D800"),
        ({"printed_name": "Ana\u0378"}, RefusedInputError, "U\\+0378"),
        ({"printed_name": "x" * 101}, RefusedInputError, "shorten it to 100"),
        ({"roles": ["wizard"]}, RefusedInputError, "no role wizard"),
        ({"roles": ["administrator", "approver"]}, RefusedInputError, "administrator cannot sign"),
        ({"roles": "viewer"}, RefusedInputError, "no role viewer"),
    ],
)
def test_a_person_that_cannot_be_is_refused(session, people, changes, error, says):
    with pytest.raises(error, match=says):
        _create(session, people["root"], **changes)


@pytest.mark.parametrize("name", ["ana", "bo", "cy", "dee", "eve"])
def test_only_administrators_make_and_change_people(session, people, name):
    actor, victim = people[name], people["root"].user_id
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
def test_no_key_manages_people_not_even_its_owner(session, people, scopes):
    key = replace(people["root"], credential="key:1234", scopes=scopes)
    approver, owner = people["cy"].user_id, people["root"].user_id
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
        with pytest.raises(ForbiddenError, check=has_code("key-not-allowed")):
            act()


def test_roles_take_effect_at_once_and_are_recorded(session, people):
    ana = people["ana"]
    users.change_roles(session, people["root"], ana.user_id, ["viewer", "viewer"])
    assert users.get_actor(session, ana.user_id).roles == {"viewer"}
    record = audit.find_last_change(session, f"users/{ana.user_id}")
    assert (record.before, record.after) == ({"roles": ["analyst"]}, {"roles": ["viewer"]})
    with pytest.raises(RefusedInputError, check=has_code("administrator-cannot-sign")):
        users.change_roles(session, people["root"], people["cy"].user_id, ["approver", "administrator"])
    with pytest.raises(NotFoundError, match="no user 99"):
        session.get_known(User, 99)


def test_a_disabled_person_is_out_at_once_and_stays_out(engine, people):
    ana = people["ana"]
    with open_writing(engine) as session:
        users.disable_user(session, people["root"], ana.user_id)
    with open_reading(engine) as session, pytest.raises(SessionEndedError, match="disabled"):
        users.get_actor(session, ana.user_id)
    with pytest.raises(UnauthenticatedError, check=has_code("wrong-password")):
        _log_in(engine, "ana", PASSWORD)
    with open_writing(engine) as session:
        users.enable_user(session, people["root"], ana.user_id)
    actor = _log_in(engine, "bo", PASSWORD)
    assert (actor.printed_name, actor.credential, actor.scopes) == ("Bo", "session", None)
    assert actor.roles == {"analyst", "approver"}
    assert _log_in(engine, "ana", PASSWORD).name == "ana"


def test_names_are_stored_in_one_form_and_found_however_they_are_typed(engine, people):
    with open_writing(engine) as session:
        row = _create(session, people["root"], name="\uff26ay", printed_name="Fay   Ne\u0301e")
        assert (row.name, row.printed_name) == ("Fay", "Fay N\u00e9e")
    for typed in ("Fay", "fay", " FAY ", "\uff26\uff21\uff39"):
        assert _log_in(engine, typed, PASSWORD).name == "Fay"
    for typed in ("f\u0430y", "fay\ud800", "fay\x00", "", "x" * 10_000):
        with pytest.raises(UnauthenticatedError, check=has_code("wrong-password")):
            _log_in(engine, typed, PASSWORD)


def test_what_was_proven_of_a_password_that_was_changed_meanwhile_proves_nothing(engine, people):
    ana = people["ana"]
    with open_reading(engine) as session:
        proof = proved(session, "ana", PASSWORD)
    with open_writing(engine) as session:
        users.change_password(session, people["root"], ana.user_id, new_password("another horse battery"))
    with open_reading(engine) as session, pytest.raises(UnauthenticatedError, check=has_code("wrong-password")):
        users.authenticate(session, proof)
    with open_reading(engine) as session:
        another = proved(session, "cy", PASSWORD)
        with pytest.raises(UnauthenticatedError, check=has_code("wrong-password")):
            confirmations.require(session, people["bo"], another)


def test_the_last_administrator_stays(session, people):
    root = people["root"]
    for act in (
        lambda: users.disable_user(session, root, root.user_id),
        lambda: users.change_roles(session, root, root.user_id, ["viewer"]),
    ):
        with pytest.raises(ConflictError, match="only administrator"):
            act()


def test_a_new_password_needs_the_old_one_and_ends_every_log_in(engine, people):
    ana, new = people["ana"], "another horse battery"
    with pytest.raises(UnauthenticatedError), open_writing(engine) as session:
        users.change_password(session, ana, ana.user_id, new_password(new), proved(session, ana, "wrong"))
    with open_writing(engine) as session:
        token = sessions.begin(session, ana.user_id, sessions.ClientAddress())[1]
        users.change_password(session, ana, ana.user_id, new_password(new), proved(session, ana, PASSWORD))
    with open_reading(engine) as session, pytest.raises(SessionEndedError, check=has_code("password_changed")):
        sessions.find(session, token)
    assert _log_in(engine, "ana", new).name == "ana"


def test_an_administrator_adds_a_person_who_can_then_log_in(site, read):
    visitor = site.visitor("adele")
    form = {"name": "nina", "printed_name": "Nina New", "password": "a long enough one", "roles": ["viewer", "analyst"]}
    assert visitor.post("/users", **form).status_code == 303
    assert re.search("Nina New .* nina", read(visitor.get("/users")))
    answer = visitor.send("POST", "/login", data={"name": "nina", "password": "a long enough one"})
    assert answer.status_code == 303


def test_a_refused_person_keeps_what_was_typed_but_never_the_password(site):
    form = {"name": "nina", "printed_name": "Nina New", "password": "short-one", "roles": ["approver"]}
    answer = site.visitor("adele").post("/users", **form)
    assert answer.status_code == 422
    assert 'value="Nina New"' in answer.text
    assert "short-one" not in answer.text
    new_person = answer.text.split('id="new-person"')[1]
    assert re.search(r'value="approver" checked', new_person)


def test_an_administrator_disables_a_person_lets_them_in_again_and_ends_their_log_ins(site):
    adele = site.visitor("adele")
    for verb in ("disable", "enable", "end-sessions"):
        victim = site.visitor("victor") if verb != "enable" else None
        assert adele.post(f"/users/5/{verb}").status_code == 303
        if victim:
            assert victim.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303
    with open_reading(site.engine) as session:
        assert session.get_known(User, 5).disabled_utc is None


def test_who_is_no_administrator_sees_only_what_is_theirs(site, read):
    page = site.visitor("ada").get("/users")
    assert "administrators-only" in codes(page)
    assert "Adele Administrator" in (page := read(page))
    assert "Alan Approver" not in page
    assert "Create a key" in page


def test_a_keys_secret_is_shown_once_and_works(site):
    visitor = site.visitor("ada")
    answer = visitor.post("/users/keys", label="Pass automation", days="30", scopes=["runs"])
    secret = re.search(r"bs_[0-9a-f]{8}_[\w-]+", answer.text)[0]
    assert answer.headers["cache-control"] == "no-store"
    assert secret not in visitor.get("/users")
    with open_reading(site.engine) as session:
        assert api_keys.find_actor_of_key(session, secret).scopes == {"runs"}


def test_a_refused_key_says_why_and_a_revoked_one_stays_in_the_list_as_revoked(site, read):
    visitor = site.visitor("ada")
    for form, sentence in (({"label": " "}, "has no label"), ({"label": "x", "days": "soon"}, "not a number of days")):
        answer = visitor.post("/users/keys", **form)
        assert (answer.status_code, sentence in read(answer.text)) == (422, True)
    visitor.post("/users/keys", label="old one")
    assert visitor.post("/users/keys/1/revoke").status_code == 303
    page = read(visitor.get("/users"))
    assert "Revoked old one" in page


def test_a_changed_password_ends_every_log_in(site):
    visitor, elsewhere = site.visitor("ada"), site.visitor("ada")
    form = {"current": PASSWORD, "password": "another long one", "repeated": "another long one"}
    assert visitor.post("/password", **(form | {"repeated": "typo"})).status_code == 422
    assert visitor.post("/password", **form).headers["location"] == "/login"
    assert elsewhere.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303


def test_who_was_given_a_password_sets_their_own_before_anything_else(site):
    victim = site.visitor("victor")
    page = site.visitor("adele").post("/users/5/password", password="a given password")
    assert page.status_code == 303
    assert 'data-must-set-password="5"' in site.visitor("adele").get("/users")
    assert victim.send("GET", "/audit", headers={"accept": "text/html"}).headers["location"].startswith("/login")
    victim.send("POST", "/login", data={"name": "victor", "password": "a given password"})
    for path in ("/", "/audit", "/users", "/login"):
        assert victim.send("GET", path, headers={"accept": "text/html"}).headers["location"] == "/password"
    assert 'id="password-due"' in victim.get("/password")


@pytest.fixture
def key(session, people) -> tuple[ApiKey, str]:
    return api_keys.create_key(session, people["ana"], label="downlink", scopes=["runs"])


def test_a_secret_lets_its_program_act_as_the_owner_within_its_scopes(session, people, key):
    row, secret = key
    actor = api_keys.find_actor_of_key(session, secret)
    assert (actor.user_id, actor.roles) == (people["ana"].user_id, people["ana"].roles)
    assert (actor.credential, actor.scopes) == (f"key:{row.prefix}", {"runs"})


def test_the_secret_itself_is_not_kept(key):
    row, secret = key
    assert secret.startswith(f"bs_{row.prefix}_")
    kept = [str(getattr(row, column.key)) for column in ApiKey.__table__.columns]
    assert all(secret.split("_", 2)[2] not in value for value in kept)


def test_a_secret_with_one_letter_changed_is_unknown(session, key):
    secret = key[1]
    for wrong in (secret[:-1] + ("A" if secret[-1] != "A" else "B"), secret[:-1], "", "bs_", "bs_a_b", "é_é_é"):
        with pytest.raises(UnauthenticatedError, match="copied completely"):
            api_keys.find_actor_of_key(session, wrong)


def test_a_key_loses_what_its_owner_loses(session, people, key):
    ana = people["ana"].user_id
    users.change_roles(session, people["root"], ana, ["viewer"])
    assert api_keys.find_actor_of_key(session, key[1]).roles == {"viewer"}
    users.disable_user(session, people["root"], ana)
    with pytest.raises(UnauthenticatedError, match=r"owner .* is disabled"):
        api_keys.find_actor_of_key(session, key[1])


def test_an_expired_and_a_revoked_key_are_told_apart(session, people, key):
    row, secret = key
    row.expires_utc = utc_after(-1.0)
    with pytest.raises(UnauthenticatedError, match="expired at"):
        api_keys.find_actor_of_key(session, secret)
    api_keys.revoke_key(session, people["ana"], row.id)
    with pytest.raises(UnauthenticatedError, match="was revoked"):
        api_keys.find_actor_of_key(session, secret)


def test_only_owner_and_administrator_revoke(session, people, key):
    with pytest.raises(ForbiddenError, check=has_code("not-the-owner")):
        api_keys.revoke_key(session, people["bo"], key[0].id)
    assert api_keys.revoke_key(session, people["root"], key[0].id).revoked_utc is not None
    with pytest.raises(NotFoundError):
        api_keys.revoke_key(session, people["root"], 99)


def test_a_key_makes_no_key(session, key):
    with pytest.raises(ForbiddenError, check=has_code("not-a-person")):
        api_keys.create_key(session, api_keys.find_actor_of_key(session, key[1]), label="child")
    with pytest.raises(ForbiddenError, match="revoke", check=has_code("key-not-allowed")):
        api_keys.revoke_key(session, api_keys.find_actor_of_key(session, key[1]), key[0].id)
    with pytest.raises(ForbiddenError, check=has_code("not-a-person")):
        api_keys.create_key(session, COMMAND_LINE, label="child")


@pytest.mark.parametrize(
    ("choices", "says"),
    [
        ({"label": "x", "scopes": ["everything"]}, "no scope everything"),
        ({"label": "  "}, "has no label"),
        ({"label": "x", "expires_days": 0}, "cannot be valid for 0 days"),
    ],
)
def test_a_key_that_cannot_be_is_refused(session, people, choices, says):
    with pytest.raises(RefusedInputError, match=says):
        api_keys.create_key(session, people["ana"], **choices)
    assert api_keys.list_keys(session) == []


def test_what_a_key_changed_is_on_record_as_the_key(engine, people, candidate, blobs):
    row = candidate()
    with open_writing(engine) as session:
        key, secret = api_keys.create_key(session, people["ana"], label="robot", scopes=["parameter-sets"])
    with open_writing(engine) as session:
        robot = api_keys.find_actor_of_key(session, secret)
        approvals.submit(session, robot, blobs, row.id, "better", row.version)
    with open_reading(engine) as session:
        record = audit.find_last_change(session, f"parameter-sets/{row.id}")
        assert record.credential == f"key:{key.prefix}"
        assert [listed.id for listed in api_keys.list_keys(session, people["ana"].user_id)] == [key.id]
        assert api_keys.list_keys(session, people["bo"].user_id) == []


def test_the_last_use_of_a_key_is_kept_and_only_ever_moves_on(engine, people):
    with open_writing(engine) as session:
        key, _ = api_keys.create_key(session, people["ana"], label="robot")
    for at_utc in ("2026-11-21T10:00:00.000000Z", "2026-11-21T09:00:00.000000Z"):
        with open_writing(engine) as session:
            api_keys.record_uses(session, {key.prefix: at_utc, "unknown": at_utc})
    with open_reading(engine) as session:
        assert session.get_known(ApiKey, key.id).last_used_utc == "2026-11-21T10:00:00.000000Z"
        assert audit.verify(session).ok
