"""Gate profiles of a sensor: the limits in force and before, setting others, trying some on past runs."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Held, OnlyAsked, Reading, SeenVersion, Who, Writing, etag
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.api.routes.change_proposals import PROPOSED, answer
from boresight.services import gate_profiles, second_person
from boresight.store.tables import ChangeProposal

router = APIRouter(prefix="/sensors", tags=["gates"])

GATES = Field(
    description="One object a gate that differs from the default; keys that are left out are the default's.",
    examples=[[{"name": "validation-rms", "limit": 2.0, "marginal": 1.3, "must_have_data": True}]],
)


class Limits(BaseModel):
    """A profile to try."""

    model_config = ConfigDict(extra="forbid")
    gates: list[dict[str, Any]] = GATES


class NewProfile(Limits):
    """A profile to put into force, and why."""

    reason: str = Field(examples=["Two lost passes in October: validation is needed from now on."])


@router.get(
    "/{sensor_id}/gate-profiles",
    name="list_gate_profiles",
    summary="List the gate profiles of a sensor",
    response_model=Page[schemas.GateProfile],
    responses=refusals(404),
)
def list_gate_profiles(
    sensor_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
) -> Response:
    """List every version of a sensor's limits, newest first; the first is in force, and its ETag is for setting another."""
    found = gate_profiles.list_profiles(session, sensor_id)
    older = [row for row in found if page.last_id is None or row.id < page.last_id]  # ids grow with the numbers
    body = page.cut(older[: page.limit + 1], lambda row: schemas.written(schemas.GateProfile, row))
    return json_response(body, headers={"ETag": etag(found[0].number)})


@router.post(
    "/{sensor_id}/gate-profiles",
    name="set_gate_profile",
    summary="Set the limits of a sensor",
    status_code=201,
    response_model=schemas.GateProfile,
    responses={**PROPOSED, **refusals(404, 409, 412, 428)},
)
def set_gate_profile(
    sensor_id: Id,
    profile: NewProfile,
    actor: Who,
    seen: SeenVersion,
    once: Idempotent,
    policy: Held,
    session: Writing,
) -> Response:
    """Put other limits into force. The sensor's undecided requests become STALE, for their verdict may be another.

    Where the setting `second_person` is on, the change is proposed, answered with 202, and moves nothing until another
    administrator confirms it.
    """

    def act() -> Answer:
        document = {"gates": profile.gates}
        asked = ("gate-profile", sensor_id, document, profile.reason, seen)
        row = second_person.change(session, actor, *asked, policy=policy)
        if isinstance(row, ChangeProposal):
            return answer(session, row, 202)
        headers = {"ETag": etag(row.number), "Location": f"/api/v1/sensors/{sensor_id}/gate-profiles"}
        return Answer(schemas.written(schemas.GateProfile, row), 201, headers)

    return once.answer(session, actor, act)


@router.post(
    "/{sensor_id}/gate-profiles:dry-run",
    name="try_gate_profile",
    summary="Try limits on past runs",
    response_model=schemas.DryRunOfProfile,
    responses=refusals(404, 409),
)
def try_gate_profile(
    sensor_id: Id,
    profile: Limits,
    actor: Who,  # noqa: ARG001 - whoever is known may try
    asked: OnlyAsked,
    session: Reading,
    request: Request,
) -> Response:
    """Say of each of the sensor's newest runs what these limits would have blocked; nothing is stored in any case."""
    found = gate_profiles.dry_run(session, request.app.state.blobs, sensor_id, {"gates": profile.gates})
    items = [
        {
            "run_id": tried.run.id,
            "parameter_set": tried.set_name,
            "verdict": tried.verdict,
            "blocking": tried.blocking,
            "verdict_now": tried.verdict_now,
            "blocking_now": tried.blocking_now,
            "basis": tried.basis,
        }
        for tried in found
    ]
    return json_response({"items": items}, headers={"X-Validate-Only": "true"} if asked else None)
