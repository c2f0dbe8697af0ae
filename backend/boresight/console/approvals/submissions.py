"""Asking that a set become baseline, and taking the request back.

A request for a set that was baseline once is a roll-back: it goes the same way, has its own shorter time, and may be
opened by an operator too, who sees what flies. A waiver in force asks for two approvals at least.
"""

from __future__ import annotations

from boresight.console.approvals import gates
from boresight.console.approvals import queries as approval_rows
from boresight.console.approvals.gates import GateAssessment
from boresight.console.approvals.staleness import bind_evidence
from boresight.console.approvals.tables import Approval
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.transitions import (
    get_parameter_set,
    move,
    name_subject,
    require_seen,
    resting_state,
    who_changed,
)
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.actors import DAY_S, POLICY, Actor, Policy, require_role, require_scope, require_user
from boresight.platform.audit import log as audit
from boresight.platform.blobs.folder import BlobStore
from boresight.platform.db.sessions import Session, utc_after, utc_now
from boresight.platform.web.text_validation import refuse_control_characters

SUBMITTABLE = ("CANDIDATE", "WITHDRAWN", "EXPIRED", "SUPERSEDED")


def submit(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    parameter_set_id: int,
    reason: str,
    seen_version: int | None,
    assessment: GateAssessment | None = None,
    *,
    policy: Policy = POLICY,
) -> Approval:
    """Ask that a set become baseline, binding the hashes of what an approver will be shown."""
    require_role(actor, "analyst")
    row = _submittable(session, actor, parameter_set_id, reason, seen_version)
    if not reason.strip():
        raise RefusedInputError("Give the reason why this set should become the baseline.")
    gates.report_for_submission(session, actor, blobs, row.id, assessment)
    return _open(session, actor, row, reason.strip(), policy)


def roll_back(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    parameter_set_id: int,
    reason: str,
    seen_version: int | None,
    assessment: GateAssessment | None = None,
    *,
    policy: Policy = POLICY,
) -> Approval:
    """Ask that a former baseline become baseline again."""
    require_role(actor, "analyst", "operator")
    row = _submittable(session, actor, parameter_set_id, reason, seen_version)
    if row.baseline_from_utc is None:
        raise ConflictError(f"{row.name} was never baseline, so there is nothing to roll back to; submit it instead.")
    if not reason.strip():
        raise RefusedInputError("Give the reason why the sensor should go back to this set.")
    gates.report_for_submission(session, actor, blobs, row.id, assessment)
    return _open(session, actor, row, reason.strip(), policy)


def is_submittable(session: Session, actor: Actor, parameter_set_id: int) -> bool:
    """Whether it is worth while to assess a set for this actor: a request for it would not be refused at once."""
    may = actor.roles.intersection({"analyst", "operator"}) and (
        actor.scopes is None or "parameter-sets" in actor.scopes
    )
    return bool(may) and get_parameter_set(session, parameter_set_id).ground_state in SUBMITTABLE


def _submittable(
    session: Session, actor: Actor, parameter_set_id: int, reason: str, seen_version: int | None
) -> ParameterSet:
    """Return a set that this actor may ask for now."""
    require_scope(actor, "parameter-sets")
    require_user(actor, "submit a parameter set")
    refuse_control_characters(reason=reason)
    row = get_parameter_set(session, parameter_set_id)
    require_seen(session, row, seen_version)
    if row.ground_state not in SUBMITTABLE:
        raise ConflictError(f"{row.name} is {row.ground_state}: {who_changed(session, row)}. It cannot be submitted.")
    return row


def _open(session: Session, actor: Actor, row: ParameterSet, reason: str, policy: Policy) -> Approval:
    """Open the request, with its time and the approvals that it needs."""
    bound = bind_evidence(session, row)
    is_rollback = row.baseline_from_utc is not None
    days = policy.rollback_days if is_rollback else policy.approval_days
    approval = Approval(
        parameter_set_id=row.id,
        state="OPEN",
        reason=reason,
        submitted_utc=utc_now(),
        submitted_by=require_user(actor, "submit a parameter set"),
        bound=bound,
        kind="ROLLBACK" if is_rollback else "PROMOTION",
        needed=policy.needed(waived=bool(bound["waivers"])),
        expires_utc=utc_after(days * DAY_S),
    )
    session.add(approval)
    session.flush()
    told = {"set": row.name, "bound": bound, "kind": approval.kind, "needed": approval.needed}
    told |= {"expires_utc": approval.expires_utc, "four_eyes": policy.four_eyes}
    audit.append(session, actor, "opened", name_subject(approval), None, told, reason)
    move(session, actor, row, "SUBMITTED", "asked to roll back to" if is_rollback else "submitted", reason=reason)
    return approval


def withdraw(
    session: Session, actor: Actor, parameter_set_id: int, seen_version: int | None, reason: str = ""
) -> ParameterSet:
    """Take a request back: its submitter, or an administrator."""
    require_scope(actor, "parameter-sets")
    refuse_control_characters(reason=reason)
    row = get_parameter_set(session, parameter_set_id)
    require_seen(session, row, seen_version)
    approval = approval_rows.find_latest(session, row.id, "OPEN", "APPROVED")
    if row.ground_state not in {"SUBMITTED", "APPROVED"} or approval is None:
        raise ConflictError(
            f"{row.name} is {row.ground_state}, not submitted: {who_changed(session, row)}. "
            "There is nothing to withdraw."
        )
    if actor.user_id != approval.submitted_by:
        require_role(actor, "administrator")
    approval.closed_utc = utc_now()
    move(session, actor, approval, "WITHDRAWN", "withdrew", reason=reason.strip() or None)
    move(session, actor, row, resting_state(row, "WITHDRAWN"), "withdrew", reason=reason.strip() or None)
    return row
