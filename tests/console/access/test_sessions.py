"""Logging in: what the cookie is, what ends it, what a request must bring beside it."""

import hashlib
import stat
import time
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy as sa
from fastapi import Response
from itsdangerous import URLSafeTimedSerializer

from boresight.console.access import sessions
from boresight.console.access.credentials import SESSION_COOKIE, LogInCookie, read_secret
from boresight.console.access.tables import LoginSession
from boresight.console.jobs.maintenance import Maintenance
from boresight.errors import SessionEndedError, UnauthenticatedError
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.db.data_version import DataVersionReader
from boresight.platform.db.sessions import open_engine, open_reading, open_writing, utc_after, utc_text
from boresight.settings import Settings
from tests.served import PASSWORD, House, add_people, serving, settings_in


def test_the_cookie_is_out_of_reach_of_scripts_and_of_other_sites(house: House) -> None:
    answer = house.anybody().post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD})
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith(f"{SESSION_COOKIE}=")
    assert {"HttpOnly", "SameSite=lax", "Path=/", "Max-Age=43200"} <= set(cookie.split("; "))
    assert answer.headers["cache-control"] == "no-store"


def test_secure_cookies_are_sent_over_https_only(tmp_path: Path) -> None:
    response = Response()
    LogInCookie(settings_in(tmp_path, secure_cookies="1")).write(response, "token")
    assert "; Secure" in response.headers["set-cookie"]


def test_who_am_i_tells_roles_and_the_same_csrf_token(house: House) -> None:
    client = house.log_in("bo")
    body = client.get("/api/v1/sessions/current").json()
    assert (body["name"], body["roles"], body["credential"]) == ("bo", ["analyst", "approver"], "session")
    assert body["csrf_token"] == client.headers["X-CSRF-Token"]


def test_a_wrong_password_and_an_unknown_name_get_the_same_answer(house: House) -> None:
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
def test_a_copied_cookie_ends_with_the_next_request(house: House, because: str) -> None:
    name, number = house.new_person("viewer")
    owner = house.log_in(name)
    thief = _copy(house, owner)
    assert ENDINGS[because](house, owner, name, number).status_code in {200, 204}
    assert _why(thief) == (401, "session-ended", because)
    assert thief.post("/api/v1/sensors", json={}).status_code == 401


def test_an_open_event_stream_ends_with_its_log_in(house: House) -> None:
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


def test_a_person_sees_their_log_ins_and_ends_one(house: House) -> None:
    name, number = house.new_person("viewer")
    phone = house.anybody(**{"User-Agent": "phone/1" + "x" * 500})
    assert phone.post("/api/v1/sessions", json={"name": name, "password": PASSWORD}).status_code == 201
    desk = house.log_in(name)
    listed = desk.get("/api/v1/sessions?open=true").json()["items"]
    assert [one["current"] for one in listed] == [True, False]
    assert {one["user_id"] for one in listed} == {number}
    assert listed[1]["user_agent"].startswith("phone/1x")
    assert len(listed[1]["user_agent"]) <= 200
    assert listed[1]["address"] == "127.0.0.1"
    ended = desk.post(f"/api/v1/sessions/{listed[1]['id']}:end").json()
    assert (ended["ended_because"], ended["ended_utc"] is None) == ("ended", False)
    assert phone.get("/api/v1/runs").status_code == 401
    assert [one["id"] for one in desk.get("/api/v1/sessions?open=false").json()["items"]] == [listed[1]["id"]]


def test_only_an_administrator_sees_and_ends_anothers_log_ins_and_no_key_any(house: House) -> None:
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


def test_what_a_program_says_of_itself_is_kept_short_and_printable() -> None:
    assert sessions.ClientAddress.of(None, "a\x7f\u202eb\ud800" + "c" * 300) == sessions.ClientAddress(
        "", "ab" + "c" * 195
    )


def test_neither_the_secret_nor_its_hash_is_told_or_stored_readably(house: House) -> None:
    client = house.log_in("victor")
    token = house.app.state.log_in_cookie.read(client.cookies[SESSION_COOKIE]).token
    assert len(token) >= 43  # 256 bits
    listed = client.get("/api/v1/sessions").text
    with open_reading(house.app.state.engine) as session:
        hashes = session.scalars(sa.select(LoginSession.token_hash)).all()
    assert hashlib.sha256(token.encode()).hexdigest() in hashes
    assert token not in listed
    assert not any(one in listed for one in hashes)


def _serve_again(settings: Settings, steps: Callable[[str, Any], Any]) -> Any:
    with serving(settings) as (address, app):
        return steps(address, app)


def test_idleness_ends_a_log_in_and_survives_a_restart(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    assert settings.session_idle_minutes == 60.0
    add_people(settings)

    def begin(address: str, _: Any) -> httpx.Cookies:
        with httpx.Client(base_url=address) as client:
            client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).raise_for_status()
            return httpx.Cookies(client.cookies)

    cookies = _serve_again(settings, begin)

    def ask(address: str, _: Any) -> list[int]:
        with httpx.Client(base_url=address, cookies=cookies) as client:
            return [client.get("/api/v1/runs").status_code for _ in range(2)]

    _shift(settings, minutes=59)
    assert _serve_again(settings, ask) == [200, 200]  # and stopping writes that use
    _shift(settings, minutes=59)
    assert _serve_again(settings, ask) == [200, 200]
    _shift(settings, minutes=61)
    assert _serve_again(settings, ask) == [401, 401]


def _shift(settings: Settings, minutes: float) -> None:
    engine = open_engine(settings.database_url)
    with open_writing(engine) as session:
        for row in session.scalars(sa.select(LoginSession)):
            used = datetime.fromisoformat(row.last_used_utc) - timedelta(minutes=minutes)
            row.last_used_utc = utc_text(used)
    engine.dispose()


def test_a_use_on_one_server_keeps_the_log_in_alive_on_another(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    add_people(settings)
    with serving(settings) as (one, app_one), serving(settings) as (two, _), httpx.Client() as client:
        client.post(f"{one}/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).raise_for_status()
        _shift(settings, minutes=59)
        app_one.state.upkeep._sessions_used_utc.clear()
        assert client.get(f"{one}/api/v1/runs").status_code == 200
        app_one.state.upkeep.write_uses()
        _shift(settings, minutes=2)  # 61 minutes after the log-in, 2 after its use on the first server
        assert client.get(f"{two}/api/v1/runs").status_code == 200


def test_an_open_page_that_only_listens_or_renews_itself_does_not_use_its_log_in(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    add_people(settings)
    with serving(settings) as (address, app), httpx.Client(base_url=address) as client:
        client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).raise_for_status()
        used = app.state.upkeep._sessions_used_utc
        background = {"X-Boresight-Background": "1"}
        for _ in range(3):  # the second and third stand ready
            assert client.get("/api/v1/runs", headers=background).status_code == 200
            assert client.get("/", headers=background).status_code == 200
        with client.stream("GET", "/api/v1/events") as stream:
            assert stream.status_code == 200
        assert used == {}
        assert client.get("/api/v1/runs").status_code == 200
        assert len(used) == 1


def test_requests_do_not_write_and_a_round_writes_the_last_use_once(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    add_people(settings)
    with serving(settings) as (address, app), httpx.Client(base_url=address) as client:
        client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).raise_for_status()
        marks = DataVersionReader(app.state.engine)
        before = marks.look()
        for _ in range(20):
            client.get("/api/v1/sensors").raise_for_status()
        assert marks.look() == before
        app.state.upkeep.write_uses()
        after = marks.look()
        assert after != before
        app.state.upkeep.write_uses()
        assert marks.look() == after
        marks.close()


def test_what_lapsed_is_written_and_what_ended_long_ago_is_forgotten(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    add_people(settings)
    engine = open_engine(settings.database_url)
    upkeep = Maintenance(engine, settings.session_limits, open_blobs(settings.blob_place))
    ages_h = {"fresh": 0.0, "idle": 1.2, "expired": 13.0}
    with open_writing(engine) as session:
        for age_h in ages_h.values():
            row, _ = sessions.begin(session, 1, sessions.ClientAddress())
            row.created_utc = row.last_used_utc = utc_after(-3600 * age_h)
        row, _ = sessions.begin(session, 1, sessions.ClientAddress())
        row.ended_utc, row.ended_because = utc_after(-sessions.KEPT_FOR_S - 60), "logged_out"
    upkeep.tidy_sessions()
    with open_reading(engine) as session:
        ended = session.scalars(sa.select(LoginSession.ended_because).order_by(LoginSession.id)).all()
    assert ended == [None, "idle", "expired"]
    engine.dispose()


def test_ending_sessions_ends_a_copied_cookie(house: House) -> None:
    client, thief = house.log_in("bo"), house.anybody()
    thief.cookies = client.cookies
    assert thief.get("/api/v1/runs").status_code == 200
    user_id = client.get("/api/v1/sessions/current").json()["user_id"]
    assert client.post(f"/api/v1/users/{user_id}:end-sessions").status_code == 204
    house.clients.pop("bo", None)
    assert thief.get("/api/v1/runs").status_code == 401


def test_an_altered_cookie_is_nobody(house: House) -> None:
    client = house.log_in("ada")
    value = client.cookies[SESSION_COOKIE]
    client.cookies.clear()
    client.cookies.set(SESSION_COOKIE, value[:-2] + ("aa" if value[-2:] != "aa" else "bb"))
    assert client.get("/api/v1/runs").status_code == 401


def _value(response: Response) -> str:
    return response.headers["set-cookie"].partition(";")[0].partition("=")[2]


def test_a_cookie_ends_with_its_hours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cookie = LogInCookie(settings_in(tmp_path, session_hours="1"))
    response = Response()
    csrf_token = cookie.write(response, "a secret")
    said = cookie.read(_value(response))
    assert (said.token, said.csrf_token) == ("a secret", csrf_token)
    later = __import__("time").time() + 3602
    monkeypatch.setattr("itsdangerous.timed.time.time", lambda: later)
    with pytest.raises(SessionEndedError, match="expired; log in again"):
        cookie.read(_value(response))


def test_a_cookie_of_another_installation_is_nobody(tmp_path: Path) -> None:
    response = Response()
    LogInCookie(settings_in(tmp_path / "one")).write(response, "a secret")
    with pytest.raises(UnauthenticatedError):
        LogInCookie(settings_in(tmp_path / "two")).read(_value(response))


def test_a_cookie_of_a_version_without_sessions_is_nobody(house: House) -> None:
    serializer = URLSafeTimedSerializer(read_secret(house.app.state.settings.data_folder), salt=SESSION_COOKIE)
    stranger = house.anybody()
    for old in ([1, 0, "csrf"], [1, "csrf"], {"token": "x"}, "x"):
        stranger.cookies.set(SESSION_COOKIE, serializer.dumps(old))
        assert stranger.get("/api/v1/runs").status_code == 401


def test_the_secret_is_made_once_and_readable_by_its_owner_only(tmp_path: Path) -> None:
    first = read_secret(tmp_path)
    assert len(first) == 32
    assert read_secret(tmp_path) == first
    assert stat.S_IMODE((tmp_path / "secret.key").stat().st_mode) == 0o600
    assert [path.name for path in tmp_path.iterdir()] == ["secret.key"]


def test_a_token_of_another_log_in_is_refused(house: House) -> None:
    client, other = house.log_in("ada"), house.log_in("ada")
    client.headers["X-CSRF-Token"] = other.headers["X-CSRF-Token"]
    assert client.post("/api/v1/sensors", json=house.sensor_file()).status_code == 403


def test_a_request_that_the_browser_says_comes_from_another_site_is_refused(house: House) -> None:
    answer = house.person("ada").post(
        "/api/v1/sensors", json=house.sensor_file(), headers={"Sec-Fetch-Site": "cross-site"}
    )
    assert answer.status_code == 403
    assert "another site" in answer.json()["detail"]


def test_a_key_needs_no_csrf_token_and_acts_within_its_scopes(house: House) -> None:
    writer, reader = house.key("ada", "sensors"), house.key("ada")
    assert writer.post("/api/v1/sensors", json=house.sensor_file()).status_code == 201
    assert reader.get("/api/v1/sensors").status_code == 200
    refused = reader.post("/api/v1/sensors", json=house.sensor_file())
    assert refused.status_code == 403
    assert "lacks the scope sensors" in refused.json()["detail"]


def test_a_key_is_told_apart_from_its_owner(house: House) -> None:
    body = house.key("ada", "runs").get("/api/v1/sessions/current").json()
    assert body["credential"].startswith("key:")
    assert (body["scopes"], body["csrf_token"]) == (["runs"], None)


@pytest.mark.parametrize("secret", ["bs_", "bs_00000000_nothing", "nonsense", "bs_a"])
def test_an_unknown_key_is_nobody_even_beside_a_good_cookie(house: House, secret: str) -> None:
    answer = house.person("ada").get("/api/v1/runs", headers={"Authorization": f"Bearer {secret}"})
    assert answer.status_code == 401


def test_a_revoked_key_is_nobody(house: House) -> None:
    client = house.person("ada")
    made = client.post("/api/v1/api-keys", json={"label": "old"}).json()
    known = house.anybody(Authorization=f"Bearer {made['secret']}")
    assert known.get("/api/v1/runs").status_code == 200
    assert client.post(f"/api/v1/api-keys/{made['id']}:revoke").status_code == 200
    assert known.get("/api/v1/runs").status_code == 401


def test_the_secret_of_a_key_is_shown_once(house: House) -> None:
    client = house.person("ada")
    made = client.post("/api/v1/api-keys", json={"label": "once"}, headers={"Idempotency-Key": "make-a-key"})
    again = client.post("/api/v1/api-keys", json={"label": "once"}, headers={"Idempotency-Key": "make-a-key"})
    assert made.json()["secret"]
    assert again.json() == {**made.json(), "secret": None}
    assert made.json()["secret"] not in client.get("/api/v1/api-keys").text


def test_a_key_cannot_make_keys(house: House) -> None:
    answer = house.key("ada", "runs").post("/api/v1/api-keys", json={"label": "child"})
    assert answer.status_code == 403


def test_people_see_their_own_keys_and_administrators_everyones(house: House) -> None:
    house.key("victor")
    ada, adele = (house.person(name).get("/api/v1/api-keys?limit=200").json()["items"] for name in ("ada", "adele"))
    assert len({key["user_id"] for key in ada}) <= 1
    assert {"test"} <= {key["label"] for key in adele}
    assert len({key["user_id"] for key in adele}) >= 2


def test_who_was_given_a_password_is_told_so_and_refused_all_else_until_it_is_set(house: House) -> None:
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


def test_a_key_that_was_revoked_meanwhile_is_not_revoked_by_who_did_not_see_it(house: House) -> None:
    client = house.person("ada")
    made = client.post("/api/v1/api-keys", json={"label": "passes"})
    address, seen = f"/api/v1/api-keys/{made.json()['id']}:revoke", {"If-Match": made.headers["etag"]}
    assert client.post(address, headers=seen).status_code == 200
    assert client.post(address, headers=seen).status_code == 412
    assert client.post(address).status_code == 200


def test_the_last_use_of_a_key_is_shown(house: House) -> None:
    client = house.person("ada")
    made = client.post("/api/v1/api-keys", json={"label": "reader"}).json()
    assert made["last_used_utc"] is None
    assert house.anybody().get("/api/v1/runs", headers={"Authorization": f"Bearer {made['secret']}"}).status_code == 200
    house.app.state.upkeep.write_uses()
    listed = client.get("/api/v1/api-keys").json()["items"]
    assert next(key for key in listed if key["id"] == made["id"])["last_used_utc"] is not None
