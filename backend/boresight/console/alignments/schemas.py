"""Alignments as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from boresight.calibration.alignment import result
from boresight.console.schemas import Document, Row

AlignmentState = Literal["QUEUED", "RUNNING", "SUCCEEDED", "FAILED"]
AlignmentRequestState = Literal["OPEN", "APPROVED", "REJECTED", "WITHDRAWN"]


@dataclass(frozen=True, kw_only=True)
class AlignmentResult(result.Alignment):
    """The alignment JSON, `boresight.alignment/1`, with the report of its gates."""

    gate_report: Document


class AlignmentSummary(Row):
    """The figures of an alignment that lists show; sigmas are of small turns about x, y, z of B."""

    sentence: str
    pairs: int
    pairs_used: int
    reference_utc: str
    quaternion: list[float] = Field(description="Between the frames, x y z w.")
    sigma_arcsec: list[float] = Field(
        description="Its one sigma, with the cameras' error and the scatter of the pairs."
    )
    load_quaternion: list[float] = Field(description="To load with the parameters of both runs, x y z w.")
    load_sigma_arcsec: list[float]


class SensorAlignment(Row):
    """The rotation from one sensor to another from a run of each; this is also the job resource to poll."""

    location = "/alignments/{row.id}"

    id: int
    sensor_a_id: int
    sensor_b_id: int
    run_a_id: int
    run_b_id: int
    options: Document = Field(description="Those that were given.")
    created_utc: str
    created_by: int | None
    state: AlignmentState
    reason: str | None = Field(description="Why it failed.")
    attempt: int
    started_utc: str | None
    ended_utc: str | None
    result_sha256: str | None
    verdict: Literal["PASS", "MARGINAL", "NO-DATA", "FAIL"] | None = Field(description="The worst answer of its gates.")
    summary: AlignmentSummary | None


class AlignmentRequest(Row):
    """A request that an alignment goes on board, with its signature."""

    versioned_by = ("version",)
    location = "/alignment-requests/{row.id}"

    id: int
    alignment_id: int
    result_sha256: str = Field(description="The result that was shown and is signed for.")
    state: AlignmentRequestState
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    reason: str
    submitted_utc: str
    submitted_by: int
    closed_utc: str | None
    signed_by: int | None
    printed_name: str | None = Field(description="Of the signer.")
    meaning: str | None
    comment: str | None
