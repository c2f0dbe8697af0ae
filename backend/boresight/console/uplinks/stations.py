"""The ten stations of a parameter set between a run and the spacecraft: where it stands, whose step is next, and what that does.

    created, assessed, submitted, signed, promoted     on the ground, as the rows of set, report, request and promotion say
    exported, sent, loaded, read back, active          as packages and on-board records say, since the set was last sent

The step that is next follows from the states alone. Whether a person may take it is decided by the transition itself; here it
only decides who is shown a button and who is told whom to ask.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from boresight.console import list_queries as lists
from boresight.console.access import users
from boresight.console.access.tables import User
from boresight.console.approvals import gates
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval, GateReport, Signature
from boresight.console.fleet.timeline import describe_source
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets.service import USABLE_STATUSES
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import queries as run_queries
from boresight.console.runs import service as runs
from boresight.console.runs.tables import TERMINAL_RUN_STATES, Run
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.tables import Package, Uplink
from boresight.platform.actors import Actor, Policy
from boresight.platform.db.sessions import Session
from boresight.verdicts.verdict import LEVEL_OF_STATUS

TITLES = ("Created", "Assessed", "Submitted", "Signed", "Promoted", "Exported", "Sent", "Loaded", "Read back", "Active")
UPLINK_STATES = {"Sent": "SENT", "Loaded": "LOADED", "Read back": "VERIFIED", "Active": "ACTIVE"}
#: The step of an operator in each on-board state: what it is, its button, and its place on the uplink page.
UPLINK_STEPS = {
    "NOT SENT": ("Send the table with your own tools; then record it.", "Record SENT", "record-sent"),
    "SENT": ("Record when the spacecraft has loaded the table.", "Record LOADED", "record-loaded"),
    "LOADED": ("Compare what was read back with what was sent.", "Read back", "read-back"),
    "VERIFIED": ("Sign when telemetry shows that the table is active.", "Sign ACTIVE", "activate"),
    "MISMATCH": (
        "The read-back differs from what was sent: read it back or send it again.",
        "Read back",
        "read-back",
    ),
    "UNKNOWN": ("Its on-board state is unknown: send it again, or read it back.", "Record", "record"),
}
#: How its first station stands while a set's run has not ended.
UNDER_WAY = {"QUEUED": "queued", "CANCELLING": "being cancelled"}
PASSED_BY = "not on record"
DECLARED = "not needed: the set came with its sensor"


@dataclass(frozen=True)
class Station:
    """One station: how it stands, and when who came there by what."""

    title: str
    level: str
    word: str
    at_utc: str | None = None
    who: str = ""
    source: str = ""
    how: str = ""


@dataclass(frozen=True)
class NextStep:
    """What is next, with the button of whoever may do it.

    `label`, `href`: of the button; `posts` says that pressing it acts at once, else it leads to a form or a dialog. `who`: the
    printed names of those who may. `held`: why somebody who has the role cannot take it now. `is_optional`: nothing needs it, so
    that the sentence is the answer and the button stands aside.
    """

    sentence: str
    label: str = ""
    href: str = ""
    posts: bool = False
    is_mine: bool = False
    who: tuple[str, ...] = ()
    role: str = ""
    held: str = ""
    is_optional: bool = False


@dataclass(frozen=True)
class Workflow:
    """Where a set stands: its name, its stations, and the step that is next."""

    name: str
    stations: tuple[Station, ...]
    next_step: NextStep


@dataclass(frozen=True)
class _Records:
    """What is on record of a set: its newest report and request with signatures, its packages and on-board records."""

    report: GateReport | None
    request: Approval | None
    signatures: Sequence[Signature]
    exported: Package | None
    records: Sequence[Uplink]


@dataclass(frozen=True)
class _Viewer:
    """Who asks, among whom: what a step is made for."""

    session: Session
    actor: Actor
    policy: Policy
    people: Sequence[User]

    def name(self, user_id: int | None) -> str:
        """Return a person's printed name, or Boresight's for what no person did."""
        return next((user.printed_name for user in self.people if user.id == user_id), "Boresight")

    def step_for(self, roles: Iterable[str], sentence: str, label: str, href: str, *, posts: bool = False) -> NextStep:
        """Ask a step of everyone who has one of some roles."""
        asked = tuple(roles)
        able = [user for user in self.people if user.disabled_utc is None and set(asked).intersection(user.roles)]
        mine = not self.actor.is_key and bool(self.actor.roles.intersection(asked))
        return NextStep(sentence, label, href, posts, mine, tuple(user.printed_name for user in able), asked[0])

    def hold(self, step: NextStep, why: str | None) -> NextStep:
        """Hold a step of the viewer's own that would be refused."""
        return replace(step, is_mine=False, held=why) if step.is_mine and why is not None else step


def make_workflow(
    session: Session, actor: Actor, policy: Policy, row: ParameterSet | None, run: Run | None = None
) -> Workflow:
    """Say where a set stands, or a run that no set was made of yet, as an actor sees it."""
    viewer = _Viewer(session, actor, policy, users.list_users(session))
    if row is None:
        step = _step_of_run(viewer, run)
        stations = lay_out([None] * len(TITLES), TITLES, stopped=not step.posts or step.is_optional)
        if run is not None and run.state not in TERMINAL_RUN_STATES:
            stations[0] = Station(TITLES[0], "standby", UNDER_WAY.get(run.state, "running"), run.launched_utc)
        return Workflow("", tuple(stations), step)
    known = _read_records(session, row)
    return Workflow(row.name, tuple(_list_stations(row, known, viewer)), _step_of_set(viewer, row, known))


def _read_records(session: Session, row: ParameterSet) -> _Records:
    request = next(iter(lists.list_newest(session, Approval, set=row.id, limit=1)), None)
    records = lists.list_newest(session, Uplink, set=row.id)
    exported = find_exported_package(lists.list_newest(session, Package, set=row.id), records)
    signed = () if request is None else approval_queries.list_signatures(session, request.id)
    return _Records(approval_queries.find_newest_report(session, row.id), request, signed, exported, records)


def _list_stations(row: ParameterSet, known: _Records, viewer: _Viewer) -> list[Station]:
    created = Station("Created", "normal", "done", row.created_utc, viewer.name(row.created_by))
    uplinked = list_uplink_stations(known.exported, known.records, viewer.name)
    stopped = row.ground_state in {"REJECTED", "SUPERSEDED"} or row.onboard_state in {"MISMATCH", "UNKNOWN"}
    if row.ground_state in approvals.SUBMITTABLE and known.report is not None:
        stopped = stopped or bool(gates.lay_waivers(viewer.session, known.report).blocking)
    return lay_out([created, *_on_the_ground(row, known, viewer), *uplinked], TITLES, stopped=stopped)


def lay_out(taken: Sequence[Station | None], titles: Sequence[str], *, stopped: bool = False) -> list[Station]:
    """Fill in what is still to come, and what was passed by without a record.

    The one after the last that was taken is next, unless the way is stopped or something on it failed.
    """
    following = max((place + 1 for place, station in enumerate(taken) if station is not None), default=0)
    stopped = stopped or any(station is not None and station.level == "critical" for station in taken)

    def fill(place: int, title: str) -> Station:
        if place < following:
            return Station(title, "off", PASSED_BY)
        return Station(title, *(("standby", "next") if place == following and not stopped else ("off", "to come")))

    return [station or fill(place, title) for place, (station, title) in enumerate(zip(taken, titles, strict=True))]


def _on_the_ground(row: ParameterSet, known: _Records, viewer: _Viewer) -> list[Station | None]:
    """Stations 2 to 5; None where one is still to come."""
    if row.run_id is None and known.request is None:
        declared = [Station(title, "off", DECLARED) for title in TITLES[1:4]]
        return [*declared, Station("Promoted", "normal", "done", row.baseline_from_utc, "Boresight")]
    report, request, since = known.report, known.request, row.baseline_from_utc
    if request is not None and request.state not in {"OPEN", "APPROVED", "REJECTED"}:
        request = None  # a request that came to nothing: the set stands where it stood before
    return [
        None if report is None else _assessed(report, viewer),
        None if request is None else _submitted(request, viewer),
        None if request is None else _signed(request, known.signatures),
        None if since is None else Station("Promoted", "normal", "done", since),
    ]


def _assessed(report: GateReport, viewer: _Viewer) -> Station:
    return Station(
        "Assessed",
        LEVEL_OF_STATUS.get(report.verdict, "normal"),
        report.verdict,
        report.created_utc,
        viewer.name(report.created_by),
    )


def _submitted(request: Approval, viewer: _Viewer) -> Station:
    who = viewer.name(request.submitted_by)
    return Station("Submitted", "normal", "done", request.submitted_utc, who, request.reason)


def _signed(request: Approval, signatures: Sequence[Signature]) -> Station | None:
    """Whether a request is signed; None while it is open."""
    if request.state == "OPEN" or not signatures:
        return None
    last = signatures[-1]
    level, word = ("critical", "REFUSED") if request.state == "REJECTED" else ("normal", "done")
    return Station("Signed", level, word, last.signed_utc, last.printed_name, last.meaning)


def list_uplink_stations(
    package: Package | None, records: Sequence[Uplink], name: Callable[[int | None], str]
) -> list[Station | None]:
    """Stations 6 to 10 by a package and a set's records, newest first; None where one is still to come."""
    exported = None
    if package is not None:
        exported = Station(
            "Exported", "normal", "done", package.created_utc, name(package.created_by), f"package {package.id}"
        )
    progress = find_uplink_progress(records)
    return [exported, *(_recorded(progress, title, state, name) for title, state in UPLINK_STATES.items())]


def _recorded(progress: Sequence[Uplink], title: str, state: str, name: Callable[[int | None], str]) -> Station | None:
    wanted = {"VERIFIED", "MISMATCH"} if state == "VERIFIED" else {state}
    row = next((row for row in progress if row.onboard_state in wanted and row.is_step), None)
    if row is None:
        return None
    level, word = ("critical", "MISMATCH") if row.onboard_state == "MISMATCH" else ("normal", "done")
    who = row.printed_name or name(row.recorded_by)
    happened_utc = row.typed_evidence.happened_utc or row.recorded_utc
    return Station(title, level, word, happened_utc, who, row.source, describe_source(row))


def find_uplink_progress(records: Sequence[Uplink]) -> Sequence[Uplink]:
    """Return what was recorded since the set was last sent, newest first."""
    sent = next((place for place, row in enumerate(records) if row.onboard_state == "SENT"), len(records) - 1)
    return records[: sent + 1]


def find_exported_package(packages: Sequence[Package], records: Sequence[Uplink]) -> Package | None:
    """Return the package that was sent, else the newest; None where there is none."""
    sent = [row for row in find_uplink_progress(records) if row.onboard_state == "SENT"]
    named = sent[-1].typed_evidence.package if sent else None
    if named is not None:
        return next((package for package in packages if package.id == named.id), None)
    return packages[0] if packages else None


def _step_of_run(viewer: _Viewer, run: Run | None) -> NextStep:
    """What follows for a run that no set was made of."""
    if run is None or run.state not in TERMINAL_RUN_STATES:
        return NextStep("No action needed; this page updates automatically.")
    again = f"/runs/new?clone={run.id}"
    if runs.lacks_times(viewer.session, run):
        said, address = (
            "Its telemetry has no times: upload it again with time_utc.",
            f"/telemetry?sensor={run.sensor_id}",
        )
        return viewer.step_for(("analyst",), said, "Upload a set with times", f"{address}#upload-title")
    if run.state != "SUCCEEDED":
        return viewer.step_for(("analyst",), "Correct what failed, then run it again.", "Run it again", again)
    status = (run.summary or {}).get("status")
    if status not in USABLE_STATUSES:
        said = f"It ended with {str(status).replace('_', ' ')}, so no parameter set can be made: follow the advice and run again."
        return viewer.step_for(("analyst",), said, "Run it again", again)
    address = f"/runs/{run.id}/parameter-set"
    if (active := find_set_on_board(viewer.session, run)) is not None:
        said = f"{active.name}, made from its telemetry, is ACTIVE on board: no further step."
        step = viewer.step_for(("analyst",), said, "Create a set anyway", address, posts=True)
        return replace(step, is_optional=True) if step.is_mine else NextStep(said)
    said = "Review the four views, then create a parameter set from the result and assess its gates."
    return viewer.step_for(("analyst",), said, "Create parameter set", address, posts=True)


def find_set_on_board(session: Session, run: Run) -> ParameterSet | None:
    """Return the set that is active on board, if all telemetry of a run went into it already."""
    active = set_queries.find_active_set(session, run.sensor_id)
    if active is None or active.run_id is None:
        return None
    went_in = run_queries.list_held_sets(session, session.get_known(Run, active.run_id))
    return active if went_in.issuperset({run.telemetry_set_id, *run.joint_set_ids}) else None


def _step_of_set(viewer: _Viewer, row: ParameterSet, known: _Records) -> NextStep:
    """What follows for a set in its state on the ground."""
    address, state = f"/parameter-sets/{row.id}", row.ground_state
    if state == "SUBMITTED" and known.request is not None:
        return _signing_step(viewer, known.request, known.report)
    if state == "APPROVED":
        said = f"Promote {row.name}: it becomes the baseline, and nothing on board changes."
        step = viewer.step_for(("operator",), said, "Promote", f"{address}#promote")
        why = approvals.explain_why_not_promote(viewer.session, viewer.actor, row.id, policy=viewer.policy)
        return viewer.hold(step, why)
    if state in {"REJECTED", "SUPERSEDED"}:
        return _step_of_former(viewer, row)
    if state == "BASELINE":
        return _uplink_step(viewer, row, known)
    return _step_of_candidate(viewer, row, known.report)


def _step_of_candidate(viewer: _Viewer, row: ParameterSet, report: GateReport | None) -> NextStep:
    """What follows for a set that nobody submitted: its gates, and what they say."""
    address = f"/parameter-sets/{row.id}"
    if report is None or gates.list_moved_since(viewer.session, report):
        said = f"Assess {row.name} against the gates and the baseline."
        return viewer.step_for(gates.ASSESSORS, said, "Assess", f"{address}/assess", posts=True)
    if stopped := gates.lay_waivers(viewer.session, report).blocking:
        which = "it" if len(stopped) == 1 else "them"
        said = f"{row.name} is blocked by {_count_gates(stopped)}: waive {which} if possible, or recalibrate."
        again = f"/runs/new?clone={row.run_id}" if row.run_id is not None else f"/runs/new?sensor={row.sensor_id}"
        return viewer.step_for(("analyst",), said, "Recalibrate", again)
    return viewer.step_for(
        ("analyst",), f"Submit {row.name} with a reason; another person signs it.", "Submit", f"{address}#reason"
    )


def _count_gates(stopped: Sequence[object]) -> str:
    """Say how many gates stop a set."""
    return f"{len(stopped)} gate{'s' if len(stopped) != 1 else ''}"


def _step_of_former(viewer: _Viewer, row: ParameterSet) -> NextStep:
    if row.ground_state == "REJECTED":
        said = f"{row.name} was refused: recalibrate and submit the new set."
        return viewer.step_for(("analyst",), said, "Run again", f"/runs/new?clone={row.run_id}")
    baseline = set_queries.find_baseline(viewer.session, row.sensor_id)
    other = baseline.name if baseline else "another set"
    said = f"It was replaced by {other}; a roll-back is signed and promoted like any other set."
    return viewer.step_for(("analyst", "operator"), said, "Roll back", f"/parameter-sets/{row.id}#roll-back")


def _signing_step(viewer: _Viewer, request: Approval, report: GateReport | None) -> NextStep:
    able = [
        one.user
        for one in approvals.list_request_signers(viewer.session, request.id, policy=viewer.policy)
        if one.refusal is None
    ]
    missing = request.needed - sum(one.decision == "APPROVE" for one in request.signatures)
    said = f"{missing} signature{'s' if missing != 1 else ''} by a second person {'are' if missing != 1 else 'is'} missing."
    mine = approvals.explain_why_not_sign(viewer.session, viewer.actor, request.id, policy=viewer.policy) is None
    names = tuple(user.printed_name for user in able)
    stopped = () if report is None else gates.lay_waivers(viewer.session, report).blocking
    if stopped:
        said = f"It is blocked by {_count_gates(stopped)}: it can be refused, and approved only once they are waived."
        return NextStep(said, "Review", f"/approvals/{request.id}#gates", is_mine=mine, who=names, role="approver")
    return NextStep(said, "Review and sign", f"/approvals/{request.id}#sign", is_mine=mine, who=names, role="approver")


def _uplink_step(viewer: _Viewer, row: ParameterSet, known: _Records) -> NextStep:
    """What follows for the baseline on its way to the spacecraft."""
    address = f"/parameter-sets/{row.id}/uplink"
    if known.exported is None and row.onboard_state == "NOT SENT":
        said = "Export the uplink package; it contains the back-out."
        return viewer.step_for(("operator", "analyst"), said, "Export", f"{address}/package", posts=True)
    if row.onboard_state == "ACTIVE":
        if not uplinks.is_c_sd_open(viewer.session, row):
            return NextStep("It is active on board: no further step.")
        said = "It is active, and its update of C_SD is not recorded as loaded: the reported attitude may have turned."
        return viewer.step_for(("operator",), said, "Record C_SD", f"{address}#c-sd")
    said, label, place = UPLINK_STEPS.get(row.onboard_state, UPLINK_STEPS["UNKNOWN"])
    step = viewer.step_for(("operator",), said, label, f"{address}#{place}")
    if row.onboard_state != "VERIFIED":
        return step
    return viewer.hold(step, uplinks.explain_why_not_activate(viewer.session, viewer.actor, row))
