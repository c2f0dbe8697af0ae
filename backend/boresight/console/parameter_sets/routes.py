"""Parameter sets: make one of a run, submit, roll back, withdraw, promote."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query
from pydantic import Field, SecretStr
from starlette.responses import Response

from boresight.cameras import CAMERA_MODELS, DEFAULT_CAMERA
from boresight.console import list_queries as lists
from boresight.console.access.dependencies import (
    SAME_FOR_ALL,
    Blobs,
    Reading,
    SeenVersion,
    ServerPolicy,
    Who,
    Writing,
    factor_field,
    own_factor,
)
from boresight.console.access.second_factors import GivenFactor
from boresight.console.approvals import schemas as approval_schemas
from boresight.console.approvals import service as approvals
from boresight.console.approvals.dependencies import AssessedBefore
from boresight.console.approvals.tables import Approval
from boresight.console.operation import json_response, operations
from boresight.console.parameter_sets import schemas, service
from boresight.console.parameter_sets import service as conversions
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.schemas import Shape
from boresight.platform.web.media import CameraFile, CameraFormat, CameraMisfit, WithResidual
from boresight.platform.web.paging import Id, Listing, Page, Paged

router = operations("/parameter-sets", tags=["parameter sets"])


class FromRun(Shape):
    """Which run's result becomes a candidate."""

    run_id: Id


class Submission(Shape):
    """Why this set should become the baseline."""

    reason: str = Field(examples=["Focal length moved by 4 sigma since launch; validation RMS is 12 % lower."])


class RollBack(Shape):
    """Why the sensor should go back to this set."""

    reason: str = Field(examples=["PS-ST-1-4 has lost stars near the edge since this morning's pass."])


class PromotionRequest(Shape):
    """Why this set becomes the baseline now."""

    reason: str = Field(
        "",
        description="Required where BORESIGHT_PROMOTION_REASON or BORESIGHT_REST_REVIEW is 1.",
        examples=["To be loaded in tonight's pass."],
    )
    factor: SecretStr = factor_field()


class Withdrawal(Shape):
    """Why a request is taken back."""

    reason: str = ""


@router.get("", summary="List parameter sets", response_model=Page[schemas.ParameterSet], dependencies=[SAME_FOR_ALL])
def list_parameter_sets(
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    ground_state: Annotated[str | None, Query(examples=["BASELINE"])] = None,
) -> Listing[ParameterSet]:
    """List parameter sets, newest first."""
    return page.cut(lists.list_newest(session, ParameterSet, **page.rows, sensor=sensor_id, state=ground_state))


@router.post("", summary="Create a candidate from a run", status_code=201, response_model=schemas.ParameterSet)
def create_parameter_set(source: FromRun, actor: Who, session: Writing, blobs: Blobs) -> ParameterSet:
    """Create an immutable candidate from a finished run; repeated for that run, the same one is returned."""
    return service.create_from_run(session, actor, blobs, source.run_id)


@router.get(
    "/{parameter_set_id}",
    summary="Read a parameter set",
    response_model=schemas.ParameterSet,
    dependencies=[SAME_FOR_ALL],
)
def get_parameter_set(parameter_set_id: Id, session: Reading) -> ParameterSet:
    """Read a parameter set; the ETag is needed for its transitions."""
    return session.get_known(ParameterSet, parameter_set_id)


@router.get(
    "/{parameter_set_id}/conversion", summary="Read it in another camera model", response_model=schemas.Conversion
)
def convert_parameter_set(
    parameter_set_id: Id,
    session: Reading,
    to: Annotated[
        str,
        Query(
            examples=[next(name for name in CAMERA_MODELS if name != DEFAULT_CAMERA.name)],
            description="The other camera model.",
        ),
    ],
    allow_px: Annotated[
        float | None,
        Query(ge=0, allow_inf_nan=False, description="Largest misfit; 1 % of centroid_sigma_px if omitted."),
    ] = None,
    *,
    residual: WithResidual = False,
) -> Response:
    """Write this set in another camera model: values, covariance and misfit, or why that is impossible. Nothing is stored."""
    return json_response(
        conversions.convert_parameter_set(session, parameter_set_id, to, allow_px, with_residual=residual)
    )


@router.get(
    "/{parameter_set_id}/camera-file", summary="Read its camera as a file of another program", response_class=CameraFile
)
def get_parameter_set_camera_file(
    parameter_set_id: Id,
    session: Reading,
    to: CameraFormat,
    allow_px: CameraMisfit = None,
    *,
    residual: WithResidual = False,
) -> Response:
    """Write the camera of this set for another program, or say why not.

    FITS has a header for each exposure, which takes telemetry: `boresight convert` writes it.
    """
    content, name = conversions.export_parameter_set(session, parameter_set_id, to, allow_px, with_residual=residual)
    return CameraFile(content, name)


@router.post(
    "/{parameter_set_id}:submit",
    summary="Submit for approval",
    status_code=201,
    response_model=approval_schemas.Approval,
)
def submit_parameter_set(
    parameter_set_id: Id,
    submission: Submission,
    actor: Who,
    seen: SeenVersion,
    measured: AssessedBefore,
    policy: ServerPolicy,
    session: Writing,
    blobs: Blobs,
) -> Approval:
    """Request that this set become the baseline. Its gates are assessed, and the request binds the report."""
    return approvals.submit(session, actor, blobs, parameter_set_id, submission.reason, seen, measured, policy=policy)


@router.post(
    "/{parameter_set_id}:roll-back",
    summary="Request a roll-back",
    status_code=201,
    response_model=approval_schemas.Approval,
)
def roll_back_parameter_set(
    parameter_set_id: Id,
    back: RollBack,
    actor: Who,
    seen: SeenVersion,
    measured: AssessedBefore,
    policy: ServerPolicy,
    session: Writing,
    blobs: Blobs,
) -> Approval:
    """Request that a superseded set become the baseline again; it is signed and promoted like any other, but sooner."""
    return approvals.roll_back(session, actor, blobs, parameter_set_id, back.reason, seen, measured, policy=policy)


@router.post("/{parameter_set_id}:withdraw", summary="Withdraw the request", response_model=schemas.ParameterSet)
def withdraw_parameter_set(
    parameter_set_id: Id, actor: Who, seen: SeenVersion, session: Writing, withdrawal: Withdrawal | None = None
) -> ParameterSet:
    """Withdraw the request for a submitted or approved set."""
    reason = withdrawal.reason if withdrawal else ""
    return approvals.withdraw(session, actor, parameter_set_id, seen, reason)


@router.post("/{parameter_set_id}:promote", summary="Promote to baseline", response_model=schemas.ParameterSet)
def promote_parameter_set(
    parameter_set_id: Id,
    actor: Who,
    seen: SeenVersion,
    policy: ServerPolicy,
    factor: Annotated[GivenFactor, own_factor(PromotionRequest | None)],
    session: Writing,
    given: PromotionRequest | None = None,
) -> ParameterSet:
    """Make an approved set the sensor's baseline; the one before is superseded in the same transaction.

    A person who is logged in and has a second factor gives it; a key needs none.
    """
    reason = given.reason if given else ""
    return approvals.promote(session, actor, parameter_set_id, seen, reason, policy=policy, factor=factor)
