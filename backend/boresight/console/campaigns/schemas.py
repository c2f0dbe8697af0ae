"""Presets, campaigns, and what the sensors of a campaign came to."""

from __future__ import annotations

from pydantic import BaseModel, Field

from boresight.console.schemas import Document, Row


class Campaign(Row):
    """One setting over many sensors."""

    versioned_by = ("id", "cancelled_utc", "newest_id")
    moves_beneath = True  # its counts move under one tag
    location = "/campaigns/{row.id}"

    id: int
    label: str
    preset: str | None
    settings: Document
    launched_utc: str
    launched_by: int | None
    cancelled_utc: str | None
    state: str = Field(
        description="`UNDER WAY`, `CANCELLING`, `CANCELLED`, `SUCCEEDED`, or `ENDED` where a run did not succeed."
    )
    sensors: int
    ended: int = Field(description="Sensors that need no more waiting for.")
    fraction: float = Field(description="0 to 1.")
    counts: dict[str, int] = Field(description="Sensors by the state of their run, or `NOT LAUNCHED`.")


class CampaignResult(Row):
    """What one sensor of a campaign came to; null is what its run has not."""

    id: int
    sensor_id: int
    sensor: str
    run_id: int | None
    state: str = Field(description="Of the run, or `NOT LAUNCHED`.")
    reason: str | None = Field(description="Why it failed, was lost, was cancelled, or could not be launched.")
    rms_initial_arc_rad: float | None
    rms_final_arc_rad: float | None
    validation_rms_initial_arc_rad: float | None
    validation_rms_final_arc_rad: float | None
    status: str | None
    level: str | None = Field(description="The verdict: normal, caution, serious or critical.")
    weak_directions: int | None
    weakest: str | None
    advice: str | None


class RefusedMember(BaseModel):
    """A sensor that could not have a run, and why."""

    sensor_id: int
    sensor: str
    refusal: str


class DryRunOfCampaign(BaseModel):
    """What a campaign would be, from `validate_only=true`."""

    label: str
    preset: str | None
    settings: Document
    sensors: int
    runs: int
    predicted_s: float = Field(description="Of all runs together, seconds of computing.")
    refused: list[RefusedMember]
