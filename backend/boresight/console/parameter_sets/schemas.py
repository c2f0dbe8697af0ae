"""Parameter sets, and what one is in another camera model."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.calibration.calibration import Covariance
from boresight.console.schemas import Document, Row, Shape, Values


class ParameterSet(Row):
    """Camera parameters with their covariance, immutable; only the two states move."""

    versioned_by = ("version",)
    location = "/parameter-sets/{row.id}"

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


class Conversion(Shape):
    """A parameter set in another camera model."""

    document_schema: Literal["boresight.parameters/1"] = Field(alias="schema")
    sensor: str
    camera_model: str
    parameters: Values
    units: dict[str, str]
    sigma: Values
    covariance: Covariance | None
    conversion: Document = Field(
        description="What it was converted from, and how far the two differ over the detector."
    )
