"""The talk about a request for approval: who is asked to decide, what people say, which evidence they opened."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from boresight.api import schemas
from boresight.api.dependencies import Held, Reading, SeenVersion, Who, Writing
from boresight.api.numbers import Id
from boresight.api.operation import Beside, operations
from boresight.api.paging import Listing, Page
from boresight.api.routes.approvals import with_signatures
from boresight.services import approvals
from boresight.store.tables import Opening, Remark

router = operations("/approvals/{approval_id}", tags=["approvals"])


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


@router.post(":assign", summary="Ask a person to decide", response_model=schemas.Approval)
def assign_approval(
    approval_id: Id, assignment: Assignment, actor: Who, seen: SeenVersion, policy: Held, session: Writing
) -> Beside:
    """Ask a person who may sign it to decide on an open request."""
    row = approvals.assign(session, actor, approval_id, assignment.user_id, seen, policy=policy)
    return with_signatures(session, row)


@router.get("/remarks", summary="Read the discussion", response_model=Page[schemas.Remark])
def list_remarks(approval_id: Id, session: Reading) -> Listing[Remark]:
    """Read what was said about a request, in order."""
    return Listing(approvals.remarks_of(session, approval_id))


@router.post("/remarks", summary="Say something about it", status_code=201, response_model=schemas.Remark)
def remark(approval_id: Id, new: NewRemark, actor: Who, session: Writing) -> Remark:
    """Add a remark to a request, be it decided or not; it is never edited."""
    return approvals.remark(session, actor, approval_id, new.text)


@router.get("/openings", summary="Read who opened which evidence", response_model=Page[schemas.Opening])
def list_openings(approval_id: Id, session: Reading) -> Listing[Opening]:
    """Read who opened which evidence of a request, in order."""
    return Listing(approvals.openings_of(session, approval_id))


@router.post(
    "/openings", summary="Say that you opened a piece of evidence", status_code=201, response_model=schemas.Opening
)
def record_opening(approval_id: Id, new: NewOpening, actor: Who, session: Writing) -> Opening:
    """Keep that you opened a piece of evidence; only the first time counts."""
    return approvals.record_opening(session, actor, approval_id, new.evidence)
