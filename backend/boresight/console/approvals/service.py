"""Requests for approval, and the signatures that decide them.

Four eyes, in the server's transaction: `signers` says who may sign, the password is given again, and what was shown is
bound by its hashes; if one moved, the request is STALE. As many approvals as the request needs approve it, one refusal
blocks, also after an approval, until the set is promoted. A request that its gates stop can be refused, not approved.

Who else gave the password of who signs stands in the signature, as `passwords.password_by` tells it from the audit log.

Over the shoulder a second person signs at the console of another, with name and password: the signature is theirs, the
console's owner stands beside it, and the log-in of the console stays whose it was.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from boresight.console import list_queries as lists
from boresight.console.access import users
from boresight.console.access.passwords import PasswordProof, password_by
from boresight.console.alarms import rules as clock
from boresight.console.approvals import queries as rows
from boresight.console.approvals.discussions import assign, list_openings, list_remarks, record_opening, remark
from boresight.console.approvals.signers import (
    Signer,
    list_signers,
    refuse_signer,
    refuse_who_never_signs,
    second_persons,
)
from boresight.console.approvals.staleness import (
    compute_binding_sha256,
    expire_due_requests,
    is_any_request_due,
    is_expired,
    refuse_blocked,
    refuse_changed_evidence,
    refuse_expired,
)
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.list_queries import Signatory
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.transitions import get_approval, move, require_seen, resting_state, who_changed
from boresight.errors import ConflictError, ForbiddenError, RefusedInputError, StaleError
from boresight.platform.actors import POLICY, Actor, Policy, require_person
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import refuse_control_characters

__all__ = [
    "DECISIONS",
    "assign",
    "compute_binding_sha256",
    "expire_due_requests",
    "get_approval",
    "is_any_request_due",
    "list_approvals",
    "list_openings",
    "list_remarks",
    "list_signatures",
    "newest_open",
    "record_opening",
    "refuse_beside",
    "remark",
    "sign",
    "sign_over_the_shoulder",
    "signatory",
    "who_may_sign",
    "why_not_sign",
]

DECISIONS = ("APPROVE", "REFUSE")


def list_approvals(
    session: Session,
    *,
    state: str | None = None,
    parameter_set_id: int | None = None,
    before_id: int | None = None,
    limit: int | None = None,
) -> Sequence[Approval]:
    """Return a page of requests, newest first; the next page starts before the last one's id."""
    return lists.newest(session, Approval, before_id=before_id, limit=limit, state=state, set=parameter_set_id)


def newest_open(session: Session, sensor_ids: Collection[int]) -> dict[int, int]:
    """Return the number of the newest open request of each of some sensors that has any, by sensor."""
    return rows.newest_open(session, sensor_ids)


def signatory(session: Session, actor: Actor, *, policy: Policy = POLICY) -> Signatory | None:
    """Return who would sign, to narrow the list of requests to those open to them; None where they may sign none at all."""
    try:
        user_id = refuse_who_never_signs(session, actor)
    except ForbiddenError:
        return None
    now_utc = "" if clock.is_held(session) else utc_now()  # before every time there is: nothing has expired
    return Signatory(user_id, now_utc, policy.four_eyes)


def submitters(session: Session, states: Collection[str]) -> frozenset[int]:
    """Return who submitted the requests that are in one of these states."""
    return rows.submitters(session, states)


def list_signatures(session: Session, approval_id: int) -> Sequence[Signature]:
    """Return who signed a request, in order."""
    return rows.signatures(session, approval_id)


def why_not_sign(session: Session, actor: Actor, approval_id: int, *, policy: Policy = POLICY) -> str | None:
    """Say why this actor may not sign a request; None when nothing but a password is missing."""
    approval = get_approval(session, approval_id)
    try:
        _refuse_decided(session, approval, "REFUSE")
        refuse_signer(session, actor, approval, policy)
    except (ForbiddenError, ConflictError, StaleError) as refusal:
        return str(refusal)
    if is_expired(approval) and not clock.is_held(session):
        return f"Request {approval.id} expired at {approval.expires_utc}; the set must be submitted again."
    return None


def who_may_sign(session: Session, approval_id: int, *, policy: Policy = POLICY) -> list[Signer]:
    """Return every approver with whether they may sign a request, and if not, why."""
    return list_signers(session, get_approval(session, approval_id), policy)


def sign(  # noqa: PLR0913 - a signature has that many parts
    session: Session,
    actor: Actor,
    approval_id: int,
    decision: str,
    meaning: str,
    comment: str,
    proof: PasswordProof,
    seen_version: int | None,
    *,
    policy: Policy = POLICY,
) -> Signature:
    """Approve or refuse a request, as a person who gives the password again."""
    approval = get_approval(session, approval_id)
    refuse_signer(session, actor, approval, policy)
    _refuse_undecidable(session, approval, decision, meaning, comment, seen_version)
    users.require_password(session, actor, proof)
    return _sign(session, actor, approval, decision, meaning.strip(), comment.strip(), policy, None)


def sign_over_the_shoulder(  # noqa: PLR0913 - a signature has that many parts, and two persons
    session: Session,
    console: Actor,
    approval_id: int,
    decision: str,
    meaning: str,
    comment: str,
    proof: PasswordProof,
    seen_version: int | None,
    *,
    policy: Policy = POLICY,
) -> Signature:
    """Approve or refuse a request as a second person, at the console where another one is logged in."""
    refuse_beside(session, console, approval_id, decision, meaning, comment, seen_version)
    owner_id = require_person(console, "lend a console")
    approval = get_approval(session, approval_id)
    actor = users.authenticate(session, proof, console.request_id)
    if actor.user_id == owner_id:
        raise ForbiddenError("This is your own console; sign without a name, or have another approver give theirs.")
    refuse_signer(session, actor, approval, policy)
    return _sign(session, actor, approval, decision, meaning.strip(), comment.strip(), policy, console.printed_name)


def refuse_beside(
    session: Session,
    console: Actor,
    approval_id: int,
    decision: str,
    meaning: str,
    comment: str,
    seen_version: int | None,
) -> None:
    """Refuse a signature over the shoulder that nobody's password can make; raises as `sign_over_the_shoulder`.

    All of it can be read by whoever is logged in; about the person who is named nothing is told without the password.
    """
    require_person(console, "lend a console")
    approval = get_approval(session, approval_id)
    _refuse_undecidable(session, approval, decision, meaning, comment, seen_version)


def _refuse_undecidable(
    session: Session, approval: Approval, decision: str, meaning: str, comment: str, seen_version: int | None
) -> None:
    """Refuse a decision on what was not seen as it is, without its words, or on what is decided."""
    require_seen(session, approval, seen_version)
    _refuse_words(decision, meaning, comment)
    _refuse_decided(session, approval, decision)
    refuse_control_characters(meaning=meaning, comment=comment)


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


def _sign(
    session: Session,
    actor: Actor,
    approval: Approval,
    decision: str,
    meaning: str,
    comment: str,
    policy: Policy,
    console: str | None,
) -> Signature:
    """Keep the signature of a person who proved to be one, if the evidence still stands, and decide by it."""
    parameter_set = session.get_one(ParameterSet, approval.parameter_set_id)
    refuse_expired(session, approval, parameter_set)
    refuse_changed_evidence(session, actor, approval, parameter_set)
    if decision == "APPROVE":
        refuse_blocked(session, parameter_set)
    user_id = require_person(actor, "sign")
    signature = Signature(
        approval_id=approval.id,
        user_id=user_id,
        printed_name=actor.printed_name,
        decision=decision,
        meaning=meaning,
        comment=comment,
        shown_sha256=compute_binding_sha256(approval),
        signed_utc=utc_now(),
        console=console,
        password_by=password_by(session, user_id),
    )
    session.add(signature)
    session.flush()
    _decide(session, actor, approval, parameter_set, signature, policy)
    return signature


def _decide(
    session: Session,
    actor: Actor,
    approval: Approval,
    parameter_set: ParameterSet,
    signature: Signature,
    policy: Policy,
) -> None:
    """Bring request and set into the state that the signature gives them."""
    told = {
        "shown_sha256": signature.shown_sha256,
        "console": signature.console,
        "password_by": signature.password_by,
        "four_eyes": policy.four_eyes,
    }
    reason = f"{signature.meaning}: {signature.comment}" if signature.comment else signature.meaning
    if signature.decision == "REFUSE":
        approval.closed_utc = signature.signed_utc
        move(session, actor, approval, "REJECTED", "refused", reason=reason, **told)
        move(session, actor, parameter_set, resting_state(parameter_set, "REJECTED"), "refused", reason=reason)
        return
    signed = len(second_persons(session, approval, policy))
    told["approvals"] = f"{signed} of {approval.needed}"
    if signed < approval.needed:
        move(session, actor, approval, "OPEN", "approved", reason=reason, **told)
        return
    approval.closed_utc = signature.signed_utc
    move(session, actor, approval, "APPROVED", "approved", reason=reason, **told)
    move(session, actor, parameter_set, "APPROVED", "approved", reason=reason)
