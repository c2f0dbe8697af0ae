"""Secrets of webhooks at rest: encrypted with a key of the installation, which no backup holds.

A secret whose key is not here, as after a restore on another machine, pauses its webhook on this server.
"""

from __future__ import annotations

import base64
import binascii
import secrets
from collections.abc import Sequence
from dataclasses import dataclass

from boresight.console.webhooks import queries as rows
from boresight.console.webhooks.tables import Webhook
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.db.secret_box import SecretBox, is_sealed
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing

PREFIX = "whsec_"
KEY_BYTES = 32


def new_secret() -> str:
    """Return a secret in the form that libraries of Standard Webhooks read."""
    return PREFIX + base64.b64encode(secrets.token_bytes(KEY_BYTES)).decode()


def decode_key(secret: str) -> bytes:
    """Return the key that a secret stands for: the bytes behind the prefix."""
    try:
        return base64.b64decode(secret.removeprefix(PREFIX), validate=True)
    except binascii.Error as error:
        raise ValueError("Expected a secret whsec_<base64> / Received another text") from error


def _standard(secret: str) -> str:
    """Write the key in standard base64, as libraries expect; older versions wrote unpadded URL-safe base64."""
    bare = secret.removeprefix(PREFIX).replace("-", "+").replace("_", "/")
    return PREFIX + bare + "=" * (-len(bare) % 4)


@dataclass(frozen=True)
class SecretStorage:
    """How many secrets of an installation are encrypted, plain or unreadable."""

    encrypted: int
    unreadable: Sequence[str]

    @property
    def sentence(self) -> str | None:
        """Return a sentence on what to do; None when nothing is."""
        if not self.unreadable:
            return None
        return (
            f"The secrets of these webhooks cannot be decrypted with this server's key, so they are paused: "
            f"{', '.join(self.unreadable)}. Copy the key file of the installation that created them, or give each webhook a "
            "new secret and pass it to its receiver."
        )


def encrypt_all(engine: Engine, box: SecretBox) -> SecretStorage:
    """Encrypt every secret that is stored plain, and return how all are stored."""
    with open_reading(engine) as session:
        if not any(not is_sealed(row.secret) for row in rows.list_webhooks(session)):
            return _keep(session, box, 0)
    with open_writing(engine) as session:
        rows.overwrite_what_is_deleted(session)
        plain = [row for row in rows.list_webhooks(session) if not is_sealed(row.secret)]
        for row in plain:
            row.secret = box.seal(_standard(row.secret))
            row.version += 1
            audit.append(session, SYSTEM, "encrypted the secret of", f"webhooks/{row.id}")
        kept = _keep(session, box, len(plain))
    rows.empty_journal(engine)
    return kept


def _keep(session: Session, box: SecretBox, encrypted: int) -> SecretStorage:
    found = rows.list_webhooks(session)
    return SecretStorage(encrypted, [row.label for row in found if box.open(row.secret) is None])


def encrypt_anew(session: Session, box: SecretBox) -> int:
    """Encrypt every readable secret with the newest key; return how many."""
    count = 0
    for row in rows.list_webhooks(session):
        if (renewed := box.renew(row.secret)) is not None:
            row.secret, row.previous_secret, count = renewed, box.renew(row.previous_secret), count + 1
            row.version += 1
            audit.append(session, SYSTEM, "encrypted the secret of", f"webhooks/{row.id}")
    return count


def list_readable_ids(session: Session, box: SecretBox) -> list[int]:
    """Return the enabled webhooks whose secret can be read here."""
    return [row.id for row in rows.list_webhooks(session, enabled_only=True) if box.open(row.secret) is not None]


def get_state(row: Webhook, box: SecretBox) -> str:
    """Return DISABLED, PAUSED where the secret cannot be read here, or ENABLED."""
    if row.disabled_utc is not None:
        return "DISABLED"
    return "ENABLED" if box.open(row.secret) is not None else "PAUSED"
