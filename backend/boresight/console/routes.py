"""The REST routes: each noun's `routes` modules, joined in order; a new noun is one line here."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType

from fastapi import APIRouter

from boresight.console.access import factor_routes as second_factors
from boresight.console.access import routes as access
from boresight.console.administration import routes as administration
from boresight.console.alarms import routes as alarms
from boresight.console.alignments import routes as alignments
from boresight.console.approvals import routes as approvals
from boresight.console.audit import routes as audit
from boresight.console.backups import routes as backups
from boresight.console.campaigns import routes as campaigns
from boresight.console.change_proposals import routes as change_proposals
from boresight.console.fleet import routes as fleet
from boresight.console.ingest import routes as ingest
from boresight.console.jobs import routes as events
from boresight.console.messages import routes as messages
from boresight.console.notes import routes as notes
from boresight.console.parameter_sets import routes as parameter_sets
from boresight.console.runs import figure_routes as figures
from boresight.console.runs import routes as runs
from boresight.console.saved_views import routes as saved_views
from boresight.console.telemetry import routes as telemetry
from boresight.console.uplinks import routes as uplinks
from boresight.console.webhooks import routes as webhooks

NOUNS = (
    fleet,
    telemetry,
    figures,  # before `runs`, which would take `compare` for a run's number
    runs,
    alignments,
    campaigns,
    change_proposals,
    parameter_sets,
    approvals,
    uplinks,
    alarms,
    ingest,
    messages,
    notes,
    saved_views,
    events,
    audit,
    backups,
    access,
    second_factors,
    webhooks,
)


def routers(module: ModuleType) -> Iterator[APIRouter]:
    """Yield every router that a module declares, in the order in which it declares them."""
    for name, value in vars(module).items():
        if name.endswith("router") and isinstance(value, APIRouter):
            yield value


def include_routes(routes: APIRouter) -> None:
    """Join the nouns to the routes of a server, and the servers' own beside them.

    Routes are added directly, because an included router makes the framework match and resolve every route twice.
    """
    for module in (*NOUNS, administration):
        for router in routers(module):
            routes.routes.extend(router.routes)
