"""Requests for approval and their signatures."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

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


class Approval(Row):
    """A request that a parameter set become its sensor's baseline."""

    id: int
    parameter_set_id: int
    state: str
    reason: str
    bound: Document = Field(description="Hashes of set, run result and incumbent that the request binds.")
    version: int
    submitted_utc: str
    submitted_by: int
    closed_utc: str | None
    signatures: list[Signature] = Field(default_factory=list)
