"""The security log: each event declared, one line of JSON, bounded, without secrets, and nothing that did not happen."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from boresight.platform.actors import Actor
from boresight.platform.audit import security_log
from boresight.platform.audit.security_log import EVENTS, SecurityLog, list_events, note, tell, write_noted
from boresight.settings import read_settings
from tests.console.access.authenticators import enrol_app
from tests.served import PASSWORD, House, add_people, serving, settings_in

ROOT = Path(__file__).resolve().parents[3]
SOURCE = "\n".join(path.read_text() for path in (ROOT / "backend").rglob("*.py"))
ACTOR = Actor(7, "ada", "Ada", frozenset({"analyst"}), "session", None, "r-1")


def _lines(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


class _Transaction:
    def __init__(self) -> None:
        self.info: dict[Any, Any] = {}


def test_the_page_has_the_table_of_all_events_as_they_are_declared():
    assert list_events() in (ROOT / "docs" / "how-to" / "security-log.md").read_text()


def test_every_event_that_is_declared_is_told_somewhere_and_no_other():
    called = re.findall(r'(?:tell|tell_once|note)\((?:session, )?\n?\s*"(\w+)"', SOURCE)
    told = {name for name in called if name.startswith(("auth", "session_", "user_", "malicious_", "sys_"))}
    told |= {
        "authn_password_change",
        "authn_password_reset",
        "sys_suppressed",
    }  # told by a choice, and by the log itself
    assert told == set(EVENTS)
    assert {event.level for event in EVENTS.values()} == {"INFO", "WARN"}


def test_a_line_tells_who_when_from_where_and_under_which_request(tmp_path):
    with _kept(tmp_path / "security.jsonl") as kept, kept.following("r-2", "192.0.2.7", "POST", "/users"):
        tell("authz_fail", "failure", ACTOR, sentence="Not you.\nNor you.")
    (line,) = _lines(tmp_path / "security.jsonl")
    assert (line["event"], line["outcome"], line["level"]) == ("authz_fail", "failure", "WARN")
    assert (line["actor"], line["actor_id"], line["source_ip"], line["request_id"]) == ("ada", 7, "192.0.2.7", "r-1")
    assert line["details"] == {"method": "POST", "path": "/users", "sentence": "Not you.\nNor you."}
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z", line["time"])


def test_an_event_of_a_transaction_is_written_with_its_commit_alone(tmp_path):
    transaction = _Transaction()
    with _kept(tmp_path / "log") as kept, kept.following():
        note(transaction, "authz_change", ACTOR, user="bo", before=[], after=["approver"], source="administrator")
        assert _lines(tmp_path / "log") == []
        write_noted(transaction)
        write_noted(transaction)
    assert [line["details"]["after"] for line in _lines(tmp_path / "log")] == [["approver"]]


def test_a_detail_that_is_not_declared_is_a_mistake_of_the_program(tmp_path):
    with SecurityLog(str(tmp_path / "log")).following(), pytest.raises(ValueError, match="password"):
        tell("authn_login_fail", "failure", password="x")


def test_what_anybody_can_cause_is_bounded_and_what_is_left_out_is_counted(tmp_path, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(security_log.time, "monotonic", lambda: now_s[0])
    with _kept(tmp_path / "log", lines_a_minute=10) as kept, kept.following(None, "192.0.2.7"):
        for _ in range(25):
            tell("authn_login_fail", "failure", name="x", reason="password")
        tell("authz_change", "success", ACTOR, user="bo")
        now_s[0] = 61.0
        tell("authn_login_fail", "failure", name="x" * 500, reason="password")
    lines = _lines(tmp_path / "log")
    assert [line["event"] for line in lines] == [
        *["authn_login_fail"] * 10,
        "authz_change",
        "sys_suppressed",
        "authn_login_fail",
    ]
    assert lines[-2]["details"]["events"] == {"authn_login_fail": 15}
    assert len(lines[-1]["details"]["name"]) == security_log.LONGEST_TEXT


def test_a_log_that_was_rotated_away_goes_on_in_a_new_file(tmp_path):
    file = tmp_path / "log"
    with _kept(file) as kept, kept.following():
        tell("sys_startup", "success")
        file.rename(tmp_path / "log.1")
        tell("sys_shutdown", "success")
    assert [line["event"] for line in _lines(file)] == ["sys_shutdown"]


@pytest.mark.parametrize("place", ["absent/log", "/dev/full"])  # cannot be opened; has no room
def test_a_log_that_cannot_be_written_holds_nobody_up(place, tmp_path, caplog):
    with _kept(tmp_path / place) as kept, kept.following():
        tell("sys_startup", "success")
    assert "cannot be written" in caplog.text


def test_without_a_place_nothing_is_written_and_a_dash_is_standard_output(capsys):
    with SecurityLog().following():
        tell("sys_startup", "success")
    with SecurityLog("-").following():
        tell("sys_shutdown", "success")
    assert json.loads(capsys.readouterr().out)["event"] == "sys_shutdown"


def test_settings_that_weaken_the_installation_are_told_by_name():
    strict = read_settings({"BORESIGHT_SECOND_FACTOR": "required-to-sign"})
    weak = {"SECOND_FACTOR": "off", "FOUR_EYES": "0", "SECURE_COOKIES": "0", "HOST": "0.0.0.0", "WEBHOOKS_LOCAL": "1"}  # noqa: S104 - listened on by nobody
    assert strict.list_weaknesses() == []
    found = read_settings({f"BORESIGHT_{name}": value for name, value in weak.items()}).list_weaknesses()
    assert {one.variable.removeprefix("BORESIGHT_") for one in found} == set(weak) - {"HOST"}


@contextmanager
def _kept(place: object, **given: Any) -> Iterator[SecurityLog]:
    made = SecurityLog(str(place), **given)
    yield made
    made.close()


@contextmanager
def _watched(folder: Path) -> Iterator[tuple[House, Path]]:
    settings = settings_in(folder, security_log=str(folder / "security.jsonl"), login_attempts="2")
    add_people(settings)
    with serving(settings) as place:
        house = House(*place, b"", {})
        yield house, folder / "security.jsonl"
        for client in house.opened:
            client.close()


def _log_in(client: httpx.Client, name: str, password: str, factor: str = "") -> int:
    body = {"name": name, "password": password, "factor": factor}
    return client.post("/api/v1/sessions", json=body).status_code


def test_a_day_of_a_server_is_told_with_outcome_actor_address_and_request_and_without_a_secret(tmp_path):
    with _watched(tmp_path) as (house, file):
        root = house.log_in("adele")
        stranger = house.anybody()
        for _ in range(9):
            if _log_in(stranger, "olga", "wrong horse battery") == 429:
                break
        victor = house.log_in("victor")
        victor.post("/api/v1/runs", json={"sensor_id": 1, "telemetry_set_id": 1})
        victor.post("/users", data={"name": "eve"}, headers={"X-CSRF-Token": "of another log-in"})
        victor.post("/api/v1/api-keys", json={"label": "x"}, headers={"Origin": "https://evil.example"})
        secret = victor.post("/api/v1/api-keys", json={"label": "x"}).json()["secret"]
        house.anybody(Authorization="Bearer bs_00000000_x").get("/api/v1/runs")
        app, codes = enrol_app(victor)
        assert _log_in(house.anybody(), "victor", PASSWORD, "000000") == 401
        assert _log_in(house.anybody(), "victor", PASSWORD, codes[0]) == 201
        listed = {one["name"]: one for one in root.get("/api/v1/users").json()["items"]}
        number = listed["victor"]["id"]
        for act, body in (("reset-second-factor", {}), ("change-roles", {"roles": ["operator"]}), ("disable", {})):
            tag = root.get(f"/api/v1/users/{number}").headers["etag"]
            answer = root.post(f"/api/v1/users/{number}:{act}", json=body, headers={"If-Match": tag})
            assert answer.status_code == 200, answer.text
        root.post("/api/v1/users/1:change-roles", json={"roles": ["nobody"]}, headers={"If-Match": '"x"'})
        root.delete("/api/v1/sessions/current")
    lines = _lines(file)
    told = {line["event"] for line in lines}
    assert told >= {
        "sys_startup",
        "sys_shutdown",
        "authn_login_success",
        "authn_login_fail",
        "authn_login_lock",
        "authz_fail",
        "malicious_csrf",
        "malicious_cors",
        "authn_token_created",
        "authn_token_fail",
        "authn_factor_enrolled",
        "authn_factor_fail",
        "authn_factor_used",
        "authn_recovery_codes_made",
        "authn_recovery_code_used",
        "authn_factor_reset",
        "authz_change",
        "user_disabled",
        "session_ended",
    }
    text = file.read_text()
    assert not any(
        word in text for word in (PASSWORD, "wrong horse", secret, app.secret, codes[0], codes[0].replace("-", ""))
    )
    (change,) = (line for line in lines if line["event"] == "authz_change")
    assert (change["actor"], change["source_ip"], change["outcome"]) == ("adele", "127.0.0.1", "success")
    assert change["request_id"]
    assert change["details"] == {
        "user": "victor",
        "before": ["viewer"],
        "after": ["operator"],
        "source": "administrator",
    }
    (refused,) = (line for line in lines if line["event"] == "authz_fail" and line["details"]["path"] == "/api/v1/runs")
    assert (refused["actor"], refused["details"]["method"]) == ("victor", "POST")
