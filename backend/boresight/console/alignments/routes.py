"""Alignments of two sensors: ask for one, follow it, read its result, its figure and the numbers behind it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import Query
from pydantic import Field
from starlette.responses import Response

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
from boresight.console.alignments import approval, queries, schemas, service
from boresight.console.alignments.tables import Alignment, AlignmentRequest
from boresight.console.approvals.routes import PlainSigning
from boresight.console.list_queries import list_newest
from boresight.console.operation import json_response, operations
from boresight.console.runs.schemas import PlotlyFigure
from boresight.console.schemas import Document, Shape
from boresight.figures import alignment as chart
from boresight.figures import figure_json
from boresight.platform.web.media import CsvFile, csv_response
from boresight.platform.web.paging import Id, Listing, Page, Paged

router = operations("/alignments", tags=["alignments"])

USUAL = AlignmentOptions()
IN_CSV: dict[int | str, dict[str, Any]] = {200: {"description": "One row a pair, arcsec."}}


class GivenOptions(Shape):
    """The choices of an alignment, as `boresight align --help` tells them."""

    tolerance_s: float = Field(USUAL.tolerance_s, description="How far an attitude is carried beyond its neighbours.")
    longest_gap_s: float = Field(USUAL.longest_gap_s, description="Between attitudes that are interpolated.")
    rate_deg_s: float = Field(USUAL.rate_deg_s, description="One sigma of a rate that no neighbour tells.")
    temperature_of: Literal["a", "b", "difference"] | None = Field(None, description="Whose counts; A's, else B's.")
    reference_temperature_c: float | None = Field(None, description="Where the rotation is told; null for the mean.")
    temperature: int | None = Field(None, description="Highest power of the temperature, 0 to 3; null for evidence.")
    drift: bool | None = Field(None, description="Whether it has a change a day; null for evidence.")
    robust: bool = Field(USUAL.robust, description="Leave out pairs that are too far off.")


class NewAlignment(Shape):
    """Two runs that succeeded, of two different sensors on one body."""

    run_a_id: Id = Field(description="The rotation leads from its sensor.")
    run_b_id: Id = Field(description="The rotation leads to its sensor.")
    options: GivenOptions | None = None


@router.get("", summary="List alignments", response_model=Page[schemas.SensorAlignment])
def list_alignments(
    session: Reading,
    page: Paged,
    sensor_id: Annotated[Id | None, Query(description="A or B of them.")] = None,
    state: Annotated[schemas.AlignmentState | None, Query(examples=["SUCCEEDED"])] = None,
) -> Listing[Alignment]:
    """List alignments, newest first."""
    return page.cut(list_newest(session, Alignment, sensor=sensor_id, state=state, **page.rows))


@router.post("", summary="Align two sensors", status_code=202, response_model=schemas.SensorAlignment)
def request_alignment(given: NewAlignment, actor: Who, session: Writing) -> Alignment:
    """Queue the alignment of two sensors from a run of each, with their results and their telemetry.

    The server computes it in the background; `Location` is where to follow it. Refused are runs of one sensor, runs that did not
    succeed, and telemetry without common hours. The result is what `boresight table encode --alignment` takes; once it is submitted
    and approved, the uplink packages of A's set contain it.
    """
    options: Document = {} if given.options is None else given.options.model_dump(exclude_unset=True)
    return service.request_alignment(session, actor, given.run_a_id, given.run_b_id, options)


@router.get("/{alignment_id}", summary="Read an alignment", response_model=schemas.SensorAlignment)
def get_alignment(alignment_id: Id, session: Reading) -> Alignment:
    """Read an alignment: its state, and when it has succeeded its verdict and its figures."""
    return session.get_known(Alignment, alignment_id)


@router.get("/{alignment_id}/result", summary="Read its result", response_model=schemas.AlignmentResult)
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

    reason: str = Field(examples=["The trackers were calibrated anew."])


class AlignmentSigning(PlainSigning):
    """A signature: what it means, and the password again."""

    meaning: str = Field(examples=["I reviewed the evidence and approve this alignment for upload."])


Proven = Annotated[PasswordProof, own_password(AlignmentSigning)]


@router.post("/{alignment_id}:submit", summary="Submit it", status_code=201, response_model=schemas.AlignmentRequest)
def submit_alignment(alignment_id: Id, given: Reasoned, actor: Who, blobs: Blobs, session: Writing) -> AlignmentRequest:
    """Ask in person that it go on board with the parameters of both runs; 409 where one of its gates blocks it."""
    return approval.submit(session, actor, blobs, alignment_id, given.reason)


@router.get("/{alignment_id}/requests", summary="List its requests", response_model=Page[schemas.AlignmentRequest])
def list_alignment_requests(alignment_id: Id, session: Reading) -> Listing[AlignmentRequest]:
    """List the requests for an alignment, newest first."""
    return Listing(queries.list_requests(session, session.get_known(Alignment, alignment_id).id))


request_router = operations("/alignment-requests", tags=["alignments"])


@request_router.get("", summary="List requests for alignments", response_model=Page[schemas.AlignmentRequest])
def list_all_alignment_requests(
    session: Reading,
    page: Paged,
    state: Annotated[schemas.AlignmentRequestState | None, Query(examples=["OPEN"])] = None,
    alignment_id: Id | None = None,
) -> Listing[AlignmentRequest]:
    """List the requests that alignments go on board, newest first."""
    return page.cut(list_newest(session, AlignmentRequest, state=state, alignment=alignment_id, **page.rows))


@request_router.get("/{request_id}", summary="Read a request", response_model=schemas.AlignmentRequest)
def get_alignment_request(request_id: Id, session: Reading) -> AlignmentRequest:
    """Read a request for an alignment; the ETag is needed to sign."""
    return session.get_known(AlignmentRequest, request_id)


@request_router.post("/{request_id}:approve", summary="Approve an alignment", response_model=schemas.AlignmentRequest)
def approve_alignment(
    request_id: Id,
    signed: AlignmentSigning,
    actor: Who,
    seen: SeenVersion,
    proof: Proven,
    policy: ServerPolicy,
    session: Writing,
) -> AlignmentRequest:
    """Approve as a second person, who did not submit it, ask for it or launch its runs; not an administrator, not by API key."""
    return approval.sign(session, actor, request_id, signed.decided("APPROVE"), proof, seen, policy=policy)


@request_router.post("/{request_id}:refuse", summary="Refuse an alignment", response_model=schemas.AlignmentRequest)
def refuse_alignment(
    request_id: Id,
    signed: AlignmentSigning,
    actor: Who,
    seen: SeenVersion,
    proof: Proven,
    policy: ServerPolicy,
    session: Writing,
) -> AlignmentRequest:
    """Refuse with a comment, as a second person."""
    return approval.sign(session, actor, request_id, signed.decided("REFUSE"), proof, seen, policy=policy)


@request_router.post("/{request_id}:withdraw", summary="Withdraw it", response_model=schemas.AlignmentRequest)
def withdraw_alignment(
    request_id: Id, given: Reasoned, actor: Who, seen: SeenVersion, session: Writing
) -> AlignmentRequest:
    """Take an open request back in person, as the one who submitted it or as an administrator; an approved one stays."""
    return approval.withdraw(session, actor, request_id, given.reason, seen)
