"""Gate profiles of a sensor: the limits in force and before, setting others, trying some on past runs."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from boresight.api import schemas
from boresight.api.dependencies import Blobs, Held, OnlyAsked, Reading, SeenVersion, Who, Writing
from boresight.api.numbers import Id
from boresight.api.operation import Answer, operations
from boresight.api.paging import Page, Paged
from boresight.api.routes.change_proposals import PROPOSED, in_force_or_proposed
from boresight.services import gate_profiles, second_person
from boresight.store.tables import GateProfile, TableDefinition

router = operations("/sensors", tags=["gates"])

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
    summary="List the gate profiles of a sensor",
    response_model=Page[schemas.GateProfile],
)
def list_gate_profiles(sensor_id: Id, session: Reading, page: Paged) -> Answer:
    """List every version of a sensor's limits, newest first; the first is in force, and its ETag is for setting another."""
    found = gate_profiles.list_profiles(session, sensor_id)
    older = [row for row in found if page.last_id is None or row.id < page.last_id]  # ids grow with the numbers
    return Answer(page.cut(older[: page.limit + 1]), headers={"ETag": schemas.GateProfile.etag(found[0])})


@router.post(
    "/{sensor_id}/gate-profiles",
    summary="Set the limits of a sensor",
    status_code=201,
    response_model=schemas.GateProfile,
    responses=PROPOSED,
)
def set_gate_profile(
    sensor_id: Id, profile: NewProfile, actor: Who, seen: SeenVersion, policy: Held, session: Writing
) -> GateProfile | TableDefinition | Answer:
    """Put other limits into force. The sensor's undecided requests become STALE, for their verdict may be another.

    Where the setting `second_person` is on, the change is proposed, answered with 202, and moves nothing until another
    administrator confirms it.
    """
    document = {"gates": profile.gates}
    made = second_person.change(
        session, actor, "gate-profile", sensor_id, document, profile.reason, seen, policy=policy
    )
    return in_force_or_proposed(session, made)


@router.post(
    "/{sensor_id}/gate-profiles:dry-run", summary="Try limits on past runs", response_model=schemas.DryRunOfProfile
)
def try_gate_profile(sensor_id: Id, profile: Limits, asked: OnlyAsked, session: Reading, blobs: Blobs) -> Answer:
    """Say of each of the sensor's newest runs what these limits would have blocked; nothing is stored in any case."""
    found = gate_profiles.dry_run(session, blobs, sensor_id, {"gates": profile.gates})
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
    return Answer({"items": items}, headers={"X-Validate-Only": "true"} if asked else {})
