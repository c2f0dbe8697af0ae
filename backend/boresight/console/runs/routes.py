"""Runs: launch, follow, stop; the calibration, its log, its report and its frames; the presets of settings."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import Path, Query
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from boresight.calibration.calibration import Calibration
from boresight.calibration.choice.result import Choice
from boresight.calibration.joint.passes import MOST_PASSES
from boresight.console import schemas as console_schemas
from boresight.console.access.dependencies import (
    SAME_FOR_ALL,
    Blobs,
    DryRunSources,
    IsDryRun,
    Reading,
    SeenTag,
    ServerPolicy,
    ServerSettings,
    Stars,
    Who,
    Writing,
)
from boresight.console.operation import OperationResponse, RowWithFields, json_response, operations
from boresight.console.runs import choices, frames, presets, schemas
from boresight.console.runs import service as runs
from boresight.console.runs.frames import FrameLine
from boresight.console.runs.presets import BUILT_IN, OfferedPreset
from boresight.console.runs.tables import TERMINAL_RUN_STATES, Preset, Run, RunEvent
from boresight.console.schemas import Shape
from boresight.figures import figure_json, held_out_error, passes
from boresight.figures.report import render_report
from boresight.figures.tables import removed_table
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session
from boresight.platform.web.media import CameraFile, CameraFormat, CameraMisfit, CsvFile, WithResidual, csv_response
from boresight.platform.web.paging import GREATEST_ID, Id, Listing, Page, Paged
from boresight.platform.web.response_cache import cover_with_tag

router = operations("/runs", tags=["runs"])
IN_CSV: dict[int | str, dict[str, Any]] = {200: {"description": "One row per candidate, numbers in SI."}}


class Launch(BaseModel):
    """A calibration to be made."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {"sensor_id": 1, "telemetry_set_id": 1, "settings": {"method": "batch"}, "label": "first look"}
            ]
        },
    )
    sensor_id: Id
    telemetry_set_id: Id
    settings: console_schemas.Settings = Field(
        default_factory=dict, description="Method, variant, free parameters and so on."
    )
    validation_set_id: Id | None = Field(
        None, description="A validation set: never fitted, only used to judge the result."
    )
    joint_set_ids: list[Id] = Field(
        default_factory=list,
        max_length=MOST_PASSES - 1,
        description="Further sets of the sensor: all are calibrated together with the first, as one.",
    )
    prior_set_id: Id | None = Field(
        None,
        description="A parameter set, approved or active, to start from with its covariance; sets that it contains count once.",
    )
    prior_run_id: Id | None = Field(None, description="The same from a finished run; give at most one of the two.")
    label: str = ""
    validate_only: bool = Field(default=False, description="Validate only, without changes, and describe the result.")


class Cancellation(Shape):
    """Why a run is stopped."""

    reason: str = ""


@router.get("", summary="List runs", response_model=Page[schemas.Run], dependencies=[SAME_FOR_ALL])
def list_runs(
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    telemetry_set_id: Id | None = None,
    method: str | None = None,
    state: Annotated[list[schemas.RunState] | None, Query(description="Repeat for several.")] = None,
    archived: Annotated[bool, Query(description="Show the archived ones too.")] = False,
) -> Listing[Run]:
    """List runs, newest first."""
    found = runs.list_runs(
        session,
        sensor_id=sensor_id,
        telemetry_set_id=telemetry_set_id,
        method=method,
        state=state,
        archived=archived,
        **page.rows,
    )
    return page.cut(found)


@router.post(
    "",
    summary="Launch a run",
    status_code=202,
    response_model=schemas.Run,
    responses={200: {"model": schemas.DryRun, "description": "The dry run of `validate_only`."}},
)
def launch_run(
    launch: Launch, actor: Who, session: Writing, asked: IsDryRun, forecast_sources: DryRunSources
) -> Run | OperationResponse:
    """Queue a calibration; `Location` is where to follow it. With `validate_only` only describe the run and predict its sigmas."""
    made = runs.launch(
        session,
        actor,
        launch.sensor_id,
        launch.telemetry_set_id,
        launch.settings,
        validation_set_id=launch.validation_set_id,
        joint_set_ids=launch.joint_set_ids,
        prior_run_id=launch.prior_run_id,
        prior_set_id=launch.prior_set_id,
        label=launch.label,
        validate_only=asked or launch.validate_only,
        forecast_sources=forecast_sources,
    )
    return OperationResponse(made, shape=schemas.DryRun, is_trial=True) if isinstance(made, dict) else made


@router.get("/{run_id}", summary="Read a run", response_model=schemas.Run, dependencies=[SAME_FOR_ALL])
def get_run(run_id: Id, session: Reading, request: Request) -> Run:
    """Read a run: its state, its progress, and when it has ended its summary."""
    row = runs.get_run(session, run_id)
    cover_with_tag(request, holds=row.state in TERMINAL_RUN_STATES)  # its progress changes without its tag
    return row


@router.post("/{run_id}:cancel", summary="Cancel a run", response_model=schemas.Run)
def cancel_run(
    run_id: Id, actor: Who, seen: SeenTag, session: Writing, cancellation: Cancellation | None = None
) -> Run:
    """Cancel a run: a queued one ends at once, a running one as soon as it notices. The ETag is that of the run."""
    seen.require(schemas.Run, runs.get_run(session, run_id), f"Run {run_id}")
    return runs.cancel(session, actor, run_id, cancellation.reason if cancellation else "")


@router.post("/{run_id}:archive", summary="Archive a run", response_model=schemas.Run)
def archive_run(run_id: Id, actor: Who, session: Writing) -> Run:
    """Have lists leave out a run that has ended; nothing is deleted."""
    return runs.archive_run(session, actor, run_id)


@router.post("/{run_id}:restore", summary="Show an archived run again", response_model=schemas.Run)
def restore_run(run_id: Id, actor: Who, session: Writing) -> Run:
    """Have lists show a run again."""
    return runs.restore_run(session, actor, run_id)


@router.get("/{run_id}/result", summary="Read the calibration", response_model=Calibration | schemas.NoResult)
def get_run_result(run_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read the calibration JSON; while the run computes, the partial result with status `running`."""
    return json_response(result_so_far(session, blobs, run_id))


@router.post("/{run_id}/choice", summary="Choose a camera", status_code=202, response_model=schemas.Run)
def choose_camera(run_id: Id, actor: Who, session: Writing, blobs: Blobs) -> Run:
    """Queue the choice of the simplest camera model that suffices for the data of a run that has ended.

    The choice is a run of its own; `Location` is where to follow it. Repeated, it returns the existing one, unless that failed.
    """
    return choices.request_choice(session, actor, blobs, run_id)


@router.get("/{run_id}/choice", summary="Read the choice of a camera", response_model=Choice)
def get_run_choice(run_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read which camera model, with which free parameters, the data of a run need, and why; 404 before a choice was launched."""
    return json_response(choices.get_choice(session, blobs, run_id).to_dict())


@router.get("/{run_id}/choice/figure", summary="Read its figure", response_model=schemas.PlotlyFigure)
def get_run_choice_figure(run_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read the error of every candidate on held-out frames as Plotly JSON."""
    figure = held_out_error.draw(choices.get_choice(session, blobs, run_id))
    return Response(figure_json(figure), media_type="application/json")


@router.get("/{run_id}/choice/data", summary="Read its numbers", response_class=CsvFile, responses=IN_CSV)
def get_run_choice_data(run_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read the numbers behind the figure as CSV."""
    return csv_response(held_out_error.table(choices.get_choice(session, blobs, run_id)), f"run-{run_id}-held-out.csv")


@router.get("/{run_id}/passes/figure", summary="Read the figure of its passes", response_model=schemas.PlotlyFigure)
def get_run_passes_figure(run_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read what varies from pass to pass of a joint run that has ended as Plotly JSON."""
    figure = passes.draw(runs.get_final_calibration(session, blobs, run_id))
    return Response(figure_json(figure), media_type="application/json")


@router.get(
    "/{run_id}/passes/data",
    summary="Read its passes",
    response_class=CsvFile,
    responses={200: {"description": "One row per pass, numbers in SI; none where the run is of one set."}},
)
def get_run_passes_data(run_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read the passes of a joint run that has ended as CSV: size, chi-square, and what varies with its sigma."""
    found = runs.get_final_calibration(session, blobs, run_id)
    return csv_response(passes.table(found), f"run-{run_id}-passes.csv")


@router.get(
    "/{run_id}/removed/data",
    summary="Read the removed stars",
    response_class=CsvFile,
    responses={200: {"description": "One row per removed star; the first 10,000."}},
)
def get_run_removed_data(run_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read which proposed stars were removed from a run that has ended, and why, as CSV."""
    found = runs.get_final_calibration(session, blobs, run_id)
    return csv_response(removed_table(found), f"run-{run_id}-removed.csv")


@router.get("/{run_id}/log", summary="Read the log", response_model=Page[schemas.LogLine], dependencies=[SAME_FOR_ALL])
def get_run_log(run_id: Id, session: Reading, page: Paged) -> Listing[RunEvent]:
    """Read a run's log in the order it happened."""
    return page.cut(runs.list_log_lines(session, run_id, after_id=page.last_id or 0, limit=page.limit + 1))


@router.get("/{run_id}/report", summary="Read the report", response_class=HTMLResponse)
def get_run_report(run_id: Id, session: Reading, blobs: Blobs, policy: ServerPolicy) -> HTMLResponse:
    """Read the report of a run that has ended: one HTML file that needs nothing else, figures included."""
    report = render_report(runs.get_final_calibration(session, blobs, run_id), four_eyes=policy.four_eyes)
    headers = {"Content-Disposition": f'attachment; filename="run-{run_id}-report.html"'}
    return HTMLResponse(report, headers=headers)


@router.get("/{run_id}/camera-file", summary="Read its camera as a file of another program", response_class=CameraFile)
def get_run_camera_file(
    run_id: Id,
    session: Reading,
    blobs: Blobs,
    to: CameraFormat,
    allow_px: CameraMisfit = None,
    *,
    residual: WithResidual = False,
) -> Response:
    """Write the camera that this run found for another program, or say why not.

    FITS has a header for each exposure, which takes telemetry: `boresight convert` writes it.
    """
    content, name = runs.export_run(session, blobs, run_id, to, allow_px, with_residual=residual)
    return CameraFile(content, name)


def result_so_far(session: Session, blobs: BlobStore, run_id: Id) -> dict[str, Any]:
    """Return a run's calibration, complete or partial; before there is one, a document with the status only."""
    found = runs.find_result(session, blobs, run_id)
    if found is not None:
        return found
    state = runs.get_run(session, run_id).state
    status = "running" if state in {"QUEUED", "RUNNING", "CANCELLING"} else "none"
    return {"schema": "boresight.calibration/1", "status": status, "run_state": state}


preset_router = operations("/presets", tags=["runs"])


class NewPreset(Shape):
    """Settings to keep under a name."""

    name: str = Field(examples=["Thermal season"])
    sentence: str = Field(description="When to use it.", examples=["While the radiator faces the Sun."])
    settings: console_schemas.Settings = Field(default_factory=dict)


def _own(offer: OfferedPreset) -> RowWithFields:
    return RowWithFields(offer, **dict.fromkeys(("id", "number", "created_utc", "created_by", "archived_utc")))


def _saved(row: Preset) -> RowWithFields:
    return RowWithFields(row, key=str(row.id), settings=row.document)


@preset_router.get("", summary="List presets", response_model=Page[schemas.Preset])
def list_presets(session: Reading, page: Paged, archived: bool = False) -> Listing[RowWithFields]:
    """List saved versions, newest first, with the archived ones where asked; the first page begins with Boresight's own."""
    found = presets.list_presets(session, archived=archived, **page.rows)
    saved = page.cut(found, _saved)
    own = [_own(offer) for offer in BUILT_IN] if page.last_id is None else []
    return Listing([*own, *saved.items], saved.next)


@preset_router.post("", summary="Save a preset", status_code=201, response_model=schemas.Preset)
def save_preset(preset: NewPreset, actor: Who, session: Writing) -> RowWithFields:
    """Save settings under a name; an existing name gets its next version."""
    return _saved(presets.save_preset(session, actor, preset.name, preset.sentence, preset.settings))


@preset_router.get("/{preset_id}", summary="Read a preset", response_model=schemas.Preset)
def get_preset(preset_id: Id, session: Reading) -> RowWithFields:
    """Read a saved version, archived or not."""
    return _saved(presets.get_preset(session, preset_id))


@preset_router.post("/{preset_id}:archive", summary="Archive a preset", response_model=schemas.Preset)
def archive_preset(preset_id: Id, actor: Who, seen: SeenTag, session: Writing) -> RowWithFields:
    """Stop offering a version; nothing is deleted."""
    seen.require(schemas.Preset, presets.get_preset(session, preset_id), f"Preset {preset_id}")
    return _saved(presets.archive_preset(session, actor, preset_id))


Order = Annotated[
    Literal["frame", "worst"],
    Query(description="`worst`: those with the worst fit first, at most a few hundred."),
]
FrameNumber = Annotated[int, Path(ge=-GREATEST_ID, le=GREATEST_ID, description="Its number in the telemetry.")]


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
