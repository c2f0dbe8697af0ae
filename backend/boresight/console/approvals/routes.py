"""Requests for approval: read, sign, refuse. Only people sign, each with the password given again.

The discussion of a request for approval: assignment, remarks, opened evidence.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import Depends, Query
from pydantic import BaseModel, ConfigDict, Field, SecretStr
from starlette.requests import Request

from boresight.console.access.dependencies import (
    PasswordChecks,
    Reading,
    SeenVersion,
    ServerPolicy,
    Who,
    Writing,
    get_client,
    own_password,
)
from boresight.console.access.passwords import PasswordProof
from boresight.console.approvals import schemas
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval, Opening, Remark
from boresight.console.operation import Beside, operations
from boresight.platform.db.sessions import Session
from boresight.platform.web.openapi import refuses
from boresight.platform.web.paging import Id, Listing, Page, Paged

router = operations("/approvals", tags=["approvals"])


class Signing(BaseModel):
    """A signature: what it means, and the password again."""

    model_config = ConfigDict(extra="forbid")
    meaning: str = Field(examples=["I reviewed the evidence and approve this set for baseline."])
    password: SecretStr = Field(description="The signer's own, given again.")
    comment: str = Field("", description="Needed to refuse.")


class SigningByName(Signing):
    """A second person's signature at another's console: who it is, and the decision, beside the rest."""

    name: str = Field(description="Log-in name of who signs.", examples=["alan"])
    decision: Literal["APPROVE", "REFUSE"]


def with_signatures(session: Session, row: Approval) -> Beside:
    """Return a request with its signatures."""
    return Beside(row, signatures=approvals.list_signatures(session, row.id))


Proven = Annotated[PasswordProof, own_password(Signing)]


@refuses(429)
async def proven_beside(
    approval_id: Id, signed: SigningByName, actor: Who, seen: SeenVersion, passwords: PasswordChecks, request: Request
) -> PasswordProof:
    """Check name and password of a second person before any transaction begins, where a password can help."""

    def refuse(session: Session) -> None:
        approvals.refuse_beside(session, actor, approval_id, signed.decision, signed.meaning, signed.comment, seen)

    password = signed.password.get_secret_value()
    return await passwords.check_beside(actor, signed.name, password, get_client(request), refuse)


@router.get("", summary="List requests", response_model=Page[schemas.Approval])
def list_approvals(
    session: Reading,
    page: Paged,
    state: Annotated[str | None, Query(examples=["OPEN"])] = None,
    parameter_set_id: Id | None = None,
) -> Listing[Approval]:
    """List requests for approval, newest first."""
    found = approvals.list_approvals(
        session, state=state, parameter_set_id=parameter_set_id, before_id=page.last_id, limit=page.limit + 1
    )
    return page.cut(found, lambda row: with_signatures(session, row))


@router.get("/{approval_id}", summary="Read a request", response_model=schemas.Approval)
def get_approval(approval_id: Id, session: Reading) -> Beside:
    """Read a request with its signatures; the ETag is for signing."""
    return with_signatures(session, approvals.get_approval(session, approval_id))


@router.get("/{approval_id}/signers", summary="List who may sign", response_model=Page[schemas.Signer])
def list_signers(approval_id: Id, policy: ServerPolicy, session: Reading) -> Listing[dict[str, Any]]:
    """List every approver with whether they may sign this request, and if not, which part in the set excludes them."""
    found = approvals.who_may_sign(session, approval_id, policy=policy)
    return Listing(
        [
            {
                "user_id": one.user.id,
                "printed_name": one.user.printed_name,
                "may_sign": one.refusal is None,
                "excluded_as": list(dict.fromkeys(one.roles)),
                "refusal": one.refusal,
            }
            for one in found
        ]
    )


@router.post("/{approval_id}:approve", summary="Sign for it", response_model=schemas.Approval)
def approve(
    approval_id: Id,
    signed: Signing,
    actor: Who,
    seen: SeenVersion,
    proof: Proven,
    policy: ServerPolicy,
    session: Writing,
) -> Beside:
    """Approve, as a second person: neither who submitted or created the set nor who launched its run; no administrator, no key."""
    approvals.sign(session, actor, approval_id, "APPROVE", signed.meaning, signed.comment, proof, seen, policy=policy)
    return with_signatures(session, approvals.get_approval(session, approval_id))


@router.post("/{approval_id}:refuse", summary="Sign against it", response_model=schemas.Approval)
def refuse(
    approval_id: Id,
    signed: Signing,
    actor: Who,
    seen: SeenVersion,
    proof: Proven,
    policy: ServerPolicy,
    session: Writing,
) -> Beside:
    """Refuse with a comment; one refusal blocks, also after an approval, until the set is promoted."""
    approvals.sign(session, actor, approval_id, "REFUSE", signed.meaning, signed.comment, proof, seen, policy=policy)
    return with_signatures(session, approvals.get_approval(session, approval_id))


@router.post(
    "/{approval_id}:sign-over-the-shoulder", summary="Sign at another's console", response_model=schemas.Approval
)
def sign_over_the_shoulder(
    approval_id: Id,
    signed: SigningByName,
    actor: Who,
    seen: SeenVersion,
    proof: Annotated[PasswordProof, Depends(proven_beside)],
    policy: ServerPolicy,
    session: Writing,
) -> Beside:
    """Approve or refuse as a second person who gives name and password where another is logged in."""
    approvals.sign_over_the_shoulder(
        session, actor, approval_id, signed.decision, signed.meaning, signed.comment, proof, seen, policy=policy
    )
    return with_signatures(session, approvals.get_approval(session, approval_id))


discussion_router = operations("/approvals/{approval_id}", tags=["approvals"])


class Assignment(BaseModel):
    """Who is asked to decide."""

    model_config = ConfigDict(extra="forbid")
    user_id: Id | None = Field(description="Null: nobody in particular.")


class NewRemark(BaseModel):
    """What is to be said."""

    model_config = ConfigDict(extra="forbid")
    text: str = Field(examples=["Was the focus heater on during this pass?"])


class NewOpening(BaseModel):
    """Which evidence was opened."""

    model_config = ConfigDict(extra="forbid")
    evidence: str = Field(examples=["gate-report"])


@discussion_router.post(":assign", summary="Ask a person to decide", response_model=schemas.Approval)
def assign_approval(
    approval_id: Id, assignment: Assignment, actor: Who, seen: SeenVersion, policy: ServerPolicy, session: Writing
) -> Beside:
    """Ask a person who may sign it to decide on an open request."""
    row = approvals.assign(session, actor, approval_id, assignment.user_id, seen, policy=policy)
    return with_signatures(session, row)


@discussion_router.get("/remarks", summary="Read the discussion", response_model=Page[schemas.Remark])
def list_remarks(approval_id: Id, session: Reading) -> Listing[Remark]:
    """Read what was said about a request, in order."""
    return Listing(approvals.list_remarks(session, approval_id))


@discussion_router.post("/remarks", summary="Say something about it", status_code=201, response_model=schemas.Remark)
def remark(approval_id: Id, new: NewRemark, actor: Who, session: Writing) -> Remark:
    """Add a remark to a request, be it decided or not; it is never edited."""
    return approvals.remark(session, actor, approval_id, new.text)


@discussion_router.get("/openings", summary="Read who opened which evidence", response_model=Page[schemas.Opening])
def list_openings(approval_id: Id, session: Reading) -> Listing[Opening]:
    """Read who opened which evidence of a request, in order."""
    return Listing(approvals.list_openings(session, approval_id))


@discussion_router.post(
    "/openings", summary="Say that you opened a piece of evidence", status_code=201, response_model=schemas.Opening
)
def record_opening(approval_id: Id, new: NewOpening, actor: Who, session: Writing) -> Opening:
    """Keep that you opened a piece of evidence; only the first time counts."""
    return approvals.record_opening(session, actor, approval_id, new.evidence)
