"""Frames of a run: listed, worst first where asked, and one with every star, residual and attitude."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Path, Query
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.dependencies import Blobs, Reading, ServerSettings, Stars
from boresight.api.numbers import GREATEST_ID, Id
from boresight.api.operation import json_response, operations
from boresight.api.paging import Listing, Page, Paged
from boresight.services import frames
from boresight.services.frames import FrameLine

router = operations("/runs", tags=["runs"])

Order = Annotated[
    Literal["frame", "worst"],
    Query(description="`worst`: those that the result explains worst, at most a few hundred, first."),
]
FrameNumber = Annotated[int, Path(ge=-GREATEST_ID, le=GREATEST_ID, description="As the telemetry numbers it.")]


@router.get("/{run_id}/frames", summary="List the frames", response_model=Page[schemas.FrameLine])
def list_frames(run_id: Id, session: Reading, blobs: Blobs, page: Paged, order: Order = "frame") -> Listing[FrameLine]:
    """List the frames of a run's calibration set."""
    return page.cut(
        frames.list_frames(session, blobs, run_id, order=order, after=page.last_id or 0, limit=page.limit + 1)
    )


@router.get("/{run_id}/frames/{frame}", summary="Read a frame", response_model=schemas.RunFrame)
def get_frame(
    run_id: Id, frame: FrameNumber, session: Reading, blobs: Blobs, stars: Stars, settings: ServerSettings
) -> Response:
    """Read one frame: its stars, matches, residuals and attitudes under the old and the new parameters."""
    return json_response(frames.get_frame(session, blobs, stars(), settings.catalogue_folder, run_id, frame))
