"""Webhooks: every record that was asked for becomes one message, is signed, is tried eight times and can be sent again."""

import base64
import hashlib
import hmac
import json
import stat
from datetime import datetime
from pathlib import Path

import pytest
import sqlalchemy as sa

from boresight.console.access import api_keys
from boresight.console.webhooks import service as webhooks
from boresight.console.webhooks.secrets import decode_key, encrypt_all, encrypt_anew, get_state
from boresight.console.webhooks.tables import Webhook, WebhookDelivery
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_now
from tests.passwords import add_person
from tests.refusals import has_code

URL = "https://mission.example/hooks?team=1"


@pytest.fixture
def box(tmp_path) -> SecretBox:
    return SecretBox(tmp_path / "webhooks.key")


@pytest.fixture
def hook(session, people, box) -> Webhook:
    return webhooks.create_webhook(session, people["root"], box, label="Chat", url=URL, actions=["users.*"])[0]


def _happens(session: Session, name: str = "zoe") -> None:
    add_person(session, name, "viewer", printed_name=name)


def _deliveries(session: Session) -> list[WebhookDelivery]:
    return list(session.scalars(sa.select(WebhookDelivery).order_by(WebhookDelivery.id)))


def test_only_administrators_manage_webhooks_and_no_key_of_theirs(session, people, box):
    _, secret = api_keys.create_key(session, people["root"], label="x", scopes=["runs"])
    refused = [(people[name], "administrator") for name in ("ana", "cy", "dee", "eve")]
    for actor, says in (*refused, (api_keys.find_actor_of_key(session, secret), "API key")):
        with pytest.raises(ForbiddenError, match=says):
            webhooks.create_webhook(session, actor, box, label="x", url=URL)
        with pytest.raises(ForbiddenError, match=says):
            webhooks.list_webhooks(session, actor)


@pytest.mark.parametrize(
    "url",
    ["", "mission.example", "ftp://mission.example", "https://", "https://a:b@mission.example/", "https://x/#y",
     "https://x:port/", "https://x/" + "y" * 2000, "file:///etc/passwd"],
)  # fmt: skip
def test_what_is_no_address_of_a_web_server_is_refused(session, people, url, box):
    with pytest.raises(RefusedInputError):
        webhooks.create_webhook(session, people["root"], box, label="x", url=url)


@pytest.mark.parametrize("kind", ["promoted", "a b.c", ".", "parameter-sets.", "x.y;z"])
def test_a_kind_that_no_event_can_have_is_refused(session, people, kind, box):
    with pytest.raises(RefusedInputError, check=has_code("unknown-event")):
        webhooks.create_webhook(session, people["root"], box, label="x", url=URL, actions=[kind])


def test_a_webhook_is_told_what_happens_after_it_was_made_and_of_the_kinds_it_asked_for(session, people, hook, box):
    webhooks.create_webhook(session, people["root"], box, label="All", url=URL)
    assert webhooks.queue_new(session) == 0, "nothing happened to a user since"
    _happens(session)
    made = webhooks.queue_new(session)
    to_hook = [json.loads(row.body) for row in _deliveries(session) if row.webhook_id == hook.id]
    assert [body["type"] for body in to_hook] == ["users.created"]
    assert made == len(_deliveries(session)) == len(to_hook) * 2
    assert webhooks.queue_new(session) == 0, "nobody is told twice"


def test_a_message_says_what_who_and_which_record_of_the_chain(session, hook, box):
    _happens(session)
    webhooks.queue_new(session)
    row = _deliveries(session)[0]
    record = audit.list_records(session, limit=1)[0]
    body = json.loads(row.body)
    assert body["id"] == webhooks.make_message_id(row.id)
    assert (body["object"], body["action"], body["actor"]) == (record.object, "created", "Command line")
    assert body["data"]["audit_hash"] == record.hash
    assert row.audit_id == record.id
    assert hook.secret not in row.body
    assert str(box.open(hook.secret)) not in row.body


def test_a_signature_is_the_hmac_of_id_second_and_body_by_the_bytes_of_each_secret():
    keys = [b"k" * 32, b"\xff" * 24]
    secrets = ["whsec_" + base64.b64encode(key).decode() for key in keys]
    expected = [hmac.new(key, b'msg_7.1700000000.{"a":1}', hashlib.sha256).digest() for key in keys]
    signed = webhooks.sign_message(secrets, "msg_7", 1700000000, '{"a":1}')
    assert signed == " ".join("v1," + base64.b64encode(one).decode() for one in expected)


def test_a_failure_is_tried_again_after_growing_waits_and_given_up_after_the_eighth(session, people, hook):
    row = webhooks.try_webhook(session, people["root"], hook.id)
    waits = []
    for _ in range(webhooks.MOST_ATTEMPTS):
        assert row.state == "PENDING"
        webhooks.settle(session, row.id, status=500, outcome="Refused with 500")
        later = datetime.fromisoformat(row.due_utc) - datetime.fromisoformat(str(row.attempted_utc))
        waits.append(round(later.total_seconds()))
    assert waits[:-1] == [5, 20, 80, 320, 1280, 5120, 20480]
    assert (row.state, row.attempts, row.status) == ("FAILED", 8, 500)


def test_the_audit_log_tells_of_a_webhook_without_its_secret(session, hook):
    record = audit.list_records(session, subject=f"webhooks/{hook.id}", limit=1)[0]
    assert record.after == {"label": "Chat", "url": URL, "actions": ["users.*"]}


def test_any_2xx_delivers_and_nothing_else_does(session, people, hook):
    for status, state in (
        (200, "DELIVERED"),
        (204, "DELIVERED"),
        (302, "PENDING"),
        (404, "PENDING"),
        (None, "PENDING"),
    ):
        row = webhooks.try_webhook(session, people["root"], hook.id)
        webhooks.settle(session, row.id, status=status, outcome="x")
        assert row.state == state, status


def test_a_message_that_was_given_up_can_be_sent_again_with_its_id_and_its_words(session, people, hook, box):
    row = webhooks.try_webhook(session, people["root"], hook.id)
    for _ in range(webhooks.MOST_ATTEMPTS):
        webhooks.settle(session, row.id, status=None, outcome="No answer.")
    body = row.body
    webhooks.redeliver(session, people["root"], row.id)
    record = audit.find_last_change(session, f"webhooks/{hook.id}")
    assert (record.action, record.actor, record.after) == ("redelivered", "Root", {"message": f"msg_{row.id}"})
    last = {"state": "FAILED", "attempts": webhooks.MOST_ATTEMPTS, "status": None, "outcome": "No answer."}
    assert last.items() <= record.before.items(), "the last attempt is kept where another will take its place"
    assert (row.state, row.attempts, row.body) == ("PENDING", 0, body)
    assert [message.delivery_id for message in webhooks.take_due(session, 10, box)] == [row.id]
    with pytest.raises(NotFoundError):
        webhooks.redeliver(session, people["root"], 99)


def test_a_disabled_webhook_is_told_nothing_and_not_of_the_meantime_when_enabled_again(session, people, hook, box):
    webhooks.try_webhook(session, people["root"], hook.id)
    webhooks.disable_webhook(session, people["root"], hook.id)
    assert webhooks.take_due(session, 10, box) == []
    with pytest.raises(ConflictError, check=has_code("webhook-disabled")):
        webhooks.try_webhook(session, people["root"], hook.id)
    _happens(session)
    assert webhooks.queue_new(session) == 0
    webhooks.enable_webhook(session, people["root"], hook.id)
    assert webhooks.queue_new(session) == 0
    _happens(session, "yan")
    assert webhooks.queue_new(session) == 1


def test_a_webhook_with_many_messages_takes_no_place_of_another(session, people, hook, box):
    other, _ = webhooks.create_webhook(session, people["root"], box, label="Other", url=URL)
    for _ in range(30):
        webhooks.try_webhook(session, people["root"], hook.id)
    webhooks.try_webhook(session, people["root"], other.id)
    taken = [message.webhook_id for message in webhooks.take_due(session, 20, box)]
    assert taken.count(hook.id) == webhooks.MESSAGES_A_TURN
    assert taken.count(other.id) == 1


def test_without_an_answer_everything_for_that_webhook_waits_and_counts_no_attempt(session, people, hook, box):
    first, second = (webhooks.try_webhook(session, people["root"], hook.id) for _ in range(2))
    assert [message.url for message in webhooks.take_due(session, 10, box)] == [URL, URL]
    assert webhooks.take_due(session, 10, box) == [], "what is under way is not taken twice"
    webhooks.settle(session, first.id, status=None, outcome="No answer.")
    session.refresh(second)
    assert (second.state, second.attempts) == ("PENDING", 0)
    assert second.due_utc >= first.due_utc
    webhooks.settle(session, second.id, status=503, outcome="Refused with 503")
    assert webhooks.take_due(session, 10, box) == []
    third, fourth = (webhooks.try_webhook(session, people["root"], hook.id) for _ in range(2))
    webhooks.settle(session, third.id, status=503, outcome="Refused with 503")
    assert [message.delivery_id for message in webhooks.take_due(session, 10, box)] == [fourth.id], "an answer goes on"


OLD = "whsec_-_" + "A" * 41  # 32 bytes as older versions wrote them: in the alphabet for addresses, unpadded


def _plain(engine: Engine, actor: Actor) -> int:
    with open_writing(engine) as session:
        row = Webhook(label="Chat", url=URL, actions=[], secret=OLD, created_utc=utc_now())
        session.add(row)
        session.flush()
        audit.append(session, actor, "created", f"webhooks/{row.id}")
        return row.id


def _secret(engine: Engine, number: int) -> str:
    with open_reading(engine) as session:
        return session.get_one(Webhook, number).secret


def test_a_new_webhooks_secret_is_stored_encrypted_and_its_key_is_its_owners_alone(engine, people, box):
    with open_writing(engine) as session:
        row, secret = webhooks.create_webhook(session, people["root"], box, label="Chat", url=URL)
    assert len(decode_key(secret)) == 32
    assert row.secret.startswith("fernet:")
    assert secret not in row.secret
    assert box.open(row.secret) == secret
    assert stat.S_IMODE(box.file.stat().st_mode) == 0o600
    with open_reading(engine) as session:
        assert audit.verify(session).ok


def test_plain_secrets_of_before_are_encrypted_once_keep_their_key_and_leave_no_trace(engine, people, box):
    number = _plain(engine, people["root"])
    kept = encrypt_all(engine, box)
    assert (kept.encrypted, kept.unreadable, kept.sentence) == (1, [], None)
    now = str(box.open(_secret(engine, number)))
    assert decode_key(now) == base64.urlsafe_b64decode(OLD.removeprefix("whsec_") + "=")
    assert encrypt_all(engine, box).encrypted == 0
    if engine.dialect.name == "sqlite":
        place = Path(str(engine.url.database))
        assert not any(OLD.encode() in path.read_bytes() for path in place.parent.glob(f"{place.name}*"))
    with open_reading(engine) as session:
        assert audit.verify(session).ok
        record = audit.find_last_change(session, f"webhooks/{number}")
    assert record.action == "encrypted the secret of"


def test_without_the_key_nothing_is_lost_and_it_is_said_what_to_do(engine, people, box, tmp_path):
    number = _plain(engine, people["root"])
    encrypt_all(engine, box)
    before, elsewhere = _secret(engine, number), SecretBox(tmp_path / "other.key")
    kept = encrypt_all(engine, elsewhere)
    assert kept.unreadable == ["Chat"]
    assert "Chat" in str(kept.sentence)
    with open_reading(engine) as session:
        row = session.get_one(Webhook, number)
        assert [get_state(row, one) for one in (elsewhere, box)] == ["PAUSED", "ENABLED"]
    assert _secret(engine, number) == before


def test_a_rotated_key_reads_what_the_former_encrypted_and_the_former_can_then_go(engine, people, box):
    number = _plain(engine, people["root"])
    encrypt_all(engine, box)
    first, secret = _secret(engine, number), box.open(_secret(engine, number))
    box.add_key()
    with open_writing(engine) as session:
        assert encrypt_anew(session, box) == 1
    assert box.open(first) == box.open(_secret(engine, number)) == secret
    assert box.forget_old_keys() == 1
    assert SecretBox(box.file).open(first) is None
    assert SecretBox(box.file).open(_secret(engine, number)) == secret
    assert stat.S_IMODE(box.file.stat().st_mode) == 0o600
    box.file.write_text("no key\n")
    with pytest.raises(RefusedInputError, check=has_code("unusable-key")):
        SecretBox(box.file).open(first)


def test_neither_a_message_nor_an_error_of_the_database_shows_a_secret(engine, people, box):
    with open_writing(engine) as session:
        row, secret = webhooks.create_webhook(session, people["root"], box, label="Chat", url=URL)
        webhooks.try_webhook(session, people["root"], row.id)
        assert secret not in repr(webhooks.take_due(session, 1, box))
    wrong = sa.text("SELECT nothing FROM webhooks WHERE secret = :secret")
    with engine.connect() as connection, pytest.raises(sa.exc.DBAPIError) as caught:
        connection.execute(wrong, {"secret": secret})
    assert secret not in str(caught.value)
