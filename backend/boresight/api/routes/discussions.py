"""The talk about a request for approval: who is asked to decide, what people say, which evidence they opened."""

from __future__ import annotations

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Held, Reading, SeenVersion, Who, Writing, etag
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page
from boresight.services import approvals

router = APIRouter(prefix="/approvals/{approval_id}", tags=["approvals"])


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


@router.post(
    ":assign",
    name="assign_approval",
    summary="Ask a person to decide",
    response_model=schemas.Approval,
    responses=refusals(404, 409, 412, 428),
)
def assign_approval(
    approval_id: Id,
    assignment: Assignment,
    actor: Who,
    seen: SeenVersion,
    once: Idempotent,
    policy: Held,
    session: Writing,
) -> Response:
    """Ask a person who may sign it to decide on an open request."""

    def act() -> Answer:
        row = approvals.assign(session, actor, approval_id, assignment.user_id, seen, policy=policy)
        signed = [schemas.written(schemas.Signature, found) for found in approvals.signatures_of(session, row.id)]
        return Answer(
            {**schemas.written(schemas.Approval, row), "signatures": signed}, 200, {"ETag": etag(row.version)}
        )

    return once.answer(session, actor, act)


@router.get(
    "/remarks",
    name="list_remarks",
    summary="Read the discussion",
    response_model=Page[schemas.Remark],
    responses=refusals(404),
)
def list_remarks(approval_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read what was said about a request, in order."""
    items = [schemas.written(schemas.Remark, row) for row in approvals.remarks_of(session, approval_id)]
    return json_response({"items": items, "next": None})


@router.post(
    "/remarks",
    name="remark",
    summary="Say something about it",
    status_code=201,
    response_model=schemas.Remark,
    responses=refusals(404),
)
def remark(approval_id: Id, new: NewRemark, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Add a remark to a request, be it decided or not; it is never edited."""

    def act() -> Answer:
        return Answer(schemas.written(schemas.Remark, approvals.remark(session, actor, approval_id, new.text)), 201)

    return once.answer(session, actor, act)


@router.get(
    "/openings",
    name="list_openings",
    summary="Read who opened which evidence",
    response_model=Page[schemas.Opening],
    responses=refusals(404),
)
def list_openings(approval_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read who opened which evidence of a request, in order."""
    items = [schemas.written(schemas.Opening, row) for row in approvals.openings_of(session, approval_id)]
    return json_response({"items": items, "next": None})


@router.post(
    "/openings",
    name="record_opening",
    summary="Say that you opened a piece of evidence",
    status_code=201,
    response_model=schemas.Opening,
    responses=refusals(404),
)
def record_opening(approval_id: Id, new: NewOpening, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Keep that you opened a piece of evidence; only the first time counts."""

    def act() -> Answer:
        row = approvals.record_opening(session, actor, approval_id, new.evidence)
        return Answer(schemas.written(schemas.Opening, row), 201)

    return once.answer(session, actor, act)
