"""Changes of gate limits and table layouts that wait for a second person: read, confirm, refuse, withdraw."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Reading, SeenVersion, Who, Writing, etag
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import proposals, second_person
from boresight.store.sessions import Session
from boresight.store.tables import ChangeProposal

router = APIRouter(prefix="/change-proposals", tags=["change proposals"])

TRANSITION = refusals(404, 409, 412, 428)
PROPOSED: dict[int | str, dict[str, Any]] = {
    202: {
        "model": schemas.ChangeProposal,
        "description": "The setting `second_person` is on: proposed, and in force when another person confirms it.",
    }
}


class ProposalComment(BaseModel):
    """A word to who proposed the change."""

    model_config = ConfigDict(extra="forbid")
    comment: str = Field("", max_length=4000, description="Needed to refuse.")


def shown(session: Session, row: ChangeProposal) -> schemas.Document:
    """Write a proposal with what it changes."""
    changed = [schemas.written(schemas.Difference, one) for one in second_person.differences(session, row)]
    return {**schemas.written(schemas.ProposedChange, row), "differences": changed}


def answer(session: Session, row: ChangeProposal, status: int = 200) -> Answer:
    """Answer with a proposal and its ETag."""
    headers = {"ETag": etag(row.version)}
    if status == 202:
        headers["Location"] = f"/api/v1/change-proposals/{row.id}"
    return Answer(shown(session, row), status, headers)


@router.get(
    "", name="list_change_proposals", summary="List proposed changes", response_model=Page[schemas.ChangeProposal]
)
def list_change_proposals(
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    kind: Literal["gate-profile", "table-definition"] | None = None,
    state: Annotated[
        Literal["OPEN", "CONFIRMED", "REFUSED", "WITHDRAWN", "STALE", "EXPIRED"] | None, Query(examples=["OPEN"])
    ] = None,
) -> Response:
    """List changes of gate limits and table layouts that were proposed, newest first."""
    asked = {"sensor_id": sensor_id, "kind": kind, "state": state}
    found = proposals.list_proposals(session, **asked, before_id=page.last_id, limit=page.limit + 1)  # type: ignore[arg-type]
    return json_response(page.cut(found, lambda row: shown(session, row)))


@router.get(
    "/{proposal_id}",
    name="get_change_proposal",
    summary="Read a proposed change",
    response_model=schemas.ChangeProposal,
    responses=refusals(404),
)
def get_change_proposal(proposal_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read a proposal with what it changes; the ETag is for deciding on it."""
    return answer(session, proposals.get_proposal(session, proposal_id)).response()


@router.post(
    "/{proposal_id}:confirm",
    name="confirm_change",
    summary="Put it into force",
    response_model=schemas.ChangeProposal,
    responses=TRANSITION,
)
def confirm_change(
    proposal_id: Id,
    actor: Who,
    seen: SeenVersion,
    once: Idempotent,
    session: Writing,
    said: ProposalComment | None = None,
) -> Response:
    """Confirm a change as a second person: one who may make it, did not propose it, and is logged in; no API key.

    The sensor's undecided requests for approval become STALE, as with every such change. A proposal that was made against a
    version which is in force no more is STALE too, and answers 412.
    """
    comment = "" if said is None else said.comment
    return once.answer(
        session,
        actor,
        lambda: answer(session, second_person.confirm(session, actor, proposal_id, seen, comment)),
    )


@router.post(
    "/{proposal_id}:refuse",
    name="refuse_change",
    summary="Refuse it",
    response_model=schemas.ChangeProposal,
    responses=TRANSITION,
)
def refuse_change(
    proposal_id: Id, said: ProposalComment, actor: Who, seen: SeenVersion, once: Idempotent, session: Writing
) -> Response:
    """Refuse a change as a second person, with a comment."""
    return once.answer(
        session,
        actor,
        lambda: answer(session, second_person.refuse(session, actor, proposal_id, seen, said.comment)),
    )


@router.post(
    "/{proposal_id}:withdraw",
    name="withdraw_change",
    summary="Take it back",
    response_model=schemas.ChangeProposal,
    responses=TRANSITION,
)
def withdraw_change(proposal_id: Id, actor: Who, seen: SeenVersion, once: Idempotent, session: Writing) -> Response:
    """Take a proposal back, as who made it or as an administrator."""
    return once.answer(session, actor, lambda: answer(session, proposals.withdraw(session, actor, proposal_id, seen)))
