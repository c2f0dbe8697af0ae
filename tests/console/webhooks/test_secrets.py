"""Secrets of webhooks at rest: ciphertext in the database and its backups, readable with a key outside both."""

import base64
import stat
from collections.abc import Mapping
from pathlib import Path

import pytest
import sqlalchemy as sa

from boresight.console.webhooks import service as webhooks
from boresight.console.webhooks.secrets import decode_key, encrypt_all, encrypt_anew, get_state
from boresight.console.webhooks.tables import Webhook
from boresight.errors import RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_now

URL = "https://mission.example/hooks"
OLD = "whsec_-_" + "A" * 41  # 32 bytes as older versions wrote them: in the alphabet for addresses, unpadded


@pytest.fixture
def box(tmp_path: Path) -> SecretBox:
    return SecretBox(tmp_path / "keys" / "webhooks.key")


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


def test_a_new_webhooks_secret_is_stored_encrypted_and_its_key_is_its_owners_alone(
    engine: Engine, people: Mapping[str, Actor], box: SecretBox
) -> None:
    with open_writing(engine) as session:
        row, secret = webhooks.create_webhook(session, people["root"], box, label="Chat", url=URL)
    assert len(decode_key(secret)) == 32
    assert row.secret.startswith("fernet:")
    assert secret not in row.secret
    assert box.open(row.secret) == secret
    assert stat.S_IMODE(box.file.stat().st_mode) == 0o600
    with open_reading(engine) as session:
        assert audit.verify(session).ok


def test_plain_secrets_of_before_are_encrypted_once_keep_their_key_and_leave_no_trace(
    engine: Engine, people: Mapping[str, Actor], box: SecretBox
) -> None:
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
        record = audit.last_change(session, f"webhooks/{number}")
    assert record is not None
    assert record.action == "encrypted the secret of"


def test_without_the_key_nothing_is_lost_and_it_is_said_what_to_do(
    engine: Engine, people: Mapping[str, Actor], box: SecretBox, tmp_path: Path
) -> None:
    number = _plain(engine, people["root"])
    encrypt_all(engine, box)
    before, elsewhere = _secret(engine, number), SecretBox(tmp_path / "other.key")
    kept = encrypt_all(engine, elsewhere)
    assert kept.unreadable == ["Chat"]
    assert "Copy the key file" in str(kept.sentence)
    with open_reading(engine) as session:
        row = session.get_one(Webhook, number)
        assert [get_state(row, one) for one in (elsewhere, box)] == ["PAUSED", "ENABLED"]
    assert _secret(engine, number) == before


def test_a_rotated_key_reads_what_the_former_encrypted_and_the_former_can_then_go(
    engine: Engine, people: Mapping[str, Actor], box: SecretBox
) -> None:
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


def test_a_damaged_key_file_is_one_sentence(box: SecretBox) -> None:
    sealed = box.seal("whsec_x")
    box.file.write_text("no key\n")
    with pytest.raises(RefusedInputError, match="holds no key that can be used"):
        SecretBox(box.file).open(sealed)


def test_neither_a_message_nor_an_error_of_the_database_shows_a_secret(
    engine: Engine, people: Mapping[str, Actor], box: SecretBox
) -> None:
    with open_writing(engine) as session:
        row, secret = webhooks.create_webhook(session, people["root"], box, label="Chat", url=URL)
        webhooks.try_webhook(session, people["root"], row.id)
        assert secret not in repr(webhooks.take_due(session, 1, box))
    wrong = sa.text("SELECT nothing FROM webhooks WHERE secret = :secret")
    with engine.connect() as connection, pytest.raises(sa.exc.DBAPIError) as caught:
        connection.execute(wrong, {"secret": secret})
    assert secret not in str(caught.value)
