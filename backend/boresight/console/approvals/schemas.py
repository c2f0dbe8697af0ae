"""Requests for approval with their signatures and discussion, gates with their limits, reports and waivers."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from boresight.console.schemas import Document, Row, Shape


class Point(Row):
    """Something that a signature answers for: a gate that is not PASS, a warning, or a figure to be opened."""

    kind: Literal["gate", "warning", "evidence"]
    name: str = Field(description="Identifies the point within the request, together with the kind.")
    title: str
    said: str = Field(description="What the gate or the warning says.")
    status: str = Field(description="The gate's answer; empty otherwise.")
    reason: str | None = Field(
        description="Why it is accepted, or why the figure was not opened; null where none is given."
    )
    opened_utc: str | None = Field(
        description="When the server first gave the figure to the signer; null where it did not."
    )


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
    console: str | None = Field(
        description="The person at whose console it was signed by a second person; null if at the signer's own."
    )
    password_by: str | None = Field(
        description="Who else set the signer's password, and when; null if the signer changed it themselves at least a day after "
        "anyone else had set one."
    )
    points: list[Point] | None = Field(
        description="Each point of the request and how this approval answered it. A point with neither reason nor time was "
        "left open (not possible on the page). Null for refusals and for older signatures."
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
        "incumbent, and the waivers in force. If one of them changes, the request is STALE."
    )
    kind: Literal["PROMOTION", "ROLLBACK"]
    needed: int = Field(description="Approvals that make it APPROVED; one refusal blocks.")
    expires_utc: str | None
    assigned_to: int | None = Field(description="The person it is assigned to.")
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    submitted_utc: str
    submitted_by: int
    closed_utc: str | None
    signatures: list[Signature] = Field(default_factory=list)


class Signer(Shape):
    """An approver, and whether they may sign a request now."""

    user_id: int
    printed_name: str
    may_sign: bool
    excluded_as: list[Literal["SUBMITTER", "LAUNCHER", "CREATOR"]] = Field(
        description="What this person did to the set that keeps them from signing: who submitted it, who launched its run or "
        "campaign, who created it."
    )
    refusal: str | None = Field(description="Why they may not sign; null when they may.")


class Remark(Row):
    """A word in the discussion of a request, or in one of its threads; never edited."""

    id: int
    approval_id: int
    user_id: int
    printed_name: str
    text: str
    made_utc: str
    thread_id: int | None = Field(description="The thread it belongs to; null where it is about the whole request.")
    mentions: list[str] | None = Field(description="Log-in names that the text mentions by `@name`.")


class Thread(Row):
    """A discussion of one gate, parameter or figure of a request."""

    versioned_by = ("version",)
    location = "/approvals/{row.approval_id}/threads/{row.id}"

    id: int
    approval_id: int
    kind: Literal["gate", "parameter", "figure"]
    name: str
    state: Literal["OPEN", "RESOLVED"]
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    opened_by: int
    printed_name: str
    opened_utc: str
    resolved_by: int | None
    resolver: str | None = Field(description="Printed name of who resolved it.")
    resolved_utc: str | None
    remarks: list[Remark]


class Opening(Row):
    """A figure of a request stood in sight of the person whom the server gave it to, while the request was open."""

    id: int
    approval_id: int
    user_id: int
    evidence: str
    opened_utc: str


Verdict = Literal["PASS", "MARGINAL", "NO-DATA", "FAIL"]


class GateProfile(Row):
    """The limits that a sensor's sets are held to; each version is kept, the newest is in force."""

    versioned_by = ("number",)
    location = "/sensors/{row.sensor_id}/gate-profiles"

    id: int | None = Field(description="Null for the default that nobody has needed yet.")
    sensor_id: int
    number: int = Field(description='The version; the ETag is `"v<number>"` of the one in force.')
    document: Document = Field(description="`gates`: one object per gate, every key present.")
    sha256: str
    reason: str
    created_utc: str
    created_by: int | None


class TriedProfile(BaseModel):
    """What a profile would have said of a past run."""

    run_id: int
    parameter_set: str | None = Field(description="Name of the set that was made from it.")
    verdict: Verdict
    blocking: list[str] = Field(description="Gates that would have blocked it.")
    verdict_now: Verdict = Field(description="By the profile in force.")
    blocking_now: list[str]
    basis: str = Field(description="What was judged: the set's gate report, or the run's own result.")


class DryRunOfProfile(BaseModel):
    """A profile tried on past runs, newest first."""

    items: list[TriedProfile]


class Waiver(Row):
    """A person let a set pass in spite of a gate; never taken back."""

    id: int
    parameter_set_id: int
    gate_report_id: int
    gate: str
    code: str
    reason: str
    expires_utc: str = Field(description="From this time on the gate blocks again.")
    made_utc: str
    made_by: int
    printed_name: str


class GateReport(Row):
    """A set held against its sensor's limits and against the incumbent, with the waivers laid over it."""

    location = "/parameter-sets/{row.parameter_set_id}/gate-report"

    id: int
    parameter_set_id: int
    gate_profile_id: int
    verdict: Verdict = Field(description="The worst answer that counts and that nobody waived.")
    words: str = Field(description="The verdict with how many gates were ever waived: `PASS (2 gates waived)`.")
    blocking: list[str] = Field(description="Gates that stop approval and promotion now.")
    waived: list[str] = Field(description="Gates with a waiver in force.")
    gates: list[Document] = Field(description="One answer per gate: status, value, interval, limit, margin, sentence.")
    held_out: Document | None = Field(description="The frames that were used: name and SHA-256.")
    bound: Document = Field(description="Hashes of everything that the report is based on.")
    holds: bool = Field(description="Whether all its inputs are unchanged (a promotion changes the incumbent).")
    sha256: str = Field(description="SHA-256 of the report as it was stored, without waivers.")
    created_utc: str
    created_by: int | None
    waivers: list[Waiver]
