"""Runs, their logs, and what a run would be."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from boresight.api.schemas.row import Document, Row

RunState = Literal["QUEUED", "RUNNING", "CANCELLING", "SUCCEEDED", "FAILED", "CANCELLED", "LOST"]


class RunProgress(Row):
    """How far a run is."""

    fraction: float | None = Field(None, description="0 to 1.")
    message: str | None = None
    elapsed_s: float | None = Field(None, description="Since its worker began.")
    at_utc: str | None = Field(None, description="When the worker last reported.")


class Run(Row):
    """A calibration; this is also the job resource to poll."""

    versioned_by = ("id", "state", "attempt")
    moves_beneath = True  # so does its progress
    location = "/runs/{row.id}"

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
    state: str | None = Field(description="The run's new state, where this line changed it.")
    cause: str | None = Field(description="Why the state changed, or why an attempt ended without a result.")
    level: Literal["info", "warning", "error"]
    numbers: dict[str, float] | None = Field(
        description="What the sentence counts: `fraction`, `elapsed_s`, `seconds`."
    )


class Forecast(BaseModel):
    """What a run would know, from a sample of its own stars."""

    model_config = ConfigDict(extra="allow")
    sentence: str
    sigma: dict[str, float | None] = Field(
        description="Predicted one-sigma of each free parameter, SI; null is unknown."
    )
    weak: int | None = Field(description="Directions known worse than half a typical sigma.")
    weak_directions: list[str]
    help: list[str] = Field(description="What would make them known.")
    observability: Document | None
    frames_sampled: int
    frames: int
    at: Literal["fitted", "present"] | None = Field(description="Where the information was taken; null is nowhere.")


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
    predicted_range_s: tuple[float, float] = Field(
        description="Four of five past runs of the method would lie between."
    )
    paced_by: int = Field(description="Past runs that the time follows from; 0 is a guess.")
    forecast: Forecast | None
    warnings: list[str]
