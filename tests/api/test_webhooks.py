"""Deliveries over the wire: a real receiver on a real port gets what was signed, once, and is tried again when it fails."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from boresight.api.deliveries import Deliveries
from boresight.services import audit, users, webhook_messages, webhooks
from boresight.services.actors import COMMAND_LINE, Actor
from boresight.store.sessions import Engine, migrate, open_engine, reading, writing
from boresight.store.tables import Webhook, WebhookDelivery
from tests.stores import url_in

from .conftest import PASSWORD, House


class Receiver:
    """A web server that keeps what it is sent and answers as told."""

    def __init__(self) -> None:
        self.heard: list[tuple[str, dict[str, str], str]] = []
        self.statuses: list[int] = []
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"])).decode()
                receiver.heard.append((self.path, {k.lower(): v for k, v in self.headers.items()}, body))
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
        self.thread = threading.Thread(target=self.server.serve_forever, daemon=True)
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
def store(tmp_path: Path) -> Iterator[Engine]:
    store = open_engine(url_in(tmp_path))
    migrate(store)
    yield store
    store.dispose()


@pytest.fixture
def hook(store: Engine, receiver: Receiver) -> Webhook:
    with writing(store) as session:
        users.create_user(
            session, COMMAND_LINE, name="root", printed_name="Root", password=PASSWORD, roles=["administrator"]
        )
        return webhooks.create_webhook(session, _root(session), label="Chat", url=receiver.url)


def _root(session: Any) -> Actor:
    row = users.list_users(session)[0]
    return users.actor_of(session, row.id)


def _trial(store: Engine, hook: Webhook) -> int:
    with writing(store) as session:
        return webhooks.try_webhook(session, _root(session), hook.id).id


def _delivery(store: Engine, number: int) -> WebhookDelivery:
    with reading(store) as session:
        return session.get_one(WebhookDelivery, number)


def test_a_receiver_can_check_the_signature_of_the_bytes_it_got(
    store: Engine, hook: Webhook, receiver: Receiver
) -> None:
    number = _trial(store, hook)
    Deliveries(store, local=True).deliver()
    path, headers, body = receiver.heard[0]
    assert path == "/hook?team=1"
    assert headers["host"].startswith("localhost:")
    assert abs(time.time() - int(headers["webhook-timestamp"])) < 60
    signed = webhook_messages.signature(hook.secret, headers["webhook-id"], int(headers["webhook-timestamp"]), body)
    assert headers["webhook-signature"] == signed
    assert json.loads(body)["id"] == headers["webhook-id"]
    assert (_delivery(store, number).state, _delivery(store, number).status) == ("DELIVERED", 204)


def test_a_message_that_was_delivered_is_not_sent_again(store: Engine, hook: Webhook, receiver: Receiver) -> None:
    _trial(store, hook)
    for _ in range(3):
        Deliveries(store, local=True).deliver()
    assert len(receiver.heard) == 1


def test_a_refusal_and_a_redirect_are_kept_and_not_followed(store: Engine, hook: Webhook, receiver: Receiver) -> None:
    receiver.statuses = [503, 302]
    first, second = _trial(store, hook), _trial(store, hook)
    Deliveries(store, local=True).deliver()
    assert [path for path, *_ in receiver.heard] == ["/hook?team=1"] * 2
    assert (_delivery(store, first).state, _delivery(store, first).outcome) == ("PENDING", "Refused with 503")
    assert (_delivery(store, second).state, _delivery(store, second).status) == ("PENDING", 302)


def test_nobody_there_is_an_outcome_and_no_error(store: Engine, hook: Webhook, receiver: Receiver) -> None:
    number = _trial(store, hook)
    receiver.close()
    Deliveries(store, local=True).deliver()
    found = _delivery(store, number)
    assert (found.state, found.status, found.attempts) == ("PENDING", None, 1)
    assert str(found.outcome).startswith("No answer: ")
    receiver.server = ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler)
    receiver.thread = threading.Thread(target=receiver.server.serve_forever, daemon=True)
    receiver.thread.start()


def test_a_dead_receiver_is_asked_once_a_look_and_delays_nobody(
    store: Engine, hook: Webhook, receiver: Receiver
) -> None:
    with writing(store) as session:
        dead = webhooks.create_webhook(session, _root(session), label="Dead", url="http://127.0.0.1:9/")
    numbers = [_trial(store, dead) for _ in range(3)]
    _trial(store, hook)
    Deliveries(store, local=True).deliver()
    assert len(receiver.heard) >= 1
    assert [_delivery(store, number).attempts for number in numbers] == [1, 0, 0]


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "[::1]", "169.254.169.254", "[::ffff:127.0.0.1]"])
def test_this_machine_and_its_link_are_not_reached_unless_allowed(
    store: Engine, hook: Webhook, receiver: Receiver, host: str
) -> None:
    with writing(store) as session:
        session.get_one(Webhook, hook.id).url = f"http://{host}:{receiver.server.server_address[1]}/hook"
        audit.append(session, _root(session), "brought in", f"webhooks/{hook.id}")
        webhooks.try_webhook(session, _root(session), hook.id)
    Deliveries(store, local=False).deliver()
    assert receiver.heard == []
    assert "not allowed" in str(_delivery(store, 1).outcome)


def _wait_for(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


def test_the_server_tells_a_webhook_made_over_rest_what_happens_next(house: House, receiver: Receiver) -> None:
    adele = house.person("adele")
    deliveries = house.app.state.deliveries
    deliveries._local = True
    made = adele.post("/api/v1/webhooks", json={"label": "Chat", "url": receiver.url, "actions": ["sensors.*"]})
    assert made.status_code == 201, made.text
    try:
        sensor = house.new_sensor()
        _wait_for(lambda: bool(receiver.heard))
        assert json.loads(receiver.heard[0][2])["object"] == f"sensors/{sensor['id']}"
    finally:
        deliveries._local = False
        adele.post(f"/api/v1/webhooks/{made.json()['id']}:disable")


def test_a_secret_is_shown_once_and_never_again(house: House) -> None:
    adele = house.person("adele")
    wanted = {"label": "Chat", "url": "https://mission.invalid/"}
    headers = {"Idempotency-Key": "one-webhook"}
    made = adele.post("/api/v1/webhooks", json=wanted, headers=headers)
    assert made.json()["secret"].startswith("whsec_")
    assert adele.post("/api/v1/webhooks", json=wanted, headers=headers).json()["secret"] is None
    assert "secret" not in adele.get(f"/api/v1/webhooks/{made.json()['id']}").json()
    assert "whsec_" not in adele.get("/api/v1/audit").text
