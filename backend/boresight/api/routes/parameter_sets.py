"""Parameter sets: make one of a run, submit, roll back, withdraw, promote."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Held, Reading, SeenVersion, Who, Writing, etag
from boresight.api.keeping import Known
from boresight.api.measured import Measured
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import conversions, parameter_sets

router = APIRouter(prefix="/parameter-sets", tags=["parameter sets"])


class FromRun(BaseModel):
    """Which run's result becomes a candidate."""

    model_config = ConfigDict(extra="forbid")
    run_id: Id


class Submission(BaseModel):
    """Why this set should become the baseline."""

    model_config = ConfigDict(extra="forbid")
    reason: str = Field(examples=["Focal length moved by 4 sigma since launch; held-out RMS is 12 % lower."])


class RollBack(BaseModel):
    """Why the sensor should go back to this set."""

    model_config = ConfigDict(extra="forbid")
    reason: str = Field(examples=["PS-ST-1-4 loses stars at the rim since the pass of this morning."])


class Withdrawal(BaseModel):
    """Why a request is taken back."""

    model_config = ConfigDict(extra="forbid")
    reason: str = ""


def _answer(row: Any, status: int = 200, **headers: str) -> Answer:
    return Answer(schemas.written(schemas.ParameterSet, row), status, {"ETag": etag(row.version), **headers})


@router.get("", name="list_parameter_sets", summary="List parameter sets", response_model=Page[schemas.ParameterSet])
def list_parameter_sets(
    known: Known,  # noqa: ARG001 - asked for what it refuses
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    ground_state: Annotated[str | None, Query(examples=["BASELINE"])] = None,
) -> Response:
    """List parameter sets, newest first."""
    found = parameter_sets.list_parameter_sets(
        session, sensor_id=sensor_id, ground_state=ground_state, before_id=page.last_id, limit=page.limit + 1
    )
    return json_response(page.cut(found, lambda row: schemas.written(schemas.ParameterSet, row)))


@router.post(
    "",
    name="create_parameter_set",
    summary="Make a candidate of a run",
    status_code=201,
    response_model=schemas.ParameterSet,
    responses=refusals(404, 409),
)
def create_parameter_set(source: FromRun, actor: Who, once: Idempotent, session: Writing, request: Request) -> Response:
    """Make an immutable candidate of a finished run; asked again for that run, the same one comes back."""

    def act() -> Answer:
        row = parameter_sets.create_from_run(session, actor, request.app.state.blobs, source.run_id)
        return _answer(row, 201, Location=f"/api/v1/parameter-sets/{row.id}")

    return once.answer(session, actor, act)


@router.get(
    "/{parameter_set_id}",
    name="get_parameter_set",
    summary="Read a parameter set",
    response_model=schemas.ParameterSet,
    responses=refusals(404),
)
def get_parameter_set(
    parameter_set_id: Id,
    known: Known,  # noqa: ARG001 - asked for what it refuses
    session: Reading,
) -> Response:
    """Read a parameter set; the ETag is for its transitions."""
    return _answer(parameter_sets.get_parameter_set(session, parameter_set_id)).response()


@router.get(
    "/{parameter_set_id}/conversion",
    name="convert_parameter_set",
    summary="Read it in another camera model",
    response_model=schemas.Conversion,
    responses=refusals(404),
)
def convert_parameter_set(
    parameter_set_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    to: Annotated[str, Query(examples=["pinhole_radial"], description="The other camera model.")],
    allow_px: Annotated[
        float | None,
        Query(ge=0, allow_inf_nan=False, description="Largest misfit; 1 % of centroid_sigma_px when left out."),
    ] = None,
) -> Response:
    """Write this set in another camera model: values, covariance and misfit, or the reason why it cannot be. Nothing is kept."""
    return json_response(conversions.conversion_of(session, parameter_set_id, to, allow_px))


def _opened(row: Any) -> Answer:
    headers = {"ETag": etag(row.version), "Location": f"/api/v1/approvals/{row.id}"}
    return Answer(schemas.written(schemas.Approval, row), 201, headers)


@router.post(
    "/{parameter_set_id}:submit",
    name="submit_parameter_set",
    summary="Submit for approval",
    status_code=201,
    response_model=schemas.Approval,
    responses=refusals(404, 409, 412, 428),
)
def submit_parameter_set(
    parameter_set_id: Id,
    submission: Submission,
    actor: Who,
    seen: SeenVersion,
    once: Idempotent,
    measured: Measured,
    session: Writing,
    request: Request,
) -> Response:
    """Ask that this set become the baseline. It is held against its gates, and the request binds what was found."""
    state = request.app.state
    asked = (state.blobs, parameter_set_id, submission.reason, seen, measured)
    return once.answer(
        session, actor, lambda: _opened(parameter_sets.submit(session, actor, *asked, policy=state.policy))
    )


@router.post(
    "/{parameter_set_id}:roll-back",
    name="roll_back_parameter_set",
    summary="Ask to go back to a former baseline",
    status_code=201,
    response_model=schemas.Approval,
    responses=refusals(404, 409, 412, 428),
)
def roll_back_parameter_set(
    parameter_set_id: Id,
    back: RollBack,
    actor: Who,
    seen: SeenVersion,
    once: Idempotent,
    measured: Measured,
    session: Writing,
    request: Request,
) -> Response:
    """Ask that a superseded set become the baseline again; it is signed and promoted like any other, in less time."""
    state = request.app.state
    asked = (state.blobs, parameter_set_id, back.reason, seen, measured)
    return once.answer(
        session, actor, lambda: _opened(parameter_sets.roll_back(session, actor, *asked, policy=state.policy))
    )


@router.post(
    "/{parameter_set_id}:withdraw",
    name="withdraw_parameter_set",
    summary="Take the request back",
    response_model=schemas.ParameterSet,
    responses=refusals(404, 409, 412, 428),
)
def withdraw_parameter_set(
    parameter_set_id: Id,
    actor: Who,
    seen: SeenVersion,
    once: Idempotent,
    session: Writing,
    withdrawal: Withdrawal | None = None,
) -> Response:
    """Take the request for a submitted or approved set back."""
    reason = withdrawal.reason if withdrawal else ""
    return once.answer(
        session, actor, lambda: _answer(parameter_sets.withdraw(session, actor, parameter_set_id, seen, reason))
    )


@router.post(
    "/{parameter_set_id}:promote",
    name="promote_parameter_set",
    summary="Make it the baseline",
    response_model=schemas.ParameterSet,
    responses=refusals(404, 409, 412, 428),
)
def promote_parameter_set(
    parameter_set_id: Id, actor: Who, seen: SeenVersion, once: Idempotent, policy: Held, session: Writing
) -> Response:
    """Make an approved set the sensor's baseline; the one before is superseded in the same transaction."""

    def act() -> Answer:
        return _answer(parameter_sets.promote(session, actor, parameter_set_id, seen, policy=policy))

    return once.answer(session, actor, act)
