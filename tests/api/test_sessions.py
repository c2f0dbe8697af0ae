"""Logging in: what the cookie is, what ends it, what a request must bring beside it."""

from __future__ import annotations

import stat
from pathlib import Path

import httpx
import pytest
from fastapi import Response

from boresight.api.cookies import SESSION_COOKIE, LogInCookie, read_secret
from boresight.errors import UnauthenticatedError

from .conftest import PASSWORD, House, add_people, serving, settings_in


def test_the_cookie_is_out_of_reach_of_scripts_and_of_other_sites(house: House) -> None:
    answer = house.anybody().post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD})
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith(f"{SESSION_COOKIE}=")
    assert {"HttpOnly", "SameSite=lax", "Path=/", "Max-Age=43200"} <= set(cookie.split("; "))
    assert answer.headers["cache-control"] == "no-store"


def test_secure_cookies_are_sent_over_https_only(tmp_path: Path) -> None:
    response = Response()
    LogInCookie(settings_in(tmp_path, secure_cookies="1")).open(response, 1, 0)
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


def test_too_many_failures_are_told_how_long_to_wait(tmp_path: Path) -> None:
    settings = settings_in(tmp_path, login_attempts="1")
    add_people(settings)
    with serving(settings) as (address, _):
        wrong = {"name": "ada", "password": "no"}
        answers = [httpx.post(f"{address}/api/v1/sessions", json=wrong, timeout=60) for _ in range(2)]
    assert [answer.status_code for answer in answers] == [401, 429]
    assert answers[1].headers["content-type"] == "application/problem+json"
    assert 1 <= int(answers[1].headers["retry-after"]) <= 60
    assert "www-authenticate" not in answers[1].headers


def test_logging_out_takes_the_cookie_away(house: House) -> None:
    client = house.log_in("victor")
    assert client.delete("/api/v1/sessions/current").status_code == 204
    assert client.get("/api/v1/runs").status_code == 401


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


def test_a_cookie_ends_with_its_hours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cookie = LogInCookie(settings_in(tmp_path, session_hours="1"))
    response = Response()
    cookie.open(response, 7, 3)
    value = response.headers["set-cookie"].split(";")[0].partition("=")[2]
    assert (cookie.read(value).user_id, cookie.read(value).epoch) == (7, 3)
    later = __import__("time").time() + 3602
    monkeypatch.setattr("itsdangerous.timed.time.time", lambda: later)
    with pytest.raises(UnauthenticatedError, match="expired; log in again"):
        cookie.read(value)


def test_a_cookie_of_another_installation_is_nobody(tmp_path: Path) -> None:
    response = Response()
    LogInCookie(settings_in(tmp_path / "one")).open(response, 1, 0)
    value = response.headers["set-cookie"].split(";")[0].partition("=")[2]
    with pytest.raises(UnauthenticatedError):
        LogInCookie(settings_in(tmp_path / "two")).read(value)


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


def test_a_log_in_that_is_not_used_ends_and_listening_is_no_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cookie = LogInCookie(settings_in(tmp_path, session_idle_hours="1"))
    response, now_s = Response(), 1e6
    monkeypatch.setattr("boresight.api.cookies.time.monotonic", lambda: now_s)
    cookie.open(response, 1, 0)
    value = response.headers["set-cookie"].partition(";")[0].partition("=")[2]
    for minutes in (0, 50, 50):
        now_s += 60 * minutes
        assert cookie.read(value).user_id == 1
    now_s += 60 * 40
    assert cookie.read(value, active=False).user_id == 1
    now_s += 60 * 40
    for _ in range(2):
        with pytest.raises(UnauthenticatedError, match="was not used for long"):
            cookie.read(value)


def test_without_the_setting_only_its_age_ends_a_log_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cookie, response = LogInCookie(settings_in(tmp_path)), Response()
    cookie.open(response, 1, 0)
    value = response.headers["set-cookie"].partition(";")[0].partition("=")[2]
    assert cookie.read(value).user_id == 1
    monkeypatch.setattr("boresight.api.cookies.time.monotonic", lambda: 1e9)
    assert cookie.read(value).user_id == 1
