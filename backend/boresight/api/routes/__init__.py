"""The REST routes: one file a noun, each with a `router`; a new noun is one file and one line here."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Security
from fastapi.security import APIKeyCookie, HTTPBearer

from boresight.api.cookies import SESSION_COOKIE
from boresight.api.dependencies import csrf
from boresight.api.openapi import refusals
from boresight.api.routes import (
    alarms,
    api_keys,
    approvals,
    audit,
    campaigns,
    change_proposals,
    comparisons,
    discussions,
    documentation,
    events,
    figures,
    frames,
    gate_profiles,
    gate_reports,
    notes,
    onboard,
    packages,
    parameter_sets,
    presets,
    runs,
    sensors,
    server,
    sessions,
    table_definitions,
    telemetry_sets,
    timeline,
    trends,
    uplinks,
    users,
    webhooks,
)

PREFIX = "/api/v1"
NOUNS = (
    sensors,
    timeline,
    trends,
    telemetry_sets,
    comparisons,  # before `runs`, which would take `compare` for a run's number
    runs,
    campaigns,
    change_proposals,
    presets,
    figures,
    frames,
    parameter_sets,
    gate_profiles,
    gate_reports,
    approvals,
    discussions,
    uplinks,
    onboard,
    table_definitions,
    packages,
    alarms,
    notes,
    events,
    audit,
    users,
    api_keys,
    webhooks,
    sessions,
)
CREDENTIALS = (
    Security(HTTPBearer(scheme_name="ApiKey", description="`bs_...`, from POST /api/v1/api-keys", auto_error=False)),
    Security(APIKeyCookie(name=SESSION_COOKIE, scheme_name="LogInCookie", auto_error=False)),
)


def join(routes: APIRouter) -> None:
    """Join the nouns to the routes of a server, under the version and guarded, and the servers' own beside them.

    Each by itself: a router around all of them would have the framework work every route out once more.
    """
    guards, refused = [*CREDENTIALS, Depends(csrf)], refusals(401, 403, 422)
    for noun in NOUNS:
        routes.include_router(noun.router, prefix=PREFIX, dependencies=guards, responses=refused)
    routes.include_router(server.router)
    routes.include_router(documentation.router)
