"""Second factors: asked at log-in and at signatures, each answer once, and no way around them."""

import html
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pyotp
import pytest
import sqlalchemy as sa

from boresight.console.access import second_factors
from boresight.console.access.second_factors import CODES, MOST_FAILURES, REQUIRED, FactorRules
from boresight.console.access.tables import FactorChallenge, LoginSession, RecoveryCode, SecondFactor
from boresight.errors import ForbiddenError
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import open_reading, open_writing, utc_after
from tests.console.access.authenticators import App, SecurityKey, enrol_app, enrol_key
from tests.served import PASSWORD, House, add_people, serving, settings_in
from tests.sites import codes

WRONG = "000000"


def _log_in(house: House, name: str, factor: str = "") -> httpx.Response:
    client = house.anybody()
    return client.post("/api/v1/sessions", json={"name": name, "password": PASSWORD, "factor": factor})


def _entered(house: House, name: str, factor: str) -> httpx.Client:
    client = house.anybody()
    answer = client.post("/api/v1/sessions", json={"name": name, "password": PASSWORD, "factor": factor})
    assert answer.status_code == 201, answer.text
    client.headers["X-CSRF-Token"] = answer.json()["csrf_token"]
    return client


def _kind(answer: httpx.Response) -> str:
    return answer.json()["type"].rpartition(":")[2]


@pytest.fixture
def enrolled(house) -> tuple[str, int, httpx.Client, App, list[str]]:
    name, number = house.new_person("approver")
    client = house.log_in(name)
    app, codes = enrol_app(client)
    return name, number, client, app, codes


def test_with_a_second_factor_the_password_alone_logs_in_neither_over_rest_nor_on_the_page(house, enrolled):
    name, _, _, app, _ = enrolled
    alone = _log_in(house, name)
    assert (alone.status_code, _kind(alone)) == (401, "second-factor-needed")
    assert "set-cookie" not in alone.headers
    page = house.anybody()
    first = page.post("/login", data={"name": name, "password": PASSWORD, "next": "/runs"})
    assert first.headers["location"] == "/login/second-factor?next=%2Fruns"
    assert "boresight_session" not in page.cookies
    assert page.get("/api/v1/runs").status_code == 401
    assert page.get("/", headers={"accept": "text/html"}).headers["location"].startswith("/login")
    assert page.post("/login/second-factor", data={"factor": WRONG}).status_code == 401
    second = page.post("/login/second-factor", data={"factor": app.code(), "next": "/runs"})
    assert (second.status_code, second.headers["location"]) == (303, "/runs")
    assert page.get("/api/v1/runs").status_code == 200
    assert "boresight_second_factor" not in page.cookies


def test_the_second_step_sends_nobody_to_another_site(house, enrolled):
    name, _, _, app, _ = enrolled
    page = house.anybody()
    page.post("/login", data={"name": name, "password": PASSWORD, "next": "//evil.example"})
    assert "evil.example" not in page.get("/login/second-factor?next=https://evil.example/").text
    answer = page.post("/login/second-factor", data={"factor": app.code(), "next": "https://evil.example/"})
    assert answer.headers["location"] == "/"


def test_a_code_is_taken_once_at_log_in_and_not_again_at_a_signature(house, enrolled):
    name, _, _, app, _ = enrolled
    code = app.code()
    client = _entered(house, name, code)
    assert _log_in(house, name, code).status_code == 401
    approval = house.submitted()
    body = {"meaning": "I approve.", "password": PASSWORD, "comment": "Seen."}
    address, seen = f"/api/v1/approvals/{approval['id']}:approve", {"If-Match": f'"v{approval["version"]}"'}
    for factor in ("", code):
        refused = client.post(address, json={**body, "factor": factor}, headers=seen)
        assert (refused.status_code, _kind(refused)) == (401, "second-factor-needed")
    assert client.post(address, json={**body, "factor": app.code()}, headers=seen).json()["state"] == "APPROVED"


def test_a_right_code_signs_nothing_without_the_password(house, enrolled):
    _, _, client, app, _ = enrolled
    approval = house.submitted()
    body = {"meaning": "I approve.", "password": "wrong horse battery", "comment": "Seen.", "factor": app.code()}
    seen = {"If-Match": f'"v{approval["version"]}"'}
    assert client.post(f"/api/v1/approvals/{approval['id']}:approve", json=body, headers=seen).status_code == 401


def test_a_promotion_over_rest_asks_a_person_for_the_second_factor_and_a_key_for_none(house):
    name, _ = house.new_person("operator")
    client = house.log_in(name)
    app, _ = enrol_app(client)
    made = client.post("/api/v1/api-keys", json={"label": "passes", "scopes": ["parameter-sets"]}).json()["secret"]
    for asks, body, status in ((client, {}, 401), (client, {"factor": app.code()}, 200), (None, {}, 200)):
        row = house.approved()
        caller = asks or house.anybody(Authorization=f"Bearer {made}")
        headers = {"If-Match": f'"v{row["version"]}"'}
        answer = caller.post(f"/api/v1/parameter-sets/{row['id']}:promote", json=body, headers=headers)
        assert answer.status_code == status, answer.text


def test_ten_recovery_codes_are_stored_hashed_and_each_works_once(house, enrolled):
    name, number, _, _, codes = enrolled
    assert len(set(codes)) == CODES
    assert all(re.fullmatch(r"[a-z2-9]{4}(-[a-z2-9]{4}){5}", code) for code in codes)
    with open_reading(house.app.state.engine) as session:
        stored = session.scalars(sa.select(RecoveryCode.code_hash).where(RecoveryCode.user_id == number)).all()
    assert len(stored) == CODES
    assert not any(code.replace("-", "") in kept for code in codes for kept in stored)
    assert _log_in(house, name, codes[0].replace("-", " ").upper()).status_code == 201
    assert _log_in(house, name, codes[0]).status_code == 401
    assert _log_in(house, name, codes[1]).status_code == 201


def test_of_ten_at_once_with_one_recovery_code_one_gets_in(house, enrolled):
    name, number, _, _, codes = enrolled
    statuses: list[int] = []
    threads = [
        threading.Thread(target=lambda: statuses.append(_log_in(house, name, codes[3]).status_code)) for _ in range(10)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert sorted(statuses) == [201] + [401] * 9
    with open_reading(house.app.state.engine) as session:
        used = sa.select(sa.func.count()).where(RecoveryCode.user_id == number, RecoveryCode.ended_because == "used")
        assert session.scalar(used) == 1


def test_the_secret_is_encrypted_and_in_no_later_answer(house, enrolled):
    _, number, client, app, codes = enrolled
    with open_reading(house.app.state.engine) as session:
        row = session.scalar(sa.select(SecondFactor).where(SecondFactor.user_id == number))
        assert row is not None
        assert row.secret.startswith("fernet:")
        told = audit.list_records(session, limit=50)
        assert not any(app.secret in str(record.after) or codes[0] in str(record.after) for record in told)
    listed = client.get("/api/v1/second-factors").text
    assert app.secret not in listed
    assert [one["kind"] for one in json.loads(listed)["items"]] == ["totp"]


@pytest.mark.parametrize("act", ["begin", "renew-recovery-codes", "remove"])
def test_no_second_factor_is_added_removed_or_recovered_without_the_one_that_is_there(enrolled, act):
    _, _, client, app, codes = enrolled
    number = client.get("/api/v1/second-factors").json()["items"][0]["id"]
    address = f"/api/v1/second-factors/{number}:remove" if act == "remove" else f"/api/v1/second-factors:{act}"
    for body in ({}, {"password": PASSWORD}, {"password": "wrong horse battery", "factor": codes[5]}):
        assert client.post(address, json=body).status_code == 401
    assert client.post(address, json={"password": PASSWORD, "factor": app.code()}).status_code == 200


def test_an_enrolment_is_of_its_person_and_log_in_alone_and_is_finished_once(house):
    name, _ = house.new_person("viewer")
    client, other, stranger = house.log_in(name), house.log_in(name), house.log_in(house.new_person("viewer")[0])
    begun = client.post("/api/v1/second-factors:begin", json={"password": PASSWORD}).json()
    app = App(begun["secret"])
    body = {"challenge_id": begun["challenge_id"], "factor": app.code()}
    assert [one.post("/api/v1/second-factors", json=body).status_code for one in (other, stranger)] == [404, 404]
    assert client.post("/api/v1/second-factors", json={**body, "factor": WRONG}).status_code == 401
    assert client.post("/api/v1/second-factors", json=body).status_code == 201
    assert client.post("/api/v1/second-factors", json={**body, "factor": app.code()}).status_code == 401
    assert other.get("/api/v1/runs").status_code == 401  # it was made with the password alone


def test_the_code_that_enrolled_an_app_does_not_log_in(house):
    name, _ = house.new_person("viewer")
    client = house.log_in(name)
    begun = client.post("/api/v1/second-factors:begin", json={"password": PASSWORD}).json()
    code = App(begun["secret"]).code()
    client.post("/api/v1/second-factors", json={"challenge_id": begun["challenge_id"], "factor": code})
    assert _log_in(house, name, code).status_code == 401


def test_an_old_or_early_code_is_refused(house, enrolled):
    name, _, _, app, _ = enrolled
    totp, now = pyotp.TOTP(app.secret), app.step
    assert [_log_in(house, name, totp.generate_otp(now + away)).status_code for away in (-2, -1, 4, 40)] == [401] * 4


def test_an_administrator_resets_another_persons_second_factor_which_ends_their_log_ins(house, enrolled):
    name, number, client, _, codes = enrolled
    root = house.person("adele")
    address = f"/api/v1/users/{number}"
    assert house.person("ada").post(f"{address}:reset-second-factor", headers={"If-Match": "x"}).status_code in {
        403,
        412,
    }
    tag = root.get(address).headers["etag"]
    assert root.post(f"{address}:reset-second-factor", headers={"If-Match": tag}).status_code == 200
    assert client.get("/api/v1/runs").status_code == 401
    assert _log_in(house, name).status_code == 201
    assert _log_in(house, name, codes[6]).status_code == 201  # nobody asks for one, so none is judged
    with open_reading(house.app.state.engine) as session:
        records = audit.list_records(session, subject=f"users/{number}")
        assert "reset the second factor of" in {record.action for record in records}
        left = sa.select(sa.func.count()).where(RecoveryCode.user_id == number, RecoveryCode.ended_utc.is_(None))
        assert session.scalar(left) == 0


def test_nobody_resets_their_own_second_factor_to_get_around_it(house):
    name, number = house.new_person("administrator")
    client = house.log_in(name)
    enrol_app(client)
    tag = client.get(f"/api/v1/users/{number}").headers["etag"]
    answer = client.post(f"/api/v1/users/{number}:reset-second-factor", headers={"If-Match": tag})
    assert answer.status_code == 403
    with open_writing(house.app.state.engine) as session:
        assert second_factors.reset(session, COMMAND_LINE, number).name == name


def test_an_api_key_is_asked_for_none_and_may_manage_none(house, enrolled):
    _, _, client, _, _ = enrolled
    secret = client.post("/api/v1/api-keys", json={"label": "passes"}).json()["secret"]
    key = house.anybody(Authorization=f"Bearer {secret}")
    assert key.get("/api/v1/runs").status_code == 200
    assert key.get("/api/v1/second-factors").status_code == 403
    assert key.post("/api/v1/second-factors:begin", json={"password": PASSWORD}).status_code == 403


def test_five_wrong_codes_end_a_log_in_that_waits_and_a_new_password_does_too(house, enrolled):
    name, number, client, app, codes = enrolled
    page = house.anybody()
    page.post("/login", data={"name": name, "password": PASSWORD})
    for _ in range(MOST_FAILURES):
        page.post("/login/second-factor", data={"factor": WRONG})
    assert page.post("/login/second-factor", data={"factor": codes[0]}).headers["location"].startswith("/login")
    assert page.get("/api/v1/runs").status_code == 401
    page.post("/login", data={"name": name, "password": PASSWORD})
    root = house.person("adele")
    root.post(f"/api/v1/users/{number}:change-password", json={"password": "kestrel over the moor 41"})
    late = page.post("/login/second-factor", data={"factor": app.code()})
    assert late.headers["location"].startswith("/login?")
    assert page.get("/api/v1/runs").status_code == 401
    assert client.get("/api/v1/runs").status_code == 401


def test_a_log_in_that_waited_ten_minutes_is_over(house, enrolled):
    name, number, _, app, _ = enrolled
    page = house.anybody()
    page.post("/login", data={"name": name, "password": PASSWORD})
    with open_writing(house.app.state.engine) as session:
        for row in session.scalars(sa.select(FactorChallenge).where(FactorChallenge.user_id == number)):
            row.created_utc = utc_after(-second_factors.WAITS_S - 1)
    assert page.post("/login/second-factor", data={"factor": app.code()}).headers["location"].startswith("/login?")


def test_the_log_in_after_a_second_factor_has_a_cookie_of_its_own_and_tells_the_kind(house, enrolled):
    name, number, _, app, _ = enrolled
    page = house.anybody()
    page.post("/login", data={"name": name, "password": PASSWORD})
    waiting = page.cookies["boresight_second_factor"]
    page.post("/login/second-factor", data={"factor": app.code()})
    assert page.cookies["boresight_session"] != waiting
    thief = house.anybody()
    thief.cookies.set("boresight_second_factor", waiting)
    assert thief.get("/login/second-factor").status_code == 303  # it was answered
    thief.cookies.set("boresight_session", waiting)
    assert thief.get("/api/v1/runs").status_code == 401
    with open_reading(house.app.state.engine) as session:
        newest = session.scalars(
            sa.select(LoginSession).where(LoginSession.user_id == number).order_by(LoginSession.id.desc())
        ).first()
        assert newest is not None
        assert (newest.method, newest.factor_kind) == ("password", "totp")


def test_a_second_person_at_anothers_console_gives_their_second_factor_too(house, enrolled):
    name, _, _, app, _ = enrolled
    approval = house.submitted()
    body = {"meaning": "I approve.", "comment": "Seen.", "name": name, "decision": "APPROVE", "password": PASSWORD}
    address, seen = (
        f"/api/v1/approvals/{approval['id']}:sign-over-the-shoulder",
        {"If-Match": f'"v{approval["version"]}"'},
    )
    console = house.person("victor")
    assert console.post(address, json=body, headers=seen).status_code == 401
    assert console.post(address, json={**body, "factor": app.code()}, headers=seen).status_code == 200


# Security keys


@pytest.fixture
def with_key(house) -> tuple[str, httpx.Client, SecurityKey]:
    name, _ = house.new_person("approver")
    client = house.log_in(name)
    client.base_url = httpx.URL(house.address.replace("127.0.0.1", "localhost"))
    client.cookies.set("boresight_session", client.cookies["boresight_session"], domain="localhost.local")
    key = SecurityKey(str(client.base_url).rstrip("/"))
    made = enrol_key(client, key)
    assert made.status_code == 201, made.text
    return name, client, key


def _page_options(page: str) -> dict[str, Any]:
    return json.loads(html.unescape(re.search(r'data-options="([^"]+)"', page)[1]))


def _waiting(house: House, name: str) -> tuple[httpx.Client, dict[str, Any]]:
    page = house.anybody()
    page.base_url = httpx.URL(house.address.replace("127.0.0.1", "localhost"))
    page.post("/login", data={"name": name, "password": PASSWORD})
    return page, _page_options(page.get("/login/second-factor").text)


def test_a_security_key_logs_in_once_for_each_question(house, with_key):
    name, _, key = with_key
    page, options = _waiting(house, name)
    assert [one["id"] for one in options["allowCredentials"]] == [key.name]
    answer = key.get(options)
    assert page.post("/login/second-factor", data={"factor": answer}).headers["location"] == "/"
    assert page.get("/api/v1/runs").status_code == 200
    again, _ = _waiting(house, name)
    assert again.post("/login/second-factor", data={"factor": answer}).status_code == 401


def test_a_security_key_signs_and_its_answer_signs_nothing_else(house, with_key):
    _, client, key = with_key
    answer = key.get(client.post("/api/v1/second-factors:challenge").json()["options"])
    statuses = []
    for _ in range(2):
        approval = house.submitted()
        body = {"meaning": "I approve.", "password": PASSWORD, "comment": "Seen.", "factor": answer}
        seen = {"If-Match": f'"v{approval["version"]}"'}
        statuses.append(client.post(f"/api/v1/approvals/{approval['id']}:approve", json=body, headers=seen).status_code)
    assert statuses == [200, 401]


def test_a_copied_key_is_noticed_by_its_count_of_signatures(house, with_key):
    name, _, key = with_key
    page, options = _waiting(house, name)
    key.count = 40
    assert page.post("/login/second-factor", data={"factor": key.get(options)}).status_code == 303
    page, options = _waiting(house, name)
    key.count = 3
    assert page.post("/login/second-factor", data={"factor": key.get(options)}).status_code == 401


def test_an_answer_from_another_site_or_for_another_question_or_of_a_strangers_key_is_refused(house, with_key):
    name, _, key = with_key
    page, options = _waiting(house, name)
    false_page = SecurityKey("https://boresight.example.evil", id=key.id, key=key.key)
    stranger = SecurityKey(key.origin)
    other_name, _ = house.new_person("viewer")
    other = house.log_in(other_name)
    other.base_url, other_key = httpx.URL(key.origin), SecurityKey(key.origin)
    other.cookies.set("boresight_session", other.cookies["boresight_session"], domain="localhost.local")
    assert enrol_key(other, other_key).status_code == 201
    swapped = SecurityKey(key.origin, id=key.id, key=other_key.key)
    for answer in (
        false_page.get(options),
        key.get({**options, "rpId": "evil.example"}),
        key.get({**options, "challenge": "AAAA"}),
        stranger.get(options),
    ):
        assert page.post("/login/second-factor", data={"factor": answer}).status_code == 401
    page, options = _waiting(house, name)
    for answer in (other_key.get(options), swapped.get(options), "{}", "{" * 4000, '{"id": 1}'):
        refused = page.post("/login/second-factor", data={"factor": answer})
        assert refused.status_code in {303, 401}
    assert page.get("/api/v1/runs").status_code == 401


def test_a_credential_is_enrolled_for_one_person_alone(house, with_key):
    _, _, key = with_key
    name, _ = house.new_person("viewer")
    client = house.log_in(name)
    client.base_url = httpx.URL(key.origin)
    client.cookies.set("boresight_session", client.cookies["boresight_session"], domain="localhost.local")
    thief = SecurityKey(key.origin, id=key.id)  # the same credential id with a key of one's own
    assert enrol_key(client, thief).status_code == 401
    assert client.get("/api/v1/second-factors").json()["items"] == []


def test_a_security_key_needs_a_host_name(house):
    client = house.log_in(house.new_person("viewer")[0])
    answer = client.post("/api/v1/second-factors:begin", json={"kind": "webauthn", "password": PASSWORD})
    assert answer.status_code == 422
    assert "localhost" in answer.json()["detail"]


# What an installation demands


@contextmanager
def _housed(folder: Path, **given: str) -> Iterator[House]:
    settings = settings_in(folder, **given)
    add_people(settings)
    with serving(settings) as place:
        house = House(*place, b"", {})
        yield house
        for client in house.opened:
            client.close()


@pytest.fixture(scope="module")
def demanding(tmp_path_factory) -> Iterator[House]:
    with _housed(tmp_path_factory.mktemp("demanding"), second_factor=REQUIRED, login_attempts="1000") as house:
        yield house


@pytest.mark.parametrize(
    ("name", "is_due"), [("alan", True), ("adele", True), ("bo", True), ("ada", False), ("olga", False)]
)
def test_where_it_is_required_approvers_and_administrators_do_nothing_before_they_enrol(demanding, name, is_due):
    client = demanding.log_in(name)
    assert client.get("/api/v1/runs").status_code == (403 if is_due else 200)
    if is_due:
        assert _kind(client.get("/api/v1/runs")) == "second-factor-to-be-enrolled"
        assert client.get("/", headers={"accept": "text/html"}).headers["location"] == "/second-factor"
        assert client.get("/second-factor").status_code == 200
        assert client.post("/api/v1/api-keys", json={"label": "way around"}).status_code == 403
        app, _ = enrol_app(client)
        assert client.get("/api/v1/runs").status_code == 200
        number = client.get("/api/v1/second-factors").json()["items"][0]["id"]
        body = {"password": PASSWORD, "factor": app.code()}
        assert client.post(f"/api/v1/second-factors/{number}:remove", json=body).status_code == 409  # the last one


def test_off_asks_nobody_and_offers_nothing(tmp_path):
    with _housed(tmp_path, second_factor="off") as house:
        client = house.log_in("alan")
        assert client.post("/api/v1/second-factors:begin", json={"password": PASSWORD}).status_code == 409
        assert codes(client.get("/second-factor").text) == ["second-factors-off"]


def test_wrong_codes_slow_down_and_a_right_password_clears_none_of_them(tmp_path):
    with _housed(tmp_path, login_attempts="3") as house:
        enrol_app(house.log_in("alan"))
        statuses = []
        for _ in range(12):
            assert _log_in(house, "alan").status_code == 401  # the right password, and no code
            statuses.append(_log_in(house, "alan", WRONG).status_code)
            if statuses[-1] == 429:
                break
        assert statuses[0] == 401
        assert statuses[-1] == 429


def test_a_lost_key_of_the_secrets_leaves_recovery_codes(session, tmp_path, people):
    rules = FactorRules("optional", SecretBox(tmp_path / "webhooks.key"))
    lost = FactorRules("optional", SecretBox(tmp_path / "other.key"))
    user_id = people["cy"].user_id or 0
    session.add(
        SecondFactor(
            user_id=user_id, kind="totp", label="x", secret=rules.box.seal(pyotp.random_base32()), created_utc="t"
        )
    )
    codes = second_factors.renew_recovery_codes(session, people["cy"])
    assert second_factors.fits(session, user_id, codes[0], lost)
    assert not second_factors.fits(session, user_id, WRONG, lost)
    rules.box.add_key()
    assert second_factors.encrypt_anew(session, rules.box) == 1
    rules.box.forget_old_keys()
    row = session.scalar(sa.select(SecondFactor))
    assert rules.box.open(row.secret)
    with pytest.raises(ForbiddenError):
        second_factors.reset(session, people["ana"], user_id)
