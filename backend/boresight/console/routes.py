"""The REST routes: one file a noun, each with a `router`; a new noun is one file and one line here."""

from __future__ import annotations

from fastapi import APIRouter

from boresight.console.access import routes as api_keys
from boresight.console.administration import documentation
from boresight.console.administration import routes as server
from boresight.console.alarms import routes as alarms
from boresight.console.approvals import gate_routes as gate_profiles
from boresight.console.approvals import routes as approvals
from boresight.console.audit import routes as audit
from boresight.console.campaigns import routes as campaigns
from boresight.console.change_proposals import routes as change_proposals
from boresight.console.fleet import routes as sensors
from boresight.console.jobs import routes as events
from boresight.console.notes import routes as notes
from boresight.console.parameter_sets import routes as parameter_sets
from boresight.console.runs import comparison_routes as comparisons
from boresight.console.runs import figure_routes as figures
from boresight.console.runs import routes as frames
from boresight.console.telemetry import routes as telemetry_sets
from boresight.console.uplinks import routes as onboard
from boresight.console.webhooks import routes as webhooks

NOUNS = (
    sensors,
    sensors,
    sensors,
    telemetry_sets,
    comparisons,  # before `runs`, which would take `compare` for a run's number
    frames,
    campaigns,
    change_proposals,
    frames,
    figures,
    frames,
    parameter_sets,
    gate_profiles,
    gate_profiles,
    approvals,
    approvals,
    onboard,
    onboard,
    onboard,
    onboard,
    alarms,
    notes,
    events,
    audit,
    api_keys,
    api_keys,
    webhooks,
    api_keys,
)


def join(routes: APIRouter) -> None:
    """Join the nouns to the routes of a server, and the servers' own beside them.

    Their routes as they are: a router that includes another has the framework seek, and work out, every route twice.
    """
    for noun in (*(noun.router for noun in NOUNS), server.router, documentation.router):
        routes.routes.extend(noun.routes)
