"""Requests for approval: opened and taken back, discussed, signed by two pairs of eyes, and met by a promotion.

The password is given again, and what was shown is bound by its hashes; if one moved, the request is STALE. One refusal
blocks until the set is promoted. A promotion counts the signatures again, by the policy that holds now, so that what
was signed while four-eyes was off does not pass once it is on. A request for a set that was baseline once is a
roll-back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from boresight.console.access import confirmations
from boresight.console.access.passwords import PasswordProof, name_password_setter
from boresight.console.access.second_factors import NO_FACTOR, GivenFactor
from boresight.console.access.tables import User
from boresight.console.alarms import rules as alarm_rules
from boresight.console.alarms.rules import update_alarms
from boresight.console.approvals import gates
from boresight.console.approvals import queries as rows
from boresight.console.approvals.gates import GateAssessment
from boresight.console.approvals.review import (
    EVIDENCE,
    Acknowledgement,
    Point,
    answer_points,
    list_points,
    read_points,
    refuse_open_points,
    write_points,
)
from boresight.console.approvals.signers import (
    Signer,
    list_second_persons,
    list_signers,
    refuse_signer,
    refuse_who_never_signs,
)
from boresight.console.approvals.staleness import (
    compute_binding,
    compute_binding_sha256,
    explain_outdated,
    is_expired,
    make_others_stale,
    refuse_blocked,
    refuse_changed_binding,
    refuse_expired,
)
from boresight.console.approvals.tables import Approval, FigureDelivery, Opening, Remark, Signature
from boresight.console.list_queries import Signatory
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.parameter_sets.service import record_promotion
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.transitions import (
    describe_last_change,
    move,
    name_subject,
    require_seen,
    resting_state,
)
from boresight.errors import ConflictError, ForbiddenError, RefusedInputError, StaleError
from boresight.platform.actors import (
    DAY_S,
    POLICY,
    Actor,
    Policy,
    require_person,
    require_role,
    require_scope,
    require_user,
)
from boresight.platform.audit import log as audit
from boresight.platform.audit.subjects import AuditAction
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session, utc_after, utc_now
from boresight.platform.db.times import seconds_between
from boresight.platform.web.text_validation import refuse_control_characters

DECISIONS = ("APPROVE", "REFUSE")
MEANINGS = {
    "APPROVE": "I reviewed the evidence and approve this set for baseline",
    "REFUSE": "I refuse this set",
}
SHOWN_S = 1.0  # how long a figure stands in sight before it counts as opened


@dataclass(frozen=True)
class Decision:
    """What a person signs: for or against, what the signature means, and why."""

    decision: str
    meaning: str
    comment: str = ""
    acknowledged: Sequence[Acknowledgement] | None = None  # None: by a client that was not asked for points
    says_itself: bool = False  # the meaning is what was decided, with the figures that were not opened

    def check(self) -> None:
        """Check that the decision is complete."""
        if self.decision not in DECISIONS:
            raise RefusedInputError(f"There is no decision {self.decision!r}; choose APPROVE or REFUSE.")
        if not self.meaning.strip() and not self.says_itself:
            raise RefusedInputError("Say what your signature means, for example: I approve this set for baseline.")
        if self.decision == "REFUSE" and not self.comment.strip():
            raise RefusedInputError("Say why you refuse: the submitter needs the comment.")


def write_meaning(decided: Decision, points: Sequence[Point] | None) -> str:
    """Say what a signature means, in the signer's words if there are any; an approval names the figures that were not opened."""
    if not decided.says_itself:
        return decided.meaning.strip()
    unseen = [point.title for point in points or () if point.kind == EVIDENCE and point.opened_utc is None]
    if decided.decision == "APPROVE" and unseen:
        return f"I approve this set for baseline without having opened {', '.join(unseen)}"
    if decided.decision == "APPROVE" and not any(point.kind == EVIDENCE for point in points or ()):
        return "I approve this set for baseline"
    return MEANINGS[decided.decision]


def find_signatory(session: Session, actor: Actor, *, policy: Policy = POLICY) -> Signatory | None:
    """Return the actor as signatory, to filter requests by who may sign; None where the actor may never sign."""
    try:
        user_id = refuse_who_never_signs(session, actor)
    except ForbiddenError:
        return None
    now_utc = "" if alarm_rules.is_held(session) else utc_now()  # earlier than any time: nothing has expired
    return Signatory(user_id, now_utc, policy.four_eyes)


def explain_why_not_sign(session: Session, actor: Actor, approval_id: int, *, policy: Policy = POLICY) -> str | None:
    """Say why this actor may not sign a request; None when nothing but a password is missing."""
    approval = session.get_known(Approval, approval_id)
    try:
        _refuse_decided(session, approval, "REFUSE")
        refuse_signer(session, actor, approval, policy)
    except (ForbiddenError, ConflictError, StaleError) as refusal:
        return str(refusal)
    if is_expired(approval) and not alarm_rules.is_held(session):
        return f"Request {approval.id} expired at {approval.expires_utc}; the set must be submitted again."
    return None


def list_request_signers(session: Session, approval_id: int, *, policy: Policy = POLICY) -> list[Signer]:
    """Return every approver with whether they may sign a request, and if not, why."""
    return list_signers(session, session.get_known(Approval, approval_id), policy)


def sign(
    session: Session,
    actor: Actor,
    approval_id: int,
    decided: Decision,
    proof: PasswordProof,
    seen_version: int | None,
    *,
    policy: Policy = POLICY,
) -> Signature:
    """Approve or refuse a request, as a person who gives the password again."""
    approval = session.get_known(Approval, approval_id)
    refuse_signer(session, actor, approval, policy)
    _refuse_undecidable(session, approval, decided, seen_version)
    confirmations.require(session, actor, proof)
    return _sign(session, actor, approval, decided, policy)


def sign_over_the_shoulder(
    session: Session,
    console: Actor,
    approval_id: int,
    decided: Decision,
    proof: PasswordProof,
    seen_version: int | None,
    *,
    policy: Policy = POLICY,
) -> Signature:
    """Approve or refuse a request as a second person, at the console where another one is logged in."""
    refuse_beside(session, console, approval_id, decided, seen_version)
    owner_id = require_person(console, "let another person sign at your console")
    approval = session.get_known(Approval, approval_id)
    actor = confirmations.authenticate_beside(session, proof, console.request_id)
    if actor.user_id == owner_id:
        raise ForbiddenError(
            "This is your own console: leave the name empty to sign yourself, or have another approver enter their name."
        )
    refuse_signer(session, actor, approval, policy)
    return _sign(session, actor, approval, decided, policy, console)


def refuse_beside(
    session: Session, console: Actor, approval_id: int, decided: Decision, seen_version: int | None
) -> None:
    """Refuse a signature over the shoulder that no password would make valid, as `sign_over_the_shoulder` would.

    It uses only what every logged-in person can read, and reveals nothing about the named person.
    """
    require_person(console, "let another person sign at your console")
    approval = session.get_known(Approval, approval_id)
    _refuse_undecidable(session, approval, decided, seen_version)


def _refuse_undecidable(session: Session, approval: Approval, decided: Decision, seen_version: int | None) -> None:
    """Refuse a decision on an outdated version, one that is incomplete, or one on a request that is decided."""
    require_seen(session, approval, seen_version)
    decided.check()
    _refuse_decided(session, approval, decided.decision)
    refuse_control_characters(meaning=decided.meaning, comment=decided.comment)


def _refuse_decided(session: Session, approval: Approval, decision: str) -> None:
    """Refuse to decide on a decided request, except to reject one that is approved and not yet promoted."""
    if approval.state == "STALE":
        raise StaleError(
            f"Request {approval.id} is STALE: {describe_last_change(session, approval)}. Submit the set again.",
            code="request-stale",
        )
    parameter_set = session.get_one(ParameterSet, approval.parameter_set_id)
    can_block = approval.state == "APPROVED" and parameter_set.ground_state == "APPROVED"
    if approval.state != "OPEN" and not (decision == "REFUSE" and can_block):
        raise ConflictError(
            f"Request {approval.id} is {approval.state}: {describe_last_change(session, approval)}. Choose one that is OPEN.",
            code="wrong-state",
        )


def _sign(
    session: Session,
    actor: Actor,
    approval: Approval,
    decided: Decision,
    policy: Policy,
    console: Actor | None = None,
) -> Signature:
    parameter_set = session.get_one(ParameterSet, approval.parameter_set_id)
    refuse_expired(session, approval, parameter_set)
    refuse_changed_binding(session, actor, approval, parameter_set)
    user_id = require_person(actor, "sign")
    points = None
    if decided.decision == "APPROVE":
        refuse_blocked(session, parameter_set)
        points = answer_points(list_points(session, approval, user_id), decided.acknowledged or ())
        if policy.rest_review or decided.acknowledged is not None:
            refuse_open_points(points)
    signature = Signature(
        approval_id=approval.id,
        user_id=user_id,
        printed_name=actor.printed_name,
        decision=decided.decision,
        meaning=write_meaning(decided, points),
        comment=decided.comment.strip(),
        shown_sha256=compute_binding_sha256(approval),
        signed_utc=utc_now(),
        console=None if console is None else console.printed_name,
        password_by=name_password_setter(session, user_id),
        points=None if points is None else write_points(points),
    )
    session.put(signature)
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
    told: dict[str, Any] = {
        "shown_sha256": signature.shown_sha256,
        "console": signature.console,
        "password_by": signature.password_by,
        "four_eyes": policy.four_eyes,
    }
    told |= {f"point {point.kind} {point.name}": point.answer for point in read_points(signature.points)}
    reason = f"{signature.meaning}: {signature.comment}" if signature.comment else signature.meaning
    if signature.decision == "REFUSE":
        approval.closed_utc = signature.signed_utc
        move(session, actor, approval, "REJECTED", AuditAction.REFUSED, reason=reason, **told)
        move(
            session, actor, parameter_set, resting_state(parameter_set, "REJECTED"), AuditAction.REFUSED, reason=reason
        )
        return
    signed = len(list_second_persons(session, approval, policy))
    told["approvals"] = f"{signed} of {approval.needed}"
    if signed < approval.needed:
        move(session, actor, approval, "OPEN", AuditAction.APPROVED, reason=reason, **told)
        return
    approval.closed_utc = signature.signed_utc
    move(session, actor, approval, "APPROVED", AuditAction.APPROVED, reason=reason, **told)
    move(session, actor, parameter_set, "APPROVED", AuditAction.APPROVED, reason=reason)


def assign(
    session: Session,
    actor: Actor,
    approval_id: int,
    user_id: int | None,
    seen_version: int | None,
    *,
    policy: Policy = POLICY,
) -> Approval:
    """Assign an open request to a person; None removes the assignee."""
    require_person(actor, "assign a request")
    require_role(actor, "analyst", "operator", "approver", "administrator")
    approval = session.get_known(Approval, approval_id)
    require_seen(session, approval, seen_version)
    if approval.state != "OPEN":
        raise ConflictError(
            f"Request {approval.id} is {approval.state}: {describe_last_change(session, approval)}. Choose one that is OPEN.",
            code="wrong-state",
        )
    named = None if user_id is None else _get_signer(session, approval, user_id, policy)
    approval.assigned_to = None if named is None else named.id
    asked = "nobody" if named is None else named.printed_name
    move(session, actor, approval, "OPEN", AuditAction.ASSIGNED, assigned_to=asked)
    return approval


def _get_signer(session: Session, approval: Approval, user_id: int, policy: Policy) -> User:
    user = session.get_known(User, user_id)
    if user.disabled_utc is not None:
        raise ConflictError(f"{user.printed_name} is disabled; ask another approver.", code="person-disabled")
    found = next((one for one in list_signers(session, approval, policy) if one.user.id == user_id), None)
    if found is None:
        raise ConflictError(
            f"{user.printed_name} cannot sign this request without the role approver; ask another person.",
            code="no-approver",
        )
    if found.refusal is not None:
        raise ConflictError(f"{found.refusal} Ask another approver.", code="signer-refused")
    return user


def list_remarks(session: Session, approval_id: int) -> Sequence[Remark]:
    """Return what was said about a request, in order."""
    return rows.list_remarks(session, session.get_known(Approval, approval_id).id)


def record_delivery(session: Session, actor: Actor, approval_id: int, view: str) -> FigureDelivery | None:
    """Record that a person was given a figure of an open request; only the first time counts."""
    if not must_record_delivery(session, actor, approval_id, view):
        return None
    user_id = require_person(actor, "open evidence")
    return session.put(FigureDelivery(approval_id=approval_id, user_id=user_id, evidence=view, given_utc=utc_now()))


def must_record_delivery(session: Session, actor: Actor, approval_id: int, view: str) -> bool:
    """Whether this would be the first time that a person is given a figure of an open request; a key opens none."""
    approval = session.get_known(Approval, approval_id)
    if actor.is_key or actor.user_id is None or approval.state != "OPEN":
        return False
    return rows.find_delivery(session, approval_id, actor.user_id, view) is None


def record_opening(session: Session, actor: Actor, approval_id: int, view: str) -> Opening:
    """Record that a figure stood in sight of the person whom it was given to; only then it counts as opened by them."""
    user_id = require_person(actor, "open evidence")
    _refuse_decided(session, session.get_known(Approval, approval_id), "APPROVE")
    given = rows.find_delivery(session, approval_id, user_id, view)
    if given is None:
        raise ConflictError(f"You have not opened the figure {view!r} of request {approval_id}; open it first.")
    if seconds_between(given.given_utc, utc_now()) < SHOWN_S:
        raise ConflictError(f"You opened the figure {view!r} less than {SHOWN_S:g} s ago; look at it first.")
    known = rows.find_opening(session, approval_id, user_id, view)
    return known or session.put(Opening(approval_id=approval_id, user_id=user_id, evidence=view, opened_utc=utc_now()))


def list_openings(session: Session, approval_id: int) -> Sequence[Opening]:
    """Return who opened which evidence of a request, in order."""
    return rows.list_openings(session, session.get_known(Approval, approval_id).id)


def promote(
    session: Session,
    actor: Actor,
    parameter_set_id: int,
    seen_version: int | None,
    reason: str = "",
    proof: PasswordProof | None = None,
    *,
    policy: Policy = POLICY,
    factor: GivenFactor = NO_FACTOR,
) -> ParameterSet:
    """Make an approved set the baseline, supersede the old one and make every other request stale, all in one.

    `proof`: of the actor's password, where it was asked for; else `factor`, of a person who has one.
    """
    require_role(actor, "operator")
    require_scope(actor, "parameter-sets")
    refuse_control_characters(reason=reason)
    reason = reason.strip()
    row = session.get_known(ParameterSet, parameter_set_id)
    require_seen(session, row, seen_version)
    approval = rows.find_latest_approval(session, row.id, "APPROVED")
    if row.ground_state != "APPROVED" or approval is None:
        raise ConflictError(
            f"{row.name} is {row.ground_state}, not APPROVED: {describe_last_change(session, row)}. "
            "Promote a set that is APPROVED.",
            code="wrong-state",
        )
    refuse_expired(session, approval, row)
    refuse_changed_binding(session, actor, approval, row)
    refuse_blocked(session, row)
    _refuse_lone(session, approval, policy)
    if (policy.promotion_reason or policy.rest_review) and not reason:
        raise RefusedInputError(f"Give the reason why {row.name} becomes the baseline now.")
    if proof is not None:
        confirmations.require(session, actor, proof)
    else:
        confirmations.require_factor(session, actor, factor)
    incumbent = set_rows.find_baseline(session, row.sensor_id)
    now = utc_now()
    if incumbent is not None:
        incumbent.baseline_to_utc = now
        move(session, actor, incumbent, "SUPERSEDED", "superseded", reason=f"{row.name} became the baseline")
    row.baseline_from_utc, row.baseline_to_utc = now, None
    given = {"reason_given": bool(reason), "password_given": proof is not None}
    told = {"approval": approval.id, "kind": approval.kind, **given}
    move(session, actor, row, "BASELINE", AuditAction.PROMOTED, reason=reason or approval.reason, **told)
    record_promotion(session, actor, row, approval, reason)
    make_others_stale(session, actor, row)
    update_alarms(session, [row.sensor_id])
    return row


def explain_why_not_promote(
    session: Session, actor: Actor, parameter_set_id: int, *, policy: Policy = POLICY
) -> str | None:
    """Say why this actor may not promote a set; None when nothing but the reason and the password is missing."""
    row = session.get_known(ParameterSet, parameter_set_id)
    if row.ground_state == "SUBMITTED":
        return "An approver must sign first; then an operator promotes."
    approval = rows.find_latest_approval(session, row.id, "APPROVED")
    if row.ground_state != "APPROVED" or approval is None:
        return f"{row.name} is {row.ground_state}, not APPROVED."
    if "operator" not in actor.roles:
        return "Only an operator may promote an approved set; ask an administrator for the role."
    try:
        refuse_blocked(session, row)
        _refuse_lone(session, approval, policy)
    except ConflictError as refusal:
        return str(refusal)
    return explain_outdated(session, approval, row)


def _refuse_lone(session: Session, approval: Approval, policy: Policy) -> None:
    """Refuse to promote on too few second persons' signatures, as when four-eyes was off or a signer made the set."""
    signed = len(list_second_persons(session, approval, policy))
    if signed < approval.needed:
        raise ConflictError(
            f"Request {approval.id} has {signed} of {approval.needed} approvals by a second person: it was signed "
            "while the four-eyes rule was off, or by the person who created the set. Withdraw it and submit the set again.",
            code="too-few-second-persons",
        )


SUBMITTABLE = ("CANDIDATE", "WITHDRAWN", "EXPIRED", "SUPERSEDED")


def submit(  # noqa: PLR0913 - who asks for what and why, with the evidence
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    parameter_set_id: int,
    reason: str,
    seen_version: int | None,
    assessment: GateAssessment | None = None,
    *,
    back: bool = False,
    policy: Policy = POLICY,
) -> Approval:
    """Ask that a set become baseline, or a former one again, binding the hashes of what an approver will be shown."""
    require_role(actor, "analyst", *(["operator"] if back else []))
    row = _get_submittable(session, actor, parameter_set_id, reason, seen_version)
    if back and row.baseline_from_utc is None:
        raise ConflictError(
            f"{row.name} was never baseline, so you cannot roll back to it; submit it instead.", code="never-baseline"
        )
    if not reason.strip():
        what = "the sensor should go back to this set" if back else "this set should become the baseline"
        raise RefusedInputError(f"Give the reason why {what}.")
    gates.choose_report_for_submission(session, actor, blobs, row.id, assessment)
    return _open(session, actor, row, reason.strip(), policy)


roll_back = partial(submit, back=True)


def is_submittable(session: Session, actor: Actor, parameter_set_id: int) -> bool:
    """Whether a request for a set by this actor would not be refused at once, so that assessing it is worthwhile."""
    may = actor.roles.intersection({"analyst", "operator"}) and (
        actor.scopes is None or "parameter-sets" in actor.scopes
    )
    return bool(may) and session.get_known(ParameterSet, parameter_set_id).ground_state in SUBMITTABLE


def _get_submittable(
    session: Session, actor: Actor, parameter_set_id: int, reason: str, seen_version: int | None
) -> ParameterSet:
    require_scope(actor, "parameter-sets")
    require_user(actor, "submit a parameter set")
    refuse_control_characters(reason=reason)
    row = session.get_known(ParameterSet, parameter_set_id)
    require_seen(session, row, seen_version)
    refuse_unsubmittable(session, row)
    return row


def refuse_unsubmittable(session: Session, row: ParameterSet) -> None:
    """Refuse to submit a set whose state on the ground does not allow it."""
    if row.ground_state not in SUBMITTABLE:
        raise ConflictError(
            f"{row.name} is {row.ground_state}: {describe_last_change(session, row)}. "
            f"Submit a set that is {' or '.join(SUBMITTABLE)}.",
            code="wrong-state",
        )


def _open(session: Session, actor: Actor, row: ParameterSet, reason: str, policy: Policy) -> Approval:
    bound = compute_binding(session, row)
    is_rollback = row.baseline_from_utc is not None
    days = policy.rollback_days if is_rollback else policy.approval_days
    approval = Approval(
        parameter_set_id=row.id,
        state="OPEN",
        reason=reason,
        submitted_utc=utc_now(),
        submitted_by=require_user(actor, "submit a parameter set"),
        bound=bound.document(),
        kind="ROLLBACK" if is_rollback else "PROMOTION",
        needed=policy.needed(waived=bool(bound.waivers)),
        expires_utc=utc_after(days * DAY_S),
    )
    session.put(approval)
    told = {"set": row.name, "bound": bound.document(), "kind": approval.kind, "needed": approval.needed}
    told |= {"expires_utc": approval.expires_utc, "four_eyes": policy.four_eyes}
    audit.append(session, actor, AuditAction.OPENED, name_subject(approval), None, told, reason)
    move(session, actor, row, "SUBMITTED", "asked to roll back to" if is_rollback else "submitted", reason=reason)
    return approval


def withdraw(
    session: Session, actor: Actor, parameter_set_id: int, seen_version: int | None, reason: str = ""
) -> ParameterSet:
    """Take a request back: its submitter, or an administrator."""
    require_scope(actor, "parameter-sets")
    refuse_control_characters(reason=reason)
    row = session.get_known(ParameterSet, parameter_set_id)
    require_seen(session, row, seen_version)
    approval = rows.find_latest_approval(session, row.id, "OPEN", "APPROVED")
    if row.ground_state not in {"SUBMITTED", "APPROVED"} or approval is None:
        raise ConflictError(
            f"{row.name} is {row.ground_state}, not submitted: {describe_last_change(session, row)}. "
            "There is nothing to withdraw.",
            code="wrong-state",
        )
    if actor.user_id != approval.submitted_by:
        require_role(actor, "administrator")
    approval.closed_utc = utc_now()
    move(session, actor, approval, "WITHDRAWN", AuditAction.WITHDREW, reason=reason.strip() or None)
    move(session, actor, row, resting_state(row, "WITHDRAWN"), AuditAction.WITHDREW, reason=reason.strip() or None)
    return row
