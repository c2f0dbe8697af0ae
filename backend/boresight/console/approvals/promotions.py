"""Promotion: an approved set becomes its sensor's baseline, the one before is superseded, all in one transaction.

Rolling back is the same move with an older set. The signatures are counted again here, by the policy that holds now, so
that what was signed while four-eyes was off does not pass once it is on.
"""

from __future__ import annotations

from boresight.console.alarms.rules import update_alarms
from boresight.console.approvals import queries as approval_rows
from boresight.console.approvals.signers import second_persons
from boresight.console.approvals.staleness import (
    make_others_stale,
    refuse_blocked,
    refuse_changed_evidence,
    refuse_expired,
)
from boresight.console.approvals.tables import Approval
from boresight.console.parameter_sets import queries as rows
from boresight.console.parameter_sets.service import record_promotion
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.transitions import get_parameter_set, move, require_seen, who_changed
from boresight.errors import ConflictError
from boresight.platform.actors import POLICY, Actor, Policy, require_role, require_scope
from boresight.platform.db.sessions import Session, utc_now


def promote(
    session: Session, actor: Actor, parameter_set_id: int, seen_version: int | None, *, policy: Policy = POLICY
) -> ParameterSet:
    """Make an approved set the baseline, supersede the old one and make every other request stale, all in one."""
    require_role(actor, "operator")
    require_scope(actor, "parameter-sets")
    row = get_parameter_set(session, parameter_set_id)
    require_seen(session, row, seen_version)
    approval = approval_rows.find_latest(session, row.id, "APPROVED")
    if row.ground_state != "APPROVED" or approval is None:
        raise ConflictError(f"{row.name} is {row.ground_state}, not APPROVED: {who_changed(session, row)}.")
    refuse_expired(session, approval, row)
    refuse_changed_evidence(session, actor, approval, row)
    refuse_blocked(session, row)
    _refuse_lone(session, approval, policy)
    incumbent = rows.baseline(session, row.sensor_id)
    now = utc_now()
    if incumbent is not None:
        incumbent.baseline_to_utc = now
        move(session, actor, incumbent, "SUPERSEDED", "superseded", reason=f"{row.name} became baseline")
    row.baseline_from_utc, row.baseline_to_utc = now, None
    move(session, actor, row, "BASELINE", "promoted", reason=approval.reason, approval=approval.id, kind=approval.kind)
    record_promotion(session, actor, row, approval)
    make_others_stale(session, actor, row)
    update_alarms(session, [row.sensor_id])
    return row


def _refuse_lone(session: Session, approval: Approval, policy: Policy) -> None:
    """Refuse an approval that lacks second persons: it was signed while four-eyes was off, or its signer made the set."""
    signed = len(second_persons(session, approval, policy))
    if signed < approval.needed:
        raise ConflictError(
            f"Request {approval.id} has {signed} of {approval.needed} approvals by a second person: it was signed "
            "while four-eyes was off, or by who created the set. Withdraw it and submit the set again."
        )
