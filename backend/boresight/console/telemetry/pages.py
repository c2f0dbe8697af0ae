"""Telemetry sets: the list, uploading one, and the quality report of one with the runs that used it."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import orjson
from fastapi import Depends, Form, Request
from fastapi.concurrency import contextmanager_in_threadpool, run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.calibration.diagnosis.result import Diagnosis
from boresight.console.access.dependencies import (
    KNOWN,
    Blobs,
    Database,
    DryRunSources,
    Reading,
    Roles,
    ServerSettings,
    Who,
    csrf,
)
from boresight.console.fleet import service as sensors
from boresight.console.fleet.pages.sensors import list_sensor_choices
from boresight.console.fleet.tables import Sensor
from boresight.console.operation import RowWithFields
from boresight.console.pages.drawings import Drawing, detector_map, histogram, number_bars
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    AttemptResult,
    RefusalContext,
    attempt,
    make_change,
    read_again,
    redirect,
    render,
)
from boresight.console.pages.tables import (
    Table,
    TableColumn,
    accept_one,
    is_number,
    is_text,
    read_all,
    read_page,
    read_view,
    write_csv,
)
from boresight.console.runs import queries as run_queries
from boresight.console.runs.pages.list import RunNames, make_run_line, read_names
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.telemetry.dependencies import Upload, Uploaded, hold_upload, require_meant
from boresight.console.telemetry.profiles import archive_profile, list_offers, list_profiles, save_profile
from boresight.console.telemetry.service import PURPOSES, OtherCameraError, PreparedUpload
from boresight.console.telemetry.tables import ImportProfile, TelemetrySet, find_diagnosis, find_quality
from boresight.errors import BoresightError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_role
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.sessions import Engine, Session, open_reading
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.web.paging import parse_row_id
from boresight.settings import Settings
from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.imports.profile import Profile
from boresight.telemetry.quality.report import QualityReport, RadialCoverage
from boresight.telemetry.read.formats import parse_json

SCRIPTED = "x-boresight-upload"  # sent by the script that shows an upload's progress

router = PageRouter()


SETS = Table(
    "telemetry",
    "Telemetry sets",
    (
        TableColumn("quality", "Quality", csv=("verdict",)),
        TableColumn("set", "Set", "set", "name", head=True, csv=("set", "name", "purpose", "archived_utc")),
        TableColumn("sensor", "Sensor", "sensor", "nowrap", csv=("sensor",)),
        TableColumn("frames", "Frames", "-frames", "num", csv=("frames",)),
        TableColumn("stars", "Stars", "-stars", "num", csv=("stars",)),
        TableColumn(
            "unmatched", "Unmatched", "-unmatched", "num", "Detections without a star number", csv=("unmatched_share",)
        ),
        TableColumn("begins", "Begins, span", "", "tight", csv=("start_utc", "span_s")),
        TableColumn(
            "temperature",
            "Temperature",
            "",
            "num",
            "Lowest and highest of the set",
            "°C",
            optional=True,
            csv=("smallest_temperature_c", "largest_temperature_c"),
        ),
        TableColumn("uploaded", "Uploaded", "-uploaded", "tight", csv=("uploaded_utc", "uploaded_by")),
    ),
    {
        "sensor": is_number,
        "sensor_name": is_text,
        "purpose": accept_one(PURPOSES),
        "archived": accept_one({"1"}),
        "q": is_text,
    },
    "-uploaded",
    kind="dense",
)


@dataclass(frozen=True)
class TelemetryContext:
    """The state of the upload form: its choices and why it was refused.

    `guessed`: nobody chose the profile of the preview; `draft`: its JSON, where it was drafted.
    """

    sensor: int | None = None
    find: str = ""
    purpose: str = PURPOSES[0]
    refusal: RefusalContext | None = None
    profile: str = ""
    time: str = ""
    elements: str = ""
    preview: dict[str, Any] | None = None
    guessed: bool = False
    draft: str = ""

    @property
    def sensors(self) -> tuple[tuple[int, str], ...]:
        """The sensors whose camera a refused set is of, by number and name."""
        error = None if self.refusal is None else self.refusal.error
        return error.sensors if isinstance(error, OtherCameraError) else ()

    @property
    def keepable(self) -> bool:
        """Whether such a set can be kept where it was sent."""
        error = None if self.refusal is None else self.refusal.error
        return isinstance(error, OtherCameraError) and error.keepable


def _page(
    request: Request, roles: frozenset[str], limit_mb: float, shown: TelemetryContext, session: Session
) -> HTMLResponse:
    view = read_view(request, SETS)
    found = read_page(session, view, **view.hide_archived())
    return render(
        request,
        "telemetry/telemetry.html",
        refused=shown.refusal,
        view=view,
        sets=found.rows,
        reports={row.id: find_quality(row.quality) for row in found.rows},
        last=found.last,
        choices=list_sensor_choices(session, view, find=shown.find, keep=[shown.sensor] if shown.sensor else []),
        names=read_names(session, sensors_of=found.rows),
        purposes=PURPOSES,
        profiles=list_offers(session),
        may_upload="analyst" in roles,
        limit_mb=limit_mb,
        shown=shown,
    )


@router.get("/telemetry", response_class=HTMLResponse)
def telemetry_page(request: Request, session: Reading, roles: Roles, settings: ServerSettings) -> HTMLResponse:
    """Show a page of sets, and the form."""
    sensor = read_view(request, SETS).where.get("sensor")
    query = request.query_params
    shown = TelemetryContext(parse_row_id(sensor or ""), query.get("find", ""), profile=query.get("profile", ""))
    return _page(request, roles, settings.upload_limit_mb, shown, session)


@router.get("/telemetry.csv", dependencies=[KNOWN])
def telemetry_csv(request: Request, session: Reading) -> Response:
    """Give every set of a view as CSV."""
    view, names = read_view(request, SETS), read_names(session, sensors_of=None)
    rows = (_csv_row(row, names) for row in read_all(session, view, **view.hide_archived()))
    return write_csv(view, rows)


def _csv_row(row: TelemetrySet, names: RunNames) -> RowWithFields:
    quality = find_quality(row.quality)
    time, temperature = quality.time, quality.temperature_c
    return RowWithFields(
        row,
        set=row.id,
        verdict=quality.verdict,
        sensor=names.sensors[row.sensor_id],
        unmatched_share=quality.unmatched_share,
        start_utc=time.start_utc if time else None,
        span_s=time.span_s if time else None,
        smallest_temperature_c=temperature.smallest if temperature else None,
        largest_temperature_c=temperature.largest if temperature else None,
        uploaded_by=names.person(row.uploaded_by),
    )


@router.post("/telemetry", response_class=HTMLResponse)
async def upload(
    request: Request,
    actor: Who,
    upload: Uploaded,
    settings: ServerSettings,
    forecast_sources: DryRunSources,
    engine: Database,
) -> Response:
    """Check and store the file, then show its quality report."""
    require_meant(request, upload)
    if upload.fields.get("instead"):  # the sensor whose camera it is, by the button that offers it
        upload = replace(upload, fields={**upload.fields, "sensor_id": upload.fields["instead"]})
    prepared = _prepared(actor, upload, settings, forecast_sources, engine)
    if upload.fields.get("preview"):
        shown = await _previewed(upload, prepared, engine)
        return await read_again(request, partial(_page, request, actor.roles, settings.upload_limit_mb, shown))
    outcome = await _attempt(request, actor, upload, forecast_sources.blobs, prepared)
    if outcome.value is None:
        shown = _refused(upload, outcome.refusal)
        return await read_again(request, partial(_page, request, actor.roles, settings.upload_limit_mb, shown))
    row = outcome.value
    response = redirect(f"/telemetry/{row.id}", flash=f"{row.name} is telemetry set {row.id}.")
    if SCRIPTED in request.headers:
        response.status_code = 201  # a script follows no redirect on its own: it opens the Location
    return response


async def _previewed(
    upload: Upload, checking: AbstractContextManager[PreparedUpload], engine: Engine
) -> TelemetryContext:
    """Import and check a form's file by the profile that is chosen or fits best, and store nothing."""
    try:
        async with contextmanager_in_threadpool(checking) as prepared:
            if prepared.imported is None:
                raise RefusedInputError("The file was not imported: choose its mapping profile.")
            told, shown = prepared.imported.to_preview(), _refused(upload, None)
            draft = "" if prepared.imported.draft is None else _write_profile(prepared.imported.draft.profile)
            key = shown.profile or await run_in_threadpool(_find_key, engine, prepared.imported.profile)
            return replace(shown, preview=told, guessed=not shown.profile, profile=key, draft=draft)
    except BoresightError as error:
        return _refused(upload, RefusalContext.of(error))


def _find_key(engine: Engine, profile: Profile) -> str:
    """Return what the form names an offered profile by."""
    with open_reading(engine) as session:
        return next((offer.key for offer in list_offers(session) if offer.profile == profile), "")


async def _attempt(
    request: Request,
    actor: Actor,
    upload: Upload,
    blobs: BlobStore,
    checking: AbstractContextManager[PreparedUpload],
) -> AttemptResult[TelemetrySet]:
    try:
        async with contextmanager_in_threadpool(checking) as prepared:
            return await attempt(request, partial(_store, actor, blobs, upload, prepared))
    except BoresightError as error:
        return AttemptResult(None, RefusalContext.of(error))


@contextmanager
def _prepared(
    actor: Actor, upload: Upload, settings: Settings, forecast_sources: ForecastSources, engine: Engine
) -> Iterator[PreparedUpload]:
    require_role(actor, "analyst")
    if parse_row_id(upload.fields.get("sensor_id", "")) is None:
        raise RefusedInputError("Choose the sensor of this telemetry.")
    if upload.path is None or not upload.file_name:
        raise RefusedInputError("No file was chosen: choose telemetry, images, or a file that a mapping profile reads.")
    with hold_upload(upload, settings, forecast_sources, engine) as prepared:
        yield prepared


def _store(actor: Actor, blobs: BlobStore, upload: Upload, prepared: PreparedUpload, session: Session) -> TelemetrySet:
    purpose = upload.fields.get("purpose", PURPOSES[0])
    return telemetry_sets.store_prepared(session, actor, blobs, upload.number("sensor_id"), prepared, purpose)


def _refused(upload: Upload, refusal: RefusalContext | None) -> TelemetryContext:
    sensor, purpose = upload.fields.get("sensor_id", ""), upload.fields.get("purpose", "")
    known = purpose if purpose in PURPOSES else PURPOSES[0]
    typed: dict[str, Any] = {name: upload.fields.get(name, "") for name in ("profile", "time", "elements")}
    return TelemetryContext(parse_row_id(sensor), purpose=known, refusal=refusal, **typed)


profile_router = PageRouter(dependencies=[Depends(csrf)])


def _profiles_page(
    request: Request, actor: Actor, typed: str, refusal: RefusalContext | None, session: Session
) -> HTMLResponse:
    offers = [offer for offer in list_offers(session) if offer.key in BUILT_IN]
    return render(
        request,
        "telemetry/profiles.html",
        refused=refusal,
        own=offers,
        saved=list_profiles(session, archived=True),
        typed=typed,
        refusal=refusal,
        people=read_names(session).people,
        may="analyst" in actor.roles,
    )


@profile_router.get("/import-profiles", response_class=HTMLResponse)
def profiles_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """List every mapping profile, and offer one to begin from, named in the address by `from`."""
    start = request.query_params.get("from", "")
    profile = next((offer.profile for offer in list_offers(session) if offer.key == start), None)
    typed = "" if profile is None else _write_profile(profile)
    return _profiles_page(request, actor, typed, None, session)


def _write_profile(profile: Profile) -> str:
    return json.dumps(profile.to_dict(), indent=2, ensure_ascii=False)


@profile_router.post("/import-profiles", response_class=HTMLResponse)
async def save(request: Request, actor: Who, document: Annotated[str, Form()]) -> Response:
    """Save a profile's next version."""

    def change(session: Session) -> ImportProfile:
        return save_profile(session, actor, _parsed_profile(document))

    outcome = await attempt(request, change)
    if outcome.refusal is not None:
        return await read_again(request, partial(_profiles_page, request, actor, document, outcome.refusal))
    saved = f"{outcome.made.name}, version {outcome.made.number}, is saved and chosen: choose the file, and upload it."
    return redirect(f"/telemetry?profile={outcome.made.id}", flash=saved)


def _parsed_profile(text: str) -> dict[str, Any]:
    try:
        document = parse_json(text)
    except ValueError as error:
        raise RefusedInputError(f"The profile is not JSON ({error}): correct it.") from error
    if not isinstance(document, dict):
        raise RefusedInputError("The profile is not a JSON object: begin with a brace.")
    return document


@profile_router.post("/import-profiles/{profile_id:int}/archive", response_class=HTMLResponse)
async def archive_version(request: Request, actor: Who, profile_id: int) -> Response:
    """Archive a version."""
    change = partial(archive_profile, actor=actor, profile_id=profile_id)
    return await make_change(request, change, "/import-profiles", "Archived: no longer available for new imports.")


RUNS_SHOWN = 100

telemetry_set_router = PageRouter(dependencies=[Depends(csrf)])


def make_drawings(quality: QualityReport) -> list[Drawing]:
    """Lay out the figures of a quality report; those without data are left out."""
    found = []
    if quality.detector_coverage is not None:
        found.append(detector_map(quality.detector_coverage))
    if (radial := quality.radial_coverage) is not None:
        found.append(
            histogram(
                radial.edges_px,
                radial.counts,
                name="radial-coverage",
                title="Radial coverage",
                x_title="distance from the detector's centre (px)",
                y_title="usable stars",
                mark=_edge_of_data(radial),
                extent=radial.corner_radius_px,
            )
        )
    if quality.stars_per_exposure is not None:
        found.append(
            number_bars(
                quality.stars_per_exposure.usable,
                name="stars-per-exposure",
                title="Stars in an exposure",
                x_title="usable stars in an exposure",
                y_title="exposures",
            )
        )
    if quality.magnitudes is not None:
        found.append(
            histogram(
                quality.magnitudes.edges,
                quality.magnitudes.counts,
                name="magnitudes",
                title="Magnitudes",
                x_title="magnitude",
                y_title="detections",
            )
        )
    return found


def _edge_of_data(radial: RadialCoverage) -> tuple[float, str] | None:
    """Return where the data end, beyond which a distortion is extrapolated."""
    largest = radial.largest_radius_px
    return None if largest is None else (largest, "no data beyond: distortion is extrapolated there")


@telemetry_set_router.get("/telemetry/{set_id}", response_class=HTMLResponse)
def telemetry_set_page(request: Request, session: Reading, actor: Who, set_id: int) -> HTMLResponse:
    """Show a set with its quality report."""
    row = session.get_known(TelemetrySet, set_id)
    quality = find_quality(row.quality)
    used_by, uses = run_queries.list_runs_of_set(session, row.id, RUNS_SHOWN)
    names = read_names(session, used_by, sensors_of=[row])
    blob = session.get(Blob, row.original_sha256)
    return render(
        request,
        "telemetry/telemetry_set.html",
        row=row,
        quality=quality,
        drawings=make_drawings(quality),
        names=names,
        size_bytes=blob.size_bytes if blob else None,
        runs=[make_run_line(run, names) for run in used_by],
        uses=uses,
        is_analyst="analyst" in actor.roles,
        diagnosis=find_diagnosis(row.quality),
        sensor=session.get_known(Sensor, row.sensor_id),
    )


@telemetry_set_router.get("/telemetry/{set_id}/figures/{name}.csv", dependencies=[KNOWN])
def figure_csv(session: Reading, set_id: int, name: str) -> Response:
    """Give a figure's numbers as CSV."""
    row = session.get_known(TelemetrySet, set_id)
    drawings = {drawing.name: drawing for drawing in make_drawings(find_quality(row.quality))}
    drawing = drawings.get(name)
    if drawing is None:
        raise NotFoundError(
            f"The quality report of telemetry set {set_id} has no figure {name}; choose from {', '.join(drawings)}."
        )
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow([drawing.x_title, drawing.y_title])
    writer.writerows(drawing.rows)
    headers = {"Content-Disposition": f'attachment; filename="telemetry-{set_id}-{drawing.name}.csv"'}
    return Response(text.getvalue(), media_type="text/csv", headers=headers)


@telemetry_set_router.get("/telemetry/{set_id}/images/{frame}.png", dependencies=[KNOWN])
def frame_image(
    request: Request, session: Reading, blobs: Blobs, settings: ServerSettings, set_id: int, frame: int
) -> Response:
    """Give the image of a frame as a picture; its bytes never change, so a browser keeps it."""
    tag = f'"{session.get_known(TelemetrySet, set_id).original_sha256[:32]}-{frame}"'
    headers = {"ETag": tag, "Cache-Control": "private, max-age=86400"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    picture = telemetry_sets.draw_image(session, blobs, set_id, frame, settings.image_limits)
    return Response(picture, media_type="image/png", headers=headers)


@telemetry_set_router.get("/telemetry/{set_id}/mended-sensor.json", dependencies=[KNOWN])
def mended_sensor(session: Reading, set_id: int) -> Response:
    """Give the sensor file as the diagnosis of a set mends it."""
    found = telemetry_sets.get_diagnosis(session.get_known(TelemetrySet, set_id))
    headers = {"Content-Disposition": f'attachment; filename="telemetry-{set_id}-sensor.json"'}
    return Response(
        orjson.dumps(found.sensor_document, option=orjson.OPT_INDENT_2), media_type="application/json", headers=headers
    )


@telemetry_set_router.post("/telemetry/{set_id}/diagnose")
async def diagnose(
    request: Request, actor: Who, set_id: int, forecast_sources: DryRunSources, engine: Database
) -> Response:
    """Diagnose a set, and show what was found."""
    outcome = await _with(request, _searched(actor, set_id, forecast_sources, engine), partial(_keep, actor, set_id))
    if outcome.refusal is not None:
        raise outcome.refusal.error
    return redirect(f"/telemetry/{set_id}", flash=f"{outcome.made.name} is diagnosed.")


def _keep(actor: Actor, set_id: int, found: Diagnosis, session: Session) -> TelemetrySet:
    return telemetry_sets.record_diagnosis(session, actor, set_id, found)


@contextmanager
def _searched(actor: Actor, set_id: int, forecast_sources: ForecastSources, engine: Engine) -> Iterator[Diagnosis]:
    """Search before the writing transaction."""
    row, document = _read_set(actor, set_id, engine)
    yield telemetry_sets.diagnose_stored(document, row, forecast_sources)


def _read_set(actor: Actor, set_id: int, engine: Engine) -> tuple[TelemetrySet, Mapping[str, Any]]:
    require_role(actor, "analyst")
    with open_reading(engine) as session:
        row = session.get_known(TelemetrySet, set_id)
        return row, session.get_known(Sensor, row.sensor_id).document


async def _with(
    request: Request, prepared: AbstractContextManager[Any], change: Callable[[Any, Session], TelemetrySet]
) -> AttemptResult[TelemetrySet]:
    """Write what takes seconds to make, which is made first and not on the server's own thread."""
    try:
        async with contextmanager_in_threadpool(prepared) as made:
            return await attempt(request, lambda session: change(made, session))
    except BoresightError as error:
        return AttemptResult(None, RefusalContext.of(error))


@telemetry_set_router.post("/telemetry/{set_id}/accept-sensor")
async def accept_sensor(request: Request, actor: Who, set_id: int) -> Response:
    """Change the sensor as the diagnosis of a set mends it."""
    version = parse_row_id(str((await request.form()).get("version", "")))
    outcome = await attempt(request, partial(_mend_sensor, actor, set_id, version))
    if outcome.refusal is not None:
        raise outcome.refusal.error
    flash = f"{outcome.made.name} was corrected; new runs use the corrected file. Diagnose the set again to check that it matches."
    return redirect(f"/telemetry/{set_id}", flash=flash)


def _mend_sensor(actor: Actor, set_id: int, version: int | None, session: Session) -> Sensor:
    """Change the sensor of a set as the set's diagnosis mends it; what else was changed of it since stays."""
    row = session.get_known(TelemetrySet, set_id)
    document = session.get_known(Sensor, row.sensor_id).document
    mended = telemetry_sets.mend_document(document, telemetry_sets.get_diagnosis(row))
    return sensors.edit_sensor(session, actor, row.sensor_id, mended, version)


@telemetry_set_router.post("/telemetry/{set_id}/accept-as-new-sensor")
async def accept_as_new_sensor(
    request: Request,
    actor: Who,
    set_id: int,
    forecast_sources: DryRunSources,
    engine: Database,
    settings: ServerSettings,
    name: Annotated[str, Form(max_length=sensors.LONGEST_NAME)] = "",
) -> Response:
    """Register the sensor as the diagnosis of a set mends it under another name, with the set."""
    made = _held_for_new_sensor(actor, set_id, name.strip(), forecast_sources, engine, settings)
    outcome = await _with(
        request, made, partial(_store_with_new_sensor, actor, forecast_sources.blobs, set_id, name.strip())
    )
    if outcome.refusal is not None:
        raise outcome.refusal.error
    row = outcome.made
    return redirect(
        f"/telemetry/{row.id}",
        flash=f"{name.strip()} is registered as the diagnosis says, and {row.name} is its telemetry set {row.id}.",
    )


@contextmanager
def _held_for_new_sensor(
    actor: Actor, set_id: int, name: str, forecast_sources: ForecastSources, engine: Engine, settings: Settings
) -> Iterator[PreparedUpload]:
    row, document = _read_set(actor, set_id, engine)
    with open_reading(engine) as session:
        sensors.require_new_name(session, name)  # before what takes long
    with telemetry_sets.hold_for_new_sensor(document, row, forecast_sources, name, settings.telemetry_limits) as made:
        yield made


def _store_with_new_sensor(
    actor: Actor, blobs: BlobStore, set_id: int, name: str, prepared: PreparedUpload, session: Session
) -> TelemetrySet:
    row = session.get_known(TelemetrySet, set_id)
    document = session.get_known(Sensor, row.sensor_id).document
    mended = telemetry_sets.mend_document(document, telemetry_sets.get_diagnosis(row)) | {"name": name}
    made = sensors.register_sensor(session, actor, mended)
    return telemetry_sets.store_prepared(session, actor, blobs, made.id, prepared, row.purpose)


@telemetry_set_router.post("/telemetry/{set_id}/accept-mapping")
async def accept_mapping(
    request: Request,
    actor: Who,
    set_id: int,
    forecast_sources: DryRunSources,
    engine: Database,
    settings: ServerSettings,
) -> Response:
    """Store a set again as its diagnosis says that it is to be read."""
    made = _mapped(actor, set_id, forecast_sources, engine, settings)
    outcome = await _with(request, made, partial(_store_mapped, actor, forecast_sources.blobs, set_id))
    if outcome.refusal is not None:
        raise outcome.refusal.error
    row = outcome.made
    return redirect(
        f"/telemetry/{row.id}", flash=f"{row.name} is telemetry set {row.id}, corrected as the diagnosis says."
    )


@contextmanager
def _mapped(
    actor: Actor, set_id: int, forecast_sources: ForecastSources, engine: Engine, settings: Settings
) -> Iterator[PreparedUpload]:
    row, document = _read_set(actor, set_id, engine)
    with telemetry_sets.hold_mapped(document, row, forecast_sources, settings.telemetry_limits) as prepared:
        yield prepared


def _store_mapped(
    actor: Actor, blobs: BlobStore, set_id: int, prepared: PreparedUpload, session: Session
) -> TelemetrySet:
    row = session.get_known(TelemetrySet, set_id)
    return telemetry_sets.store_prepared(session, actor, blobs, row.sensor_id, prepared, row.purpose)


@telemetry_set_router.post("/telemetry/{set_id}/archive")
async def archive(request: Request, actor: Who, set_id: int) -> Response:
    """Archive a set."""
    change = partial(telemetry_sets.archive_telemetry_set, actor=actor, set_id=set_id)
    outcome = await attempt(request, change)
    if outcome.refusal is not None:
        raise outcome.refusal.error
    return redirect("/telemetry", flash=f"{outcome.made.name} is archived; runs that used it are not affected.")
