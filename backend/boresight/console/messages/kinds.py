"""The kinds of messages, each declared once: which audit records tell of it, whom it is for, and what it says.

A record is read when its message is made, a moment after its commit. A message names the sensor and what happened, and leads to the
page; it holds no number, no comment and no reason, because it passes through the hands of others.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

from boresight.console.access import queries as user_rows
from boresight.console.access.tables import User
from boresight.console.alarms.tables import Alarm
from boresight.console.alignments.tables import Alignment, AlignmentRequest
from boresight.console.approvals.signers import list_parts, list_signers
from boresight.console.approvals.tables import Approval, Remark
from boresight.console.change_proposals.service import MAY_CONFIRM, TITLES
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet.tables import Sensor
from boresight.console.ingest.tables import IngestDecision
from boresight.console.parameter_sets.tables import ONBOARD_ACTIONS, ParameterSet
from boresight.console.runs.tables import Run
from boresight.platform.actors import Policy
from boresight.platform.audit.subjects import AuditAction, AuditSubject
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Session


@dataclass(frozen=True)
class News:
    """What a message says, which page it leads to, and whom it is for; `None` is everybody who asked for the kind."""

    sensor_id: int | None
    said: str
    path: str
    user_ids: Collection[int] | None = None


@dataclass(frozen=True)
class Source:
    """An audit record with the number of its object and of the part that it is about, and what a kind may ask beside it."""

    session: Session
    record: AuditRecord
    number: int
    part_number: int | None
    policy: Policy


@dataclass(frozen=True)
class Records:
    """Which records a kind is made of: those of one noun, of a part of it or of none, by their actions; None takes all."""

    noun: str
    actions: Collection[str] | None
    part: str | None = None

    def hold(self, record: AuditRecord, subject: AuditSubject) -> bool:
        """Whether a record is one of them."""
        part = None if subject.part is None else subject.part.noun
        return (subject.noun, part) == (self.noun, self.part) and (
            self.actions is None or record.action in self.actions
        )


@dataclass(frozen=True)
class MessageKind:
    """A kind of messages: its name, the line of the form, the records it is made of, and how."""

    name: str
    title: str
    records: Records
    tell: Callable[[Source], News | None]


def _tell_signature_waits(of: Source) -> News | None:
    row = of.session.get_one(Approval, of.number)
    if row.state != "OPEN":
        return None
    waits_for = [one.user.id for one in list_signers(of.session, row, of.policy) if one.refusal is None]
    named = of.session.get_one(ParameterSet, row.parameter_set_id)
    return News(
        named.sensor_id,
        f"request {row.id} for {named.name} is waiting for your signature",
        f"/approvals/{row.id}",
        waits_for,
    )


DECIDED: Mapping[str, str] = {
    AuditAction.APPROVED: "is approved",
    AuditAction.REFUSED: "is refused",
    AuditAction.WITHDREW: "was withdrawn",
    AuditAction.WITHDRAWN: "was withdrawn",
    AuditAction.MADE_STALE: "is stale",
    AuditAction.LET_EXPIRE: "has expired",
}


def _tell_alignment_signature_waits(of: Source) -> News | None:
    row = of.session.get_one(AlignmentRequest, of.number)
    if row.state != "OPEN":
        return None
    made = of.session.get_one(Alignment, row.alignment_id)
    runs = [of.session.get_one(Run, number) for number in (made.run_a_id, made.run_b_id)]
    own = {row.submitted_by, made.created_by, *(run.launched_by for run in runs)} if of.policy.four_eyes else set()
    people = user_rows.list_users(of.session)
    able = [one.id for one in people if "approver" in one.roles and "administrator" not in one.roles]
    said = f"alignment {made.id} is waiting for your signature"
    return News(made.sensor_a_id, said, f"/alignment-requests/{row.id}", set(able) - own)


def _tell_alignment_decided(of: Source) -> News:
    row = of.session.get_one(AlignmentRequest, of.number)
    made = of.session.get_one(Alignment, row.alignment_id)
    said = f"request {row.id} for alignment {made.id} {DECIDED[of.record.action]}"
    concerned = {one for one in (row.submitted_by, made.created_by) if one is not None}
    return News(made.sensor_a_id, said, f"/alignment-requests/{row.id}", concerned - {of.record.actor_id})


def _tell_decided(of: Source) -> News | None:
    row = of.session.get_one(Approval, of.number)
    if of.record.outcome.state == "OPEN":
        return None  # it needs another signature
    named = of.session.get_one(ParameterSet, row.parameter_set_id)
    concerned = {part.user_id for part in list_parts(of.session, row)} | {one.user_id for one in row.signatures}
    said = f"request {row.id} for {named.name} {DECIDED[of.record.action]}"
    return News(named.sensor_id, said, f"/approvals/{row.id}", concerned - {of.record.actor_id})


def _tell_promoted(of: Source) -> News:
    row = of.session.get_one(ParameterSet, of.number)
    return News(row.sensor_id, f"{row.name} is the baseline", f"/parameter-sets/{row.id}")


def _tell_on_board(of: Source) -> News:
    row = of.session.get_one(ParameterSet, of.number)
    said = f"{row.name} is {of.record.outcome.onboard_state} on board"
    return News(row.sensor_id, said, f"/parameter-sets/{row.id}/uplink")


def _tell_alarm(of: Source) -> News:
    row = of.session.get_one(Alarm, of.number)
    again = " again, or with higher severity" if of.record.outcome.event == "RAISED AGAIN" else ""
    return News(row.sensor_id, f"alarm {row.id}, {row.kind}, {row.level}, is raised{again}", f"/alarms/{row.id}")


def _tell_alarm_assigned(of: Source) -> News | None:
    row = of.session.get_one(Alarm, of.number)
    said = f"alarm {row.id} is assigned to you"
    return None if row.assigned_to is None else News(row.sensor_id, said, f"/alarms/{row.id}", [row.assigned_to])


def _tell_request_assigned(of: Source) -> News | None:
    row = of.session.get_one(Approval, of.number)
    if row.assigned_to is None:
        return None
    sensor_id = of.session.get_one(ParameterSet, row.parameter_set_id).sensor_id
    return News(sensor_id, f"request {row.id} is assigned to you", f"/approvals/{row.id}", [row.assigned_to])


def _tell_run(of: Source, states: Collection[str]) -> News | None:
    row, state = of.session.get_one(Run, of.number), of.record.outcome.state
    if state not in states or row.launched_by is None:
        return None
    return News(row.sensor_id, f"run {row.id} {state}", f"/runs/{row.id}", [row.launched_by])


def _tell_ingest_asks(of: Source) -> News | None:
    row = of.session.get_one(IngestDecision, of.number)
    if row.state != "ASKED":
        return None
    analysts = [user.id for user in user_rows.list_users(of.session) if "analyst" in user.roles]
    said = f"new telemetry no longer agrees with the baseline: decision {row.id} is waiting for an answer"
    return News(row.sensor_id, said, f"/ingest/{row.id}", analysts)


def _tell_mentioned(of: Source) -> News | None:
    row = of.session.get_one(Remark, of.part_number)
    named = {user.id for user in user_rows.list_users(of.session) if user.name in (row.mentions or ())}
    if not named:
        return None
    sensor_id = of.session.get_one(ParameterSet, of.session.get_one(Approval, of.number).parameter_set_id).sensor_id
    said = f"{row.printed_name} mentions you at request {of.number}"
    return News(sensor_id, said, f"/approvals/{of.number}", named - {row.user_id})


def _tell_change_waits(of: Source) -> News | None:
    row = of.session.get_one(ChangeProposal, of.number)
    if row.state != "OPEN":
        return None
    may = [user.id for user in user_rows.list_users(of.session) if set(user.roles) & set(MAY_CONFIRM[row.kind])]
    said = f"proposal {row.id}, new {TITLES[row.kind]}, is waiting for a second person"
    return News(row.sensor_id, said, f"/change-proposals/{row.id}", {*may} - {row.proposed_by})


def _tell_account(of: Source) -> News | None:
    if of.record.actor_id == of.number:
        return None
    person = of.session.get_one(User, of.number)
    return News(None, f"{of.record.actor} {of.record.action} {person.printed_name}", "/sessions", [of.number])


KINDS: Mapping[str, MessageKind] = {
    kind.name: kind
    for kind in (
        MessageKind("signature-waits", "A request is waiting for my signature",
                    Records("approvals", {AuditAction.OPENED}), _tell_signature_waits),
        MessageKind("request-decided", "A request I am involved in is decided, becomes stale or expires",
                    Records("approvals", DECIDED), _tell_decided),
        MessageKind("mention", "Somebody mentions me",
                    Records("approvals", {AuditAction.REMARKED}, "remarks"), _tell_mentioned),
        MessageKind("alarm-assigned", "An alarm is assigned to me",
                    Records("alarms", {AuditAction.ALARM_ASSIGNED}), _tell_alarm_assigned),
        MessageKind("request-assigned", "A request is assigned to me",
                    Records("approvals", {AuditAction.ASSIGNED}), _tell_request_assigned),
        MessageKind("promoted", "A parameter set becomes the baseline",
                    Records("parameter-sets", {AuditAction.PROMOTED}), _tell_promoted),
        MessageKind("on-board", "What is on board changes",
                    Records("parameter-sets", {*ONBOARD_ACTIONS.values()}), _tell_on_board),
        MessageKind("alarm", "An alarm is raised or its severity increases",
                    Records("alarms", {AuditAction.ALARM_RAISED, AuditAction.ALARM_RAISED_AGAIN}), _tell_alarm),
        MessageKind("run-failed", "A run of mine fails or is lost", Records("runs", {AuditAction.ENDED}),
                    lambda of: _tell_run(of, ("FAILED", "LOST"))),
        MessageKind("run-ended", "A run of mine ends in another way", Records("runs", {AuditAction.ENDED}),
                    lambda of: _tell_run(of, ("SUCCEEDED", "CANCELLED"))),
        MessageKind("ingest-asks", "New telemetry needs an answer",
                    Records("ingest-decisions", {AuditAction.DECIDED}), _tell_ingest_asks),
        MessageKind("change-waits", "A new gate profile or table definition is waiting for a second person",
                    Records("change-proposals", {AuditAction.PROPOSED}), _tell_change_waits),
        MessageKind("alignment-waits", "An alignment is waiting for my signature",
                    Records("alignment-requests", {AuditAction.SUBMITTED}), _tell_alignment_signature_waits),
        MessageKind("alignment-decided", "A request for an alignment that I am involved in is decided",
                    Records("alignment-requests", DECIDED), _tell_alignment_decided),
        MessageKind("account", "Somebody else changes my account", Records("users", None), _tell_account),
    )
}  # fmt: skip


@dataclass(frozen=True)
class KindNews:
    """News of a kind, with the name of its sensor."""

    kind: str
    news: News
    sensor: str


def list_news(session: Session, record: AuditRecord, policy: Policy) -> list[KindNews]:
    """Return what an audit record tells people, by kind."""
    found, subject = [], record.subject
    part_number = None if subject.part is None else subject.part.id
    for kind in KINDS.values():
        if subject.id is None or not kind.records.hold(record, subject):
            continue
        news = kind.tell(Source(session, record, subject.id, part_number, policy))
        if news is not None:
            sensor = None if news.sensor_id is None else session.get(Sensor, news.sensor_id)
            found.append(KindNews(kind.name, news, sensor.name if sensor else ""))
    return found
