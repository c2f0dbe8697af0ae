"""The form for a new sensor, filled from uploaded images or telemetry; nothing is stored until the person sends the form."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastapi import Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import Role
from boresight.console.access.dependencies import ServerSettings, Who
from boresight.console.fleet import proposals
from boresight.console.fleet.pages.sensors import (
    LONGEST_TYPED,
    Proposal,
    SensorsContext,
    compute_optics,
    show_sensors,
)
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext
from boresight.console.telemetry.dependencies import Upload, Uploaded, require_meant
from boresight.errors import BoresightError, NotFoundError, RefusedInputError
from boresight.settings import Settings
from boresight.telemetry.data_sheets import ASKED
from boresight.telemetry.new_sensor import Described, read_typed

router = PageRouter()

#: What is asked beside the stars; all of it may be left out.
ASKED_BESIDE = ("name", "rows", "columns", "pixel_pitch_um")


@router.post("/sensors/propose", response_class=HTMLResponse)
async def propose(request: Request, actor: Who, upload: Uploaded, settings: ServerSettings) -> Response:
    """Solve the stars of the upload, which takes seconds to minutes, and show the form with what they say."""
    require_meant(request, upload)
    proposals.require_registrar(actor)
    typed = {name: upload.fields.get(name, "").strip()[:LONGEST_TYPED] for name in ASKED_BESIDE}
    try:
        described, sentences = await run_in_threadpool(_solve, upload, typed, settings)
    except NotFoundError:
        raise
    except BoresightError as error:
        refusal = RefusalContext.of(error)
        faults = tuple(getattr(error, "faults", ()))
        shown = SensorsContext(refusal=refusal, proposal=Proposal(typed, faults=faults), of_stars=True)
        return await run_in_threadpool(show_sensors, request, actor.roles, shown)
    filled = Proposal(_filled(typed, described), described, _optics(described))
    shown = SensorsContext(filled.text, proposal=filled, sentences=tuple(sentences))
    return await run_in_threadpool(show_sensors, request, actor.roles, shown)


def _solve(upload: Upload, typed: Mapping[str, str], settings: Settings) -> tuple[Described, list[str]]:
    if upload.path is None or not upload.file_name:
        raise RefusedInputError(
            "No file was chosen: choose images of the night sky, or a CSV, JSON Lines or Parquet file."
        )
    known = read_typed(typed, proposals.SUBJECT)
    folder, seconds = settings.catalogue_folder, settings.image_seconds
    if upload.images:
        return proposals.propose_of_images(upload.images, known, folder, settings.image_limits, seconds)
    limits = (settings.telemetry_limits, settings.image_limits)
    return proposals.propose_of_file(upload.path, upload.file_name, known, folder, limits, seconds)


def _optics(described: Described) -> Any:
    document = described.document
    return compute_optics(CAMERA_MODELS[document["camera_model"]], document["detector"], document["initial"])


def _filled(typed: Mapping[str, str], described: Described) -> dict[str, str]:
    """What the form's fields hold of a sensor, as they would have been typed."""
    sensor = described.sensor
    focal_m = sensor.initial[CAMERA_MODELS[sensor.camera_model].place(Role.FOCAL)]
    numbers = {
        "rows": sensor.rows,
        "columns": sensor.columns,
        "pixel_pitch_um": sensor.pixel_pitch_m * 1e6,
        "focal_length_mm": focal_m * 1e3,
        "centroid_sigma_px": sensor.centroid_sigma_px,
        "magnitude_limit": sensor.magnitude_limit,
    }
    texts = {name: f"{value:.7g}" for name, value in numbers.items() if name in ASKED and value is not None}
    return {**typed, **texts, "camera_model": sensor.camera_model, "parity": str(sensor.parity)}
