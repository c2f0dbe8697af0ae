"""Changes of gate limits and table layouts that wait for a second person: read, confirm, refuse, withdraw."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import Query
from pydantic import Field

from boresight.console.access.dependencies import Reading, SeenVersion, Who, Writing
from boresight.console.approvals.tables import GateProfile
from boresight.console.change_proposals import service as proposals
from boresight.console.change_proposals import tables
from boresight.console.operation import OperationResponse, RowWithFields, operations
from boresight.console.schemas import Document, Row, Shape
from boresight.console.uplinks.tables import TableDefinition
from boresight.platform.db.sessions import Session
from boresight.platform.web.paging import Id, Listing, Page, Paged


class Difference(Row):
    """An entry that a proposal changes."""

    place: str = Field(description="Path in the document.", examples=["gates[coverage].limit"])
    before: bool | int | float | str | None = Field(
        description="Value in the version that the proposal was based on; null if there was none."
    )
    after: bool | int | float | str | None = Field(description="Value after confirmation; null if there is none.")


class ProposedChange(Row):
    """A change of a sensor's gate limits or table layout that takes effect when another person confirms it."""

    versioned_by = ("version",)
    location = "/change-proposals/{row.id}"

    id: int
    sensor_id: int
    kind: Literal["gate-profile", "table-definition"]
    base_number: int = Field(description="The version in force that it was made against; 0: the default, or none.")
    document: Document
    sha256: str
    reason: str
    proposed_utc: str
    proposed_by: int = Field(description="The person who cannot confirm it; for an API key, its owner.")
    expires_utc: str
    state: Literal["OPEN", "CONFIRMED", "REFUSED", "WITHDRAWN", "STALE", "EXPIRED"]
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    closed_utc: str | None
    closed_by: int | None = Field(description="Who confirmed, refused or withdrew it, or made it stale.")
    comment: str | None
    number: int | None = Field(description="The version that it became; null unless it is CONFIRMED.")


class ChangeProposal(ProposedChange):
    """A proposed change with the entries that it changes."""

    differences: list[Difference] = Field(default_factory=list)


router = operations("/change-proposals", tags=["change proposals"])

PROPOSED: dict[int | str, dict[str, Any]] = {
    202: {
        "model": ChangeProposal,
        "description": "The setting `second_person` is on: proposed, and in force when another person confirms it.",
    }
}


class ProposalComment(Shape):
    """A comment for the proposer."""

    comment: str = Field("", max_length=4000, description="Required to refuse.")


def make_row(session: Session, row: tables.ChangeProposal) -> RowWithFields:
    """Return a proposal with what it changes."""
    return RowWithFields(row, differences=proposals.list_differences(session, row))


def in_force_or_proposed(
    session: Session, row: GateProfile | TableDefinition | tables.ChangeProposal
) -> GateProfile | TableDefinition | OperationResponse:
    """Answer a change that is in force with its version, and one that waits with its proposal."""
    if isinstance(row, tables.ChangeProposal):
        return OperationResponse(make_row(session, row), 202, ChangeProposal)
    return row


@router.get("", summary="List proposed changes", response_model=Page[ChangeProposal])
def list_change_proposals(
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    kind: Literal["gate-profile", "table-definition"] | None = None,
    state: Annotated[
        Literal["OPEN", "CONFIRMED", "REFUSED", "WITHDRAWN", "STALE", "EXPIRED"] | None, Query(examples=["OPEN"])
    ] = None,
) -> Listing[tables.ChangeProposal]:
    """List changes of gate limits and table layouts that were proposed, newest first."""
    found = proposals.list_proposals(session, sensor_id=sensor_id, kind=kind, state=state, **page.rows)
    return page.cut(found, lambda row: make_row(session, row))


@router.get("/{proposal_id}", summary="Read a proposed change", response_model=ChangeProposal)
def get_change_proposal(proposal_id: Id, session: Reading) -> RowWithFields:
    """Read a proposal with what it changes; the ETag is needed to decide on it."""
    return make_row(session, session.get_known(tables.ChangeProposal, proposal_id))


@router.post("/{proposal_id}:confirm", summary="Confirm a change", response_model=ChangeProposal)
def confirm_change(
    proposal_id: Id, actor: Who, seen: SeenVersion, session: Writing, said: ProposalComment | None = None
) -> RowWithFields:
    """Confirm a change as a second person, who may make it and did not propose it; not by API key.

    The sensor's open requests for approval become STALE, as with every such change. A proposal that was made against a
    version that is no longer in force is STALE too, and the answer is 412.
    """
    comment = "" if said is None else said.comment
    return make_row(session, proposals.confirm(session, actor, proposal_id, seen, comment))


@router.post("/{proposal_id}:refuse", summary="Refuse a change", response_model=ChangeProposal)
def refuse_change(
    proposal_id: Id, said: ProposalComment, actor: Who, seen: SeenVersion, session: Writing
) -> RowWithFields:
    """Refuse a change as a second person, with a comment."""
    return make_row(session, proposals.refuse(session, actor, proposal_id, seen, said.comment))


@router.post("/{proposal_id}:withdraw", summary="Withdraw a proposal", response_model=ChangeProposal)
def withdraw_change(proposal_id: Id, actor: Who, seen: SeenVersion, session: Writing) -> RowWithFields:
    """Withdraw a proposal, as its proposer or as an administrator."""
    return make_row(session, proposals.withdraw(session, actor, proposal_id, seen))
