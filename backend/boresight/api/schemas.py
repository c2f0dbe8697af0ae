"""The shapes of answers, as the OpenAPI document shows them: a row of the store as JSON.

A list and a single item show the same members. Times are ISO 8601 in UTC. Large documents (a calibration, a figure) have
addresses of their own.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Document = dict[str, Any]


class Row(BaseModel):
    """A row of the store, read by its columns."""

    model_config = ConfigDict(from_attributes=True)


def written(shape: type[Row], row: Any) -> Document:
    """Write a row in one of the shapes below."""
    return shape.model_validate(row).model_dump(mode="json")


class Sensor(Row):
    """A star tracker."""

    id: int
    name: str
    version: int = Field(description='Counts edits; the ETag is `"v<version>"`.')
    document: Document = Field(description="The sensor file.")
    simulated: bool = Field(description="Whether its telemetry was made here.")
    truth: Document | None = Field(description="True parameters of a simulated sensor.")
    created_utc: str
    created_by: int | None


class TelemetrySet(Row):
    """An uploaded telemetry file."""

    id: int
    sensor_id: int
    name: str
    purpose: Literal["calibration", "validation"]
    frames: int
    stars: int
    quality: Document = Field(description="What the file is good for: counts, gaps, coverage, warnings.")
    original_sha256: str = Field(description="SHA-256 of the bytes that were uploaded.")
    table_sha256: str = Field(description="SHA-256 of the Parquet table that runs work on.")
    uploaded_utc: str
    uploaded_by: int | None
    archived_utc: str | None


RunState = Literal["QUEUED", "RUNNING", "CANCELLING", "SUCCEEDED", "FAILED", "CANCELLED", "LOST"]


class RunProgress(Row):
    """How far a run is."""

    fraction: float | None = Field(None, description="0 to 1.")
    message: str | None = None


class Run(Row):
    """A calibration; this is also the job resource to poll."""

    id: int
    sensor_id: int
    telemetry_set_id: int
    validation_set_id: int | None
    label: str
    method: str
    settings: Document
    state: RunState
    reason: str | None = Field(description="Why it failed, was lost or was cancelled.")
    attempt: int = Field(description="Grows when a worker or server was lost under it.")
    progress: RunProgress | None
    summary: Document | None = Field(description="The figures of a finished run that lists show.")
    result_sha256: str | None
    launched_utc: str
    launched_by: int | None
    started_utc: str | None
    ended_utc: str | None


class LogLine(Row):
    """One line of a run's log."""

    id: int
    attempt: int
    at_utc: str
    kind: str = Field(description="`state`, `log` or `lost`.")
    message: str


class ParameterSet(Row):
    """Camera parameters with their covariance, immutable; only the two states move."""

    id: int
    name: str
    sensor_id: int
    number: int
    run_id: int | None = Field(description="Null for the ground calibration.")
    sha256: str = Field(description="SHA-256 of the canonical JSON of `document`.")
    document: Document
    ground_state: str
    onboard_state: str = Field(description="From recorded read-backs only.")
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    created_utc: str
    created_by: int | None
    baseline_from_utc: str | None
    baseline_to_utc: str | None


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
    signatures: list[Signature] = []


class Uplink(Row):
    """What was recorded about a set on board."""

    id: int
    parameter_set_id: int
    onboard_state: str
    source: str
    recorded_utc: str
    recorded_by: int


class AuditRecord(Row):
    """One record of the hash-chained log."""

    id: int
    at_utc: str
    actor_id: int | None
    actor: str
    credential: str
    action: str
    object: str
    before: Document | None
    after: Document | None
    reason: str | None
    request_id: str | None
    previous_hash: str
    hash: str


class User(Row):
    """A person."""

    id: int
    name: str
    printed_name: str
    roles: list[str]
    created_utc: str
    disabled_utc: str | None


class ApiKey(Row):
    """A key, without its secret."""

    id: int
    user_id: int
    label: str
    prefix: str
    scopes: list[str]
    created_utc: str
    expires_utc: str | None
    revoked_utc: str | None


class NewApiKey(ApiKey):
    """A key just made."""

    secret: str | None = Field(description="Shown this once; null when the answer is replayed.")


class Session(BaseModel):
    """Who is acting, and the token that unsafe requests repeat."""

    user_id: int | None
    name: str
    printed_name: str
    roles: list[str]
    credential: str
    scopes: list[str] | None = Field(description="Of an API key; null for a person.")
    csrf_token: str | None = Field(description="For `X-CSRF-Token`; null with an API key.")


class ChainReport(Row):
    """What a walk along the audit chain found."""

    ok: bool
    records: int
    head: str
    first_broken_id: int | None
    sentence: str


class DryRun(BaseModel):
    """What a run would be, from `validate_only=true`."""

    model_config = ConfigDict(extra="allow")
    sensor: str
    telemetry_set: str
    frames: int
    stars: int
    pairs: int
    free: list[str]
    predicted_s: float
    warnings: list[str]
