"""Requests for approval, their signatures and their discussion."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from boresight.api.schemas.row import Document, Row


class Signature(Row):
    """A person's decision on a request."""

    id: int
    user_id: int
    printed_name: str
    decision: Literal["APPROVE", "REFUSE"]
    meaning: str
    comment: str
    shown_sha256: str = Field(description="Hash of what was shown when this was signed.")
    signed_utc: str
    console: str | None = Field(description="At whose console it was signed over the shoulder; null at one's own.")
    password_by: str | None = Field(
        description="Who else gave the password that it was signed with, and when; null where the signer chose it, a day "
        "or more after anybody else had given one."
    )


class Approval(Row):
    """A request that a parameter set become its sensor's baseline."""

    versioned_by = ("version",)
    location = "/approvals/{row.id}"

    id: int
    parameter_set_id: int
    state: Literal["OPEN", "APPROVED", "REJECTED", "WITHDRAWN", "STALE", "EXPIRED"]
    reason: str
    bound: Document = Field(
        description="What the request binds: hashes of set, run result, gate report, gate profile, table definition and "
        "incumbent, and the waivers in force. If one of them moves, the request is STALE."
    )
    kind: Literal["PROMOTION", "ROLLBACK"]
    needed: int = Field(description="Approvals that make it APPROVED; one refusal blocks.")
    expires_utc: str | None
    assigned_to: int | None = Field(description="The person who is asked to decide.")
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    submitted_utc: str
    submitted_by: int
    closed_utc: str | None
    signatures: list[Signature] = Field(default_factory=list)


class Signer(BaseModel):
    """An approver, and whether they may sign a request now."""

    model_config = ConfigDict(extra="forbid")
    user_id: int
    printed_name: str
    may_sign: bool
    excluded_as: list[Literal["SUBMITTER", "LAUNCHER", "CREATOR"]] = Field(
        description="The part in the set that keeps this person from signing: who submitted it, who launched its run or "
        "campaign, who created it."
    )
    refusal: str | None = Field(description="Why they may not, a sentence; null when they may.")


class Remark(Row):
    """A word in the discussion of a request; never edited."""

    id: int
    approval_id: int
    user_id: int
    printed_name: str
    text: str
    made_utc: str


class Opening(Row):
    """A person opened a piece of a request's evidence."""

    id: int
    approval_id: int
    user_id: int
    evidence: str
    opened_utc: str
