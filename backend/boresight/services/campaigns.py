"""Campaigns: one setting over many sensors, launched, followed and stopped as one.

Each sensor gets a run of its own, or the cause why it has none; what failed can be launched again, and the newest run of each
sensor counts. However many sensors, a launch is one transaction and reads and writes them many at a time; its audit records, one
a run, are written in portions, so that none carries the seals of more than `PORTION` runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.services import audit
from boresight.services.actors import Actor, require_role, require_scope
from boresight.services.campaign_places import Member, Place, places_of
from boresight.services.campaign_views import CampaignView, view_of
from boresight.services.dry_runs import expected_s
from boresight.services.orders import refuse_label
from boresight.services.presets import chosen_settings
from boresight.services.words import refuse_control_characters
from boresight.store import campaigns as rows
from boresight.store.campaigns import Standing
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import Campaign

PORTION = 200
AGAIN = ("FAILED", "LOST", None)  # states of the runs that are launched again; None is a sensor without one


def launch_campaign(
    session: Session,
    actor: Actor,
    label: str,
    settings: Mapping[str, Any],
    members: Sequence[Member] | None = None,
    *,
    preset: str | None = None,
    validate_only: bool = False,
) -> Campaign | dict[str, Any]:
    """Launch one setting over many sensors, or only say what that would be.

    Parameters
    ----------
    settings
        Of every run; over those of the preset where one is named.
    members
        The sensors; None takes the whole fleet.

    Returns
    -------
    Campaign or dict
        The row; with `validate_only` the `label`, `preset`, `settings`, `sensors`, `runs`, `predicted_s` of all runs together, and
        `refused` [{`sensor_id`, `sensor`, `refusal`}].

    Raises
    ------
    ForbiddenError
        When the actor is no analyst, or the key lacks the scope `runs`.
    NotFoundError
        When there is no such sensor or preset.
    RefusedInputError
        When there are too many sensors, one twice, or none that can have a run.
    """
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    refuse_label(label)
    if not label.strip():
        raise RefusedInputError("Give the campaign a label: what it is for, in a few words.")
    named, chosen = chosen_settings(session, preset, settings)
    places = places_of(session, members, chosen, label.strip())
    if validate_only:
        return _dry(session, places, label.strip(), named, chosen)
    whole = next(place.order.settings.document() for place in places if place.order is not None)
    row = Campaign(label=label.strip(), preset=named, settings=whole, launched_utc=utc_now(), launched_by=actor.user_id)
    session.add(row)
    session.flush()
    after = {"label": row.label, "preset": named, "settings": row.settings, "sensors": len(places)}
    audit.append(session, actor, "launched", _subject(row), None, after)
    _queue(session, actor, row, places)
    return row


def _dry(
    session: Session, places: Sequence[Place], label: str, preset: str | None, settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Say what a campaign would be."""
    orders = [place.order for place in places if place.order is not None]
    refused = [place for place in places if place.order is None]
    return {
        "label": label,
        "preset": preset,
        "settings": orders[0].settings.document() if orders else dict(settings),
        "sensors": len(places),
        "runs": len(orders),
        "predicted_s": expected_s(session, orders),
        "refused": [
            {"sensor_id": place.sensor.id, "sensor": place.sensor.name, "refusal": place.refusal} for place in refused
        ],
    }


def _queue(session: Session, actor: Actor, row: Campaign, places: Sequence[Place]) -> None:
    """Add the runs and the places of a campaign, portion by portion, and put each run on record."""
    for start in range(0, len(places), PORTION):
        some = places[start : start + PORTION]
        orders = [place.order for place in some if place.order is not None]
        run_of = rows.add_runs(session, [{**order.columns(), "launched_by": actor.user_id} for order in orders])
        named = [
            {"sensor_id": place.sensor.id, "run_id": run_of.get(place.sensor.id), "refusal": place.refusal}
            for place in some
        ]
        rows.add_places(session, [{"campaign_id": row.id, **one} for one in named])
        for order in orders:
            after = {**order.on_record(), "campaign": row.id}
            audit.append(session, actor, "launched", f"runs/{run_of[order.sensor.id]}", None, after)
        audit.head(session)  # written out now: the seals of this portion are in its own last record


def cancel_campaign(session: Session, actor: Actor, campaign_id: int, reason: str = "") -> Campaign:
    """Stop every run of a campaign that has not ended.

    Raises
    ------
    ForbiddenError
        When the actor is no analyst, or the key lacks the scope `runs`.
    NotFoundError
        When there is no such campaign.
    ConflictError
        When all its runs have ended, or are stopping.
    """
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    refuse_control_characters(reason=reason)
    row = get_campaign(session, campaign_id)
    why = f"campaign {row.id} was cancelled by {actor.printed_name}" + (f": {reason.strip()}" if reason.strip() else "")
    stopped = rows.cancel_all(session, row.id, why)
    if not stopped:
        raise ConflictError(f"No run of campaign {row.id} waits or computes; there is nothing to stop.")
    row.cancelled_utc = utc_now()
    audit.append(session, actor, "cancelled", _subject(row), None, {"runs": len(stopped)}, reason.strip() or None)
    for run_id, state in stopped:
        audit.append(session, actor, "cancelled", f"runs/{run_id}", None, {"state": state, "campaign": row.id})
    return row


def relaunch_failed(session: Session, actor: Actor, campaign_id: int) -> Campaign:
    """Launch again what failed, was lost, or could not be launched, with the sensor and the sets as they are now.

    A run that failed keeps its sets; a sensor without a run takes its newest.

    Raises
    ------
    ForbiddenError
        When the actor is no analyst, or the key lacks the scope `runs`.
    NotFoundError
        When there is no such campaign.
    ConflictError
        When nothing of it failed.
    RefusedInputError
        When none of them can have a run.
    """
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    row = get_campaign(session, campaign_id)
    failed = [one for one in rows.standings(session, row.id) if one.state in AGAIN]
    if not failed:
        raise ConflictError(f"Nothing of campaign {row.id} failed; there is nothing to launch again.")
    members = [
        Member(one.sensor_id)
        if one.telemetry_set_id is None
        else Member(one.sensor_id, one.telemetry_set_id, one.validation_set_id)
        for one in failed
    ]
    places = [place for place in places_of(session, members, row.settings, row.label) if place.order is not None]
    audit.append(session, actor, "launched again", _subject(row), None, {"sensors": len(places)})
    _queue(session, actor, row, places)
    return row


def get_campaign(session: Session, campaign_id: int) -> Campaign:
    """Return a campaign.

    Raises
    ------
    NotFoundError
        When there is none of this number.
    """
    row = rows.find_campaign(session, campaign_id)
    if row is None:
        raise NotFoundError(f"There is no campaign {campaign_id}; choose one of the list.")
    return row


def read_campaign(session: Session, campaign_id: int) -> CampaignView:
    """Return a campaign with its counts.

    Raises
    ------
    NotFoundError
        When there is none of this number.
    """
    row = get_campaign(session, campaign_id)
    return view_of(row, rows.counts(session, [row.id])[row.id])


def list_campaigns(session: Session, *, before_id: int | None = None, limit: int | None = None) -> list[CampaignView]:
    """Return a page of campaigns with their counts, newest first; the next starts before the last one's id."""
    found = rows.campaigns(session, before_id=before_id, limit=limit)
    counted = rows.counts(session, [row.id for row in found])
    return [view_of(row, counted[row.id]) for row in found]


def results(session: Session, campaign_id: int, *, after_id: int = 0, limit: int | None = None) -> list[Standing]:
    """Return where every sensor of a campaign stands, in the order of launch.

    Raises
    ------
    NotFoundError
        When there is no such campaign.
    """
    get_campaign(session, campaign_id)
    return rows.standings(session, campaign_id, after_id=after_id, limit=limit)


def _subject(row: Campaign) -> str:
    """Name a campaign as the audit log does."""
    return f"campaigns/{row.id}"
