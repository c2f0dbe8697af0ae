"""Who may sign a request: a second person, in person.

An approver signs, and is no administrator: who gives roles and passwords must not be able to sign with them. The second
pair of eyes belongs neither to who submitted the set nor to who launched the run that it comes from, whichever session
or key they used. Where the policy says that four-eyes is off, those two may sign, and are still told apart: they are
never counted as second persons once it is on.
"""

from __future__ import annotations

from collections.abc import Sequence

from boresight.errors import ConflictError, ForbiddenError
from boresight.services.actors import Actor, Policy, require_person, require_role
from boresight.store import approvals as rows
from boresight.store.sessions import Session
from boresight.store.tables import Approval, ParameterSet, Run, Signature, User


def launcher_of(session: Session, approval: Approval) -> int | None:
    """Return who launched the run that a request's set comes from."""
    row = session.get_one(ParameterSet, approval.parameter_set_id)
    run = None if row.run_id is None else session.get(Run, row.run_id)
    return None if run is None else run.launched_by


def refuse_signer(session: Session, actor: Actor, approval: Approval, policy: Policy) -> None:
    """Refuse whoever is not a second person, with the reason.

    Raises
    ------
    ForbiddenError
        When this person may not sign.
    ConflictError
        When this person signed already.
    """
    user_id = require_person(actor, "sign")
    if "administrator" in actor.roles:
        raise ForbiddenError("An administrator cannot sign; an approver who is no administrator must.")
    require_role(actor, "approver")
    if session.get_one(User, user_id).must_change_password:
        raise ForbiddenError("Somebody else set your password; set your own first, then sign.")
    if policy.four_eyes and user_id == approval.submitted_by:
        raise ForbiddenError("You submitted this set; another approver must sign.")
    if policy.four_eyes and user_id == launcher_of(session, approval):
        run_id = session.get_one(ParameterSet, approval.parameter_set_id).run_id
        raise ForbiddenError(f"You launched run {run_id}, which this set comes from; another approver must sign.")
    if (earlier := rows.signature_of(session, approval.id, user_id)) is not None:
        raise ConflictError(f"You signed this request already, at {earlier.signed_utc}; its submitter can withdraw it.")


def second_persons(session: Session, approval: Approval, policy: Policy) -> Sequence[Signature]:
    """Return the approvals of a request that count: with four-eyes, only those of second persons."""
    first = {approval.submitted_by, launcher_of(session, approval)} if policy.four_eyes else set()
    signed = rows.signatures(session, approval.id)
    return [row for row in signed if row.decision == "APPROVE" and row.user_id not in first]
