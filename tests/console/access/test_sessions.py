"""Logging in: what the cookie is, what ends it, what a request must bring beside it."""

import hashlib
import re
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from typing import Any

import httpx
import pytest
import sqlalchemy as sa
from fastapi import Response
from hypothesis import given
from hypothesis import strategies as st
from itsdangerous import URLSafeTimedSerializer

from boresight.console.access import sessions
from boresight.console.access.credentials import SESSION_COOKIE, LogInCookie, read_secret
from boresight.console.access.pages.log_in import local_path
from boresight.console.access.pages.people import WHY_ENDED
from boresight.console.access.tables import LoginSession
from boresight.console.jobs.maintenance import Maintenance
from boresight.errors import SessionEndedError, UnauthenticatedError
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.db.data_version import DataVersionReader
from boresight.platform.db.sessions import open_engine, open_reading, open_writing, utc_after, utc_text
from boresight.settings import Settings
from tests.refusals import has_code
from tests.served import PASSWORD, House, add_people, serving, settings_in
from tests.sites import codes


def test_the_cookie_is_out_of_reach_of_scripts_and_of_other_sites(house):
    answer = house.anybody().post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD})
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith(f"{SESSION_COOKIE}=")
    assert {"HttpOnly", "SameSite=lax", "Path=/", "Max-Age=43200"} <= set(cookie.split("; "))
    assert answer.headers["cache-control"] == "no-store"


def test_secure_cookies_are_sent_over_https_only(tmp_path):
    response = Response()
    LogInCookie(settings_in(tmp_path, secure_cookies="1")).write(response, "token")
    assert "; Secure" in response.headers["set-cookie"]


def test_who_am_i_tells_roles_and_the_same_csrf_token(house):
    client = house.log_in("bo")
    body = client.get("/api/v1/sessions/current").json()
    assert (body["name"], body["roles"], body["credential"]) == ("bo", ["analyst", "approver"], "session")
    assert body["csrf_token"] == client.headers["X-CSRF-Token"]


def test_a_wrong_password_and_an_unknown_name_get_the_same_answer(house):
    answers = [
        house.anybody().post("/api/v1/sessions", json={"name": name, "password": "not the password"})
        for name in ("ada", "nobody-of-that-name")
    ]
    assert [answer.status_code for answer in answers] == [401, 401]
    assert answers[0].json()["detail"] == answers[1].json()["detail"]
    assert all("set-cookie" not in answer.headers for answer in answers)


def _copy(house: House, client: httpx.Client) -> httpx.Client:
    thief = house.anybody(**{"X-CSRF-Token": client.headers["X-CSRF-Token"]})
    thief.cookies.set(SESSION_COOKIE, client.cookies[SESSION_COOKIE])
    assert thief.get("/api/v1/runs").status_code == 200
    assert thief.get("/").status_code == 200
    return thief


def _why(client: httpx.Client) -> tuple[int, str, str]:
    answer = client.get("/api/v1/runs")
    page = client.get("/", headers={"accept": "text/html"})
    ended = page.headers.get("location", "").partition("ended=")[2]
    return answer.status_code, answer.json().get("type", "").rpartition(":")[2], ended


def _administer(house: House, number: int, verb: str, **body: Any) -> httpx.Response:
    root = house.person("adele")
    tag = root.get(f"/api/v1/users/{number}").headers["etag"]
    return root.post(f"/api/v1/users/{number}:{verb}", headers={"If-Match": tag}, json=body or None)


ENDINGS: dict[str, Callable[[House, httpx.Client, str, int], httpx.Response]] = {
    "logged_out": lambda _, owner, *__: owner.delete("/api/v1/sessions/current"),
    "ended": lambda house, _, name, __: house.log_in(name).post("/api/v1/sessions/current:end-others"),
    "ended_by_administrator": lambda house, _, __, number: _administer(house, number, "end-sessions"),
    "password_changed": lambda _, owner, __, number: owner.post(
        f"/api/v1/users/{number}:change-password", json={"password": "known to nobody else", "current": PASSWORD}
    ),
    "roles_changed": lambda house, _, __, number: _administer(house, number, "change-roles", roles=["operator"]),
    "disabled": lambda house, _, __, number: _administer(house, number, "disable"),
}


@pytest.mark.parametrize("because", ENDINGS)
def test_a_copied_cookie_ends_with_the_next_request(house, because):
    name, number = house.new_person("viewer")
    owner = house.log_in(name)
    thief = _copy(house, owner)
    assert ENDINGS[because](house, owner, name, number).status_code in {200, 204}
    assert _why(thief) == (401, "session-ended", because)
    assert thief.post("/api/v1/sensors", json={}).status_code == 401


def test_an_open_event_stream_ends_with_its_log_in(house):
    name, _ = house.new_person("viewer")
    owner, other = house.log_in(name), house.log_in(name)
    with other.stream("GET", "/api/v1/events", timeout=20) as stream:
        lines = stream.iter_lines()
        assert next(lines) == ": connected"
        began_s = time.monotonic()
        assert owner.post("/api/v1/sessions/current:end-others").json() == {"ended": 1}
        assert any(line == "event: logged-out" for line in lines)
        assert list(lines)[-1:] == [""]  # and nothing more
    assert time.monotonic() - began_s < 5
    assert owner.get("/api/v1/runs").status_code == 200


def test_a_person_sees_their_log_ins_and_ends_one(house):
    name, number = house.new_person("viewer")
    phone = house.anybody(**{"User-Agent": "phone/1" + "x" * 500})
    assert phone.post("/api/v1/sessions", json={"name": name, "password": PASSWORD}).status_code == 201
    browser = house.log_in(name)
    listed = browser.get("/api/v1/sessions?open=true").json()["items"]
    assert [one["current"] for one in listed] == [True, False]
    assert {one["user_id"] for one in listed} == {number}
    assert listed[1]["user_agent"].startswith("phone/1x")
    assert len(listed[1]["user_agent"]) <= 200
    assert listed[1]["address"] == "127.0.0.1"
    ended = browser.post(f"/api/v1/sessions/{listed[1]['id']}:end").json()
    assert (ended["ended_because"], ended["ended_utc"] is None) == ("ended", False)
    assert phone.get("/api/v1/runs").status_code == 401
    assert [one["id"] for one in browser.get("/api/v1/sessions?open=false").json()["items"]] == [listed[1]["id"]]


def test_only_an_administrator_sees_and_ends_anothers_log_ins_and_no_key_any(house):
    name, number = house.new_person("viewer")
    own = house.log_in(name)
    session_id = own.get("/api/v1/sessions").json()["items"][0]["id"]
    ada, root, key = house.person("ada"), house.person("adele"), house.key("adele", "runs")
    assert ada.get(f"/api/v1/sessions?user_id={number}").status_code == 403
    assert ada.post(f"/api/v1/sessions/{session_id}:end").status_code == 404
    for method, path in (
        ("GET", "sessions"),
        ("POST", f"sessions/{session_id}:end"),
        ("POST", "sessions/current:end-others"),
        ("DELETE", "sessions/current"),
    ):
        assert key.request(method, f"/api/v1/{path}").status_code == 403
    assert [one["id"] for one in root.get(f"/api/v1/sessions?user_id={number}").json()["items"]] == [session_id]
    assert root.post(f"/api/v1/sessions/{session_id}:end").json()["ended_because"] == "ended_by_administrator"
    assert own.get("/api/v1/runs").status_code == 401


def test_what_a_program_says_of_itself_is_kept_short_and_printable():
    assert sessions.ClientAddress.of(None, "a\x7f\u202eb\ud800" + "c" * 300) == sessions.ClientAddress(
        "", "ab" + "c" * 195
    )


def test_neither_the_secret_nor_its_hash_is_told_or_stored_readably(house):
    client = house.log_in("victor")
    token = house.app.state.log_in_cookie.read(client.cookies[SESSION_COOKIE]).token
    assert len(token) >= 43  # 256 bits
    listed = client.get("/api/v1/sessions").text
    with open_reading(house.app.state.engine) as session:
        hashes = session.scalars(sa.select(LoginSession.token_hash)).all()
    assert hashlib.sha256(token.encode()).hexdigest() in hashes
    assert token not in listed
    assert not any(one in listed for one in hashes)


@pytest.fixture
def settings(tmp_path) -> Settings:
    settings = settings_in(tmp_path)
    add_people(settings)
    return settings


@contextmanager
def _logged_in(settings: Settings) -> Iterator[tuple[httpx.Client, Any]]:
    with serving(settings) as (address, app), httpx.Client(base_url=address) as client:
        client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).raise_for_status()
        yield client, app


def test_idleness_ends_a_log_in_and_survives_a_restart(settings):
    assert settings.session_idle_minutes == 60.0
    with _logged_in(settings) as (client, _):
        cookies = httpx.Cookies(client.cookies)
    for minutes, status in ((59, 200), (59, 200), (61, 401)):  # and stopping writes that use
        _shift(settings, minutes)
        with serving(settings) as (address, _), httpx.Client(base_url=address, cookies=cookies) as client:
            assert [client.get("/api/v1/runs").status_code for _ in range(2)] == [status] * 2


def _shift(settings: Settings, minutes: float) -> None:
    engine = open_engine(settings.database_url)
    with open_writing(engine) as session:
        for row in session.scalars(sa.select(LoginSession)):
            used = datetime.fromisoformat(row.last_used_utc) - timedelta(minutes=minutes)
            row.last_used_utc = utc_text(used)
    engine.dispose()


def test_a_use_on_one_server_keeps_the_log_in_alive_on_another(settings):
    with serving(settings) as (one, app_one), serving(settings) as (two, _), httpx.Client() as client:
        client.post(f"{one}/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).raise_for_status()
        _shift(settings, minutes=59)
        app_one.state.maintenance._sessions_used_utc.clear()
        assert client.get(f"{one}/api/v1/runs").status_code == 200
        app_one.state.maintenance.write_uses()
        _shift(settings, minutes=2)  # 61 minutes after the log-in, 2 after its use on the first server
        assert client.get(f"{two}/api/v1/runs").status_code == 200


def test_an_open_page_that_only_listens_or_renews_itself_does_not_use_its_log_in(settings):
    with _logged_in(settings) as (client, app):
        used = app.state.maintenance._sessions_used_utc
        background = {"X-Boresight-Background": "1"}
        for _ in range(3):  # the second and third are cached
            assert client.get("/api/v1/runs", headers=background).status_code == 200
            assert client.get("/", headers=background).status_code == 200
        with client.stream("GET", "/api/v1/events") as stream:
            assert stream.status_code == 200
        assert used == {}
        assert client.get("/api/v1/runs").status_code == 200
        assert len(used) == 1


def test_requests_do_not_write_and_a_round_writes_the_last_use_once(settings):
    with _logged_in(settings) as (client, app):
        reader = DataVersionReader(app.state.engine)
        before = reader.look()
        for _ in range(20):
            client.get("/api/v1/sensors").raise_for_status()
        assert reader.look() == before
        app.state.maintenance.write_uses()
        after = reader.look()
        assert after != before
        app.state.maintenance.write_uses()
        assert reader.look() == after
        reader.close()


def test_what_lapsed_is_written_and_what_ended_long_ago_is_forgotten(settings):
    engine = open_engine(settings.database_url)
    maintenance = Maintenance(engine, settings.session_limits, open_blobs(settings.blob_location))
    ages_h = {"fresh": 0.0, "idle": 1.2, "expired": 13.0}
    with open_writing(engine) as session:
        for age_h in ages_h.values():
            row, _ = sessions.begin(session, 1, sessions.ClientAddress())
            row.created_utc = row.last_used_utc = utc_after(-3600 * age_h)
        row, _ = sessions.begin(session, 1, sessions.ClientAddress())
        row.ended_utc, row.ended_because = utc_after(-sessions.KEPT_FOR_S - 60), "logged_out"
    maintenance.tidy_sessions()
    with open_reading(engine) as session:
        ended = session.scalars(sa.select(LoginSession.ended_because).order_by(LoginSession.id)).all()
    assert ended == [None, "idle", "expired"]
    engine.dispose()


def test_ending_sessions_ends_a_copied_cookie(house):
    client, thief = house.log_in("bo"), house.anybody()
    thief.cookies = client.cookies
    assert thief.get("/api/v1/runs").status_code == 200
    user_id = client.get("/api/v1/sessions/current").json()["user_id"]
    assert client.post(f"/api/v1/users/{user_id}:end-sessions").status_code == 204
    house.clients.pop("bo", None)
    assert thief.get("/api/v1/runs").status_code == 401


def test_an_altered_cookie_is_nobody(house):
    client = house.log_in("ada")
    value = client.cookies[SESSION_COOKIE]
    client.cookies.clear()
    client.cookies.set(SESSION_COOKIE, value[:-2] + ("aa" if value[-2:] != "aa" else "bb"))
    assert client.get("/api/v1/runs").status_code == 401


def _value(response: Response) -> str:
    return response.headers["set-cookie"].partition(";")[0].partition("=")[2]


def test_a_cookie_ends_with_its_hours_and_is_nobody_elsewhere(tmp_path, monkeypatch):
    cookie = LogInCookie(settings_in(tmp_path, session_hours="1"))
    response = Response()
    csrf_token = cookie.write(response, "a secret")
    said = cookie.read(_value(response))
    assert (said.token, said.csrf_token) == ("a secret", csrf_token)
    with pytest.raises(UnauthenticatedError):
        LogInCookie(settings_in(tmp_path / "two")).read(_value(response))  # another installation
    later = time.time() + 3602
    monkeypatch.setattr("itsdangerous.timed.time.time", lambda: later)
    with pytest.raises(SessionEndedError, check=has_code("expired")):
        cookie.read(_value(response))


def test_a_cookie_of_a_version_without_sessions_is_nobody(house):
    serializer = URLSafeTimedSerializer(read_secret(house.app.state.settings.data_folder), salt=SESSION_COOKIE)
    stranger = house.anybody()
    for old in ([1, 0, "csrf"], [1, "csrf"], {"token": "x"}, "x"):
        stranger.cookies.set(SESSION_COOKIE, serializer.dumps(old))
        assert stranger.get("/api/v1/runs").status_code == 401


def test_the_secret_is_made_once_and_readable_by_its_owner_only(tmp_path):
    first = read_secret(tmp_path)
    assert len(first) == 32
    assert read_secret(tmp_path) == first
    assert stat.S_IMODE((tmp_path / "secret.key").stat().st_mode) == 0o600
    assert [path.name for path in tmp_path.iterdir()] == ["secret.key"]


def test_a_token_of_another_log_in_is_refused(house):
    client, other = house.log_in("ada"), house.log_in("ada")
    client.headers["X-CSRF-Token"] = other.headers["X-CSRF-Token"]
    assert client.post("/api/v1/sensors", json=house.sensor_file()).status_code == 403


def test_a_request_that_the_browser_says_comes_from_another_site_is_refused(house):
    answer = house.person("ada").post(
        "/api/v1/sensors", json=house.sensor_file(), headers={"Sec-Fetch-Site": "cross-site"}
    )
    assert answer.status_code == 403
    assert "another site" in answer.json()["detail"]


def test_a_key_needs_no_csrf_token_and_acts_within_its_scopes(house):
    writer, reader = house.key("ada", "sensors"), house.key("ada")
    assert writer.post("/api/v1/sensors", json=house.sensor_file()).status_code == 201
    assert reader.get("/api/v1/sensors").status_code == 200
    refused = reader.post("/api/v1/sensors", json=house.sensor_file())
    assert refused.status_code == 403
    assert (refused.json()["code"], "sensors" in refused.json()["detail"]) == ("scope-missing", True)
    body = writer.get("/api/v1/sessions/current").json()
    assert body["credential"].startswith("key:")
    assert (body["scopes"], body["csrf_token"]) == (["sensors"], None)


@pytest.mark.parametrize("secret", ["bs_", "bs_00000000_nothing", "nonsense", "bs_a"])
def test_an_unknown_key_is_nobody_even_beside_a_good_cookie(house, secret):
    answer = house.person("ada").get("/api/v1/runs", headers={"Authorization": f"Bearer {secret}"})
    assert answer.status_code == 401


def test_the_secret_of_a_key_is_shown_once(house):
    client = house.person("ada")
    made = client.post("/api/v1/api-keys", json={"label": "once"}, headers={"Idempotency-Key": "make-a-key"})
    again = client.post("/api/v1/api-keys", json={"label": "once"}, headers={"Idempotency-Key": "make-a-key"})
    assert made.json()["secret"]
    assert again.json() == {**made.json(), "secret": None}
    assert made.json()["secret"] not in client.get("/api/v1/api-keys").text


def test_people_see_their_own_keys_and_administrators_everyones(house):
    house.key("victor")
    ada, adele = (house.person(name).get("/api/v1/api-keys?limit=200").json()["items"] for name in ("ada", "adele"))
    assert len({key["user_id"] for key in ada}) <= 1
    assert {"test"} <= {key["label"] for key in adele}
    assert len({key["user_id"] for key in adele}) >= 2


def test_who_was_given_a_password_is_told_so_and_refused_all_else_until_it_is_set(house):
    given, own = "given by an administrator", "known to nobody else"
    root = house.person("adele")
    person = {"name": "fay", "printed_name": "Fay", "password": PASSWORD, "roles": ["approver"]}
    row = root.post("/api/v1/users", json=person)
    address = f"/api/v1/users/{row.json()['id']}"
    stale = {"If-Match": row.headers["etag"]}
    assert root.post(f"{address}:change-password", json={"password": given}, headers=stale).status_code == 200
    assert root.post(f"{address}:change-password", json={"password": given}, headers=stale).status_code == 412
    assert root.post(f"{address}:end-sessions", headers=stale).status_code == 412
    fay = house.anybody()
    log_in = fay.post("/api/v1/sessions", json={"name": "fay", "password": given}).json()
    fay.headers["X-CSRF-Token"] = log_in["csrf_token"]
    assert log_in["must_change_password"]
    refused = fay.get("/api/v1/runs")
    assert (refused.status_code, refused.json()["type"]) == (403, "urn:boresight:problem:password-to-be-set")
    assert fay.get("/api/v1/sessions/current").json()["must_change_password"]
    body = {"password": own, "current": given}
    assert fay.post(f"{address}:change-password", json=body).json()["must_change_password"] is False
    again = fay.post("/api/v1/sessions", json={"name": "fay", "password": own})
    assert again.json()["must_change_password"] is False
    assert fay.get("/api/v1/runs").status_code == 200


def test_a_revoked_key_is_nobody_and_one_revoked_meanwhile_is_not_revoked_by_who_did_not_see_it(house):
    client = house.person("ada")
    made = client.post("/api/v1/api-keys", json={"label": "passes"})
    address, seen = f"/api/v1/api-keys/{made.json()['id']}:revoke", {"If-Match": made.headers["etag"]}
    known = house.anybody(Authorization=f"Bearer {made.json()['secret']}")
    assert known.get("/api/v1/runs").status_code == 200
    assert client.post(address, headers=seen).status_code == 200
    assert known.get("/api/v1/runs").status_code == 401
    assert client.post(address, headers=seen).status_code == 412
    assert client.post(address).status_code == 200


def test_the_last_use_of_a_key_is_shown(house):
    client = house.person("ada")
    made = client.post("/api/v1/api-keys", json={"label": "reader"}).json()
    assert made["last_used_utc"] is None
    assert house.anybody().get("/api/v1/runs", headers={"Authorization": f"Bearer {made['secret']}"}).status_code == 200
    house.app.state.maintenance.write_uses()
    listed = client.get("/api/v1/api-keys").json()["items"]
    assert next(key for key in listed if key["id"] == made["id"])["last_used_utc"] is not None


def test_a_person_sees_their_log_ins_and_ends_one_and_all_others(site, read):
    here, there, third = (site.visitor("ada") for _ in range(3))
    page = here.get("/sessions")
    assert page.count("this one") == 1
    ends = re.findall(r"/sessions/(\d+)/end", page)
    assert len(ends) == 2
    assert here.post(f"/sessions/{max(ends, key=int)}/end").headers["location"] == "/sessions"
    assert len(re.findall(r"/sessions/(\d+)/end", here.get("/sessions"))) == 1
    assert third.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303
    assert there.send("GET", "/audit").status_code == 200
    assert here.post("/sessions/end-others").status_code == 303
    assert re.search("1 other .*ended", read(here.get("/sessions")))
    assert there.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303
    assert WHY_ENDED["ended"] in read(here.get("/sessions"))


def test_an_administrator_sees_and_ends_anothers_and_nobody_else_does(site):
    victor, adele = site.visitor("victor"), site.visitor("adele")
    assert site.visitor("ada").send("GET", "/sessions?user=5").status_code == 403
    page = adele.get("/sessions?user=5")
    assert "Victor Viewer" in re.search("<h1>(.*?)</h1>", page)[1]
    number = re.search(r"/sessions/(\d+)/end", page)[1]
    assert site.visitor("ada").post(f"/sessions/{number}/end").status_code == 404
    assert adele.post(f"/sessions/{number}/end").headers["location"] == "/sessions?user=5"
    assert victor.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303


def test_the_log_in_page_says_why_the_log_in_of_before_has_ended(site, read):
    victor = site.visitor("victor")
    site.visitor("adele").post("/users/5/roles", roles=["viewer", "analyst"])
    sent = victor.send("GET", "/runs?state=RUNNING", headers={"accept": "text/html"})
    assert sent.headers["location"] == "/login?next=%2Fruns%3Fstate%3DRUNNING&ended=roles_changed"
    assert SessionEndedError("roles_changed").args[0] in read(victor.get(sent.headers["location"]))
    assert "<script>" not in victor.get("/login?ended=%3Cscript%3E")


def test_logging_out_ends_a_copied_cookie(site):
    visitor = site.visitor("ada")
    copied = dict(visitor.cookies)
    assert visitor.send("POST", "/logout", data={"csrf_token": visitor.csrf_token}).headers["location"] == "/login"
    visitor.cookies.update(copied)
    sent = visitor.send("GET", "/audit", headers={"accept": "text/html"})
    assert sent.headers["location"].endswith("&ended=logged_out")
    assert visitor.send("POST", "/logout", data={"csrf_token": visitor.csrf_token}).headers["location"] == "/login"


@pytest.fixture
def stranger(site):
    visitor = site.visitor("ada")
    visitor.cookies.clear()
    return visitor


def log_in(visitor, **form):
    return visitor.send("POST", "/login", data={"name": "ada", "password": PASSWORD, "next": "/audit", **form})


def test_the_right_password_leads_to_where_one_wanted_to_go_but_from_another_site_nowhere(stranger):
    form = {"name": "ada", "password": PASSWORD}
    assert stranger.send("POST", "/login", data=form, headers={"sec-fetch-site": "cross-site"}).status_code == 403
    answer = log_in(stranger)
    assert (answer.status_code, answer.headers["location"]) == (303, "/audit")
    assert "HttpOnly" in answer.headers["set-cookie"]
    assert "Ada Analyst" in stranger.get("/audit")


@pytest.mark.parametrize("form", [{"password": "not-hers"}, {"name": "nobody"}])
def test_a_wrong_name_and_a_wrong_password_sound_the_same_and_the_name_stays(stranger, form):
    answer = log_in(stranger, **form)
    assert answer.status_code == 401
    assert f'value="{form.get("name", "ada")}"' in answer.text
    assert codes(answer.text) == ["wrong-password"]
    assert "not-hers" not in answer.text


def test_too_many_failures_are_slowed_down_and_then_told_to_wait(stranger, read, monkeypatch):
    monkeypatch.setattr("boresight.console.access.log_in_attempts.HELD_S", 0.01)
    for _ in range(6):
        answer = log_in(stranger, password="wrong")
    answer = log_in(stranger)
    assert answer.status_code == 429
    assert "try again" in read(answer.text)
    assert 1 <= int(answer.headers["retry-after"]) <= 60


def test_who_is_logged_in_needs_no_form(site):
    answer = site.visitor("ada").send("GET", "/login?next=/runs")
    assert (answer.status_code, answer.headers["location"]) == (303, "/runs")


@given(st.text(max_size=40))
def test_the_way_back_never_leaves_this_server(address):
    way = local_path(address)
    assert way.startswith("/")
    assert not way.startswith(("//", "/\\"))


@pytest.mark.parametrize(
    "address", ["https://evil.example", "//evil.example", "/\\evil.example", "/a\r\nb", "javascript:x"]
)
def test_an_address_of_elsewhere_becomes_the_start(address):
    assert local_path(address) == "/"
