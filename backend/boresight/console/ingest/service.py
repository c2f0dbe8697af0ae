"""Decisions on new telemetry: received, calibrated, judged, and asked of people where it left the baseline.

    received --> CALIBRATING --run ended--> WITHIN FORECAST | UNCONFIRMED | NOT JUDGED     nothing is asked
        |                    `--outside the baseline--> ASKED --a person--> ANSWERED
        `--> REFUSED                                      `--a newer set asks, or the baseline moved--> SUPERSEDED

`INGEST` acts here, which may upload, launch and prepare a set with its gate report. It has no row of a person, so it can neither
submit nor sign nor promote: a person answers, and with SUBMIT is the first of the two. Every change is one audit record.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from boresight.console import list_queries as lists
from boresight.console.alarms.rules import is_held
from boresight.console.approvals import gates
from boresight.console.approvals import queries as approval_rows
from boresight.console.approvals import service as approvals
from boresight.console.approvals.gates import GateAssessment
from boresight.console.fleet.tables import Sensor
from boresight.console.fleet.trend import Trend, describe_limit, read_trend, read_trends
from boresight.console.fleet.trend_document import Advice, advise
from boresight.console.ingest import policies
from boresight.console.ingest import queries as rows
from boresight.console.ingest.change_tests import OtherSensor, PolicyFinding, Reason, agree, judge_newest
from boresight.console.ingest.other_sensor import find_other_sensor, is_of_one_design
from boresight.console.ingest.rules import PolicyRules
from boresight.console.ingest.tables import ANSWERS, IngestDecision, IngestPolicy
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import service as runs
from boresight.console.runs.presets import choose_settings
from boresight.console.runs.tables import Run
from boresight.console.telemetry import queries as telemetry_rows
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.telemetry.profiles import find_profile
from boresight.console.telemetry.service import (
    ImageUpload,
    ImportRequest,
    OtherCameraError,
    PreparedUpload,
    RegisteredCameras,
)
from boresight.console.telemetry.tables import TelemetrySet, parse_quality
from boresight.console.transitions import move, name_subject, require_seen
from boresight.errors import BoresightError, ConflictError, ForbiddenError, RefusedInputError
from boresight.platform.actors import DAY_S, INGEST, POLICY, Actor, Policy, require_person, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.audit.subjects import AuditAction
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session, utc_after, utc_now, utc_text
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.web.text_validation import refuse_control_characters
from boresight.telemetry.read.limits import Limits
from boresight.verdicts.numbers import number, urad
from boresight.verdicts.verdict import parse_run_summary

log = logging.getLogger(__name__)

AHEAD_S = 3600.0  # that the times of telemetry may be ahead of this clock
QUIET_DAYS = 7.0
MOST_QUIET_DAYS = 90.0
LONGEST_REASON = 2000
LONGEST_NAME = 200


@dataclass(frozen=True)
class SentFile:
    """A file as it came: from where, its name, its bytes."""

    source: str
    name: str
    sha256: str | None
    size_bytes: int


def get_active_policy(session: Session, sensor_id: int) -> IngestPolicy:
    """Return the policy of a sensor that takes files in; refuse where none does, and while the clock is in doubt."""
    sensor = session.get_known(Sensor, sensor_id)
    row = rows.find_policy_in_force(session, sensor_id)
    if row is None:
        raise ConflictError(f"{sensor.name} has no ingest policy in force; write one, rehearse it and have it enabled.")
    if row.state == "PAUSED":
        raise ConflictError(f"Ingest of {sensor.name} is paused: {row.pause_reason} Have a person resume it.")
    if is_held(session):
        raise ConflictError(
            "The clock of this server jumped, so nothing is ingested; have a person acknowledge its alarm."
        )
    return row


def find_earlier(session: Session, sensor_id: int, sha256: str) -> IngestDecision | None:
    """Return the decision that was made on the same bytes."""
    return rows.find_decision_on(session, sensor_id, sha256)


def explain_flood(session: Session, policy: IngestPolicy) -> str | None:
    """Say why no further file is taken in today; None where one may be."""
    rules, since = policies.read_rules(policy), max(utc_after(-DAY_S), policy.resumed_utc or "")
    if rows.count_received(session, policy.sensor_id, since) < rules.sets_per_day:
        return None
    return f"More than {rules.sets_per_day} files arrived within a day; check the sender."


def receive(
    session: Session, actor: Actor, blobs: BlobStore, policy_id: int, prepared: PreparedUpload, sent: SentFile
) -> IngestDecision:
    """Store a file that was read and checked, launch its calibration, and open its decision, in one transaction.

    What runs away is refused on record and pauses the policy.
    """
    require_role(actor, "analyst")
    require_scope(actor, "telemetry-sets")
    policy = session.get_known(IngestPolicy, policy_id)
    get_active_policy(session, policy.sensor_id)
    known = None if sent.sha256 is None else find_earlier(session, policy.sensor_id, sent.sha256)
    if known is not None:
        return known
    rules = policies.read_rules(policy)
    if (clock := _doubt_times(prepared, rules)) is not None:
        return refuse(session, actor, policy_id, sent, clock, "BAD CLOCK")
    row = telemetry_sets.store_prepared(session, actor, blobs, policy.sensor_id, prepared)
    decision = _open(session, actor, policy, sent, "CALIBRATING", "Its calibration is queued.", row.id)
    try:
        decision.run_id = _launch(session, policy, rules, row).id
    except BoresightError as error:
        _end(session, decision, "NOT JUDGED", (Reason("NOT LAUNCHED", str(error)),))
        return decision
    audit.append(session, INGEST, "launched", name_subject(decision), None, {"run_id": decision.run_id})
    return decision


def _doubt_times(prepared: PreparedUpload, rules: PolicyRules) -> str | None:
    """Say what is wrong with the times of a file; None where nothing is, or where it has none."""
    time = parse_quality(prepared.quality).time
    if time is None:
        return None
    begins, ends = (utc_text(datetime.fromisoformat(text)) for text in (time.start_utc, time.end_utc))
    if ends > utc_after(AHEAD_S):
        return f"The telemetry ends at {ends}, which is in the future: check the on-board clock and the clock of this server."
    if begins < utc_after(-rules.oldest_days * DAY_S):
        return (
            f"The telemetry begins at {begins}, more than {rules.oldest_days:g} days ago: "
            "check the clock on board, or upload it by hand."
        )
    return None


def _launch(session: Session, policy: IngestPolicy, rules: PolicyRules, data: TelemetrySet) -> Run:
    """Queue the calibration of a set from the baseline's parameters, with the newest validation set that is not its own."""
    sensor, baseline = session.get_known(Sensor, policy.sensor_id), set_rows.find_baseline(session, policy.sensor_id)
    same_model = baseline is not None and baseline.document["camera_model"] == sensor.document["camera_model"]
    _, settings = choose_settings(session, rules.preset, {})
    newest = lists.list_newest(
        session, TelemetrySet, sensor=policy.sensor_id, purpose="validation", in_use=True, limit=1
    )
    run = runs.launch(
        session,
        INGEST,
        policy.sensor_id,
        data.id,
        settings,
        validation_set_id=newest[0].id if newest else None,
        label=f"Ingest: {data.name}"[:LONGEST_NAME],
        initial=baseline.document["parameters"] if baseline is not None and same_model else None,
    )
    if not isinstance(run, Run):
        raise TypeError("Expected a run, received the answer of a dry run")
    return run


def refuse(
    session: Session, actor: Actor, policy_id: int, sent: SentFile, sentence: str, code: str | None = None
) -> IngestDecision:
    """Put on record that a file was refused; a code pauses the policy, and so do too many refusals in a row."""
    require_role(actor, "analyst")
    require_scope(actor, "telemetry-sets")
    policy = session.get_known(IngestPolicy, policy_id)
    row = _open(session, actor, policy, sent, "REFUSED", sentence)
    row.decided_utc = utc_now()
    row.evidence = {"reasons": [{"code": code or "REFUSED", "sentence": sentence}]}
    if code is not None:
        policies.pause(session, policy, code, sentence)
    _stop_after_failures(session, policy)
    return row


def find_code(error: BoresightError) -> str | None:
    """Return the code that a refusal of a file pauses its policy with; None for an ordinary one."""
    return "WRONG SENSOR" if isinstance(error, OtherCameraError) else None


def _open(
    session: Session,
    actor: Actor,
    policy: IngestPolicy,
    sent: SentFile,
    state: str,
    sentence: str,
    set_id: int | None = None,
) -> IngestDecision:
    row = IngestDecision(
        sensor_id=policy.sensor_id,
        policy_id=policy.id,
        source=sent.source,
        file_name=sent.name[:LONGEST_NAME],
        file_sha256=sent.sha256,
        size_bytes=sent.size_bytes,
        received_utc=utc_now(),
        received_by=actor.user_id,
        telemetry_set_id=set_id,
        state=state,
        sentence=sentence,
        evidence={},
    )
    session.put(row)
    told = {
        "sensor_id": row.sensor_id,
        "file": row.file_name,
        "sha256": sent.sha256,
        "source": sent.source,
        "state": state,
    }
    audit.append(session, actor, "received", name_subject(row), None, told, sentence)
    return row


@dataclass(frozen=True)
class Found:
    """What was found out about a decision whose run has ended, before the writing transaction."""

    decision_id: int
    judgement: PolicyFinding
    alternatives: tuple[Mapping[str, Any], ...] = ()
    advice: Advice | None = None


def examine(session: Session, decision_id: int) -> Found:
    """Judge the calibration of a decision; only reads."""
    row = session.get_known(IngestDecision, decision_id)
    run = session.get_known(Run, row.run_id or 0)
    policy = session.get_known(IngestPolicy, row.policy_id)
    if run.state != "SUCCEEDED":
        return Found(row.id, _report_failure(run))
    summary = parse_run_summary(run.summary)
    if summary.status not in parameter_sets.USABLE_STATUSES:
        said = f"Run {run.id} ended {(summary.status or 'without a status').replace('_', ' ')}: {summary.advice or 'see its page.'}"
        return Found(row.id, PolicyFinding("NOT JUDGED", (Reason("UNUSABLE", said),)))
    rules = policies.read_rules(policy)
    trend = read_trend(session, row.sensor_id)
    found = judge_newest(trend, run.id, rules)
    if found.in_row and (other := _find_other_sensor(session, trend, run.id, rules)) is not None:
        return Found(row.id, _report_other_sensor(found, trend.sensor.name, other))
    if found.state == "ASKED":
        found = _as_answered(session, row, found, trend, rules) or found
    if found.state != "ASKED":
        return Found(row.id, found)
    return Found(row.id, found, _list_alternatives(found, run), advise(trend))


def _find_other_sensor(session: Session, own: Trend, run_id: int, rules: PolicyRules) -> OtherSensor | None:
    """Find the sensor of the same design that a set outside of its forecast is of."""
    point = own.find_run(run_id)
    measured = telemetry_rows.read_measured_baselines(session)
    alike = [
        sensor_id
        for sensor_id, document in telemetry_rows.read_sensor_documents(session)
        if sensor_id in measured and sensor_id != own.sensor.id and is_of_one_design(own.sensor.document, document)
    ]
    if point is None or not alike:
        return None
    sensors = [session.get_known(Sensor, sensor_id) for sensor_id in alike]
    return find_other_sensor(point, own, list(read_trends(session, sensors).values()), rules)


def _report_other_sensor(found: PolicyFinding, name: str, other: OtherSensor) -> PolicyFinding:
    """Say whose set it is, with the numbers; nothing is asked, and `conclude` pauses the policy."""
    instead, own = other.other, other.own
    said = (
        f"The stars fit {other.name} better than {name}: χ² {number(instead.statistic, 3)} for {instead.dof} degrees of freedom "
        f"against the sets of {other.name}, {number(own.statistic, 3)} against those of {name}, {describe_limit(own)}. "
        f"Send the file to {other.name}, and check who puts files into the folder of {name}. If the camera of {name} has really "
        "changed this way, submit its run manually."
    )
    return replace(found, state="NOT JUDGED", reasons=(Reason("WRONG SENSOR", said), *found.reasons), other=other)


def _report_failure(run: Run) -> PolicyFinding:
    return PolicyFinding(
        "NOT JUDGED", (Reason("RUN", f"Run {run.id} {run.state.lower()}: {run.reason or 'no cause was recorded'}"),)
    )


def _as_answered(
    session: Session, row: IngestDecision, found: PolicyFinding, trend: Trend, rules: PolicyRules
) -> PolicyFinding | None:
    """Return why nothing is asked again although a set is outside the baseline: it waits for signatures, or was answered."""
    waiting = approval_rows.read_newest_open(session, [row.sensor_id]).get(row.sensor_id)
    if waiting is not None:
        said = f"Request {waiting} of this sensor is already waiting for signatures."
        return _quiet(found, "REQUEST OPEN", said)
    quiet = rows.find_quiet(session, row.sensor_id, utc_now())
    same_baseline = (
        quiet is not None
        and found.reference is not None
        and quiet.typed_evidence.reference_id == found.reference.parameter_set_id
    )
    if quiet is None or not same_baseline:
        return None
    if not (found.is_forecast if found.forecast is not None else agree(trend, row.run_id, quiet.run_id, rules)):
        return None
    return _quiet(
        found,
        "ANSWERED WAIT",
        f"Decision {quiet.id} was answered with WAIT until {quiet.quiet_until_utc}, and nothing new was found.",
    )


def _quiet(found: PolicyFinding, code: str, sentence: str) -> PolicyFinding:
    return PolicyFinding(
        "WITHIN FORECAST",
        (Reason(code, sentence), *found.reasons),
        found.reference,
        found.holds,
        found.forecast,
        found.largest,
        found.in_row,
    )


def _list_alternatives(found: PolicyFinding, run: Run) -> tuple[Mapping[str, Any], ...]:
    """Write what a person may answer, each with its price in this case."""
    name = found.reference.name if found.reference else "the baseline"
    summary = parse_run_summary(run.summary)
    before, after = summary.rms_initial_arc_rad, summary.rms_final_arc_rad
    price = (
        f"The arcs in this telemetry have an error of {urad(before)} µrad with {name}"
        if before is not None
        else f"{name} stays"
    )
    gain = f", and {urad(after)} µrad with the new parameter set" if before is not None and after is not None else ""
    more = found.in_row + 1
    sets = "this telemetry set" if found.in_row == 1 else f"the {found.in_row} sets since then together"
    said = {
        "SUBMIT": f"Request that the new parameter set become the baseline; an approver signs and an operator promotes it. "
        f"{price}{gain}.",
        "WAIT": f"{name} stays the baseline. No decision on the same change is requested for the number of days you enter, unless "
        f"there is a jump. {price}.",
        "MORE DATA": f"{name} stays the baseline, and the next set will request a decision again. {more} consecutive sets together "
        f"reduce the sigmas by √{more}.",
        "RECALIBRATE": f"Calibrate {sets} with other settings, or a longer pass, and submit the result. If a validation "
        "gate blocks the new parameter set, the validation frames may predate the change: upload newer ones.",
    }
    return tuple({"answer": one, "sentence": said[one]} for one in ANSWERS)


def recommend(found: PolicyFinding, blocking: Sequence[str], advice: Advice | None) -> str:
    """Return the answer that the findings speak for: never to wait for data where the sensor's trend says to recalibrate now.

    What stops a set at the gates does not make the baseline valid again: then another calibration is asked for, on validation
    frames of its own time.
    """
    jumps = found.forecast is not None and found.forecast.rejects
    if jumps or (advice is not None and advice.answer != "YES"):
        return "MORE DATA"
    return "RECALIBRATE" if blocking else "SUBMIT"


def prepare_set(session: Session, blobs: BlobStore, decision_id: int) -> ParameterSet:
    """Make the candidate of a decision's run, or return it."""
    row = session.get_known(IngestDecision, decision_id)
    return parameter_sets.create_from_run(session, INGEST, blobs, row.run_id or 0)


def conclude(session: Session, found: Found, assessment: GateAssessment | None = None) -> IngestDecision:
    """Write what was found into a decision; the same again changes nothing."""
    row = session.get_known(IngestDecision, found.decision_id)
    if row.state != "CALIBRATING":
        return row
    judged, policy = found.judgement, session.get_known(IngestPolicy, row.policy_id)
    evidence = _write_evidence(judged)
    if assessment is None:
        _end(session, row, judged.state, judged.reasons, evidence)
        if judged.other is not None:
            policies.pause(session, policy, judged.reasons[0].code, judged.sentence)
        return row
    report = gates.record_report(session, INGEST, assessment)
    blocking = assessment.report.blocking
    advised = recommend(judged, blocking, found.advice)
    evidence |= {
        "gates": {"verdict": report.verdict, "blocking": blocking, "sha256": report.sha256},
        "alternatives": [{**one, "recommended": one["answer"] == advised} for one in found.alternatives],
        "advised": advised,
        "recalibrate": None if found.advice is None else asdict(found.advice),
    }
    row.parameter_set_id = assessment.parameter_set_id
    _supersede(session, row, f"Replaced by decision {row.id}, which uses newer telemetry.")
    _end(session, row, "ASKED", judged.reasons, evidence)
    since, rules = max(utc_after(-7 * DAY_S), policy.resumed_utc or ""), policies.read_rules(policy)
    if rows.count_asked_since(session, row.sensor_id, since) > rules.requests_per_week:
        policies.pause(
            session,
            policy,
            "TOO MANY REQUESTS",
            f"More than {rules.requests_per_week} requests were prepared within a week; decide on the newest first.",
        )
    return row


def _write_evidence(found: PolicyFinding) -> dict[str, Any]:
    tests = {"holds": found.holds, "forecast": found.forecast}
    return {
        "reasons": [{"code": one.code, "sentence": one.sentence} for one in found.reasons],
        "reference": None if found.reference is None else found.reference.name,
        "reference_id": None if found.reference is None else found.reference.parameter_set_id,
        "in_row": found.in_row,
        "other_sensor_id": None if found.other is None else found.other.sensor_id,
        "largest": None if found.largest is None else {"name": found.largest[0], "sigmas": found.largest[1]},
        **{
            name: None if one is None else {"statistic": one.statistic, "dof": one.dof, "limit": one.limit, "p": one.p}
            for name, one in tests.items()
        },
    }


def _end(
    session: Session,
    row: IngestDecision,
    state: str,
    reasons: tuple[Reason, ...],
    evidence: Mapping[str, Any] | None = None,
) -> None:
    row.sentence, row.decided_utc = reasons[0].sentence, utc_now()
    row.evidence = dict(evidence or {"reasons": [{"code": one.code, "sentence": one.sentence} for one in reasons]})
    told = {"code": reasons[0].code, "run_id": row.run_id, "parameter_set_id": row.parameter_set_id}
    move(session, INGEST, row, state, AuditAction.DECIDED, reason=row.sentence, **told)
    if state == "NOT JUDGED":
        _stop_after_failures(session, session.get_known(IngestPolicy, row.policy_id))


def _stop_after_failures(session: Session, policy: IngestPolicy) -> None:
    session.flush()
    rules = policies.read_rules(policy)
    failed = rows.count_failures_in_row(session, policy.sensor_id, policy.resumed_utc or "")
    if failed >= rules.failures_in_row:
        policies.pause(
            session,
            policy,
            "FAILURES",
            f"{failed} consecutive files were refused or not judged; read the reasons of their decisions.",
        )


def _supersede(session: Session, newer: IngestDecision, why: str) -> None:
    """Close the question of a sensor that a newer one replaces: it is asked once at a time."""
    older = rows.find_asked(session, newer.sensor_id)
    if older is not None and older.id != newer.id:
        move(session, INGEST, older, "SUPERSEDED", "superseded", reason=why)
        session.flush()


def list_overtaken(session: Session) -> list[int]:
    """Return the decisions that wait for an answer although the baseline that they were judged against is another now."""
    found = []
    for row in rows.list_asked(session, 1000):
        baseline = set_rows.find_baseline(session, row.sensor_id)
        if baseline is not None and baseline.id != row.typed_evidence.reference_id:
            found.append(row.id)
    return found


def supersede_overtaken(session: Session, decision_id: int) -> None:
    """Close a question whose baseline moved."""
    row = session.get_known(IngestDecision, decision_id)
    if row.state == "ASKED":
        baseline = set_rows.find_baseline(session, row.sensor_id)
        name = baseline.name if baseline else "another set"
        move(session, INGEST, row, "SUPERSEDED", "superseded", reason=f"{name} is the baseline now.")


@dataclass(frozen=True)
class DecisionAnswer:
    """What a person answers: one of `ANSWERS`, why, and for WAIT for how many days."""

    answer: str
    reason: str
    days: float = QUIET_DAYS

    def check(self) -> None:
        """Check that it is complete."""
        refuse_control_characters(reason=self.reason)
        if self.answer not in ANSWERS:
            raise RefusedInputError(f"There is no answer {self.answer[:40]!r}; choose from {', '.join(ANSWERS)}.")
        if not self.reason.strip() or len(self.reason) > LONGEST_REASON:
            raise RefusedInputError(f"Enter the reason for your answer, up to {LONGEST_REASON} characters.")
        if not 0.0 < self.days <= MOST_QUIET_DAYS:
            raise RefusedInputError(f"WAIT can last up to {MOST_QUIET_DAYS:.0f} days; enter a number greater than 0.")


def explain_why_not_answer(session: Session, actor: Actor, row: IngestDecision, given: str) -> str | None:
    """Say why this actor may not give an answer; None when nothing but the reason is missing."""
    try:
        _refuse_answerer(actor)
        _refuse_answer(session, row, given)
    except (ForbiddenError, ConflictError) as refusal:
        return str(refusal)
    return None


def _refuse_answerer(actor: Actor) -> int:
    user_id = require_person(actor, "answer an ingest decision")
    require_role(actor, "analyst")
    return user_id


def _refuse_answer(session: Session, row: IngestDecision, given: str) -> None:
    """Refuse an answer where none is asked for, and to submit a set that was submitted on its own page meanwhile."""
    if row.state != "ASKED":
        raise ConflictError(f"Decision {row.id} is {row.state}; it needs no answer. Choose one that is ASKED.")
    if given == "SUBMIT":
        approvals.refuse_unsubmittable(session, session.get_known(ParameterSet, row.parameter_set_id or 0))


def answer(
    session: Session,
    actor: Actor,
    blobs: BlobStore,
    decision_id: int,
    given: DecisionAnswer,
    seen_version: int | None,
    *,
    policy: Policy = POLICY,
) -> IngestDecision:
    """Answer a question in person; SUBMIT opens the request for approval, with whoever answers as its submitter."""
    user_id = _refuse_answerer(actor)
    row = session.get_known(IngestDecision, decision_id)
    require_seen(session, row, seen_version)
    given.check()
    _refuse_answer(session, row, given.answer)
    if given.answer == "SUBMIT":
        prepared = session.get_known(ParameterSet, row.parameter_set_id or 0)
        request = approvals.submit(session, actor, blobs, prepared.id, given.reason, prepared.version, policy=policy)
        row.approval_id = request.id
    row.answer, row.answer_reason, row.answered_by, row.answered_utc = (
        given.answer,
        given.reason.strip(),
        user_id,
        utc_now(),
    )
    row.quiet_until_utc = utc_after(given.days * DAY_S) if given.answer == "WAIT" else None
    told = {"answer": given.answer, "approval_id": row.approval_id, "advised": row.typed_evidence.advised}
    move(session, actor, row, "ANSWERED", "answered", reason=row.answer_reason, **told)
    return row


def list_due(session: Session) -> list[int]:
    """Return the decisions whose run has ended."""
    return list(rows.list_due(session))


@dataclass(frozen=True)
class IntakeSources:
    """What a file is checked against before anything is written: policy, sensor file, cameras and mapping profile."""

    policy_id: int
    document: Mapping[str, Any]
    cameras: RegisteredCameras
    wanted: ImportRequest | None


def read_intake(session: Session, sensor_id: int) -> IntakeSources:
    """Read what a file of a sensor is checked against; refuses where no policy takes files in."""
    policy = get_active_policy(session, sensor_id)
    key = policies.read_rules(policy).profile
    wanted = ImportRequest(find_profile(session, key)) if key else None
    document = session.get_known(Sensor, sensor_id).document
    return IntakeSources(policy.id, document, telemetry_sets.read_cameras(session, sensor_id), wanted)


@contextmanager
def hold_intake(
    intake: IntakeSources, sources: ForecastSources, path: Path, name: str, limits: Limits, images: ImageUpload
) -> Iterator[PreparedUpload]:
    """Read and check a file without the database; a defect of ours refuses it too, for it would be met again each time."""
    with ExitStack() as stack:
        try:
            prepared = stack.enter_context(
                telemetry_sets.hold_prepared(
                    intake.document,
                    sources.catalogue(),
                    path,
                    name,
                    limits,
                    sources.catalogue_folder,
                    images,
                    intake.wanted,
                    cameras=intake.cameras,
                )
            )
        except (BoresightError, OSError):
            raise
        except Exception as error:
            log.exception("%s could not be read", name)
            raise RefusedInputError(
                f"{name} could not be read because of a software error; send it with the server log to the maintainers."
            ) from error
        sources.blobs.send_ahead(prepared.original, prepared.table)
        yield prepared
