"""Log-ins: each is a row, so that a person sees their own and ends any of them, and a copied cookie ends with it.

The row keeps the SHA-256 of the cookie's random secret. A log-in ends by log-out, from the list, with a changed
password or roles, when the person is disabled, unused for `session_idle_minutes`, and at the latest after
`session_hours`.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Sequence
from dataclasses import dataclass

from boresight.console import list_queries as lists
from boresight.console.access import queries as rows
from boresight.console.access.log_in_attempts import name_network
from boresight.console.access.second_factors import FORGET_S
from boresight.console.access.tables import LoginSession
from boresight.errors import ForbiddenError, NotFoundError, SessionEndedError, UnauthenticatedError
from boresight.platform.actors import SYSTEM, Actor, SessionLimits, refuse_key, require_person
from boresight.platform.audit import log as audit
from boresight.platform.audit.security_log import note
from boresight.platform.db.sessions import Session, utc_after, utc_now

KEPT_FOR_S = 90 * 24 * 3600.0
CONFIRMED_FOR_S = 300.0
LONGEST_ADDRESS, LONGEST_USER_AGENT = 64, 200


@dataclass(frozen=True)
class ClientAddress:
    """Where a log-in is made: the client's address and user agent, printable and shortened."""

    address: str = ""
    user_agent: str = ""

    @classmethod
    def of(cls, address: str | None, user_agent: str | None) -> ClientAddress:
        """Read both from a request."""
        return cls(_printable(address, LONGEST_ADDRESS), _printable(user_agent, LONGEST_USER_AGENT))


def _printable(text: str | None, longest: int) -> str:
    return "".join(letter for letter in (text or "")[:longest] if letter.isprintable())


def begin(
    session: Session, user_id: int, client: ClientAddress, method: str = "password", factor_kind: str | None = None
) -> tuple[LoginSession, str]:
    """Begin a log-in of an authenticated person; returns the row and the secret for the cookie, which is always new."""
    token, now = secrets.token_urlsafe(32), utc_now()
    row = LoginSession(
        user_id=user_id,
        token_hash=_hash(token),
        created_utc=now,
        last_used_utc=now,
        address=client.address,
        user_agent=client.user_agent,
        method=method,
        factor_kind=factor_kind,
    )
    session.put(row)
    return row, token


def confirm(session: Session, actor: Actor) -> None:
    """Record that the provider confirmed the acting person again, for one act soon."""
    row = _current(session, actor)
    if row is not None:
        row.confirmed_utc = utc_now()
        note(session, "authn_confirm_success", actor, log_in=row.id)


def is_confirmed(session: Session, actor: Actor) -> bool:
    """Whether the provider confirmed the acting person a short time ago, and nothing was done with it."""
    row = _current(session, actor)
    return row is not None and (row.confirmed_utc or "") > utc_after(-CONFIRMED_FOR_S)


def use_confirmation(session: Session, actor: Actor) -> bool:
    """Use the provider's confirmation, which is good for one act; returns whether there was one."""
    confirmed, row = is_confirmed(session, actor), _current(session, actor)
    if row is not None:
        row.confirmed_utc = None
    return confirmed


def _current(session: Session, actor: Actor) -> LoginSession | None:
    return None if actor.session_id is None else session.get(LoginSession, actor.session_id)


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()


def has_logged_in_from(session: Session, user_id: int | None, place: str) -> bool:
    """Whether a person logged in from a place, as `name_network` names it, as far back as log-ins are kept."""
    return user_id is not None and any(name_network(one) == place for one in rows.list_addresses(session, user_id))


def find(session: Session, token: str) -> LoginSession:
    """Return the log-in of a secret."""
    row = rows.find_log_in(session, _hash(token))
    if row is None:
        raise UnauthenticatedError("This log-in is not known to this server; log in again.")
    if row.ended_because is not None:
        raise SessionEndedError(row.ended_because)
    return row


def list_sessions(
    session: Session,
    actor: Actor,
    user_id: int | None = None,
    *,
    is_open: bool | None = None,
    before_id: int | None = None,
    limit: int | None = None,
) -> Sequence[LoginSession]:
    """Return log-ins, newest first, all or a page: one's own, or as an administrator another person's."""
    own_id = require_person(actor, "see log-ins")
    if user_id not in {None, own_id}:
        _require_administrator(actor)
    return lists.list_newest(
        session, LoginSession, before_id=before_id, limit=limit, user=user_id or own_id, open=is_open
    )


def end_session(session: Session, actor: Actor, session_id: int) -> LoginSession:
    """End one log-in: one's own, or as an administrator another's. One that has ended stays as it ended."""
    own_id = require_person(actor, "end a log-in")
    row = session.get(LoginSession, session_id)
    own = row is not None and row.user_id == own_id
    if row is None or not (own or "administrator" in actor.roles):
        raise NotFoundError(f"There is no log-in {session_id} of yours; choose one from the list.")
    if row.ended_utc is None:
        row.ended_utc, row.ended_because = utc_now(), "ended" if own else "ended_by_administrator"
        audit.append(session, actor, "ended a log-in of", f"users/{row.user_id}", None, {"log_in": row.id})
        note(session, "session_ended", actor, user=row.user_id, reason=row.ended_because, log_ins=1, log_in=row.id)
    return row


def end_other_sessions(session: Session, actor: Actor) -> int:
    """End every log-in of the acting person except the current one; returns how many were ended."""
    user_id = require_person(actor, "end log-ins")
    count = rows.end_open_log_ins(session, user_id, utc_now(), "ended", spare_id=actor.session_id)
    if count:
        audit.append(session, actor, "ended the other log-ins of", f"users/{user_id}", None, {"log_ins": count})
        note(session, "session_ended", actor, user=actor.name, reason="ended", log_ins=count)
    return count


def log_out(session: Session, actor: Actor) -> None:
    """End the current log-in."""
    refuse_key(actor, "log out")
    row = _current(session, actor)
    if row is not None and row.ended_utc is None:
        row.ended_utc, row.ended_because = utc_now(), "logged_out"
        note(session, "session_ended", actor, user=actor.name, reason="logged_out", log_ins=1, log_in=row.id)


def write_uses(session: Session, used_utc: dict[int, str]) -> None:
    """Write when log-ins were last used; not a change that anybody made, so not in the audit log."""
    rows.write_uses(session, used_utc)


def need_tidying(session: Session, limits: SessionLimits, grace_s: float) -> bool:
    """Whether `tidy` would write anything."""
    return (
        rows.has_lapsed(session, **_bounds(limits, grace_s))
        or rows.has_ended_before(session, utc_after(-KEPT_FOR_S))
        or rows.has_old_challenge(session, utc_after(-FORGET_S))
    )


def tidy(session: Session, limits: SessionLimits, grace_s: float) -> None:
    """Write the end of the log-ins that lapsed, and forget those that ended long ago and what waited for a second factor."""
    oldest = _bounds(limits, grace_s)["created_before_utc"]
    for log_in, user_id, created_utc in rows.list_lapsed_log_ins(session, **_bounds(limits, grace_s)):
        reason = "expired" if created_utc < oldest else "idle"
        note(session, "session_ended", SYSTEM, user=user_id, reason=reason, log_ins=1, log_in=log_in)
    rows.forget_challenges(session, utc_after(-FORGET_S))
    rows.end_lapsed_log_ins(session, utc_now(), **_bounds(limits, grace_s))
    rows.forget_ended_log_ins(session, utc_after(-KEPT_FOR_S))


def _bounds(limits: SessionLimits, grace_s: float) -> dict[str, str]:
    """Return the times before which a log-in that was made, or last used, has lapsed."""
    used_before = utc_after(-limits.idle_s - grace_s) if limits.idle_s else ""
    return {"created_before_utc": utc_after(-limits.age_s), "used_before_utc": used_before}


def _require_administrator(actor: Actor) -> None:
    if "administrator" not in actor.roles:
        raise ForbiddenError(
            "Only the person themselves or an administrator may see these log-ins; ask an administrator."
        )
