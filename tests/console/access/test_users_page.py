"""People and API keys."""

import re

import pytest

from boresight.console.access import api_keys, users
from boresight.platform.db.sessions import open_reading

PASSWORD = "correct horse battery"


def test_an_administrator_adds_a_person_who_can_then_log_in(site, read):
    visitor = site.visitor("adele")
    form = {"name": "nina", "printed_name": "Nina New", "password": "a long enough one", "roles": ["viewer", "analyst"]}
    assert visitor.post("/users", **form).status_code == 303
    assert "Nina New may log in as nina." in read(visitor.get("/users"))
    answer = visitor.send("POST", "/login", data={"name": "nina", "password": "a long enough one"})
    assert answer.status_code == 303


def test_a_refused_person_keeps_what_was_typed_but_never_the_password(site):
    form = {"name": "nina", "printed_name": "Nina New", "password": "short-one", "roles": ["approver"]}
    answer = site.visitor("adele").post("/users", **form)
    assert answer.status_code == 422
    assert answer.status_code == 422
    assert 'value="Nina New"' in answer.text
    assert "short-one" not in answer.text
    new_person = answer.text.split('id="new-person"')[1]
    assert re.search(r'value="approver" checked', new_person)


def test_the_last_administrator_cannot_be_disabled_or_lose_the_role(site):
    visitor = site.visitor("adele")
    for path, form in (("/users/4/disable", {}), ("/users/4/roles", {"roles": ["viewer"]})):
        answer = visitor.post(path, **form)
        assert answer.status_code == 409
        assert answer.status_code == 409


def test_a_disabled_person_is_out_at_once_and_can_be_let_in_again(site):
    victim, visitor = site.visitor("victor"), site.visitor("adele")
    visitor.post("/users/5/disable")
    assert victim.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303
    visitor.post("/users/5/enable")
    with open_reading(site.engine) as session:
        assert users.get_user(session, 5).disabled_utc is None


def test_who_is_no_administrator_sees_only_what_is_theirs(site, read):
    page = read(site.visitor("ada").get("/users"))
    assert "People are managed by administrators: Adele Administrator" in page
    assert "Alan Approver" not in page
    assert "Make a key" in page


def test_a_keys_secret_is_shown_once_and_works(site):
    visitor = site.visitor("ada")
    answer = visitor.post("/users/keys", label="Pass automation", days="30", scopes=["runs"])
    secret = re.search(r"bs_[0-9a-f]{8}_[\w-]+", answer.text)[0]
    assert answer.headers["cache-control"] == "no-store"
    assert secret not in visitor.get("/users")
    with open_reading(site.engine) as session:
        assert api_keys.actor_of_key(session, secret).scopes == {"runs"}


@pytest.mark.parametrize(
    ("form", "sentence"),
    [({"label": " "}, "needs a label"), ({"label": "x", "days": "soon"}, "not a number of days")],
)
def test_a_refused_key_says_why(site, read, form, sentence):
    answer = site.visitor("ada").post("/users/keys", **form)
    assert answer.status_code == 422
    assert sentence in read(answer.text)


def test_a_revoked_key_stays_in_the_list_as_revoked(site, read):
    visitor = site.visitor("ada")
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


def test_who_was_given_a_password_sets_their_own_before_anything_else(site, read):
    victim = site.visitor("victor")
    page = site.visitor("adele").post("/users/5/password", password="a given password")
    assert page.status_code == 303
    assert "must set a password" in read(site.visitor("adele").get("/users"))
    assert victim.send("GET", "/audit", headers={"accept": "text/html"}).headers["location"].startswith("/login")
    victim.send("POST", "/login", data={"name": "victor", "password": "a given password"})
    for path in ("/", "/audit", "/users", "/login"):
        assert victim.send("GET", path, headers={"accept": "text/html"}).headers["location"] == "/password"
    assert "Only a password that nobody else knows" in read(victim.get("/password"))


def test_an_administrator_ends_the_log_ins_of_a_person(site):
    victim = site.visitor("victor")
    assert site.visitor("adele").post("/users/5/end-sessions").status_code == 303
    assert victim.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303
