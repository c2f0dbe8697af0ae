"""Alignments of two sensors: ask for one, follow it, read its result, its figure and the numbers behind it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import Query
from pydantic import Field
from starlette.responses import Response

from boresight.calibration.alignment.align import AlignmentOptions
from boresight.console.access.dependencies import Blobs, Reading, Who, Writing
from boresight.console.alignments import schemas, service
from boresight.console.alignments.tables import Alignment
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
    succeed, and telemetry without common hours. It is evidence: nobody approves it, and no uplink package contains it. The result
    is what `boresight table encode --alignment` takes.
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
