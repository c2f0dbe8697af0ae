"""API keys: how programs act for a person, within the scopes that the person gave.

A secret is `bs_<prefix>_<random>`. It is shown once and kept as SHA-256, which is enough for 256 random bits: a slow
hash protects what can be guessed. A key never has more roles than its owner has now, and never signs.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Collection, Mapping, Sequence

from boresight.console.access import queries as rows
from boresight.console.access.tables import ApiKey, User
from boresight.errors import ForbiddenError, RefusedInputError, UnauthenticatedError
from boresight.platform.actors import KEY, SCOPES, Actor, refuse_key, require_person
from boresight.platform.audit import log as audit
from boresight.platform.audit.security_log import note
from boresight.platform.db.sessions import Session, utc_after, utc_now
from boresight.platform.web.text_validation import refuse_control_characters

SECONDS_PER_DAY = 86400.0
LONGEST_DAYS = 3650


def create_key(
    session: Session, actor: Actor, *, label: str, scopes: Collection[str] = (), expires_days: int | None = 90
) -> tuple[ApiKey, str]:
    """Make a key for the person who asks; without scopes it can only read."""
    user_id = require_person(actor, "make an API key")
    if unknown := sorted(set(scopes) - set(SCOPES)):
        raise RefusedInputError(f"There is no scope {', '.join(unknown)}; choose from {', '.join(SCOPES)}.")
    refuse_control_characters(label=label)
    if not label.strip():
        raise RefusedInputError("The key has no label; give one that says which program uses it.")
    if expires_days is not None and not 1 <= expires_days <= LONGEST_DAYS:
        raise RefusedInputError(f"A key cannot be valid for {expires_days} days; give 1 to {LONGEST_DAYS}.")
    prefix, random = secrets.token_hex(4), secrets.token_urlsafe(32)
    secret = f"bs_{prefix}_{random}"
    key = ApiKey(
        user_id=user_id,
        label=label.strip(),
        prefix=prefix,
        key_hash=_hash(secret),
        scopes=sorted(set(scopes)),
        created_utc=utc_now(),
        expires_utc=None if expires_days is None else utc_after(expires_days * SECONDS_PER_DAY),
    )
    session.put(key)
    audit.append(session, actor, "created", _subject(key), None, {"label": key.label, "scopes": key.scopes})
    told = {"key": key.prefix, "scopes": key.scopes, "expires_utc": key.expires_utc}
    note(session, "authn_token_created", actor, **told)
    return key, secret


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()


def find_actor_of_key(session: Session, secret: str, request_id: str | None = None) -> Actor:
    """Return whom a secret lets act; a reading transaction is enough."""
    parts = secret.split("_", 2)
    key = rows.find_key_by_prefix(session, parts[1]) if len(parts) == 3 else None
    if key is None or not hmac.compare_digest(key.key_hash, _hash(secret)):
        raise UnauthenticatedError("Unknown API key; check that it was copied completely.")
    if key.revoked_utc is not None:
        raise UnauthenticatedError(f"The API key {key.label!r} was revoked; make another one.")
    if key.expires_utc is not None and key.expires_utc <= utc_now():
        raise UnauthenticatedError(f"The API key {key.label!r} expired at {key.expires_utc}; make another one.")
    user = session.get(User, key.user_id)
    if user is None or user.disabled_utc is not None:
        raise UnauthenticatedError(f"The owner of the API key {key.label!r} is disabled; ask an administrator.")
    roles, scopes = frozenset(user.roles), frozenset(key.scopes)
    credential = f"{KEY}{key.prefix}"
    return Actor(user.id, user.name, user.printed_name, roles, credential, scopes, request_id, key.expires_utc)


def list_keys(session: Session, user_id: int | None = None) -> Sequence[ApiKey]:
    """Return a person's keys, or everyone's, newest first."""
    return rows.list_keys(session, user_id)


def record_uses(session: Session, used_utc: Mapping[str, str]) -> None:
    """Write when keys were last used, by prefix; not a change that anybody made, so not in the audit log."""
    for prefix, at_utc in used_utc.items():
        key = rows.find_key_by_prefix(session, prefix)
        if key is not None and at_utc > (key.last_used_utc or ""):
            key.last_used_utc = at_utc


def revoke_key(session: Session, actor: Actor, key_id: int) -> ApiKey:
    """End a key: one's own, or as an administrator anyone's."""
    refuse_key(actor, "revoke a key")
    key = session.get_known(ApiKey, key_id)
    if key.user_id != actor.user_id and "administrator" not in actor.roles:
        raise ForbiddenError(
            "Only its owner or an administrator may revoke this API key; ask one of them.", code="not-the-owner"
        )
    if key.revoked_utc is None:
        key.revoked_utc = utc_now()
        audit.append(
            session, actor, "revoked", _subject(key), {"revoked": False}, {"revoked": True, "label": key.label}
        )
        note(session, "authn_token_revoked", actor, key=key.prefix)
    return key


def _subject(key: ApiKey) -> str:
    return f"api-keys/{key.id}"
