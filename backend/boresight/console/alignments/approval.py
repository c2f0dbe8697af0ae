"""Requests that an alignment goes on board: opened by one person, signed by another, and then part of uplink packages.

    submit --> OPEN --approve--> APPROVED
                 |---refuse----> REJECTED
                 `---withdraw--> WITHDRAWN

An alignment that its gates block is not submitted: there is no waiver, for it is aligned again in a minute. The signer is an
approver who neither asked for the alignment, nor submitted it, nor launched one of its runs; the password is given again. The
signature is for the result whose SHA-256 the request holds, and an alignment that has ended never changes.
"""

from __future__ import annotations

from boresight.console.access import confirmations
from boresight.console.access.passwords import PasswordProof
from boresight.console.alignments import queries, service
from boresight.console.alignments.tables import Alignment, AlignmentRequest
from boresight.console.approvals.service import Decision
from boresight.console.approvals.signers import (
    CREATOR,
    LAUNCHER,
    SUBMITTER,
    SetPart,
    refuse_own_part,
    refuse_who_never_signs,
)
from boresight.console.runs.tables import Run
from boresight.console.transitions import describe_last_change, move, name_subject, require_seen
from boresight.errors import ConflictError, ForbiddenError, RefusedInputError
from boresight.platform.actors import POLICY, Actor, Policy, require_person, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.audit.subjects import AuditAction
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import refuse_control_characters

LONGEST_REASON = 2000


def submit(session: Session, actor: Actor, blobs: BlobStore, alignment_id: int, reason: str) -> AlignmentRequest:
    """Ask that an alignment go on board with the parameters of its runs."""
    user_id = require_person(actor, "submit an alignment")
    require_role(actor, service.ALIGNER)
    row = session.get_known(Alignment, alignment_id)
    refuse_control_characters(reason=reason)
    if not reason.strip() or len(reason) > LONGEST_REASON:
        raise RefusedInputError(f"Enter the reason for loading it on board, up to {LONGEST_REASON} characters.")
    _, report = service.read_result(session, blobs, alignment_id)
    if report.blocking:
        raise ConflictError(
            f"Alignment {row.id} is blocked by its gate{'s' if len(report.blocking) > 1 else ''} {', '.join(report.blocking)}: "
            "align again with more or better pairs."
        )
    if (known := queries.find_request_in_force(session, row.id)) is not None:
        raise ConflictError(f"Alignment {row.id} already has request {known.id}, which is {known.state}; use that one.")
    request = AlignmentRequest(
        alignment_id=row.id,
        result_sha256=str(row.result_sha256),
        state="OPEN",
        reason=reason.strip(),
        submitted_utc=utc_now(),
        submitted_by=user_id,
    )
    session.put(request)
    told = {"alignment": row.id, "result_sha256": request.result_sha256, "verdict": row.verdict}
    audit.append(session, actor, AuditAction.SUBMITTED, name_subject(request), None, told, request.reason)
    return request


def explain_why_not_sign(
    session: Session, actor: Actor, request: AlignmentRequest, policy: Policy = POLICY
) -> str | None:
    """Say why this actor may not sign a request; None when nothing but a password is missing."""
    try:
        _refuse_signer(session, actor, request, policy)
    except ForbiddenError as refusal:
        return str(refusal)
    return None


def _refuse_signer(session: Session, actor: Actor, request: AlignmentRequest, policy: Policy) -> int:
    user_id = refuse_who_never_signs(session, actor)
    row = session.get_known(Alignment, request.alignment_id)
    runs = [session.get_known(Run, number) for number in (row.run_a_id, row.run_b_id)]
    done = [
        (request.submitted_by, SUBMITTER, "submitted this alignment"),
        (row.created_by, CREATOR, "requested this alignment"),
        *((run.launched_by, LAUNCHER, f"launched run {run.id} that it was computed from") for run in runs),
    ]
    refuse_own_part([SetPart(by, role, deed) for by, role, deed in done if by == user_id] if policy.four_eyes else [])
    return user_id


def sign(
    session: Session,
    actor: Actor,
    request_id: int,
    decided: Decision,
    proof: PasswordProof,
    seen_version: int | None,
    *,
    policy: Policy = POLICY,
) -> AlignmentRequest:
    """Approve or refuse a request, as a second person who gives the password again."""
    request = session.get_known(AlignmentRequest, request_id)
    user_id = _refuse_signer(session, actor, request, policy)
    require_seen(session, request, seen_version)
    decided.check()
    refuse_control_characters(meaning=decided.meaning, comment=decided.comment)
    _refuse_closed(session, request)
    confirmations.require(session, actor, proof)
    request.signed_by, request.printed_name = user_id, actor.printed_name
    request.meaning, request.comment = decided.meaning.strip(), decided.comment.strip()
    request.closed_utc = utc_now()
    reason = f"{request.meaning}: {request.comment}" if request.comment else request.meaning
    state, action = (
        ("APPROVED", AuditAction.APPROVED) if decided.decision == "APPROVE" else ("REJECTED", AuditAction.REFUSED)
    )
    told = {"result_sha256": request.result_sha256, "four_eyes": policy.four_eyes}
    move(session, actor, request, state, action, reason=reason, **told)
    return request


def may_withdraw(actor: Actor, request: AlignmentRequest) -> bool:
    """Whether an open request is the actor's to take back: its submitter, or an administrator."""
    return request.submitted_by == actor.user_id or "administrator" in actor.roles


def withdraw(
    session: Session, actor: Actor, request_id: int, reason: str, seen_version: int | None
) -> AlignmentRequest:
    """Take an open request back: its submitter, or an administrator; one that is approved stays, as decision 113 says."""
    require_person(actor, "withdraw a request")
    require_scope(actor, "runs")
    request = session.get_known(AlignmentRequest, request_id)
    require_seen(session, request, seen_version)
    refuse_control_characters(reason=reason)
    if not may_withdraw(actor, request):
        raise ForbiddenError(
            "Somebody else submitted this request; ask them or an administrator to withdraw it, or an approver to refuse it."
        )
    _refuse_closed(session, request)
    request.closed_utc = utc_now()
    move(session, actor, request, "WITHDRAWN", AuditAction.WITHDRAWN, reason=reason.strip()[:LONGEST_REASON] or None)
    return request


def _refuse_closed(session: Session, request: AlignmentRequest) -> None:
    if request.state != "OPEN":
        raise ConflictError(
            f"Request {request.id} is {request.state}: {describe_last_change(session, request)}. Choose one that is OPEN.",
            code="wrong-state",
        )
