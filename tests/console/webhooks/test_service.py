"""Webhooks: every record that was asked for becomes one message, is signed, is tried eight times and can be sent again."""

import base64
import hashlib
import hmac
import json
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

import pytest
import sqlalchemy as sa

from boresight.console.access import api_keys
from boresight.console.webhooks import service as webhook_messages
from boresight.console.webhooks.tables import Webhook, WebhookDelivery
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Session
from tests.passwords import add_person

URL = "https://mission.example/hooks?team=1"


@pytest.fixture
def box(tmp_path: Path) -> SecretBox:
    return SecretBox(tmp_path / "webhooks.key")


@pytest.fixture
def hook(session: Session, people: Mapping[str, Actor], box: SecretBox) -> Webhook:
    return webhook_messages.create_webhook(session, people["root"], box, label="Chat", url=URL, actions=["users.*"])[0]


def _happens(session: Session, name: str = "zoe") -> None:
    add_person(session, name, "viewer", printed_name=name)


def _deliveries(session: Session) -> list[WebhookDelivery]:
    return list(session.scalars(sa.select(WebhookDelivery).order_by(WebhookDelivery.id)))


@pytest.mark.parametrize("name", ["ana", "cy", "dee", "eve"])
def test_only_administrators_manage_webhooks(
    session: Session, people: Mapping[str, Actor], name: str, box: SecretBox
) -> None:
    with pytest.raises(ForbiddenError, match="administrator"):
        webhook_messages.create_webhook(session, people[name], box, label="x", url=URL)
    with pytest.raises(ForbiddenError, match="administrator"):
        webhook_messages.list_webhooks(session, people[name])


def test_an_administrators_key_manages_no_webhooks(
    session: Session, people: Mapping[str, Actor], box: SecretBox
) -> None:
    _, secret = api_keys.create_key(session, people["root"], label="x", scopes=["runs"])
    with pytest.raises(ForbiddenError, match="API key"):
        webhook_messages.create_webhook(session, api_keys.actor_of_key(session, secret), box, label="x", url=URL)


@pytest.mark.parametrize(
    "url",
    ["", "mission.example", "ftp://mission.example", "https://", "https://a:b@mission.example/", "https://x/#y",
     "https://x:port/", "https://x/" + "y" * 2000, "file:///etc/passwd"],
)  # fmt: skip
def test_what_is_no_address_of_a_web_server_is_refused(
    session: Session, people: Mapping[str, Actor], url: str, box: SecretBox
) -> None:
    with pytest.raises(RefusedInputError):
        webhook_messages.create_webhook(session, people["root"], box, label="x", url=url)


@pytest.mark.parametrize("kind", ["promoted", "a b.c", ".", "parameter-sets.", "x.y;z"])
def test_a_kind_that_no_event_can_have_is_refused(
    session: Session, people: Mapping[str, Actor], kind: str, box: SecretBox
) -> None:
    with pytest.raises(RefusedInputError, match="no kind of event"):
        webhook_messages.create_webhook(session, people["root"], box, label="x", url=URL, actions=[kind])


def test_a_webhook_is_told_what_happens_after_it_was_made_and_of_the_kinds_it_asked_for(
    session: Session, people: Mapping[str, Actor], hook: Webhook, box: SecretBox
) -> None:
    webhook_messages.create_webhook(session, people["root"], box, label="All", url=URL)
    assert webhook_messages.queue_new(session) == 0, "nothing happened to a user since"
    _happens(session)
    made = webhook_messages.queue_new(session)
    to_hook = [json.loads(row.body) for row in _deliveries(session) if row.webhook_id == hook.id]
    assert [body["type"] for body in to_hook] == ["users.created"]
    assert made == len(_deliveries(session)) == len(to_hook) * 2
    assert webhook_messages.queue_new(session) == 0, "nobody is told twice"


def test_a_message_says_what_who_and_which_record_of_the_chain(session: Session, hook: Webhook, box: SecretBox) -> None:
    _happens(session)
    webhook_messages.queue_new(session)
    row = _deliveries(session)[0]
    record = audit.list_records(session, limit=1)[0]
    body = json.loads(row.body)
    assert body["id"] == webhook_messages.message_id(row.id)
    assert (body["object"], body["action"], body["actor"]) == (record.object, "created", "Command line")
    assert body["data"]["audit_hash"] == record.hash
    assert row.audit_id == record.id
    assert hook.secret not in row.body
    assert str(box.open(hook.secret)) not in row.body


def test_a_signature_is_the_hmac_of_id_second_and_body_by_the_bytes_of_each_secret() -> None:
    keys = [b"k" * 32, b"\xff" * 24]
    secrets = ["whsec_" + base64.b64encode(key).decode() for key in keys]
    expected = [hmac.new(key, b'msg_7.1700000000.{"a":1}', hashlib.sha256).digest() for key in keys]
    signed = webhook_messages.signature(secrets, "msg_7", 1700000000, '{"a":1}')
    assert signed == " ".join("v1," + base64.b64encode(one).decode() for one in expected)


def test_a_message_under_way_is_not_taken_twice(
    session: Session, people: Mapping[str, Actor], hook: Webhook, box: SecretBox
) -> None:
    webhook_messages.try_webhook(session, people["root"], hook.id)
    assert [message.url for message in webhook_messages.take_due(session, 10, box)] == [URL]
    assert webhook_messages.take_due(session, 10, box) == []


def test_a_failure_is_tried_again_after_growing_waits_and_given_up_after_the_eighth(
    session: Session, people: Mapping[str, Actor], hook: Webhook
) -> None:
    row = webhook_messages.try_webhook(session, people["root"], hook.id)
    waits = []
    for _ in range(webhook_messages.MOST_ATTEMPTS):
        assert row.state == "PENDING"
        webhook_messages.settle(session, row.id, status=500, outcome="Refused with 500")
        later = datetime.fromisoformat(row.due_utc) - datetime.fromisoformat(str(row.attempted_utc))
        waits.append(round(later.total_seconds()))
    assert waits[:-1] == [5, 20, 80, 320, 1280, 5120, 20480]
    assert (row.state, row.attempts, row.status) == ("FAILED", 8, 500)


def test_any_2xx_delivers_and_nothing_else_does(session: Session, people: Mapping[str, Actor], hook: Webhook) -> None:
    for status, state in (
        (200, "DELIVERED"),
        (204, "DELIVERED"),
        (302, "PENDING"),
        (404, "PENDING"),
        (None, "PENDING"),
    ):
        row = webhook_messages.try_webhook(session, people["root"], hook.id)
        webhook_messages.settle(session, row.id, status=status, outcome="x")
        assert row.state == state, status


def test_a_message_that_was_given_up_can_be_sent_again_with_its_id_and_its_words(
    session: Session, people: Mapping[str, Actor], hook: Webhook, box: SecretBox
) -> None:
    row = webhook_messages.try_webhook(session, people["root"], hook.id)
    for _ in range(webhook_messages.MOST_ATTEMPTS):
        webhook_messages.settle(session, row.id, status=None, outcome="No answer.")
    body = row.body
    webhook_messages.redeliver(session, people["root"], row.id)
    record = audit.last_change(session, f"webhooks/{hook.id}")
    assert (record.action, record.actor, record.after) == ("redelivered", "Root", {"message": f"msg_{row.id}"})
    last = {"state": "FAILED", "attempts": webhook_messages.MOST_ATTEMPTS, "status": None, "outcome": "No answer."}
    assert last.items() <= record.before.items(), "the last attempt is kept where another will take its place"
    assert (row.state, row.attempts, row.body) == ("PENDING", 0, body)
    assert [message.delivery_id for message in webhook_messages.take_due(session, 10, box)] == [row.id]
    with pytest.raises(NotFoundError):
        webhook_messages.redeliver(session, people["root"], 99)


def test_a_disabled_webhook_is_told_nothing_and_not_of_the_meantime_when_enabled_again(
    session: Session, people: Mapping[str, Actor], hook: Webhook, box: SecretBox
) -> None:
    webhook_messages.try_webhook(session, people["root"], hook.id)
    webhook_messages.disable_webhook(session, people["root"], hook.id)
    assert webhook_messages.take_due(session, 10, box) == []
    with pytest.raises(ConflictError, match="enable it first"):
        webhook_messages.try_webhook(session, people["root"], hook.id)
    _happens(session)
    assert webhook_messages.queue_new(session) == 0
    webhook_messages.enable_webhook(session, people["root"], hook.id)
    assert webhook_messages.queue_new(session) == 0
    _happens(session, "yan")
    assert webhook_messages.queue_new(session) == 1


def test_the_audit_log_tells_of_a_webhook_without_its_secret(session: Session, hook: Webhook) -> None:
    record = audit.list_records(session, subject=f"webhooks/{hook.id}", limit=1)[0]
    assert record.after == {"label": "Chat", "url": URL, "actions": ["users.*"]}


def test_a_webhook_with_many_messages_takes_no_place_of_another(
    session: Session, people: Mapping[str, Actor], hook: Webhook, box: SecretBox
) -> None:
    other, _ = webhook_messages.create_webhook(session, people["root"], box, label="Other", url=URL)
    for _ in range(30):
        webhook_messages.try_webhook(session, people["root"], hook.id)
    webhook_messages.try_webhook(session, people["root"], other.id)
    taken = [message.webhook_id for message in webhook_messages.take_due(session, 20, box)]
    assert taken.count(hook.id) == webhook_messages.MESSAGES_A_TURN
    assert taken.count(other.id) == 1


def test_without_an_answer_everything_for_that_webhook_waits_and_counts_no_attempt(
    session: Session, people: Mapping[str, Actor], hook: Webhook, box: SecretBox
) -> None:
    first, second = (webhook_messages.try_webhook(session, people["root"], hook.id) for _ in range(2))
    webhook_messages.take_due(session, 10, box)
    webhook_messages.settle(session, first.id, status=None, outcome="No answer.")
    session.refresh(second)
    assert (second.state, second.attempts) == ("PENDING", 0)
    assert second.due_utc >= first.due_utc
    webhook_messages.settle(session, second.id, status=503, outcome="Refused with 503")
    assert webhook_messages.take_due(session, 10, box) == []


def test_an_answer_lets_the_other_messages_go_on(
    session: Session, people: Mapping[str, Actor], hook: Webhook, box: SecretBox
) -> None:
    first, second = (webhook_messages.try_webhook(session, people["root"], hook.id) for _ in range(2))
    webhook_messages.settle(session, first.id, status=503, outcome="Refused with 503")
    assert [message.delivery_id for message in webhook_messages.take_due(session, 10, box)] == [second.id]
