"""Deliveries over the wire: a real receiver on a real port gets what was signed, once, and is tried again when it fails."""

import gzip
import json
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from standardwebhooks import Webhook as StandardWebhook
from standardwebhooks import WebhookVerificationError

from boresight.console.access import users
from boresight.console.jobs.webhook_sender import WebhookSender
from boresight.console.webhooks import service as webhooks
from boresight.console.webhooks.secrets import encrypt_all, get_state
from boresight.console.webhooks.tables import Webhook, WebhookDelivery
from boresight.errors import RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_now
from boresight.platform.web.targets import WebhookTargets
from tests.passwords import add_person
from tests.sites import codes
from tests.stores import open_migrated, url_in


class Receiver:
    def __init__(self) -> None:
        self.heard: list[tuple[str, dict[str, str], str]] = []
        self.statuses: list[int] = []
        self.says: Callable[[Any], None] | None = None
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"])).decode()
                receiver.heard.append((self.path, {k.lower(): v for k, v in self.headers.items()}, body))
                if receiver.says is not None:
                    receiver.says(self.wfile)
                    return
                status = receiver.statuses.pop(0) if receiver.statuses else 204
                self.send_response(status)
                if status == 302:
                    self.send_header("Location", "/elsewhere")
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_: Any) -> None:
                """Keep quiet."""

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://localhost:{self.server.server_address[1]}/hook?team=1"
        self.thread = threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True)
        self.thread.start()

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()
        self.thread.join()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    receiver = Receiver()
    yield receiver
    receiver.close()


@pytest.fixture
def store(tmp_path) -> Iterator[Engine]:
    store = open_migrated(url_in(tmp_path))
    yield store
    store.dispose()


@pytest.fixture
def box(tmp_path) -> SecretBox:
    return SecretBox(tmp_path / "webhooks.key")


@pytest.fixture
def hook(store, receiver, box) -> Webhook:
    with open_writing(store) as session:
        add_person(session, "root", "administrator")
        return webhooks.create_webhook(session, _root(session), box, label="Chat", url=receiver.url)[0]


@pytest.fixture
def deliver(store, box) -> Callable[[], None]:
    return WebhookSender(store, WebhookTargets(local=True), box).deliver


def _root(session: Any) -> Actor:
    row = users.list_users(session)[0]
    return users.get_actor(session, row.id)


def _trial(store: Engine, hook: Webhook) -> int:
    with open_writing(store) as session:
        return webhooks.try_webhook(session, _root(session), hook.id).id


def _delivery(store: Engine, number: int) -> WebhookDelivery:
    with open_reading(store) as session:
        return session.get_one(WebhookDelivery, number)


def test_the_library_of_standard_webhooks_accepts_what_a_receiver_got_once(store, hook, receiver, box, deliver):
    number = _trial(store, hook)
    deliver()
    path, headers, body = receiver.heard[0]
    assert path == "/hook?team=1"
    assert headers["host"].startswith("localhost:")
    assert abs(time.time() - int(headers["webhook-timestamp"])) < 60
    secret = str(box.open(hook.secret))
    assert StandardWebhook(secret).verify(body, headers)["id"] == headers["webhook-id"]
    with pytest.raises(WebhookVerificationError):
        StandardWebhook(secret).verify(body + " ", headers)
    assert json.loads(body)["id"] == headers["webhook-id"]
    assert (_delivery(store, number).state, _delivery(store, number).status) == ("DELIVERED", 204)
    deliver()
    assert len(receiver.heard) == 1


def test_a_refusal_and_a_redirect_are_kept_and_not_followed(store, hook, receiver, deliver):
    receiver.statuses = [503, 302]
    first, second = _trial(store, hook), _trial(store, hook)
    deliver()
    assert [path for path, *_ in receiver.heard] == ["/hook?team=1"] * 2
    assert (_delivery(store, first).state, _delivery(store, first).outcome) == ("PENDING", "Refused with 503")
    assert (_delivery(store, second).state, _delivery(store, second).status) == ("PENDING", 302)


def test_nobody_there_is_an_outcome_and_no_error(store, hook, receiver, deliver):
    number = _trial(store, hook)
    receiver.close()
    deliver()
    found = _delivery(store, number)
    assert (found.state, found.status, found.attempts) == ("PENDING", None, 1)
    assert str(found.outcome).startswith("No answer: ")
    receiver.server = ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler)
    receiver.thread = threading.Thread(target=receiver.server.serve_forever, args=(0.01,), daemon=True)
    receiver.thread.start()


def test_a_dead_receiver_is_asked_once_a_look_and_delays_nobody(store, hook, receiver, box, deliver):
    with open_writing(store) as session:
        dead, _ = webhooks.create_webhook(session, _root(session), box, label="Dead", url="http://127.0.0.1:9/")
    numbers = [_trial(store, dead) for _ in range(3)]
    _trial(store, hook)
    deliver()
    assert len(receiver.heard) >= 1
    assert [_delivery(store, number).attempts for number in numbers] == [1, 0, 0]


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "[::1]", "169.254.169.254", "[::ffff:127.0.0.1]"])
def test_this_machine_and_its_link_are_not_reached_unless_allowed(store, hook, receiver, host, box):
    with open_writing(store) as session:
        session.get_one(Webhook, hook.id).url = f"http://{host}:{receiver.server.server_address[1]}/hook"
        audit.append(session, _root(session), "brought in", f"webhooks/{hook.id}")
        webhooks.try_webhook(session, _root(session), hook.id)
    WebhookSender(store, WebhookTargets(), box).deliver()
    assert receiver.heard == []
    assert "not allowed" in str(_delivery(store, 1).outcome)


def _wait_for(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


def test_the_server_tells_a_webhook_made_over_rest_what_happens_next(house, receiver):
    adele = house.person("adele")
    sender = house.app.state.webhook_sender
    sender.targets = WebhookTargets(local=True)
    made = adele.post("/api/v1/webhooks", json={"label": "Chat", "url": receiver.url, "actions": ["sensors.*"]})
    assert made.status_code == 201, made.text
    try:
        sensor = house.new_sensor()
        _wait_for(lambda: bool(receiver.heard))
        assert json.loads(receiver.heard[0][2])["object"] == f"sensors/{sensor['id']}"
    finally:
        sender.targets = WebhookTargets()
        adele.post(f"/api/v1/webhooks/{made.json()['id']}:disable")


def test_a_secret_is_shown_once_and_never_again(house):
    adele = house.person("adele")
    wanted = {"label": "Chat", "url": "https://mission.invalid/"}
    headers = {"Idempotency-Key": "one-webhook"}
    made = adele.post("/api/v1/webhooks", json=wanted, headers=headers)
    assert made.json()["secret"].startswith("whsec_")
    assert adele.post("/api/v1/webhooks", json=wanted, headers=headers).json()["secret"] is None
    assert "secret" not in adele.get(f"/api/v1/webhooks/{made.json()['id']}").json()
    assert "whsec_" not in adele.get("/api/v1/audit").text


def test_where_a_name_leads_is_judged_at_each_attempt_and_the_judged_address_is_connected_to(
    store, hook, receiver, box, monkeypatch
):
    lookups: list[str] = []
    answers = [["93.184.215.14", "10.0.0.7"], ["127.0.0.1"], ["10.0.0.7"]]  # the second rebinds to this machine

    real = socket.getaddrinfo

    def look_up(host: str, port: int, *rest: Any, **named: Any) -> list[Any]:
        if host != "rebinding.example":  # another sender of this process may be at work
            return real(host, port, *rest, **named)
        lookups.append(host)
        return [(2, 1, 6, "", (address, port)) for address in answers.pop(0)]

    number = _trial(store, hook)
    with open_writing(store) as session:
        webhooks.queue_new(session)
        session.get_one(Webhook, hook.id).url = f"http://rebinding.example:{receiver.server.server_address[1]}/hook"
        session.get_one(Webhook, hook.id).actions = ["nothing.else"]
        audit.append(session, _root(session), "brought in", f"webhooks/{hook.id}")
    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    outcomes = []
    for targets in (WebhookTargets(), WebhookTargets(local=True), WebhookTargets()):
        with open_writing(store) as session:
            for row in session.query(WebhookDelivery):
                row.state, row.due_utc = ("PENDING", utc_now()) if row.id == number else ("DELIVERED", utc_now())
        WebhookSender(store, targets, box).deliver()
        outcomes.append(str(_delivery(store, number).outcome))
    assert lookups == ["rebinding.example"] * 3
    assert re.search("10.0.0.7, .*BORESIGHT_WEBHOOKS_PRIVATE", outcomes[0])
    assert [headers["host"].partition(":")[0] for _, headers, _ in receiver.heard] == ["rebinding.example"]
    assert "resolves to 10.0.0.7" in outcomes[2]


def test_while_a_former_secret_holds_both_verify_and_afterwards_only_the_new_one(store, hook, receiver, box, deliver):
    former = str(box.open(hook.secret))
    with open_writing(store) as session:
        _, newer = webhooks.renew_secret(session, _root(session), box, hook.id)
    _trial(store, hook)
    deliver()
    with open_writing(store) as session:
        _, newest = webhooks.renew_secret(session, _root(session), box, hook.id, overlap_hours=0.0)
    _trial(store, hook)
    deliver()
    told = [(headers, body) for _, headers, body in receiver.heard if "boresight.trial" in body]
    assert [_verifies(secret, *told[0]) for secret in (former, newer, newest)] == [True, True, False]
    assert [_verifies(secret, *told[1]) for secret in (former, newer, newest)] == [False, False, True]


def _verifies(secret: str, headers: dict[str, str], body: str) -> bool:
    try:
        StandardWebhook(secret).verify(body, headers)
    except WebhookVerificationError:
        return False
    return True


def test_without_its_key_a_webhook_is_paused_and_its_messages_wait_for_a_new_secret(
    store, hook, receiver, box, tmp_path
):
    elsewhere = SecretBox(tmp_path / "elsewhere" / "webhooks.key")
    number = _trial(store, hook)
    WebhookSender(store, WebhookTargets(local=True), elsewhere).deliver()
    assert (receiver.heard, _delivery(store, number).attempts) == ([], 0)
    assert (get_state(hook, elsewhere), get_state(hook, box)) == ("PAUSED", "ENABLED")
    assert encrypt_all(store, elsewhere).unreadable == ["Chat"]
    assert not elsewhere.file.exists()
    with open_writing(store) as session:
        row, secret = webhooks.renew_secret(session, _root(session), elsewhere, hook.id)
    assert (get_state(row, elsewhere), row.previous_secret) == ("ENABLED", None)
    WebhookSender(store, WebhookTargets(local=True), elsewhere).deliver()
    assert receiver.heard
    assert all(_verifies(secret, headers, body) for _, headers, body in receiver.heard)
    assert _delivery(store, number).state == "DELIVERED"


@pytest.mark.parametrize("host", ["127.0.0.1", "[fd00:ec2::254]", "10.1.2.3", "[64:ff9b::7f00:1]", "[2002:7f00:1::]"])
def test_an_address_that_is_not_allowed_is_refused_when_a_webhook_is_made(house, host):
    answer = house.person("adele").post("/api/v1/webhooks", json={"label": "x", "url": f"http://{host}/hook"})
    assert answer.status_code == 422
    assert "not allowed" in answer.json()["detail"]


def test_only_an_administrator_makes_the_server_look_a_name_up(house, monkeypatch):
    def look_up(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr("boresight.console.webhooks.service.refuse_address", look_up)
    wanted = {"label": "x", "url": "https://mission.invalid/"}
    assert house.person("ada").post("/api/v1/webhooks", json=wanted).status_code == 403


def test_a_new_secret_is_shown_once_and_the_webhook_says_until_when_the_former_signs(house):
    adele = house.person("adele")
    made = adele.post("/api/v1/webhooks", json={"label": "Chat", "url": "https://mission.invalid/"}).json()
    address, headers = f"/api/v1/webhooks/{made['id']}", {"Idempotency-Key": "one-renewal"}
    renewed = adele.post(f"{address}:renew-secret", json={}, headers=headers).json()
    assert renewed["secret"] != made["secret"]
    assert adele.post(f"{address}:renew-secret", json={}, headers=headers).json()["secret"] is None
    shown = adele.get(address).json()
    assert (shown["state"], shown["former_secret_until_utc"]) == ("ENABLED", renewed["former_secret_until_utc"])
    assert shown["former_secret_until_utc"] > made["created_utc"]
    ended = adele.post(f"{address}:renew-secret", json={"overlap_hours": 0})
    assert ended.json()["former_secret_until_utc"] is None


def test_an_answer_that_drips_ends_at_the_deadline_of_the_whole(store, hook, receiver, monkeypatch, deliver):
    monkeypatch.setattr("boresight.console.jobs.webhook_sender.TIMEOUT_S", 1.0)

    def drip(wire: Any) -> None:
        with suppress(OSError):
            for letter in b"HTTP/1.1 200 OK\r\nX: " + b"x" * 100:
                wire.write(bytes([letter]))
                wire.flush()
                time.sleep(0.1)

    receiver.says = drip
    number, began_s = _trial(store, hook), time.monotonic()
    deliver()
    assert time.monotonic() - began_s < 5
    found = _delivery(store, number)
    assert (found.state, found.status, found.attempts) == ("PENDING", None, 1)


def test_of_an_answer_no_more_is_read_than_is_kept(store, hook, receiver, deliver):
    sent: list[int] = []

    def flood(wire: Any) -> None:
        wire.write(b"HTTP/1.1 500 No\r\nContent-Encoding: gzip\r\nConnection: close\r\n\r\n")
        with suppress(OSError):
            for _ in range(4000):
                wire.write(gzip.compress(bytes(100_000)) * 100)
                sent.append(1)

    receiver.says = flood
    number = _trial(store, hook)
    deliver()
    assert (_delivery(store, number).state, _delivery(store, number).status) == ("PENDING", 500)
    assert len(str(_delivery(store, number).outcome)) < 300
    assert len(sent) < 4000


@pytest.mark.parametrize(
    "url", ["http://a..b/", "http://.../", "http://@host/", "http://:@host/", f"http://{'a' * 64}.b/"]
)
def test_an_address_that_no_name_can_have_is_refused_when_it_is_given(store, url, box, hook):
    del hook  # its administrator
    with open_writing(store) as session, pytest.raises(RefusedInputError):
        webhooks.create_webhook(session, _root(session), box, label="Poison", url=url)


FORM = {
    "label": "Mission chat",
    "url": "https://mission.invalid/hook",
    "actions": "parameter-sets.promoted, approvals.*",
}


def _made(site) -> str:
    answer = site.visitor("adele").post("/webhooks", **FORM)
    assert answer.status_code == 200
    return re.search(r'href="(/webhooks/\d+)"', answer.text)[1]


def test_a_new_webhooks_secret_is_shown_this_once(site):
    visitor = site.visitor("adele")
    assert "whsec_" in visitor.post("/webhooks", **FORM).text
    page = visitor.get("/webhooks")
    assert "whsec_" not in page
    assert "approvals.*" in page


def test_a_refused_webhook_keeps_what_was_typed(site, read):
    answer = site.visitor("adele").post("/webhooks", **{**FORM, "url": "mission"})
    assert answer.status_code == 422
    assert "is not an address" in read(answer.text)
    assert 'value="Mission chat"' in answer.text


def test_a_trial_stands_in_the_log_and_a_message_given_up_can_be_sent_again(site, read):
    visitor, address = site.visitor("adele"), _made(site)
    assert visitor.post(f"{address}/try").status_code == 303
    number = int(re.search(r"msg_(\d+)", visitor.get(address))[1])
    with open_writing(site.engine) as session:
        for _ in range(webhooks.MOST_ATTEMPTS):
            webhooks.settle(session, number, status=None, outcome="No answer: nobody is there.")
    page = read(visitor.get(address))
    assert "FAILED" in page
    assert "No answer: nobody is there." in page
    assert visitor.post(f"{address}/deliveries/{number}/redeliver").status_code == 303
    assert "PENDING" in read(visitor.get(address))


def test_a_disabled_webhook_offers_to_be_enabled_and_nothing_else(site):
    visitor, address = site.visitor("adele"), _made(site)
    visitor.post(f"{address}/disable")
    page = visitor.get(address)
    assert f'action="{address}/try"' not in page
    assert f'action="{address}/enable"' in page


def test_who_is_no_administrator_is_told_who_may_and_shown_no_address(site, read):
    address = _made(site)
    page = read(site.visitor("ada").get("/webhooks"))
    assert "administrators-only" in codes(site.visitor("ada").get("/webhooks"))
    assert "mission.invalid" not in page
    assert site.visitor("ada").send("GET", address, headers={"accept": "text/html"}).status_code == 403
