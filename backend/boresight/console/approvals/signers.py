"""Who may sign a request: an approver who is no administrator and had no part in the set, whichever session or key they used.

Where the policy says that four-eyes is off, those with a part in it may sign, and are still told apart: they are never
counted as second persons once it is on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from boresight.console.access import queries as user_rows
from boresight.console.access.tables import User
from boresight.console.approvals import queries as rows
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.campaigns import queries as campaign_rows
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.errors import ConflictError, ForbiddenError
from boresight.platform.actors import Actor, Policy, require_person, require_role
from boresight.platform.db.sessions import Session

SUBMITTER, LAUNCHER, CREATOR = "SUBMITTER", "LAUNCHER", "CREATOR"
PARTS = (SUBMITTER, LAUNCHER, CREATOR)


@dataclass(frozen=True)
class SetPart:
    """What a person did for a set that is asked for."""

    user_id: int
    role: str
    deed: str


@dataclass(frozen=True)
class Signer:
    """An approver, and whether they may sign a request now."""

    user: User
    roles: tuple[str, ...]
    refusal: str | None


def list_parts(session: Session, approval: Approval) -> list[SetPart]:
    """Return who had which part in the set of a request, without Boresight itself and the command line."""
    row = session.get_one(ParameterSet, approval.parameter_set_id)
    run = None if row.run_id is None else session.get(Run, row.run_id)
    done: list[tuple[int | None, str, str]] = [(approval.submitted_by, SUBMITTER, "submitted this set")]
    if run is not None:
        done.append((run.launched_by, LAUNCHER, f"launched run {run.id} that produced this set"))
        done += [
            (campaign.launched_by, LAUNCHER, f"launched campaign {campaign.id} that produced this set")
            for campaign in campaign_rows.list_campaigns_of_run(session, run.id)
            if campaign.launched_by != run.launched_by
        ]
    done.append((row.created_by, CREATOR, "created this set"))
    return [SetPart(user_id, role, deed) for user_id, role, deed in done if user_id is not None]


def refuse_who_never_signs(session: Session, actor: Actor) -> int:
    """Refuse whoever may sign no request at all, with the reason; returns the person's number."""
    user_id = require_person(actor, "sign")
    if "administrator" in actor.roles:
        raise ForbiddenError(
            "An administrator cannot sign; ask an approver who is not an administrator.",
            code="administrator-cannot-sign",
        )
    require_role(actor, "approver")
    if session.get_one(User, user_id).must_change_password:
        raise ForbiddenError("Somebody else set your password; set your own first, then sign.", code="password-due")
    return user_id


def refuse_signer(session: Session, actor: Actor, approval: Approval, policy: Policy) -> None:
    """Refuse whoever is not a second person, with the reason."""
    user_id = refuse_who_never_signs(session, actor)
    own = [part for part in list_parts(session, approval) if part.user_id == user_id] if policy.four_eyes else []
    refuse_own_part(own)
    if (earlier := rows.find_signature(session, approval.id, user_id)) is not None:
        raise ConflictError(
            f"You signed this request already, at {earlier.signed_utc}; ask its submitter to withdraw it if it is wrong.",
            code="already-signed",
        )


def refuse_own_part(own: Sequence[SetPart]) -> None:
    """Refuse whoever had a part in what is to be signed."""
    if own:
        raise ForbiddenError(f"You {_listed(own)}; ask another approver to sign.", code="own-part")


def _listed(parts: Sequence[SetPart]) -> str:
    return " and ".join(part.deed for part in parts)


def list_signers(session: Session, approval: Approval, policy: Policy) -> list[Signer]:
    """Return every approver of this installation with whether they may sign a request now, by log-in name."""
    parts = list_parts(session, approval) if policy.four_eyes else []
    signed = {one.user_id: one.signed_utc for one in rows.list_signatures(session, approval.id)}
    return [
        _signer(user, [part for part in parts if part.user_id == user.id], signed.get(user.id))
        for user in user_rows.list_users(session)
        if "approver" in user.roles and user.disabled_utc is None
    ]


def _signer(user: User, own: Sequence[SetPart], signed_utc: str | None) -> Signer:
    """Return an approver with what prevents them from signing, in the order in which `refuse_signer` checks."""
    roles, name = tuple(dict.fromkeys(part.role for part in own)), user.printed_name
    if "administrator" in user.roles:
        return Signer(user, roles, f"{name} is an administrator, who cannot sign.")
    if user.must_change_password:
        return Signer(user, roles, f"Somebody else set the password of {name}, who must set their own first.")
    if own:
        return Signer(user, roles, f"{name} {_listed(own)}.")
    return Signer(user, roles, None if signed_utc is None else f"{name} signed it already, at {signed_utc}.")


def list_second_persons(session: Session, approval: Approval, policy: Policy) -> Sequence[Signature]:
    """Return the approvals of a request that count: with four-eyes, only those of second persons."""
    first = {part.user_id for part in list_parts(session, approval)} if policy.four_eyes else set()
    signed = rows.list_signatures(session, approval.id)
    return [row for row in signed if row.decision == "APPROVE" and row.user_id not in first]
