"""Ingest policies and decisions as JSON."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.console.schemas import Document, Row

PolicyState = Literal["DRAFT", "ACTIVE", "PAUSED", "OFF"]
DecisionState = Literal[
    "CALIBRATING", "WITHIN FORECAST", "UNCONFIRMED", "ASKED", "ANSWERED", "SUPERSEDED", "NOT JUDGED", "REFUSED"
]


class IngestPolicy(Row):
    """A version of a sensor's policy for new telemetry."""

    versioned_by = ("version",)
    location = "/ingest-policies/{row.id}"

    id: int
    sensor_id: int
    number: int
    document: Document = Field(description="Its rules.")
    sha256: str
    reason: str
    created_utc: str
    created_by: int | None
    state: PolicyState
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    rehearsal: Document | None = Field(description="What it would have asked in the past; null until it is rehearsed.")
    rehearsed_utc: str | None
    enabled_utc: str | None
    pause_code: str | None = Field(description="Why it is paused, for programs.", examples=["BAD CLOCK"])
    pause_reason: str | None
    paused_utc: str | None
    resumed_utc: str | None = Field(description="Limits count from here.")


class IngestDecision(Row):
    """What was made of one file of new telemetry."""

    versioned_by = ("version",)
    location = "/ingest-decisions/{row.id}"

    id: int
    sensor_id: int
    policy_id: int
    source: Literal["FOLDER", "REST", "ARCHIVE", "BUCKET"]
    file_name: str
    file_sha256: str | None
    size_bytes: int
    received_utc: str
    received_by: int | None = Field(description="Who sent it; null for the watched folder and an archive.")
    telemetry_set_id: int | None
    run_id: int | None
    parameter_set_id: int | None = Field(description="The candidate that was prepared, where people are asked.")
    approval_id: int | None = Field(description="The request for approval that a person's answer opened.")
    state: DecisionState
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    sentence: str
    evidence: Document = Field(
        description="`reasons` with code and sentence; `holds` and `forecast`, the tests against baseline and line; `gates`; "
        "`alternatives` with the one that is `recommended`; `recalibrate`, what the sensor's trend advised then."
    )
    decided_utc: str | None
    answer: Literal["SUBMIT", "WAIT", "MORE DATA", "RECALIBRATE"] | None
    answer_reason: str | None
    answered_utc: str | None
    answered_by: int | None
    quiet_until_utc: str | None
