"""Frames of a run: listed, worst first where asked, and one with every star, residual and attitude."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import json_response
from boresight.api.dependencies import Reading, Who
from boresight.api.numbers import GREATEST_ID, Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import frames

router = APIRouter(prefix="/runs", tags=["runs"])

Order = Annotated[
    Literal["frame", "worst"],
    Query(description="`worst`: those that the result explains worst, at most a few hundred, first."),
]
FrameNumber = Annotated[int, Path(ge=-GREATEST_ID, le=GREATEST_ID, description="As the telemetry numbers it.")]


@router.get(
    "/{run_id}/frames",
    name="list_frames",
    summary="List the frames",
    response_model=Page[schemas.FrameLine],
    responses=refusals(404, 409),
)
def list_frames(
    run_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    request: Request,
    page: Paged,
    order: Order = "frame",
) -> Response:
    """List the frames of a run's calibration set."""
    found = frames.list_frames(
        session, request.app.state.blobs, run_id, order=order, after=page.last_id or 0, limit=page.limit + 1
    )
    return json_response(page.cut(found, lambda line: schemas.written(schemas.FrameLine, line)))


@router.get(
    "/{run_id}/frames/{frame}",
    name="get_frame",
    summary="Read a frame",
    response_model=schemas.RunFrame,
    responses=refusals(404, 409),
)
def get_frame(
    run_id: Id,
    frame: FrameNumber,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    request: Request,
) -> Response:
    """Read one frame: its stars, matches, residuals and attitudes under the old and the new parameters."""
    state = request.app.state
    return json_response(
        frames.get_frame(session, state.blobs, state.catalogue(), state.settings.catalogue_folder, run_id, frame)
    )
