"""The REST routes: one file a noun, each with a `router`; a new noun is one file and one line here."""

from __future__ import annotations

from fastapi import APIRouter

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


def join(routes: APIRouter) -> None:
    """Join the nouns to the routes of a server, and the servers' own beside them.

    Their routes as they are: a router that includes another has the framework seek, and work out, every route twice.
    """
    for noun in (*(noun.router for noun in NOUNS), server.router, documentation.router):
        routes.routes.extend(noun.routes)
