"""The discussion of a request: assignment, remarks, opened evidence.

Nothing here decides. Remarks and openings are only ever added. Which evidence a person opened is shown beside their
signature and not enforced: a click proves no reading.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from boresight.console.access.tables import User
from boresight.console.approvals import queries as rows
from boresight.console.approvals.signers import list_signers
from boresight.console.approvals.tables import Approval, Opening, Remark
from boresight.console.transitions import get_approval, move, name_subject, require_seen, who_changed
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.platform.actors import POLICY, Actor, Policy, require_person, require_role
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import refuse_control_characters

LONGEST_REMARK = 4000
EVIDENCE = re.compile(r"[a-z0-9][a-z0-9-]{0,63}")


def assign(
    session: Session,
    actor: Actor,
    approval_id: int,
    user_id: int | None,
    seen_version: int | None,
    *,
    policy: Policy = POLICY,
) -> Approval:
    """Ask a person to decide on an open request; None asks nobody in particular again."""
    require_person(actor, "assign a request")
    require_role(actor, "analyst", "operator", "approver", "administrator")
    approval = get_approval(session, approval_id)
    require_seen(session, approval, seen_version)
    if approval.state != "OPEN":
        raise ConflictError(f"Request {approval.id} is {approval.state}: {who_changed(session, approval)}.")
    named = None if user_id is None else _signer(session, approval, user_id, policy)
    approval.assigned_to = None if named is None else named.id
    asked = "nobody in particular" if named is None else named.printed_name
    move(session, actor, approval, "OPEN", "assigned", assigned_to=asked)
    return approval


def _signer(session: Session, approval: Approval, user_id: int, policy: Policy) -> User:
    """Return a person who may sign a request."""
    user = session.get(User, user_id)
    if user is None:
        raise NotFoundError(f"There is no user {user_id}.")
    if user.disabled_utc is not None:
        raise ConflictError(f"{user.printed_name} is disabled; ask another approver.")
    found = next((one for one in list_signers(session, approval, policy) if one.user.id == user_id), None)
    if found is None:
        raise ConflictError(
            f"{user.printed_name} cannot sign this request, having no role approver; ask another person."
        )
    if found.refusal is not None:
        raise ConflictError(f"{found.refusal} Ask another approver.")
    return user


def remark(session: Session, actor: Actor, approval_id: int, text: str) -> Remark:
    """Say something about a request, be it decided or not."""
    user_id = require_person(actor, "discuss a request")
    require_role(actor, "analyst", "operator", "approver", "administrator")
    approval = get_approval(session, approval_id)
    refuse_control_characters(remark=text)
    if not text.strip() or len(text) > LONGEST_REMARK:
        raise RefusedInputError(f"A remark has 1 to {LONGEST_REMARK} characters; this one has {len(text.strip())}.")
    row = Remark(
        approval_id=approval.id,
        user_id=user_id,
        printed_name=actor.printed_name,
        text=text.strip(),
        made_utc=utc_now(),
    )
    session.add(row)
    session.flush()
    audit.append(session, actor, "remarked", f"{name_subject(approval)}/remarks/{row.id}", None, {"text": row.text})
    return row


def list_remarks(session: Session, approval_id: int) -> Sequence[Remark]:
    """Return what was said about a request, in order."""
    return rows.remarks(session, get_approval(session, approval_id).id)


def record_opening(session: Session, actor: Actor, approval_id: int, evidence: str) -> Opening:
    """Keep that a person opened a piece of a request's evidence; only the first time counts."""
    user_id = require_person(actor, "open evidence")
    approval = get_approval(session, approval_id)
    if not EVIDENCE.fullmatch(evidence):
        raise RefusedInputError("Name the evidence in small letters, digits and -, such as gate-report or radial.")
    if (known := rows.find_opening(session, approval.id, user_id, evidence)) is not None:
        return known
    row = Opening(approval_id=approval.id, user_id=user_id, evidence=evidence, opened_utc=utc_now())
    session.add(row)
    session.flush()
    return row


def list_openings(session: Session, approval_id: int) -> Sequence[Opening]:
    """Return who opened which evidence of a request, in order."""
    return rows.openings(session, get_approval(session, approval_id).id)
