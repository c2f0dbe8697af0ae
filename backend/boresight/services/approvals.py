"""Requests for approval, and the signatures that decide them.

Four eyes, in the server's transaction: who signs is a person with the role approver who gives the password again, is no
administrator, and neither submitted the set nor launched the run that it comes from. One approval approves, one refusal
blocks, also after an approval, until the set is promoted. What was shown is bound by its hashes: if one moved, the
request is STALE.
"""

from __future__ import annotations

from collections.abc import Sequence

from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError, StaleError
from boresight.services import users
from boresight.services.actors import Actor, require_person, require_role
from boresight.services.staleness import refuse_moved
from boresight.services.transitions import move, require_seen, resting_state, who_changed
from boresight.services.words import refuse_control_characters
from boresight.store import approvals as rows
from boresight.store.documents import sha256_of
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import Approval, ParameterSet, Run, Signature

DECISIONS = ("APPROVE", "REFUSE")


def get_approval(session: Session, approval_id: int) -> Approval:
    """Return a request.

    Raises
    ------
    NotFoundError
        When there is none with this number.
    """
    row = session.get(Approval, approval_id)
    if row is None:
        raise NotFoundError(f"There is no request for approval {approval_id}.")
    return row


def list_approvals(
    session: Session,
    *,
    state: str | None = None,
    parameter_set_id: int | None = None,
    before_id: int | None = None,
    limit: int = 100,
) -> Sequence[Approval]:
    """Return a page of requests, newest first; the next page starts before the last one's id."""
    return rows.approvals(session, state=state, parameter_set_id=parameter_set_id, before_id=before_id, limit=limit)


def signatures_of(session: Session, approval_id: int) -> Sequence[Signature]:
    """Return who signed a request, in order."""
    return rows.signatures(session, approval_id)


def shown_sha256(approval: Approval) -> str:
    """Return the hash of what a signature stands for: the request with the hashes that it binds."""
    return sha256_of(
        {
            "approval": approval.id,
            "parameter_set": approval.parameter_set_id,
            "reason": approval.reason,
            "submitted_by": approval.submitted_by,
            "submitted_utc": approval.submitted_utc,
            "bound": approval.bound,
        }
    )


def why_not_sign(session: Session, actor: Actor, approval_id: int) -> str | None:
    """Say why this actor may not sign a request; None when nothing but a password is missing."""
    approval = get_approval(session, approval_id)
    try:
        _refuse_decided(session, approval, "REFUSE")
        _refuse_signer(session, actor, approval)
    except (ForbiddenError, ConflictError, StaleError) as refusal:
        return str(refusal)
    return None


def sign(
    session: Session,
    actor: Actor,
    approval_id: int,
    decision: str,
    meaning: str,
    comment: str,
    password: str,
    seen_version: int | None,
) -> Signature:
    """Approve or refuse a request, as a person who gives the password again.

    Parameters
    ----------
    decision
        `APPROVE` or `REFUSE`.
    meaning
        What the signature means, in words that are kept with it: "I approve this set for baseline".
    comment
        Needed to refuse.
    seen_version
        Version of the request that the person saw.

    Raises
    ------
    ForbiddenError, UnauthenticatedError, TooManyAttemptsError
        When this person may not sign, or the password is wrong.
    RefusedInputError
        When decision, meaning or comment is missing.
    PreconditionRequiredError, ConflictError
        When no version was given, or the request is decided.
    StaleError
        When the version, or what the request is bound to, has moved; then it is STALE from now on.
    """
    approval = get_approval(session, approval_id)
    _refuse_signer(session, actor, approval)
    require_seen(session, approval, seen_version)
    _refuse_words(decision, meaning, comment)
    _refuse_decided(session, approval, decision)
    refuse_control_characters(meaning=meaning, comment=comment)
    users.verify_password(session, actor, password)
    parameter_set = session.get_one(ParameterSet, approval.parameter_set_id)
    refuse_moved(session, actor, approval, parameter_set)
    signature = _add_signature(session, actor, approval, decision, meaning.strip(), comment.strip())
    _decide(session, actor, approval, parameter_set, signature)
    return signature


def _refuse_signer(session: Session, actor: Actor, approval: Approval) -> None:
    """Refuse whoever is not a second person, with the reason."""
    user_id = require_person(actor, "sign")
    if "administrator" in actor.roles:
        raise ForbiddenError("An administrator cannot sign; an approver who is no administrator must.")
    require_role(actor, "approver")
    parameter_set = session.get_one(ParameterSet, approval.parameter_set_id)
    if user_id == approval.submitted_by:
        raise ForbiddenError("You submitted this set; another approver must sign.")
    run = None if parameter_set.run_id is None else session.get(Run, parameter_set.run_id)
    if run is not None and user_id == run.launched_by:
        raise ForbiddenError(f"You launched run {run.id}, which this set comes from; another approver must sign.")
    if (earlier := rows.signature_of(session, approval.id, user_id)) is not None:
        raise ConflictError(f"You signed this request already, at {earlier.signed_utc}; its submitter can withdraw it.")


def _refuse_words(decision: str, meaning: str, comment: str) -> None:
    """Refuse a signature that does not say what it means."""
    if decision not in DECISIONS:
        raise RefusedInputError(f"The decision is APPROVE or REFUSE, not {decision!r}.")
    if not meaning.strip():
        raise RefusedInputError("Say what your signature means, such as: I approve this set for baseline.")
    if decision == "REFUSE" and not comment.strip():
        raise RefusedInputError("Say why you refuse: the comment is what the submitter learns from.")


def _refuse_decided(session: Session, approval: Approval, decision: str) -> None:
    """Refuse to decide what is decided; only a refusal still stops what was approved and not yet promoted."""
    if approval.state == "STALE":
        raise StaleError(
            f"Request {approval.id} is STALE: {who_changed(session, approval)}. The set must be submitted again."
        )
    parameter_set = session.get_one(ParameterSet, approval.parameter_set_id)
    can_block = approval.state == "APPROVED" and parameter_set.ground_state == "APPROVED"
    if approval.state != "OPEN" and not (decision == "REFUSE" and can_block):
        raise ConflictError(f"Request {approval.id} is {approval.state}: {who_changed(session, approval)}.")


def _add_signature(
    session: Session, actor: Actor, approval: Approval, decision: str, meaning: str, comment: str
) -> Signature:
    """Keep the signature with the hash of what was shown."""
    signature = Signature(
        approval_id=approval.id,
        user_id=require_person(actor, "sign"),
        printed_name=actor.printed_name,
        decision=decision,
        meaning=meaning,
        comment=comment,
        shown_sha256=shown_sha256(approval),
        signed_utc=utc_now(),
    )
    session.add(signature)
    session.flush()
    return signature


def _decide(
    session: Session, actor: Actor, approval: Approval, parameter_set: ParameterSet, signature: Signature
) -> None:
    """Bring request and set into the state that the signature gives them."""
    approved = signature.decision == "APPROVE"
    action = "approved" if approved else "refused"
    approval.closed_utc = signature.signed_utc
    reason = f"{signature.meaning}: {signature.comment}" if signature.comment else signature.meaning
    move(session, actor, approval, "APPROVED" if approved else "REJECTED", action, reason=reason)
    state = "APPROVED" if approved else resting_state(parameter_set, "REJECTED")
    move(session, actor, parameter_set, state, action, reason=reason)
