"""The fleet at a glance: every sensor's worst status with its reason, the queue, tasks for the reader, and recent events."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Annotated, Any

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse, JSONResponse

from boresight.console import list_queries as lists
from boresight.console.access.dependencies import Reading, ServerPolicy, Who, Workers, depend_on_server, same_for_one
from boresight.console.alarms import service as alarms
from boresight.console.alarms.tables import Alarm
from boresight.console.alignments import approval as alignment_approval
from boresight.console.alignments import queries as alignment_queries
from boresight.console.alignments.tables import AlignmentRequest
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.approvals import threads
from boresight.console.approvals.tables import Remark
from boresight.console.audit.pages import make_audit_line
from boresight.console.audit.queries import name_subjects
from boresight.console.backups import service as backups
from boresight.console.change_proposals import queries as proposal_queries
from boresight.console.change_proposals import service as proposals
from boresight.console.fleet import queries as sensor_queries
from boresight.console.fleet import status as fleet
from boresight.console.fleet.status import SensorStatus, SensorTile
from boresight.console.ingest import queries as ingest_queries
from boresight.console.pages.drawings import Sparkline, sparkline
from boresight.console.pages.formats import LEVELS
from boresight.console.pages.frame import FleetStatusCache
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import render
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.runs import service as runs
from boresight.console.runs.tables import TERMINAL_RUN_STATES
from boresight.console.saved_views import service as saved_views
from boresight.console.uplinks.stations import UPLINK_STEPS
from boresight.platform.actors import Actor, Policy
from boresight.platform.audit import log as audit
from boresight.platform.audit.subjects import AuditAction
from boresight.platform.db.data_version import VersionedCache
from boresight.platform.db.sessions import Session
from boresight.platform.web.response_cache import HELD_S, mark_outdated
from boresight.verdicts.verdict import RunSummary, parse_run_summary

RECENT_EVENTS = 12
MOST_ACTIONS = 8
MOST_ALIGNMENTS = 100  # open requests that are looked through
MOST_TILES = 120
MOST_FAVOURITES = 12
RUNS_IN_A_SPARKLINE = 16
VIEWS = ("rows", "tiles")
CAME_BACK = ("STALE", "REJECTED")  # states of a request that its submitter is shown

router = PageRouter()


@dataclass(frozen=True)
class WaitingAction:
    """Something that waits for the person who looks."""

    level: str
    sentence: str
    address: str
    label: str


@dataclass(frozen=True)
class WaitingItems:
    """The waiting items of one kind: their number and the first few."""

    count: int
    first: Sequence[WaitingAction]


NOTHING = WaitingItems(0, ())


def _signatures(session: Session, actor: Actor, policy: Policy) -> WaitingItems:
    signatory = approvals.find_signatory(session, actor, policy=policy)
    if signatory is None:
        return NOTHING
    return _requests(session, {"open_to": signatory}, "standby", "is waiting for your signature", "Review", "#review")


def _requests(
    session: Session, where: Mapping[str, Any], level: str, words: str, label: str, place: str = ""
) -> WaitingItems:
    """Count the requests that a list is narrowed to, and write the newest of them."""
    newest = lists.read_page(session, "approvals", where, "-request", limit=MOST_ACTIONS)
    sets = set_queries.read_heads(session, [request.parameter_set_id for request in newest])
    first = [
        WaitingAction(
            level, f"{sets[request.parameter_set_id].name} {words}.", f"/approvals/{request.id}{place}", label
        )
        for request in newest
    ]
    return WaitingItems(lists.count(session, "approvals", where), first)


def _count_waiting(told: Iterable[tuple[str, str]], label: str) -> WaitingItems:
    """Count the waiting items that a sentence and an address tell of, and write the first few."""
    every = list(told)
    return WaitingItems(len(every), [WaitingAction("standby", *one, label) for one in every[:MOST_ACTIONS]])


def _mentions(remarks: Sequence[Remark]) -> WaitingItems:
    """Write where others mentioned a person who has not answered."""
    return _count_waiting(
        (
            (
                f"{remark.printed_name} mentions you on request {remark.approval_id}.",
                f"/approvals/{remark.approval_id}#remark-{remark.id}",
            )
            for remark in remarks
        ),
        "Answer",
    )


def _proposals(session: Session, actor: Actor) -> WaitingItems:
    able = [
        row
        for row in proposals.list_open_proposals(session)
        if proposals.explain_why_not_decide(session, actor, row) is None
    ]
    return _count_waiting(
        (
            (
                f"A change of the {proposals.TITLES[row.kind]} is waiting for a second person.",
                f"/change-proposals/{row.id}",
            )
            for row in able
        ),
        "Review",
    )


def _alignments(session: Session, actor: Actor, policy: Policy) -> WaitingItems:
    able = [
        row
        for row in lists.list_newest(session, AlignmentRequest, limit=MOST_ALIGNMENTS, state="OPEN")
        if alignment_approval.explain_why_not_sign(session, actor, row, policy) is None
    ]
    return _count_waiting(
        (
            (f"Alignment {row.alignment_id} is waiting for your signature.", f"/alignments/{row.alignment_id}")
            for row in able
        ),
        "Review",
    )


def _alarms(session: Session, actor: Actor, names: Mapping[int, str]) -> WaitingItems:
    if not actor.roles.intersection(alarms.HANDLERS):
        return NOTHING
    newest = alarms.list_alarms(session, alarms.AlarmFilter(state="unacknowledged"), limit=MOST_ACTIONS)
    first = []
    for alarm in newest:
        gist = f"{names.get(alarm.sensor_id or 0, 'A sensor')} drifts." if alarm.kind == "DRIFT" else alarm.sentence
        first.append(WaitingAction(alarm.level, f"Alarm {alarm.id}: {gist}", f"/alarms/{alarm.id}", "Handle"))
    return WaitingItems(alarms.count_unacknowledged(session), first)


def _questions(session: Session, actor: Actor, names: Mapping[int, str]) -> WaitingItems:
    """Write the decisions on new telemetry that ask an analyst."""
    if "analyst" not in actor.roles:
        return NOTHING
    first = [
        WaitingAction(
            "caution",
            f"{names[row.sensor_id]} no longer agrees with its baseline: answer decision {row.id}.",
            f"/ingest/{row.id}",
            "Decide",
        )
        for row in ingest_queries.list_asked(session, MOST_ACTIONS)
    ]
    return WaitingItems(ingest_queries.count_asked(session), first)


def _promotions(session: Session, actor: Actor) -> Iterator[WaitingItems]:
    """Yield the tasks of an operator: promote approved sets, and record the uplink of a new baseline."""
    if "operator" not in actor.roles:
        return
    yield _sets(session, {"state": "APPROVED"}, "is approved and can be promoted", "Promote", "#promote")
    unsent = {"state": "BASELINE", "board": "NOT SENT", "of_a_run": True}
    yield _sets(session, unsent, "is the baseline; no on-board state is recorded", "Export", "/uplink")
    for state, (words, label, place) in UPLINK_STEPS.items():
        if state != "NOT SENT":
            on_board = {"state": "BASELINE", "board": state, "of_a_run": True}
            yield _sets(session, on_board, f"is {state} on board. {words.rstrip('.')}", label, f"/uplink#{place}")


def _sets(session: Session, where: Mapping[str, Any], words: str, label: str, place: str) -> WaitingItems:
    """Count the parameter sets that a list is narrowed to, and write the newest of them."""
    newest = lists.read_page(session, "parameter-sets", where, "-set", limit=MOST_ACTIONS)
    first = [
        WaitingAction("standby", f"{row.name} {words}.", f"/parameter-sets/{row.id}{place}", label) for row in newest
    ]
    return WaitingItems(lists.count(session, "parameter-sets", where), first)


def _own_requests(session: Session, actor: Actor) -> Iterator[WaitingItems]:
    if actor.user_id is None:
        return
    for state, words in zip(
        CAME_BACK, ("is stale: assess and submit it again", "was refused: read the reason"), strict=True
    ):
        yield _requests(session, {"state": state, "submitted_by": actor.user_id}, "caution", words, "Read")


def _calibrations(session: Session, standings: Sequence[SensorStatus], actor: Actor) -> WaitingItems:
    """Find the tasks of an analyst: launch a first run, look at a failed one, make a set from a good one."""
    if "analyst" not in actor.roles:
        return NOTHING
    converged = {one.last_run.id for one in standings if _converged(one)}
    unused = converged - set_queries.list_runs_with_sets(session, converged)
    found = [action for one in _worst_first(standings) if (action := _next_step(one, unused)) is not None]
    return WaitingItems(len(found), found[:MOST_ACTIONS])


def _next_step(one: SensorStatus, unused: Collection[int]) -> WaitingAction | None:
    """Return the next step after a sensor's newest run; `unused` are converged runs from which no set was made."""
    run = one.last_run
    if run is None:
        address = f"/runs/new?sensor={one.sensor_id}"
        told = WaitingAction("standby", f"{one.name} has telemetry but no run yet.", address, "Launch")
        return told if one.has_telemetry else None
    if run.state in {"FAILED", "LOST"}:
        return WaitingAction("serious", f"{one.name}: run {run.id} {run.state}.", f"/runs/{run.id}", "Look")
    if run.id in unused:
        return WaitingAction("standby", f"Review run {run.id} of {one.name}.", f"/runs/{run.id}", "Review")
    return None


def _converged(one: SensorStatus) -> bool:
    run = one.last_run
    return run is not None and run.state == "SUCCEEDED" and parse_run_summary(run.summary).status == "converged"


@dataclass(frozen=True)
class RecentCalibrations:
    """A sensor's recent calibrations."""

    rms: Sparkline | None
    availability: float | None
    drift: Alarm | None
    tested: str


@dataclass(frozen=True)
class RecentEvent:
    """A recent event: an action by a person, or the end of a run."""

    at_utc: str
    who: str
    did: str
    to: str
    address: str | None
    gist: str


@dataclass(frozen=True, eq=False)
class FleetView:
    """The part of the overview that is the same for everybody; read once after a commit."""

    standings: Sequence[SensorStatus]
    tiles: Sequence[SensorTile]
    histories: Mapping[int, RecentCalibrations]
    waiting: Mapping[int, int]
    approved: Mapping[int, int]
    queue: Mapping[str, int]
    events: Sequence[RecentEvent]
    open_requests: int = 0
    open_proposals: int = 0
    open_alignments: int = 0
    submitters: Collection[int] = ()
    mentions: Mapping[str, Sequence[Remark]] = field(default_factory=dict)
    by_roles: dict[frozenset[str], tuple[WaitingItems, Sequence[WaitingItems]]] = field(default_factory=dict)

    @property
    def is_whole(self) -> bool:
        """Whether every sensor is drawn."""
        return len(self.tiles) == len(self.standings)

    @property
    def unjudged(self) -> int:
        """The number of sensors whose ground calibration has not been checked yet."""
        return sum(not one.is_judged for one in self.standings)


def choose_drawn_sensors(standings: Sequence[SensorStatus]) -> Sequence[SensorStatus]:
    """Choose the sensors that a page has room for, the worst status first, then by name."""
    return _worst_first(standings)[:MOST_TILES]


def _worst_first(standings: Sequence[SensorStatus]) -> Sequence[SensorStatus]:
    return sorted(standings, key=lambda one: -LEVELS.index(one.status))


def _list_recent_calibrations(session: Session, tiles: Sequence[SensorTile]) -> dict[int, RecentCalibrations]:
    ids = [tile.sensor.id for tile in tiles]
    summaries = sensor_queries.list_recent_summaries(session, ids, RUNS_IN_A_SPARKLINE)
    drifting = alarms.list_newest_open_of_sensors(session, "DRIFT", ids)
    tested = _list_drift_words(session, tiles)
    return {
        number: _read_recent_calibrations(summaries.get(number, ()), drifting.get(number), tested[number])
        for number in ids
    }


def _list_drift_words(session: Session, tiles: Sequence[SensorTile]) -> dict[int, str]:
    """Say of each sensor what its drift test says: a sensor that was never tested does not look like one that holds."""
    stamps = sensor_queries.read_trend_stamps(session, [tile.sensor.id for tile in tiles])
    asked = [tile.sensor for tile in tiles if tile.sensor.id in stamps]
    baselines = {tile.sensor.id: tile.baseline for tile in tiles}
    judged = fleet.get_drift_verdicts(session, asked, baselines, stamps, most=fleet.MOST_JUDGED)
    words = {tile.sensor.id: "NOT TESTED" for tile in tiles}
    words |= {sensor.id: judged[sensor.id].verdict if sensor.id in judged else "NOT YET TESTED" for sensor in asked}
    return words


def _read_recent_calibrations(summaries: Sequence[RunSummary], drift: Alarm | None, tested: str) -> RecentCalibrations:
    rms = [it.tail_rms_rad or it.rms_final_arc_rad for it in summaries]
    seen = [it.availability for it in summaries if it.availability is not None]
    return RecentCalibrations(sparkline([value for value in rms if value]), seen[-1] if seen else None, drift, tested)


def _recorded(session: Session) -> Iterator[RecentEvent]:
    """Yield the newest audit records except the ends of runs, whose rows say more."""
    records = [one for one in audit.list_records(session, limit=RECENT_EVENTS) if one.action != AuditAction.ENDED]
    names = name_subjects(session, [one.subject for one in records])
    for record in records:
        line = make_audit_line(record)
        yield RecentEvent(record.at_utc, record.actor, record.action, names[record.subject], line.address, line.gist)


def _ended_runs(session: Session, names: Mapping[int, str]) -> Iterator[RecentEvent]:
    for run in runs.list_runs(session, state=TERMINAL_RUN_STATES, limit=RECENT_EVENTS):
        if run.ended_utc:
            gist = " · ".join(filter(None, (names.get(run.sensor_id), run.own_label, run.reason)))
            yield RecentEvent(run.ended_utc, "Boresight", run.state, f"Run {run.id}", f"/runs/{run.id}", gist)


def _events(session: Session, standings: Sequence[SensorStatus]) -> list[RecentEvent]:
    """Return the most recent events, newest first."""
    names = {one.sensor_id: one.name for one in standings}
    found = [*_recorded(session), *_ended_runs(session, names)]
    return sorted(found, key=lambda event: event.at_utc, reverse=True)[:RECENT_EVENTS]


def _fleet(session: Session, memory: FleetStatusCache) -> FleetView:
    standings = memory.known_standings() or fleet.list_sensor_statuses(session)
    tiles = fleet.list_tiles(session, choose_drawn_sensors(standings), documents=False)
    return FleetView(
        standings,
        tiles,
        _list_recent_calibrations(session, tiles),
        approval_queries.read_newest_open(session, [tile.sensor.id for tile in tiles]),
        set_queries.read_newest_approved(session, [tile.sensor.id for tile in tiles]),
        runs.count_by_state(session),
        _events(session, standings),
        lists.count(session, "approvals", {"state": "OPEN"}),
        proposal_queries.count_open_proposals(session),
        alignment_queries.read_open_requests(session)[0],
        approval_queries.list_submitter_ids(session, CAME_BACK),
        threads.find_open_mentions(session),
    )


def _ours(session: Session, actor: Actor, overview: FleetView) -> tuple[WaitingItems, Sequence[WaitingItems]]:
    """Gather the tasks that are the same for everybody with these roles: alarms, promotions and calibrations."""
    found = overview.by_roles.get(actor.roles)
    if found is None:
        names = {one.sensor_id: one.name for one in overview.standings}
        questions = _questions(session, actor, names)
        rest = (questions, *_promotions(session, actor), _calibrations(session, overview.standings, actor))
        found = overview.by_roles[actor.roles] = (_alarms(session, actor, names), rest)
    return found


def _mine(session: Session, actor: Actor, policy: Policy, overview: FleetView) -> tuple[WaitingItems, WaitingItems]:
    """Gather a person's tasks, and separately the requests to sign; queries that can find nothing are skipped."""
    signatures = _signatures(session, actor, policy) if overview.open_requests else NOTHING
    own = _own_requests(session, actor) if actor.user_id in overview.submitters else ()
    decisions = _proposals(session, actor) if overview.open_proposals else NOTHING
    alignments = _alignments(session, actor, policy) if overview.open_alignments else NOTHING
    alarming, (*promotions, calibrations) = _ours(session, actor, overview)
    mentions = _mentions(overview.mentions.get(actor.name, ()))
    kinds = [alarming, signatures, alignments, mentions, decisions, *promotions, *own, calibrations]
    first = [action for kind in kinds for action in kind.first][:MOST_ACTIONS]
    return signatures, WaitingItems(sum(kind.count for kind in kinds), first)


def _counts(standings: Sequence[SensorStatus]) -> dict[str, int]:
    """Count the sensors by level, worst first; every level, so that the strip keeps its shape."""
    return {level: sum(one.status == level for one in standings) for level in reversed(LEVELS)}


OverviewCache = Annotated[VersionedCache[FleetView], depend_on_server("overview")]


def _look(request: Request, session: Session, cache: VersionedCache[FleetView]) -> FleetView:
    """Return the fleet as of the newest commit, before anything else is read."""
    ages = time.monotonic() // HELD_S  # times in the rows are recomputed when this changes
    read = partial(_fleet, session, request.app.state.fleet_status)
    overview, is_older = cache.answer_to(ages, read, request.state.came_s)
    if is_older:
        mark_outdated(request)
    return overview


@router.get("/waiting", response_class=JSONResponse, dependencies=[Depends(same_for_one)])
def waiting(request: Request, session: Reading, actor: Who, policy: ServerPolicy, cache: OverviewCache) -> JSONResponse:
    """Tell how much waits for this person, and the first of it: the number in the browser's tab, and its notifications."""
    _, actions = _mine(session, actor, policy, _look(request, session, cache))
    return JSONResponse({"count": actions.count, "first": [asdict(action) for action in actions.first]})


@router.get("/", response_class=HTMLResponse, dependencies=[Depends(same_for_one)])
def overview_page(
    request: Request,
    session: Reading,
    actor: Who,
    policy: ServerPolicy,
    cache: OverviewCache,
    dispatcher: Workers,
    view: str = "",
) -> HTMLResponse:
    """Show what waits for this person, then the fleet: a row a sensor, or tiles where they were chosen last."""
    overview = _look(request, session, cache)
    signatures, actions = _mine(session, actor, policy, overview)
    workers = dispatcher.state() if dispatcher else None
    backup = backups.look(session) if "administrator" in actor.roles else None
    favourites = saved_views.list_favourites(session, actor)[:MOST_FAVOURITES]
    return render(
        request,
        "fleet/overview.html",
        follows_from=(
            view,
            overview,
            signatures.count,
            actions.count,
            tuple(actions.first),
            tuple((row.path, row.name) for row in favourites),
            workers,
            backup and (backup.schedule and backup.schedule.id, backup.newest and backup.newest.id, backup.fault),
        ),
        view=view if view in VIEWS else VIEWS[0],
        overview=overview,
        levels=LEVELS,
        counts=_counts(overview.standings),
        actions=actions.first,
        favourites=favourites,
        more_actions=actions.count - len(actions.first),
        waiting_for_me=signatures.count,
        events=overview.events,
        workers=workers,
        backup=backup,
        may_register=bool({"analyst", "administrator"} & actor.roles),
    )
