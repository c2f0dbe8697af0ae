"""Changes that wait for a second person: how they are read, closed, and go stale. `second_person` makes and confirms them.

A proposal binds the version in force that it was made against::

    OPEN --another confirms--> CONFIRMED   --another refuses--> REFUSED   --who proposed takes it back--> WITHDRAWN
    OPEN --another version came into force--> STALE                       --its time is over--> EXPIRED
"""

from __future__ import annotations

from collections.abc import Sequence

from boresight.console import list_queries as lists
from boresight.console.alarms import rules as alarm_rules
from boresight.console.approvals import queries as rows
from boresight.console.approvals.tables import PROPOSAL_KINDS, PROPOSAL_STATES, ChangeProposal
from boresight.console.transitions import describe_last_change, move, require_seen
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.actors import SYSTEM, Actor, require_role, require_scope
from boresight.platform.db.sessions import Session, keep_despite_refusal, utc_now
from boresight.platform.web.text_validation import refuse_control_characters

MAY_CONFIRM = {"gate-profile": ("administrator",), "table-definition": ("analyst", "administrator")}
TITLES = {"gate-profile": "gate limits", "table-definition": "table layout"}


def list_proposals(
    session: Session,
    *,
    sensor_id: int | None = None,
    kind: str | None = None,
    state: str | None = None,
    before_id: int | None = None,
    limit: int | None = None,
) -> Sequence[ChangeProposal]:
    """Return proposals, newest first: all, or a page, the next of which starts before the last one's id."""
    for asked, known in ((kind, PROPOSAL_KINDS), (state, PROPOSAL_STATES)):
        if asked is not None and asked not in known:
            raise RefusedInputError(f"{asked!r} is none of {', '.join(known)}.")
    return lists.list_newest(
        session, ChangeProposal, before_id=before_id, limit=limit, sensor=sensor_id, kind=kind, state=state
    )


def list_open_proposals(
    session: Session, sensor_id: int | None = None, kind: str | None = None
) -> Sequence[ChangeProposal]:
    """Return every proposal that waits, of a sensor or of all, newest first."""
    return lists.list_newest(session, ChangeProposal, sensor=sensor_id, kind=kind, state="OPEN")


def list_confirmed_by_number(session: Session, sensor_id: int, kind: str) -> dict[int, ChangeProposal]:
    """Return the proposals that came into force, by the number of the version that they became."""
    found = lists.list_newest(session, ChangeProposal, sensor=sensor_id, kind=kind, state="CONFIRMED")
    return {row.number: row for row in found if row.number is not None}


def withdraw(session: Session, actor: Actor, proposal_id: int, seen_version: int | None) -> ChangeProposal:
    """Take a proposal back: who made it, or an administrator."""
    require_scope(actor, "sensors")
    row = session.get_known(ChangeProposal, proposal_id)
    if actor.user_id != row.proposed_by:
        require_role(actor, "administrator")
    require_seen(session, row, seen_version)
    require_open(session, row)
    close(session, actor, row, "WITHDRAWN", "withdrew")
    return row


def explain_closed(session: Session, row: ChangeProposal) -> str | None:
    """Say why nobody can decide on a proposal any more; None while somebody can."""
    if row.state != "OPEN":
        return f"Proposal {row.id} is {row.state}: {describe_last_change(session, row)}. Propose the change anew."
    if row.expires_utc <= utc_now() and not alarm_rules.is_held(session):
        return f"Proposal {row.id} expired at {row.expires_utc}. Propose the change anew."
    return None


def require_open(session: Session, row: ChangeProposal) -> None:
    """Refuse to decide on a proposal that is decided; one whose time is over becomes EXPIRED."""
    why = explain_closed(session, row)
    if why is None:
        return
    if row.state == "OPEN":
        _expire(session, row)
        keep_despite_refusal(session)
    raise ConflictError(why)


def close(
    session: Session,
    actor: Actor,
    row: ChangeProposal,
    state: str,
    action: str,
    *,
    comment: str = "",
    reason: str | None = None,
    password_by: str | None = None,
) -> None:
    """Bring a proposal into its last state, with its audit record."""
    refuse_control_characters(comment=comment)
    row.closed_utc, row.closed_by, row.comment = utc_now(), actor.user_id, comment.strip() or None
    told = {"kind": row.kind, "sensor": f"sensors/{row.sensor_id}", "sha256": row.sha256, "number": row.number}
    told |= {} if password_by is None else {"password_by": password_by}
    move(session, actor, row, state, action, reason=reason or row.comment, **told)


def make_stale(session: Session, actor: Actor, sensor_id: int, kind: str, number: int) -> None:
    """Close every proposal that was made against a version which is in force no more."""
    for row in list_open_proposals(session, sensor_id, kind):
        if row.base_number != number:
            close(session, actor, row, "STALE", "made stale", reason=f"version {number} came into force")


def is_any_due(session: Session) -> bool:
    """Whether any open proposal has expired."""
    return bool(rows.list_due_proposals(session, utc_now())) and not alarm_rules.is_held(session)


def expire_due(session: Session) -> Sequence[ChangeProposal]:
    """Close every proposal whose time is over, and return them."""
    found = () if alarm_rules.is_held(session) else rows.list_due_proposals(session, utc_now())
    for row in found:
        _expire(session, row)
    return found


def _expire(session: Session, row: ChangeProposal) -> None:
    close(session, SYSTEM, row, "EXPIRED", "let expire", reason=f"nobody decided on it before {row.expires_utc}")
