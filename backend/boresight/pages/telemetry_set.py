"""One telemetry set: the quality report before any run, and the runs that used it."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Reading, Who, csrf
from boresight.errors import NotFoundError
from boresight.pages.attempts import attempt
from boresight.pages.drawings import Drawing, detector_map, histogram, number_bars
from boresight.pages.rendering import redirect, render
from boresight.pages.runs import line_of, read_names
from boresight.services import runs, telemetry_sets
from boresight.store.tables import Blob

RUNS_SHOWN = 100

router = APIRouter(dependencies=[Depends(csrf)])


def drawings_of(quality: Mapping[str, Any]) -> list[Drawing]:
    """Lay out the figures of a quality report; what it has no data for is left out."""
    found = [detector_map(quality["detector_coverage"])]
    radial = quality["radial_coverage"]
    found.append(
        histogram(
            radial["edges_px"],
            radial["counts"],
            name="radial-coverage",
            title="Radial coverage",
            x_title="distance from the detector's centre (px)",
            y_title="usable stars",
            mark=_edge_of_data(radial),
            extent=radial["corner_radius_px"],
        )
    )
    found.append(
        number_bars(
            quality["stars_per_exposure"]["usable"],
            name="stars-per-exposure",
            title="Stars in an exposure",
            x_title="usable stars in an exposure",
            y_title="exposures",
        )
    )
    if quality.get("magnitudes"):
        magnitudes = quality["magnitudes"]
        found.append(
            histogram(
                magnitudes["edges"],
                magnitudes["counts"],
                name="magnitudes",
                title="Magnitudes",
                x_title="magnitude",
                y_title="detections",
            )
        )
    return found


def _edge_of_data(radial: Mapping[str, Any]) -> tuple[float, str] | None:
    """Return where the data end, beyond which a distortion is extrapolated."""
    largest = radial.get("largest_radius_px")
    return None if largest is None else (largest, "no data beyond: distortion is extrapolated there")


@router.get("/telemetry/{set_id}", response_class=HTMLResponse)
def telemetry_set_page(request: Request, session: Reading, actor: Who, set_id: int) -> HTMLResponse:
    """Show a set with its quality report."""
    row = telemetry_sets.get_telemetry_set(session, set_id)
    used_by, uses = runs.runs_of_set(session, row.id, RUNS_SHOWN)
    names = read_names(session, used_by, sensors_of=[row])
    blob = session.get(Blob, row.original_sha256)
    return render(
        request,
        "telemetry/telemetry_set.html",
        row=row,
        quality=row.quality,
        drawings=drawings_of(row.quality),
        names=names,
        size_bytes=blob.size_bytes if blob else None,
        runs=[line_of(run, names) for run in used_by],
        uses=uses,
        is_analyst="analyst" in actor.roles,
    )


@router.get("/telemetry/{set_id}/figures/{name}.csv")
def figure_csv(session: Reading, actor: Who, set_id: int, name: str) -> Response:  # noqa: ARG001 - whoever is known may read
    """Give a figure's numbers as CSV.

    Raises
    ------
    NotFoundError
        When the report has no such figure.
    """
    row = telemetry_sets.get_telemetry_set(session, set_id)
    drawing = next((it for it in drawings_of(row.quality) if it.name == name), None)
    if drawing is None:
        raise NotFoundError(f"The quality report of telemetry set {set_id} has no figure {name}.")
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow([drawing.x_title, drawing.y_title])
    writer.writerows(drawing.rows)
    headers = {"Content-Disposition": f'attachment; filename="telemetry-{set_id}-{drawing.name}.csv"'}
    return Response(text.getvalue(), media_type="text/csv", headers=headers)


@router.post("/telemetry/{set_id}/archive")
async def archive(request: Request, actor: Who, set_id: int) -> Response:
    """Put a set out of sight."""
    change = partial(telemetry_sets.archive_telemetry_set, actor=actor, set_id=set_id)
    outcome = await attempt(request, change)
    if outcome.refusal is not None:
        raise outcome.refusal.error
    return redirect("/telemetry", flash=f"{outcome.made.name} is archived; runs that used it keep it.")
