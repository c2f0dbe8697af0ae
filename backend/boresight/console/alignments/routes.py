"""Alignments of two sensors: ask for one, follow it, read its result, its figure and the numbers behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from fastapi import Query
from pydantic import Field
from starlette.responses import Response

from boresight.calibration.alignment import result
from boresight.calibration.alignment.align import AlignmentOptions
from boresight.console.access.dependencies import (
    Blobs,
    Reading,
    SeenVersion,
    ServerPolicy,
    Who,
    Writing,
    own_password,
)
from boresight.console.access.passwords import PasswordProof
from boresight.console.alignments import approval, queries, service, tables
from boresight.console.approvals.routes import PlainSigning
from boresight.console.list_queries import list_newest
from boresight.console.operation import json_response, operations
from boresight.console.runs.schemas import PlotlyFigure
from boresight.console.schemas import Document, Row, Shape
from boresight.figures import alignment as chart
from boresight.figures import figure_json
from boresight.platform.web.media import CsvFile, csv_response
from boresight.platform.web.paging import Id, Listing, Page, Paged

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
    options: Document = Field(description="The options given.")
    created_utc: str
    created_by: int | None
    state: AlignmentState
    reason: str | None = Field(description="Why it failed.")
    attempt: int
    started_utc: str | None
    ended_utc: str | None
    result_sha256: str | None
    verdict: Literal["PASS", "MARGINAL", "NO-DATA", "FAIL"] | None = Field(description="The worst gate result.")
    summary: AlignmentSummary | None


class AlignmentRequest(Row):
    """A request that an alignment goes on board, with its signature."""

    versioned_by = ("version",)
    location = "/alignment-requests/{row.id}"

    id: int
    alignment_id: int
    result_sha256: str = Field(description="Hash of the result that was shown and signed.")
    state: AlignmentRequestState
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    reason: str
    submitted_utc: str
    submitted_by: int
    closed_utc: str | None
    signed_by: int | None
    printed_name: str | None = Field(description="Name of the signer.")
    meaning: str | None
    comment: str | None


router = operations("/alignments", tags=["alignments"])

USUAL = AlignmentOptions()
IN_CSV: dict[int | str, dict[str, Any]] = {200: {"description": "One row per pair, arcsec."}}


class GivenOptions(Shape):
    """The choices of an alignment, as `boresight align --help` tells them."""

    tolerance_s: float = Field(
        USUAL.tolerance_s, description="How far an attitude may be extrapolated beyond its neighbours."
    )
    longest_gap_s: float = Field(
        USUAL.longest_gap_s, description="The longest interval over which attitudes are interpolated."
    )
    rate_deg_s: float = Field(
        USUAL.rate_deg_s, description="One sigma of a rate that cannot be computed from neighbours."
    )
    temperature_of: Literal["a", "b", "difference"] | None = Field(
        None, description="Whose temperature is used; A's, else B's."
    )
    reference_temperature_c: float | None = Field(
        None, description="Reference temperature of the rotation; null for the mean."
    )
    temperature: int | None = Field(
        None, description="Polynomial order in temperature, 0 to 3; chosen from the data if null."
    )
    drift: bool | None = Field(None, description="Whether it changes linearly per day; chosen from the data if null.")
    robust: bool = Field(USUAL.robust, description="Leave out pairs that are too far off.")


class NewAlignment(Shape):
    """Two runs that succeeded, of two different sensors on one body."""

    run_a_id: Id = Field(description="The rotation leads from its sensor.")
    run_b_id: Id = Field(description="The rotation leads to its sensor.")
    options: GivenOptions | None = None


@router.get("", summary="List alignments", response_model=Page[SensorAlignment])
def list_alignments(
    session: Reading,
    page: Paged,
    sensor_id: Annotated[Id | None, Query(description="A or B of them.")] = None,
    state: Annotated[AlignmentState | None, Query(examples=["SUCCEEDED"])] = None,
) -> Listing[tables.Alignment]:
    """List alignments, newest first."""
    return page.cut(list_newest(session, tables.Alignment, sensor=sensor_id, state=state, **page.rows))


@router.post("", summary="Align two sensors", status_code=202, response_model=SensorAlignment)
def request_alignment(given: NewAlignment, actor: Who, session: Writing) -> tables.Alignment:
    """Queue the alignment of two sensors from a run of each, with their results and their telemetry.

    The server computes it in the background; `Location` is where to follow it. Refused are runs of one sensor, runs that did not
    succeed, and telemetry without common hours. The result is what `boresight table encode --alignment` takes; once it is submitted
    and approved, the uplink packages of A's set contain it.
    """
    options: Document = {} if given.options is None else given.options.model_dump(exclude_unset=True)
    return service.request_alignment(session, actor, given.run_a_id, given.run_b_id, options)


@router.get("/{alignment_id}", summary="Read an alignment", response_model=SensorAlignment)
def get_alignment(alignment_id: Id, session: Reading) -> tables.Alignment:
    """Read an alignment: its state, and when it has succeeded its verdict and its figures."""
    return session.get_known(tables.Alignment, alignment_id)


@router.get("/{alignment_id}/result", summary="Read its result", response_model=AlignmentResult)
def get_alignment_result(alignment_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read the alignment JSON with its gate report; 409 before it has succeeded."""
    return json_response(service.read_document(session, blobs, alignment_id))


@router.get("/{alignment_id}/figure", summary="Read its figure", response_model=PlotlyFigure)
def get_alignment_figure(alignment_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read the angles of its pairs over time and temperature as Plotly JSON."""
    found, _ = service.read_result(session, blobs, alignment_id)
    return Response(figure_json(chart.draw(found)), media_type="application/json")


@router.get("/{alignment_id}/figure/data", summary="Read its pairs", response_class=CsvFile, responses=IN_CSV)
def get_alignment_data(alignment_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read the numbers behind the figure as CSV."""
    found, _ = service.read_result(session, blobs, alignment_id)
    return csv_response(chart.table(found), f"alignment-{alignment_id}.csv")


class Reasoned(Shape):
    """Why."""

    reason: str = Field(examples=["The trackers were calibrated again."])


class AlignmentSigning(PlainSigning):
    """A signature: what it means, and the password again."""

    meaning: str = Field(examples=["I reviewed the evidence and approve this alignment for upload."])


Proven = Annotated[PasswordProof, own_password(AlignmentSigning)]


@router.post("/{alignment_id}:submit", summary="Submit it", status_code=201, response_model=AlignmentRequest)
def submit_alignment(
    alignment_id: Id, given: Reasoned, actor: Who, blobs: Blobs, session: Writing
) -> tables.AlignmentRequest:
    """Ask in person that it go on board with the parameters of both runs; 409 where one of its gates blocks it."""
    return approval.submit(session, actor, blobs, alignment_id, given.reason)


@router.get("/{alignment_id}/requests", summary="List its requests", response_model=Page[AlignmentRequest])
def list_alignment_requests(alignment_id: Id, session: Reading) -> Listing[tables.AlignmentRequest]:
    """List the requests for an alignment, newest first."""
    return Listing(queries.list_requests(session, session.get_known(tables.Alignment, alignment_id).id))


request_router = operations("/alignment-requests", tags=["alignments"])


@request_router.get("", summary="List requests for alignments", response_model=Page[AlignmentRequest])
def list_all_alignment_requests(
    session: Reading,
    page: Paged,
    state: Annotated[AlignmentRequestState | None, Query(examples=["OPEN"])] = None,
    alignment_id: Id | None = None,
) -> Listing[tables.AlignmentRequest]:
    """List the requests that alignments go on board, newest first."""
    return page.cut(list_newest(session, tables.AlignmentRequest, state=state, alignment=alignment_id, **page.rows))


@request_router.get("/{request_id}", summary="Read a request", response_model=AlignmentRequest)
def get_alignment_request(request_id: Id, session: Reading) -> tables.AlignmentRequest:
    """Read a request for an alignment; the ETag is needed to sign."""
    return session.get_known(tables.AlignmentRequest, request_id)


@request_router.post("/{request_id}:approve", summary="Approve an alignment", response_model=AlignmentRequest)
def approve_alignment(
    request_id: Id,
    signed: AlignmentSigning,
    actor: Who,
    seen: SeenVersion,
    proof: Proven,
    policy: ServerPolicy,
    session: Writing,
) -> tables.AlignmentRequest:
    """Approve as a second person, who did not submit it, ask for it or launch its runs; not an administrator, not by API key."""
    return approval.sign(session, actor, request_id, signed.decided("APPROVE"), proof, seen, policy=policy)


@request_router.post("/{request_id}:refuse", summary="Refuse an alignment", response_model=AlignmentRequest)
def refuse_alignment(
    request_id: Id,
    signed: AlignmentSigning,
    actor: Who,
    seen: SeenVersion,
    proof: Proven,
    policy: ServerPolicy,
    session: Writing,
) -> tables.AlignmentRequest:
    """Refuse with a comment, as a second person."""
    return approval.sign(session, actor, request_id, signed.decided("REFUSE"), proof, seen, policy=policy)


@request_router.post("/{request_id}:withdraw", summary="Withdraw it", response_model=AlignmentRequest)
def withdraw_alignment(
    request_id: Id, given: Reasoned, actor: Who, seen: SeenVersion, session: Writing
) -> tables.AlignmentRequest:
    """Take an open request back in person, as the one who submitted it or as an administrator; an approved one stays."""
    return approval.withdraw(session, actor, request_id, given.reason, seen)
