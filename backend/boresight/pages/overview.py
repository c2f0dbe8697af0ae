"""The fleet at a glance: every sensor's worst status with its reason, the queue, what waits for me, what happened."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from boresight.api.dependencies import Reading, Who
from boresight.pages.audit import line_of
from boresight.pages.rendering import render
from boresight.pages.sparkline import Sparkline, sparkline
from boresight.pages.states import LEVELS
from boresight.services import alarms, approvals, audit, fleet, lists, parameter_sets, runs
from boresight.services.actors import Actor, Policy
from boresight.services.fleet import SensorTile, Standing
from boresight.store.sessions import Session
from boresight.store.tables import TERMINAL_RUN_STATES, Alarm, Approval

RECENT_EVENTS = 12
MOST_ACTIONS = 8
MOST_TILES = 120
RUNS_IN_A_SPARKLINE = 16

router = APIRouter()


@dataclass(frozen=True)
class Action:
    """Something that waits for the person who looks."""

    level: str
    sentence: str
    address: str
    label: str


def _signatures(
    session: Session, actor: Actor, opened: Sequence[Approval], sets: Mapping[int, Any], policy: Policy
) -> Iterator[Action]:
    """Yield the open requests that this person may sign now."""
    for request in opened:
        if approvals.why_not_sign(session, actor, request.id, policy=policy) is None:
            name = sets[request.parameter_set_id].name
            yield Action("standby", f"{name} waits for your signature.", f"/approvals/{request.id}", "Review")


def _alarms(session: Session, actor: Actor) -> Iterator[Action]:
    """Yield the alarms that wait for whoever may handle them."""
    if not actor.roles.intersection(alarms.HANDLERS):
        return
    for alarm in alarms.list_alarms(session, alarms.Sought(state="unacknowledged")):
        gist = alarm.sentence.split(". ", maxsplit=1)[0].rstrip(".")
        yield Action(alarm.level, f"Alarm {alarm.id}: {gist}.", f"/alarms/{alarm.id}", "Handle")


def _promotions(session: Session, actor: Actor) -> Iterator[Action]:
    """Yield what an operator may do: promote what is approved, record what became of a new baseline."""
    if "operator" not in actor.roles:
        return
    for row in parameter_sets.list_parameter_sets(session, ground_state="APPROVED"):
        yield Action("standby", f"{row.name} is approved and can be promoted.", f"/parameter-sets/{row.id}", "Promote")
    for row in parameter_sets.list_parameter_sets(session, ground_state="BASELINE"):
        if row.run_id is not None and row.onboard_state == "NOT SENT":
            sentence = f"{row.name} is the baseline; nothing is recorded of it on board."
            yield Action("standby", sentence, f"/parameter-sets/{row.id}", "Record")


def _own_requests(session: Session, actor: Actor) -> Iterator[Action]:
    """Yield this person's requests that came back."""
    for state, words in (("STALE", "went stale: evaluate again"), ("REJECTED", "was refused: read why")):
        own = {"state": state, "submitted_by": actor.user_id}
        came_back = lists.page_of(session, "approvals", own, "-request", limit=20)
        sets = parameter_sets.heads_of(session, [request.parameter_set_id for request in came_back])
        for request in came_back:
            name = sets[request.parameter_set_id].name
            yield Action("caution", f"{name} {words}.", f"/approvals/{request.id}", "Read")


def _calibrations(session: Session, tiles: Sequence[SensorTile], actor: Actor) -> Iterator[Action]:
    """Yield what an analyst may do: launch a first run, look at a failed one, make a set of a good one."""
    if "analyst" not in actor.roles:
        return
    used = parameter_sets.runs_with_sets(session, [tile.last_run.id for tile in tiles if tile.last_run])
    for tile in tiles:
        name, run = tile.sensor.name, tile.last_run
        if run is None and tile.telemetry_sets:
            address = f"/runs/new?sensor={tile.sensor.id}"
            yield Action("standby", f"{name} has telemetry and no run yet.", address, "Launch")
        elif run is not None and run.state in {"FAILED", "LOST"}:
            yield Action("serious", f"{name}: run {run.id} {run.state}.", f"/runs/{run.id}", "Look")
        elif run is not None and run.state == "SUCCEEDED" and run.id not in used and _converged(tile):
            yield Action("standby", f"{name}: run {run.id} converged; judge it.", f"/runs/{run.id}", "Judge")


def _converged(tile: SensorTile) -> bool:
    """Tell whether the newest run came to rest."""
    summary = tile.last_run.summary if tile.last_run else None
    return bool(summary) and summary is not None and summary.get("status") == "converged"


@dataclass(frozen=True)
class Course:
    """How a sensor's calibrations went lately.

    Parameters
    ----------
    rms
        Arc RMS of the newest runs, oldest first: of the tail where a run has one, else of all frames.
    availability
        Of the newest run with a validation set; None where there is none.
    drift
        The open alarm of its drift; None where there is none.
    """

    rms: Sparkline | None
    availability: float | None
    drift: Alarm | None


@dataclass(frozen=True)
class Desk:
    """Everything that the overview shows of the fleet's work.

    Parameters
    ----------
    standings
        How every sensor stands, by name.
    tiles
        The sensors that are drawn: all, or of a large fleet those that stand worst.
    courses, waiting
        By sensor: how its calibrations went lately, and its open request.
    actions
        What waits for the person who looks; of calibrations, those of the sensors that are drawn.
    queue
        How many runs are in each state.
    """

    standings: Sequence[Standing]
    tiles: Sequence[SensorTile]
    courses: Mapping[int, Course]
    waiting: Mapping[int, Approval]
    actions: Sequence[Action]
    queue: Mapping[str, int]

    @property
    def is_whole(self) -> bool:
        """Whether every sensor is drawn."""
        return len(self.tiles) == len(self.standings)

    @property
    def unjudged(self) -> int:
        """Of how many sensors it is not known yet whether the ground calibration holds."""
        return sum(not one.is_judged for one in self.standings)


def drawn_of(standings: Sequence[Standing]) -> Sequence[Standing]:
    """Choose the sensors that a page has room for: all by name, or of a large fleet those that stand worst, the worst first."""
    if len(standings) <= MOST_TILES:
        return standings
    return sorted(standings, key=lambda one: -LEVELS.index(one.status))[:MOST_TILES]


def _courses(session: Session, tiles: Sequence[SensorTile]) -> dict[int, Course]:
    """Return how each sensor's calibrations went lately."""
    summaries = fleet.recent_summaries(session, [tile.sensor.id for tile in tiles], RUNS_IN_A_SPARKLINE)
    drifting = {alarm.sensor_id: alarm for alarm in alarms.list_alarms(session, alarms.Sought(kind="DRIFT"), limit=500)}
    return {tile.sensor.id: _course(summaries.get(tile.sensor.id, ()), drifting.get(tile.sensor.id)) for tile in tiles}


def _course(summaries: Sequence[Mapping[str, Any]], drift: Alarm | None) -> Course:
    rms = [it.get("tail_rms_rad") or it.get("rms_final_arc_rad") for it in summaries]
    seen = [it["availability"] for it in summaries if it.get("availability") is not None]
    return Course(sparkline([value for value in rms if value]), seen[-1] if seen else None, drift)


def _desk(session: Session, actor: Actor, policy: Policy) -> Desk:
    """Gather the fleet's work for a person."""
    standings = fleet.standings(session)
    tiles = fleet.tiles(session, drawn_of(standings))
    opened = approvals.list_approvals(session, state="OPEN")
    sets = parameter_sets.heads_of(session, [request.parameter_set_id for request in opened])
    actions = [
        *_alarms(session, actor),
        *_signatures(session, actor, opened, sets, policy),
        *_promotions(session, actor),
        *_own_requests(session, actor),
        *_calibrations(session, tiles, actor),
    ]
    waiting = {sets[request.parameter_set_id].sensor_id: request for request in opened}
    return Desk(standings, tiles, _courses(session, tiles), waiting, actions, runs.count_by_state(session))


@dataclass(frozen=True)
class Event:
    """Something that happened: somebody did it, or a run ended."""

    at_utc: str
    who: str
    did: str
    to: str
    address: str | None
    gist: str


def _recorded(session: Session) -> Iterator[Event]:
    """Yield the newest records of the audit log, but for the ends of runs, which tell more by their rows."""
    for record in audit.list_records(session, limit=RECENT_EVENTS):
        if record.action == "ended":
            continue
        line = line_of(record)
        yield Event(record.at_utc, record.actor, record.action, record.object, line.address, line.gist)


def _ended_runs(session: Session, names: Mapping[int, str]) -> Iterator[Event]:
    """Yield the ends of the newest runs."""
    for run in runs.list_runs(session, state=TERMINAL_RUN_STATES, limit=RECENT_EVENTS):
        if run.ended_utc:
            gist = " · ".join(filter(None, (names.get(run.sensor_id), run.label, run.reason)))
            yield Event(run.ended_utc, "Boresight", run.state, f"runs/{run.id}", f"/runs/{run.id}", gist)


def _events(session: Session, standings: Sequence[Standing]) -> list[Event]:
    """Return what happened last, newest first."""
    names = {one.sensor_id: one.name for one in standings}
    found = [*_recorded(session), *_ended_runs(session, names)]
    return sorted(found, key=lambda event: event.at_utc, reverse=True)[:RECENT_EVENTS]


def _counts(standings: Sequence[Standing]) -> dict[str, int]:
    """Count the sensors by level, worst first; every level, so that the strip keeps its shape."""
    return {level: sum(one.status == level for one in standings) for level in reversed(LEVELS)}


@router.get("/", response_class=HTMLResponse)
def overview_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show the fleet."""
    desk = _desk(session, actor, request.app.state.policy)
    return render(
        request,
        "overview.html",
        desk=desk,
        counts=_counts(desk.standings),
        actions=desk.actions[:MOST_ACTIONS],
        more_actions=max(len(desk.actions) - MOST_ACTIONS, 0),
        waiting_for_me=sum(action.label == "Review" for action in desk.actions),
        events=_events(session, desk.standings),
        workers=request.app.state.workers.state() if request.app.state.workers else None,
        may_register=bool({"analyst", "administrator"} & actor.roles),
    )
