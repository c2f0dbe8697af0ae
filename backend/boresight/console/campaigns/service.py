"""Campaigns: one setting over many sensors, launched, followed and stopped as one.

Each sensor gets a run of its own, or the cause why it has none; the newest run of each counts. A launch is one
transaction that reads and writes many sensors at a time; its audit records are written in portions of `PORTION` runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from boresight.console import list_queries as lists
from boresight.console.campaigns import queries as rows
from boresight.console.campaigns.queries import Counted, MemberStatus
from boresight.console.campaigns.tables import Campaign
from boresight.console.fleet import queries as sensor_rows
from boresight.console.fleet.tables import Sensor
from boresight.console.runs.dry_runs import RunRequest, check_run_request, estimate_s, refuse_label
from boresight.console.runs.presets import choose_settings
from boresight.console.runs.tables import RUN_STATES, TERMINAL_RUN_STATES
from boresight.errors import BoresightError, ConflictError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import refuse_control_characters

MOST_SENSORS = 1000

Newest = Literal["newest"]


@dataclass(frozen=True)
class MemberRequest:
    """A sensor of a campaign and its sets: numbers, the newest in use, or for validation none."""

    sensor_id: int
    telemetry_set_id: int | Newest = "newest"
    validation_set_id: int | Newest | None = "newest"


@dataclass(frozen=True)
class CampaignMemberPlan:
    """A sensor of a campaign with its run request, or the cause why it has none."""

    sensor: Sensor
    request: RunRequest | None
    refusal: str | None


def plan_members(
    session: Session, members: Sequence[MemberRequest] | None, settings: Mapping[str, Any], label: str
) -> list[CampaignMemberPlan]:
    """Check every sensor's request."""
    wanted = (
        [MemberRequest(head.id) for head in sensor_rows.list_sensor_heads(session)]
        if members is None
        else list(members)
    )
    ids = [member.sensor_id for member in wanted]
    _refuse_members(ids)
    fleet = {sensor.id: sensor for sensor in sensor_rows.list_sensors(session, ids)}
    if strange := [number for number in ids if number not in fleet]:
        raise NotFoundError(f"There is no sensor {strange[0]}; choose from the list.")
    newest = rows.read_newest_sets(session, ids)
    named = [(member, *_choose_sets(member, newest)) for member in wanted]
    numbers = {number for _, *numbers in named for number in numbers if number is not None}
    held = rows.list_sets(session, numbers)  # held so that each request finds its sets in the session without a query
    plans = [
        _plan_member(session, fleet[member.sensor_id], calibration, validation, settings, label)
        for member, calibration, validation in named
    ]
    del held
    if all(planned.request is None for planned in plans):
        raise RefusedInputError(f"No run can be launched for any sensor of the campaign. {plans[0].refusal}")
    return plans


def _refuse_members(ids: Sequence[int]) -> None:
    """Refuse twice the same sensor, none, or too many."""
    if not ids:
        raise RefusedInputError("A campaign needs at least one sensor; choose some.")
    if len(ids) > MOST_SENSORS:
        raise RefusedInputError(
            f"A campaign can have at most {MOST_SENSORS} sensors; {len(ids)} were chosen: launch several campaigns."
        )
    if len(set(ids)) < len(ids):
        raise RefusedInputError("The campaign contains a sensor twice; name each sensor once.")


def _choose_sets(member: MemberRequest, newest: Mapping[tuple[int, str], int]) -> tuple[int | None, int | None]:
    """Return the numbers of a member's calibration and validation sets."""
    calibration, validation = member.telemetry_set_id, member.validation_set_id
    return (
        newest.get((member.sensor_id, "calibration")) if calibration == "newest" else calibration,
        newest.get((member.sensor_id, "validation")) if validation == "newest" else validation,
    )


def _plan_member(
    session: Session,
    sensor: Sensor,
    calibration: int | None,
    validation: int | None,
    settings: Mapping[str, Any],
    label: str,
) -> CampaignMemberPlan:
    """Check one sensor's request; a refusal is its cause."""
    if calibration is None:
        return CampaignMemberPlan(
            sensor, None, f"{sensor.name} has no calibration set; upload one and launch it again."
        )
    try:
        return CampaignMemberPlan(
            sensor, check_run_request(session, sensor.id, calibration, settings, validation, label), None
        )
    except BoresightError as error:
        return CampaignMemberPlan(sensor, None, str(error))


NOT_LAUNCHED = "NOT LAUNCHED"
FAILED = ("FAILED", "LOST", NOT_LAUNCHED)


@dataclass(frozen=True)
class CampaignView:
    """A campaign with its counts."""

    row: Campaign
    counts: Mapping[str, int]
    newest_id: int

    @property
    def id(self) -> int:
        """Its number, which cursors name."""
        return self.row.id

    @property
    def sensors(self) -> int:
        """How many sensors it has."""
        return sum(self.counts.values())

    @property
    def ended(self) -> int:
        """How many of them have ended."""
        return sum(self.counts[state] for state in (*TERMINAL_RUN_STATES, NOT_LAUNCHED))

    @property
    def failed(self) -> int:
        """How many could be launched again."""
        return sum(self.counts[state] for state in FAILED)

    @property
    def fraction(self) -> float:
        """Its progress, 0 to 1."""
        return self.ended / self.sensors if self.sensors else 1.0

    @property
    def state(self) -> str:
        """One word: UNDER WAY, CANCELLING, CANCELLED, SUCCEEDED, or ENDED where some run did not succeed."""
        cancelled = self.row.cancelled_utc is not None and self.counts["CANCELLED"] + self.counts["CANCELLING"] > 0
        if self.ended < self.sensors:
            return "CANCELLING" if cancelled and not self.counts["QUEUED"] + self.counts["RUNNING"] else "UNDER WAY"
        if cancelled:
            return "CANCELLED"
        return "SUCCEEDED" if self.counts["SUCCEEDED"] == self.sensors else "ENDED"


def make_campaign_view(row: Campaign, counted: Counted) -> CampaignView:
    """Combine a campaign with its counts by state; the key None counts sensors without a run."""
    counts = {state: counted.by_state.get(state, 0) for state in RUN_STATES}
    return CampaignView(row, {**counts, NOT_LAUNCHED: counted.by_state.get(None, 0)}, counted.newest_id)


def make_result_line(standing: MemberStatus) -> dict[str, Any]:
    """Return one line of the results over sensors, arcs in rad; values that a run lacks are None."""
    names = (
        "rms_initial_arc_rad", "rms_final_arc_rad", "validation_rms_initial_arc_rad", "validation_rms_final_arc_rad",
        "status", "level", "weak_directions", "weakest", "advice", "advice_code",
    )  # fmt: skip
    return {
        "id": standing.id,
        "sensor_id": standing.sensor_id,
        "sensor": standing.sensor,
        "run_id": standing.run_id,
        "state": standing.state or NOT_LAUNCHED,
        "reason": standing.refusal or standing.reason,
        **{name: getattr(standing.summary, name) for name in names},
    }


PORTION = 200
AGAIN = ("FAILED", "LOST", None)  # states of the runs that are launched again; None is a sensor without one


def launch_campaign(
    session: Session,
    actor: Actor,
    label: str,
    settings: Mapping[str, Any],
    members: Sequence[MemberRequest] | None = None,
    *,
    preset: str | None = None,
    validate_only: bool = False,
) -> Campaign | dict[str, Any]:
    """Launch one setting over many sensors, or only say what that would be."""
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    refuse_label(label)
    if not label.strip():
        raise RefusedInputError("Give the campaign a label: what it is for, in a few words.")
    named, chosen = choose_settings(session, preset, settings)
    plans = plan_members(session, members, chosen, label.strip())
    if validate_only:
        return _dry_run(session, plans, label.strip(), named, chosen)
    whole = next(planned.request.settings.document() for planned in plans if planned.request is not None)
    row = Campaign(label=label.strip(), preset=named, settings=whole, launched_utc=utc_now(), launched_by=actor.user_id)
    session.put(row)
    after = {"label": row.label, "preset": named, "settings": row.settings, "sensors": len(plans)}
    audit.append(session, actor, "launched", _subject(row), None, after)
    _queue(session, actor, row, plans)
    return row


def _dry_run(
    session: Session, plans: Sequence[CampaignMemberPlan], label: str, preset: str | None, settings: Mapping[str, Any]
) -> dict[str, Any]:
    requests = [planned.request for planned in plans if planned.request is not None]
    refused = [planned for planned in plans if planned.request is None]
    return {
        "label": label,
        "preset": preset,
        "settings": requests[0].settings.document() if requests else dict(settings),
        "sensors": len(plans),
        "runs": len(requests),
        "predicted_s": estimate_s(session, requests),
        "refused": [
            {"sensor_id": planned.sensor.id, "sensor": planned.sensor.name, "refusal": planned.refusal}
            for planned in refused
        ],
    }


def _queue(session: Session, actor: Actor, row: Campaign, plans: Sequence[CampaignMemberPlan]) -> None:
    """Add the runs and the members of a campaign, portion by portion, and put each run on record."""
    for start in range(0, len(plans), PORTION):
        some = plans[start : start + PORTION]
        requests = [planned.request for planned in some if planned.request is not None]
        run_of = rows.add_runs(session, [{**request.columns(), "launched_by": actor.user_id} for request in requests])
        named = [
            {"sensor_id": planned.sensor.id, "run_id": run_of.get(planned.sensor.id), "refusal": planned.refusal}
            for planned in some
        ]
        rows.add_members(session, [{"campaign_id": row.id, **one} for one in named])
        for request in requests:
            after = {**request.on_record(), "campaign": row.id}
            audit.append(session, actor, "launched", f"runs/{run_of[request.sensor.id]}", None, after)
        audit.head(session)  # written out now: the seals of this portion are in its own last record


def cancel_campaign(session: Session, actor: Actor, campaign_id: int, reason: str = "") -> Campaign:
    """Stop every run of a campaign that has not ended."""
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    refuse_control_characters(reason=reason)
    row = get_campaign(session, campaign_id)
    why = f"campaign {row.id} was cancelled by {actor.printed_name}" + (f": {reason.strip()}" if reason.strip() else "")
    stopped = rows.cancel_all(session, row.id, why)
    if not stopped:
        raise ConflictError(
            f"Campaign {row.id} has no queued or running runs; there is nothing to cancel.", code="nothing-to-cancel"
        )
    row.cancelled_utc = utc_now()
    audit.append(session, actor, "cancelled", _subject(row), None, {"runs": len(stopped)}, reason.strip() or None)
    for run_id, state in stopped:
        audit.append(session, actor, "cancelled", f"runs/{run_id}", None, {"state": state, "campaign": row.id})
    return row


def relaunch_failed(session: Session, actor: Actor, campaign_id: int) -> Campaign:
    """Launch again the failed runs with their own sets, and sensors without a run with their newest sets."""
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    row = get_campaign(session, campaign_id)
    failed = [one for one in rows.list_member_statuses(session, row.id) if one.state in AGAIN]
    if not failed:
        raise ConflictError(
            f"Nothing of campaign {row.id} failed; there is nothing to launch again.", code="nothing-to-relaunch"
        )
    members = [
        MemberRequest(one.sensor_id)
        if one.telemetry_set_id is None
        else MemberRequest(one.sensor_id, one.telemetry_set_id, one.validation_set_id)
        for one in failed
    ]
    plans = [
        planned for planned in plan_members(session, members, row.settings, row.label) if planned.request is not None
    ]
    audit.append(session, actor, "launched again", _subject(row), None, {"sensors": len(plans)})
    _queue(session, actor, row, plans)
    return row


def get_campaign(session: Session, campaign_id: int) -> Campaign:
    """Return a campaign."""
    return session.get_known(Campaign, campaign_id)


def read_campaign(session: Session, campaign_id: int) -> CampaignView:
    """Return a campaign with its counts."""
    row = get_campaign(session, campaign_id)
    return make_campaign_view(row, rows.count_members(session, [row.id])[row.id])


def list_campaigns(session: Session, *, before_id: int | None = None, limit: int | None = None) -> list[CampaignView]:
    """Return a page of campaigns with their counts, newest first; the next starts before the last one's id."""
    return make_campaign_views(session, lists.list_newest(session, Campaign, before_id=before_id, limit=limit))


def make_campaign_views(session: Session, found: Sequence[Campaign]) -> list[CampaignView]:
    """Return campaigns with their counts."""
    counted = rows.count_members(session, [row.id for row in found])
    return [make_campaign_view(row, counted[row.id]) for row in found]


def list_results(
    session: Session, campaign_id: int, *, before_id: int | None = None, limit: int | None = None
) -> list[MemberStatus]:
    """Return where every sensor of a campaign stands, or those of a page, in the order of launch."""
    get_campaign(session, campaign_id)
    if limit is None:
        return rows.list_member_statuses(session, campaign_id)
    of_campaign = {"campaign": campaign_id, "newest": True}
    found = lists.read_page(session, "campaign-sensors", of_campaign, "launched", before_id=before_id, limit=limit)
    return rows.list_member_statuses(session, campaign_id, [row.id for row in found])


def _subject(row: Campaign) -> str:
    return f"campaigns/{row.id}"
