"""Gate profiles, gate reports and waivers."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from boresight.api.schemas.row import Document, Row

Verdict = Literal["PASS", "MARGINAL", "NO-DATA", "FAIL"]


class GateProfile(Row):
    """The limits that a sensor's sets are held to; each version is kept, the newest is in force."""

    versioned_by = ("number",)
    location = "/sensors/{row.sensor_id}/gate-profiles"

    id: int | None = Field(description="Null of the default that nobody has needed yet.")
    sensor_id: int
    number: int = Field(description='The version; the ETag is `"v<number>"` of the one in force.')
    document: Document = Field(description="`gates`: one object a gate, every key present.")
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
    expires_utc: str = Field(description="From then on the gate blocks again.")
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
    waived: list[str] = Field(description="Gates with a waiver that holds now.")
    gates: list[Document] = Field(description="One answer a gate: status, value, interval, limit, margin, sentence.")
    held_out: Document | None = Field(description="The frames that were looked at: name and SHA-256.")
    bound: Document = Field(description="Hashes of all that the report rests on.")
    holds: bool = Field(description="Whether all that it rests on is as it was; a promotion moves the incumbent.")
    sha256: str = Field(description="SHA-256 of the report as it was stored, without waivers.")
    created_utc: str
    created_by: int | None
    waivers: list[Waiver]
