"""Single sign-on against a stand-in provider: what an ID token must be, whose account it opens, and how people sign."""

import re
import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest
import sqlalchemy as sa

from benchmarks.identity_provider import (
    CLIENT_ID,
    CLIENT_SECRET,
    LOG_OUT,
    Provider,
    other_key,
    providing,
    symmetric_key,
)
from boresight.console.access.external_identities import NO_ROLE
from boresight.console.access.openid_connect import ALGORITHMS, read_provider_settings
from boresight.console.access.tables import ExternalIdentity, LoginSession, User
from boresight.errors import RefusedInputError
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing, utc_after
from tests.console.access.authenticators import App
from tests.served import PASSWORD, PLAIN, House, add_people, serving, settings_in
from tests.sites import codes

ROLES = "/crew/approvers=approver; /crew/operators=operator; cn=analysts,ou=crew=analyst; /crew/roots=administrator"
APPROVERS, OPERATORS, ANALYSTS, ROOTS = "/crew/approvers", "/crew/operators", "cn=analysts,ou=crew", "/crew/roots"


@pytest.fixture(scope="module")
def single(tmp_path_factory) -> Iterator[tuple[House, Provider]]:
    folder = tmp_path_factory.mktemp("single")
    secret = folder / "client-secret"
    secret.write_text(f"{CLIENT_SECRET}\n")
    with providing() as provider:
        settings = settings_in(
            folder / "data",
            oidc_issuer=provider.issuer,
            oidc_client_id=CLIENT_ID,
            oidc_client_secret_file=str(secret),
            oidc_roles=ROLES,
            oidc_label="Log in with the mission's account",
            public_url="http://boresight.example:8000",
            login_attempts="1000",
        )
        add_people(settings)
        with serving(settings) as (address, app):
            house = House(address, app, b"", {})
            provider.redirect_uri = "http://boresight.example:8000/login/single-sign-on/callback"
            yield house, provider
            for client in house.opened:
                client.close()


@pytest.fixture
def right(single) -> tuple[House, Provider]:
    """The provider as it should be, with a person who never came before."""
    house, provider = single
    number = len(provider.asked) + 1
    provider.person = {"sub": f"s-{number}", "preferred_username": f"sam{number}", "groups": [ANALYSTS]}
    provider.claims, provider.discovery, provider.error = {}, {}, ""
    provider.key, provider.algorithm, provider.token_answer = None, "ES256", None
    return house, provider


def _go(client: httpx.Client, query: str = "?next=/runs") -> str:
    """Go to the provider and return where it sends the browser back to, as a path of the server."""
    there = client.get(f"/login/single-sign-on{query}")
    assert there.status_code == 303, there.text
    with httpx.Client(verify=PLAIN) as browser:
        back = urlsplit(browser.get(there.headers["location"]).headers["location"])
    return f"{back.path}?{back.query}"


def _come(house: House, query: str = "?next=/runs") -> tuple[httpx.Client, httpx.Response]:
    client = house.anybody()
    return client, client.get(_go(client, query))


def _said(answer: httpx.Response) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", answer.text.partition("<main")[2]))


def _with_token(client: httpx.Client) -> httpx.Client:
    client.headers["X-CSRF-Token"] = client.get("/api/v1/sessions/current").json()["csrf_token"]
    return client


def test_the_log_in_page_has_the_button_and_keeps_the_form_of_local_accounts(right):
    house, _ = right
    page = house.anybody().get("/login?next=/runs").text
    assert 'href="/login/single-sign-on?next=%2Fruns"' in page
    assert 'name="password"' in page
    assert house.log_in("ada").get("/api/v1/runs").status_code == 200


def test_somebody_who_comes_first_gets_an_account_with_the_roles_of_their_groups(right):
    house, provider = right
    provider.person |= {"name": "Sam Sample", "groups": [APPROVERS, OPERATORS, "/crew/others"]}
    client, answer = _come(house)
    assert (answer.status_code, answer.headers["location"]) == (303, "/runs")
    me = client.get("/api/v1/sessions/current").json()
    assert (me["printed_name"], me["roles"]) == ("Sam Sample", ["approver", "operator"])
    with open_reading(house.app.state.engine) as session:
        bound = session.scalar(sa.select(ExternalIdentity).where(ExternalIdentity.user_id == me["user_id"]))
        assert bound is not None
        assert (bound.issuer, bound.subject) == (provider.issuer, provider.person["sub"])
        log_in = session.scalar(sa.select(LoginSession).where(LoginSession.user_id == me["user_id"]))
        assert log_in is not None
        assert log_in.method == "single sign-on"
        actions = [record.action for record in audit.list_records(session, subject=f"users/{me['user_id']}")]
        assert actions == ["bound", "created"]


def test_the_request_has_state_nonce_and_a_hashed_verifier_and_each_is_new(right):
    house, provider = right
    asked = [
        parse_qs(urlsplit(house.anybody().get("/login/single-sign-on").headers["location"]).query) for _ in range(2)
    ]
    for name in ("state", "nonce", "code_challenge"):
        assert asked[0][name] != asked[1][name]
        assert all(len(one[name][0]) >= 43 for one in asked)
    assert asked[0]["redirect_uri"] == [provider.redirect_uri]
    assert CLIENT_SECRET not in str(asked)


def test_roles_follow_the_groups_at_every_log_in_and_a_change_ends_the_log_ins_of_before(right):
    house, provider = right
    provider.person["groups"] = [ANALYSTS, OPERATORS]
    before, _ = _come(house)
    provider.person["groups"] = [OPERATORS]
    after, _ = _come(house)
    assert before.get("/api/v1/runs").status_code == 401
    assert after.get("/api/v1/sessions/current").json()["roles"] == ["operator"]
    provider.person["groups"] = ["/crew/others"]
    _, answer = _come(house)
    assert answer.status_code == 401
    assert NO_ROLE in _said(answer)
    assert after.get("/api/v1/runs").status_code == 401
    with open_reading(house.app.state.engine) as session:
        user = session.scalar(sa.select(User).where(User.name == provider.person["preferred_username"]))
        assert user is not None
        assert user.roles == []


def _refused(right: tuple[House, Provider]) -> str:
    house, _ = right
    client, answer = _come(house)
    assert answer.status_code == 401, answer.text
    assert client.get("/api/v1/runs").status_code == 401
    assert "boresight_session" not in client.cookies
    return _said(answer)


def _refused_for(right: tuple[House, Provider]) -> list[str]:
    return codes(_come(right[0])[1].text)


@pytest.mark.parametrize(
    ("claims", "says"),
    [
        ({"nonce": "another"}, "belongs to another log-in"),
        ({"nonce": None}, "belongs to another log-in"),
        ({"aud": "another-program"}, "for another program"),
        ({"aud": [CLIENT_ID, "another-program"], "azp": "another-program"}, "for another program"),
        ({"iss": "https://other.example"}, "from another provider"),
        ({"exp": 1_600_000_000}, "has expired"),
        ({"iat": 4_000_000_000}, "from the future"),
        ({"exp": None}, "lacks required claims"),
        ({"sub": None}, "lacks required claims"),
        ({"sub": ""}, "lacks required claims"),
        ({"groups": None}, "None of your groups"),
        ({"groups": [["/crew/approvers"]]}, "None of your groups"),
        ({"groups": [ROOTS, APPROVERS]}, "both administrator and approver"),
        ({"preferred_username": None}, "is not valid as a log-in name"),
        ({"preferred_username": "ada"}, "already used by another account"),
        ({"preferred_username": "ADA"}, "already used by another account"),
        ({"preferred_username": "system"}, "already used by another account"),
    ],
)
def test_a_token_that_does_not_fit_logs_nobody_in(right, claims, says):
    right[1].claims = claims
    assert says in _refused(right)


def test_a_token_signed_by_another_key_or_by_no_key_is_refused(right):
    _, provider = right
    provider.key = other_key()
    assert _refused_for(right) == ["signature"]
    provider.key = other_key("never published")
    assert _refused_for(right) == ["signature"]
    provider.key, provider.algorithm = symmetric_key(provider.published[0]), "HS256"
    assert _refused_for(right) == ["signature"]
    provider.token_answer = {"id_token": "eyJhbGciOiJub25lIn0.e30."}
    assert _refused_for(right) == ["signature"]
    assert not any(name.startswith(("HS", "none")) for name in ALGORITHMS)


def test_a_code_is_taken_once_and_only_in_the_browser_that_began(right):
    house, _ = right
    client = house.anybody()
    back = _go(client)
    thief = house.anybody()
    assert codes(thief.get(back).text) == ["state"]
    _go(thief)
    assert codes(thief.get(back).text) == ["state"]  # with the cookie of an attempt of their own
    kept = client.cookies["boresight_single_sign_on"]
    assert client.get(back).status_code == 303
    assert "boresight_single_sign_on" not in client.cookies
    again = house.anybody()
    again.cookies.set("boresight_single_sign_on", kept)
    replayed = again.get(back)
    assert replayed.status_code == 401
    assert "used already" in _said(replayed)


def test_an_answer_of_another_provider_or_a_refusal_logs_nobody_in(right):
    house, provider = right
    client = house.anybody()
    back = _go(client)
    mixed = re.sub("iss=[^&]+", "iss=https%3A%2F%2Fevil.example", back)
    assert codes(client.get(mixed).text) == ["issuer"]
    provider.error = "access_denied"
    assert _refused_for(right) == ["denied"]


def test_a_provider_that_is_away_or_strange_is_told_and_local_accounts_go_on(right):
    house, provider = right
    provider.discovery = {"issuer": "https://other.example"}
    house.app.state.identity_provider._known = None
    answer = house.anybody().get("/login/single-sign-on")
    assert answer.status_code == 401
    provider.discovery = {"token_endpoint": "http://other.example/token"}
    client = house.anybody()
    assert client.get(_go(client)).status_code == 503
    house.app.state.identity_provider._known = None
    assert house.log_in("ada").get("/api/v1/runs").status_code == 200


def test_new_keys_of_the_provider_are_read_when_a_token_names_one(right, monkeypatch):
    house, provider = right
    assert _come(house)[1].status_code == 303
    monkeypatch.setattr("boresight.console.access.openid_connect.KEYS_AGAIN_S", 0.0)
    provider.published = [other_key("second")]
    assert _come(house)[1].status_code == 303


def test_no_log_in_leads_to_another_site(right):
    house, _ = right
    for back in ("https%3A%2F%2Fevil.example%2F", "%2F%2Fevil.example", "%2F%5Cevil.example"):
        assert _come(house, f"?next={back}")[1].headers["location"] == "/"


def test_a_disabled_account_stays_out_and_no_password_opens_one_of_single_sign_on(right):
    house, provider = right
    client, _ = _come(house)
    number, root = client.get("/api/v1/sessions/current").json()["user_id"], house.person("adele")
    name = provider.person["preferred_username"]
    for password in ("", PASSWORD):
        assert house.anybody().post("/api/v1/sessions", json={"name": name, "password": password}).status_code == 401
    assert f'data-external="{number}"' in root.get("/users").text
    tag = root.get(f"/api/v1/users/{number}").headers["etag"]
    for act, body in (
        ("change-password", {"password": "kestrel over the moor 41"}),
        ("change-roles", {"roles": ["approver"]}),
    ):
        assert root.post(f"/api/v1/users/{number}:{act}", json=body, headers={"If-Match": tag}).status_code == 409
    assert root.post(f"/api/v1/users/{number}:disable", headers={"If-Match": tag}).status_code == 200
    assert client.get("/api/v1/runs").status_code == 401
    assert _refused_for(right) == ["disabled"]


def test_a_signature_needs_the_provider_to_confirm_the_person_anew_for_each_one(right):
    house, provider = right
    provider.person["groups"] = [APPROVERS]
    client = _with_token(_come(house)[0])

    def wanted() -> int:  # a second factor needs the same as a signature, and no runs behind it
        return client.post("/api/v1/second-factors:begin", json={}).status_code

    assert wanted() == 401
    assert client.get(_go(client, "?confirm=true&next=/runs")).headers["location"] == "/runs"
    assert provider.asked[-1]["prompt"] == "login"
    assert provider.asked[-1]["max_age"] == "0"
    assert [wanted(), wanted()] == [200, 401]
    client.get(_go(client, "?confirm=true&next=/runs"))
    with open_writing(house.app.state.engine) as session:
        for row in session.scalars(sa.select(LoginSession).where(LoginSession.confirmed_utc.is_not(None))):
            row.confirmed_utc = utc_after(-301.0)
    assert wanted() == 401


@pytest.mark.parametrize("claims", [{"auth_time": 1_600_000_000}, {"auth_time": None}, {"sub": "somebody else"}])
def test_an_old_log_in_at_the_provider_or_another_person_confirms_nobody(right, claims):
    house, provider = right
    client = _with_token(_come(house)[0])
    provider.claims = claims
    client.get(_go(client, "?confirm=true&next=/runs"))
    assert client.post("/api/v1/second-factors:begin", json={}).status_code == 401


def test_nobody_is_confirmed_under_another_log_in_than_the_one_that_asked(right):
    house, _ = right
    first, second = (_with_token(_come(house)[0]) for _ in range(2))
    back = _go(first, "?confirm=true&next=/runs")
    second.cookies.set("boresight_single_sign_on", first.cookies["boresight_single_sign_on"])
    second.get(back)
    assert second.post("/api/v1/second-factors:begin", json={}).status_code == 401
    assert house.anybody().get("/login/single-sign-on?confirm=true").status_code == 401


def test_with_a_second_factor_single_sign_on_waits_for_it_and_signatures_take_it_instead(right):
    house, _ = right
    client = _with_token(_come(house)[0])
    client.get(_go(client, "?confirm=true&next=/runs"))
    begun = client.post("/api/v1/second-factors:begin", json={}).json()
    app = App(begun["secret"])
    body = {"challenge_id": begun["challenge_id"], "factor": app.code()}
    assert client.post("/api/v1/second-factors", json=body).status_code == 201
    later, answer = _come(house)
    assert answer.headers["location"] == "/login/second-factor?next=%2Fruns"
    assert later.get("/api/v1/runs").status_code == 401
    assert later.post("/login/second-factor", data={"factor": app.code(), "next": "/runs"}).status_code == 303
    _with_token(later)
    assert later.post("/api/v1/second-factors:begin", json={}).status_code == 401
    assert later.post("/api/v1/second-factors:begin", json={"factor": app.code()}).status_code == 200


def test_logging_out_at_the_provider_too_is_a_link_that_leads_there(right):
    house, provider = right
    there = house.anybody().get("/login/single-sign-on/log-out").headers["location"]
    assert there.startswith(f"{provider.issuer}/log-out?client_id={CLIENT_ID}&post_logout_redirect_uri=")


BACK_CHANNEL = "/login/single-sign-on/back-channel-log-out"


def test_whom_the_provider_logs_out_is_out_everywhere_and_nobody_else_is(right):
    house, provider = right
    clients = [_come(house)[0] for _ in range(2)]
    user_id = clients[0].get("/api/v1/sessions/current").json()["user_id"]
    token = provider.make_log_out_token(iat=int(time.time()) - 5)
    provider.person = {**provider.person, "sub": "another", "preferred_username": f"sam-{user_id}-other"}
    other, _ = _come(house)
    answer = house.anybody().post(BACK_CHANNEL, data={"logout_token": token})
    assert (answer.status_code, answer.content, answer.headers["cache-control"]) == (200, b"", "no-store")
    assert [one.get("/api/v1/runs").status_code for one in (*clients, other)] == [401, 401, 200]
    with open_reading(house.app.state.engine) as session:
        records = [one for one in audit.list_records(session, subject=f"users/{user_id}") if "provider" in one.action]
        assert [(one.action, one.after) for one in records] == [("logged out at the provider", {"log_ins": 2})]
        ended = session.scalars(sa.select(LoginSession.ended_because).where(LoginSession.user_id == user_id))
        assert set(ended) == {"logged_out"}


def test_a_log_out_token_that_comes_again_ends_no_later_log_in(right):
    house, provider = right
    client, _ = _come(house)
    token = provider.make_log_out_token(iat=int(time.time()) - 3600)
    assert house.anybody().post(BACK_CHANNEL, data={"logout_token": token}).status_code == 200
    assert client.get("/api/v1/runs").status_code == 200


def test_a_log_out_of_somebody_who_never_came_is_done_at_once(right):
    house, provider = right
    assert house.anybody().post(BACK_CHANNEL, data={"logout_token": provider.make_log_out_token()}).status_code == 200


@pytest.mark.parametrize(
    "claims",
    [
        {"iss": "https://other.example"},
        {"aud": "another-program"},
        {"exp": 1_600_000_000},
        {"exp": None},
        {"iat": 4_000_000_000},
        {"iat": None},
        {"jti": None},
        {"sub": None},
        {"sub": 7},
        {"nonce": "of an ID token"},
        {"events": None},
        {"events": {}},
        {"events": {LOG_OUT: True}},
        {"events": [LOG_OUT]},
    ],
    ids=str,
)
def test_a_log_out_token_that_does_not_fit_logs_nobody_out(right, claims):
    house, provider = right
    client, _ = _come(house)
    answer = house.anybody().post(BACK_CHANNEL, data={"logout_token": provider.make_log_out_token(**claims)})
    assert (answer.status_code, answer.json()["error"]) == (400, "invalid_request")
    assert client.get("/api/v1/runs").status_code == 200


def test_a_log_out_token_that_names_only_a_session_is_refused_and_says_what_to_change(right):
    house, provider = right
    client, _ = _come(house)
    answer = house.anybody().post(BACK_CHANNEL, data={"logout_token": provider.make_log_out_token(sub=None)})
    assert (answer.status_code, "sub into" in answer.json()["error_description"]) == (400, True)
    assert client.get("/api/v1/runs").status_code == 200


def test_a_log_out_token_of_another_key_or_none_at_all_logs_nobody_out(right):
    house, provider = right
    client, _ = _come(house)
    published = provider.published[0]
    forged = []
    for key, algorithm in ((other_key(), "ES256"), (symmetric_key(published), "HS256")):
        provider.key, provider.algorithm = key, algorithm
        forged.append(provider.make_log_out_token())
    for token in (*forged, "", "no token", "a" * 20_000):
        assert house.anybody().post(BACK_CHANNEL, data={"logout_token": token}).status_code == 400
    assert house.anybody().post(BACK_CHANNEL).status_code == 400
    assert client.get("/api/v1/runs").status_code == 200


@pytest.mark.parametrize(
    "given",
    [
        {"oidc_client_id": ""},
        {"public_url": ""},
        {"oidc_issuer": "http://provider.example"},
        {"oidc_roles": "/crew=captain"},
        {"oidc_client_secret_file": "/nowhere/at/all"},
    ],
)
def test_settings_that_cannot_work_or_are_unsafe_are_refused_at_the_start(tmp_path, given):
    right = {
        "oidc_issuer": "https://provider.example",
        "oidc_client_id": "x",
        "public_url": "https://boresight.example",
    }
    assert read_provider_settings(settings_in(tmp_path, **right)).scopes == "openid profile"
    with pytest.raises(RefusedInputError):
        read_provider_settings(settings_in(tmp_path, **{**right, **given}))


def test_the_client_secret_is_in_no_printed_setting(tmp_path):
    given: dict[str, Any] = {
        "oidc_issuer": "https://p.example",
        "oidc_client_id": "x",
        "public_url": "https://b.example",
    }
    settings = settings_in(tmp_path, oidc_client_secret=CLIENT_SECRET, **given)
    assert read_provider_settings(settings).client_secret == CLIENT_SECRET
    assert CLIENT_SECRET not in repr(settings) + repr(read_provider_settings(settings))


def test_without_a_provider_there_is_neither_button_nor_way(house):
    assert "single-sign-on" not in house.anybody().get("/login").text
    assert house.anybody().get("/login/single-sign-on").status_code == 404
    assert house.anybody().post(BACK_CHANNEL, data={"logout_token": "any"}).status_code == 404
