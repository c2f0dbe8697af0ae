"""What a webhook's message says and how it is signed.

With the key k, the bytes whose base64 stands behind `whsec_` in a secret, the message's id, the second t at which it is
sent and its body::

    webhook-signature: v1,base64(HMAC-SHA256(k, id "." t "." body))

These are the headers and the scheme of Standard Webhooks, so receivers have libraries that check it; they refuse a t
more than five minutes off, so each attempt is signed anew. While a former secret still holds there is one signature by
each, with a space between them.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
from collections.abc import Sequence

from boresight.services.webhook_secrets import key_of
from boresight.store.tables import AuditRecord


def signature(secrets: Sequence[str], message_id: str, timestamp: int, body: str) -> str:
    """Return the `webhook-signature` of a message sent at a second of Unix time, by each secret that holds."""
    signed = f"{message_id}.{timestamp}.{body}".encode()
    digests = (hmac.new(key_of(secret), signed, hashlib.sha256).digest() for secret in secrets)
    return " ".join(f"v1,{base64.b64encode(digest).decode()}" for digest in digests)


def message_id(delivery_id: int) -> str:
    """Return the id under which a receiver knows a message again."""
    return f"msg_{delivery_id}"


def kind_of(record: AuditRecord) -> str:
    """Name the kind of an audit record: `parameter-sets.promoted`."""
    return f"{record.object.partition('/')[0]}.{'-'.join(record.action.split())}"


def told(record: AuditRecord) -> dict[str, object]:
    """Tell an audit record to programs."""
    return {
        "type": kind_of(record),
        "at_utc": record.at_utc,
        "object": record.object,
        "action": record.action,
        "actor": record.actor,
        "data": {"before": record.before, "after": record.after, "reason": record.reason, "audit_hash": record.hash},
    }
