"""Alarms and their events."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.console.schemas import Document, Row


class Alarm(Row):
    """A condition that needs a person, until it is acknowledged and over."""

    versioned_by = ("version",)

    id: int
    source: str = Field(
        description="What it is about; only one alarm per source is open at a time.", examples=["sensors/3/DRIFT"]
    )
    sensor_id: int | None
    kind: Literal["DRIFT", "AGE", "MISMATCH", "CHAIN", "FILES", "HEAD", "CLOCK", "INGEST", "LINK"]
    level: Literal["critical", "serious", "caution"]
    sentence: str
    state: str = Field(
        "", description="ISA-18.2: unacknowledged or acknowledged, active or returned to normal, shelved."
    )
    active: bool
    acknowledged: bool
    evidence: Document = Field(description="The evidence behind the sentence.")
    raised_utc: str
    returned_utc: str | None
    shelved_until_utc: str | None
    assigned_to: int | None
    version: int = Field(description='Counts its changes; the ETag is `"v<version>"`.')
    closed_utc: str | None


class AlarmEvent(Row):
    """A step in an alarm's life; never edited."""

    id: int
    alarm_id: int
    event: str
    user_id: int | None
    printed_name: str
    text: str
    at_utc: str
