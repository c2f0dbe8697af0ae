"""Gate reports and waivers: a set held against its sensor's limits and against the incumbent.

A report is made in three steps, because seeing validation frames under two sets takes seconds and there is one writer::

    gather   reading transaction    what the verdict rests on, with its hashes     (`StoredGateInputs`)
    examine  no transaction         measure and judge
    record   writing transaction    stored if none of the hashes moved meanwhile

A report is valid while none of its bound hashes has changed. Validation frames are those that neither the set nor the incumbent
was fitted to. A waiver is never taken back; it is laid over the report until it expires, and makes an open request of the set
STALE.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from boresight.calibration.calibration import Calibration, parse_calibration, to_plain
from boresight.calibration.options import CalibrationSettings
from boresight.console import list_queries as lists
from boresight.console.access import confirmations
from boresight.console.access.passwords import PasswordProof
from boresight.console.approvals import queries as rows
from boresight.console.approvals import staleness
from boresight.console.approvals.gate_profiles import ensure_profile, get_profile_in_force
from boresight.console.approvals.tables import GateReport, Waiver
from boresight.console.fleet.tables import Sensor as SensorRow
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import queries as run_rows
from boresight.console.runs.results import read_result
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.transitions import describe_baseline, require_seen
from boresight.console.uplinks import queries as table_definitions
from boresight.errors import (
    BoresightError,
    ConflictError,
    CorruptFileError,
    ForbiddenError,
    NotFoundError,
    RefusedInputError,
    StaleError,
)
from boresight.platform.actors import Actor, require_person, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.working_tables import table_path
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Session, utc_after, utc_now
from boresight.platform.db.times import read_time
from boresight.platform.web.text_validation import refuse_control_characters
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.sensors import Sensor, parse_sensor
from boresight.telemetry.working_table import WorkingTable
from boresight.verdicts import gates
from boresight.verdicts.gates import GATES
from boresight.verdicts.gates.assessed_set import parse_assessed_set
from boresight.verdicts.gates.assessment import compute_validation_scores, started_from, take_scores


@dataclass(frozen=True)
class StoredGateInputs:
    """A set with everything that its verdict rests on, as it stands in the store."""

    parameter_set_id: int
    name: str
    sensor_document: Mapping[str, Any]
    candidate: Mapping[str, Any]
    incumbent: Mapping[str, Any] | None
    result_sha256: str | None
    made_with: Mapping[str, Any] | None
    settings: Mapping[str, Any] | None
    validation: tuple[str, str] | None
    profile: Mapping[str, Any]
    definition: Mapping[str, Any] | None
    bound: gates.BoundHashes


def read_gate_inputs(session: Session, parameter_set_id: int) -> StoredGateInputs:
    """Read the inputs of a set's gates."""
    row = session.get_known(ParameterSet, parameter_set_id)
    run = None if row.run_id is None else session.get_one(Run, row.run_id)
    incumbent = _find_incumbent(session, row)
    definition = table_definitions.find_definition_in_force(session, row.sensor_id)
    validation = _choose_validation_frames(session, row, run, incumbent)
    return StoredGateInputs(
        parameter_set_id=row.id,
        name=row.name,
        sensor_document=session.get_known(SensorRow, row.sensor_id).document,
        candidate=row.document,
        incumbent=None if incumbent is None else incumbent.document,
        result_sha256=None if run is None else run.result_sha256,
        made_with=None if run is None else run.sensor_document,
        settings=None if run is None else run.settings,
        validation=None if validation is None else (validation.name, validation.table_sha256),
        profile=get_profile_in_force(session, row.sensor_id).document,
        definition=None if definition is None else definition.document,
        bound=compute_bound_hashes(session, row),
    )


def compute_bound_hashes(session: Session, row: ParameterSet) -> gates.BoundHashes:
    """Return the hashes of everything that a report on a set rests on, as they are now."""
    run = None if row.run_id is None else session.get_one(Run, row.run_id)
    incumbent = set_rows.find_baseline(session, row.sensor_id)
    definition = table_definitions.find_definition_in_force(session, row.sensor_id)
    return gates.BoundHashes(
        set_sha256=compute_sha256(row.document),
        run_result_sha256=None if run is None else run.result_sha256,
        profile_sha256=get_profile_in_force(session, row.sensor_id).sha256,
        incumbent_sha256=None if incumbent is None else incumbent.sha256,
        table_definition_sha256=None if definition is None else definition.sha256,
    )


def _find_incumbent(session: Session, row: ParameterSet) -> ParameterSet | None:
    """Return the baseline that a set would replace; None where it is the baseline itself."""
    baseline = set_rows.find_baseline(session, row.sensor_id)
    return None if baseline is None or baseline.id == row.id else baseline


def _choose_validation_frames(
    session: Session, row: ParameterSet, run: Run | None, incumbent: ParameterSet | None
) -> TelemetrySet | None:
    behind = [run, None if incumbent is None or incumbent.run_id is None else session.get_one(Run, incumbent.run_id)]
    fitted = {number for known in behind if known is not None for number in run_rows.list_held_sets(session, known)}
    own = None if run is None or run.validation_set_id is None else session.get(TelemetrySet, run.validation_set_id)
    others = lists.list_newest(  # among so many sets at least one took no part in the fit
        session, TelemetrySet, sensor=row.sensor_id, purpose="validation", in_use=True, limit=len(fitted) + 1
    )
    candidates = [*([] if own is None else [own]), *others]
    return next((known for known in candidates if known.id not in fitted), None)


NO_SET = "There are no validation frames: upload a validation set that neither this set nor the baseline was fitted to."
NOT_SEEN = "The validation frames were not matched with this set and the baseline: assess the set."
ASSESSORS = ("analyst", "approver", "operator", "administrator")


@dataclass(frozen=True)
class GateAssessment:
    """A report that is not stored yet."""

    parameter_set_id: int
    report: gates.BoundGateReport


def measure(session: Session, blobs: BlobStore, catalogue: Catalogue | None, parameter_set_id: int) -> GateAssessment:
    """Gather and examine in one call; only reads from the session."""
    return examine(read_gate_inputs(session, parameter_set_id), blobs, catalogue)


def examine(
    stored: StoredGateInputs, blobs: BlobStore, catalogue: Catalogue | None, cache_folder: Path | None = None
) -> GateAssessment:
    """Measure and judge a set from its inputs."""
    sensor = parse_sensor(stored.sensor_document)
    result = None if stored.result_sha256 is None else parse_calibration(read_result(blobs, stored.result_sha256))
    candidate = parse_assessed_set(stored.candidate, sensor)
    incumbent = None
    if stored.incumbent is not None:
        incumbent = parse_assessed_set(stored.incumbent, sensor, "The baseline")
    validation, why = _seen(stored, blobs, sensor, candidate, incumbent, result, catalogue, cache_folder)
    inputs = gates.GateInputs(
        sensor=sensor,
        candidate=candidate,
        incumbent=incumbent,
        result=result,
        made_with=None if stored.made_with is None else parse_sensor(stored.made_with),
        validation=validation,
        no_validation=why,
        definition=stored.definition,
    )
    report = gates.judge(gates.parse_profile(stored.profile), gates.measure(inputs))
    frames = None
    if validation is not None and stored.validation is not None:
        frames = gates.HeldOut(name=stored.validation[0], sha256=stored.validation[1])
    bound = gates.BoundGateReport(**vars(report), held_out=frames, bound=stored.bound)
    return GateAssessment(stored.parameter_set_id, bound)


def _seen(
    stored: StoredGateInputs,
    blobs: BlobStore,
    sensor: Sensor,
    candidate: gates.AssessedSet,
    incumbent: gates.AssessedSet | None,
    result: Calibration | None,
    catalogue: Catalogue | None,
    cache_folder: Path | None,
) -> tuple[gates.ValidationScores | None, str]:
    """Return the scores on validation frames, or None with the reason; a comparison that the run made already is reused."""
    if incumbent is not None and result is not None and started_from(result, incumbent):
        own = take_scores(result)
        if own is not None:
            return own, ""
    if stored.validation is None:
        return None, NO_SET
    if catalogue is None:
        return None, NOT_SEEN
    name, sha256 = stored.validation
    try:
        settings = CalibrationSettings.parse(stored.settings or {})
        frames = WorkingTable(table_path(blobs, sha256)).read()
        return compute_validation_scores(
            frames, sensor, catalogue, incumbent or candidate, candidate, settings, cache_folder
        ), ""
    except CorruptFileError:
        raise  # no evidence is made of, or in spite of, a file that was altered
    except BoresightError as refusal:
        return None, f"The held-out set {name} could not be used: {refusal}"


def record_report(session: Session, actor: Actor, assessment: GateAssessment) -> GateReport:
    """Store a report; the same one again is the row that is there."""
    require_role(actor, *ASSESSORS)
    require_scope(actor, "parameter-sets")
    return _record(session, actor, assessment)


def _record(session: Session, actor: Actor, assessment: GateAssessment) -> GateReport:
    row = session.get_known(ParameterSet, assessment.parameter_set_id)
    profile = ensure_profile(session, actor, row.sensor_id)
    moved = assessment.report.bound.list_moved(compute_bound_hashes(session, row))
    if moved:
        since = describe_baseline(session, row.sensor_id)
        raise StaleError(
            f"The {gates.name_inputs(moved)} changed while {row.name} was assessed.{since} Assess it again.",
            code="changed-while-assessed",
        )
    document = to_plain(assessment.report)
    sha256 = compute_sha256(document)
    newest = rows.find_newest_report(session, row.id)
    if newest is not None and newest.sha256 == sha256:
        return newest
    report = GateReport(
        parameter_set_id=row.id,
        gate_profile_id=profile.id,
        verdict=assessment.report.verdict,
        document=document,
        sha256=sha256,
        created_utc=utc_now(),
        created_by=actor.user_id,
    )
    session.put(report)
    told = {"set": row.name, "verdict": report.verdict, "blocking": assessment.report.blocking, "sha256": sha256}
    audit.append(session, actor, "assessed", f"parameter-sets/{row.id}/gate-report", None, told)
    return report


def find_valid_report(session: Session, parameter_set_id: int) -> GateReport | None:
    """Return a set's newest report if its inputs are unchanged; None otherwise."""
    report = rows.find_newest_report(session, parameter_set_id)
    return None if report is None or list_moved_since(session, report) else report


def get_report(session: Session, parameter_set_id: int, sha256: str | None = None) -> GateReport:
    """Return a set's newest report, or the one with a hash; refuse where there is none."""
    row = session.get_known(ParameterSet, parameter_set_id)
    report = rows.find_newest_report(session, parameter_set_id, sha256)
    if report is None and sha256 is not None:
        raise NotFoundError(
            f"{row.name} (parameter set {row.id}) has no gate report {sha256}; leave sha256 out for the newest."
        )
    if report is None:
        raise NotFoundError(f"{row.name} (parameter set {row.id}) has no gate report; make one with POST :assess.")
    return report


def list_moved_since(session: Session, report: GateReport) -> list[gates.BoundInput]:
    """List the inputs of a report that have changed; it is valid while there are none."""
    now = compute_bound_hashes(session, session.get_known(ParameterSet, report.parameter_set_id))
    return gates.parse_bound_report(report.document).bound.list_moved(now)


def choose_report_for_submission(
    session: Session, actor: Actor, blobs: BlobStore, parameter_set_id: int, assessment: GateAssessment | None = None
) -> GateReport:
    """Return the report for a request to bind: the given one, the valid one, or one made from the run's own result only."""
    if assessment is not None:
        return _record(session, actor, assessment)
    known = find_valid_report(session, parameter_set_id)
    return known or _record(session, actor, measure(session, blobs, None, parameter_set_id))


def lay_waivers(session: Session, report: GateReport, bound: Collection[int] | None = None) -> gates.BoundGateReport:
    """Return a report with the waivers laid over it: what is waived, what blocks, and the verdict in words."""
    return _laid_over(report, rows.list_waivers(session, [report.parameter_set_id]), bound)


def _laid_over(
    report: GateReport, waivers: Collection[Waiver], bound: Collection[int] | None = None
) -> gates.BoundGateReport:
    now = utc_now()
    holding = [waiver for waiver in waivers if (waiver.expires_utc > now if bound is None else waiver.id in bound)]
    waived = {waiver.gate for waiver in holding}
    return gates.summarise(gates.parse_bound_report(report.document), waived, {waiver.gate for waiver in waivers})


def read_verdicts(session: Session, parameter_set_ids: Collection[int]) -> dict[int, gates.BoundGateReport]:
    """Return the newest report of each of some sets that was ever assessed, with the waivers laid over it forever."""
    given = rows.list_waivers(session, parameter_set_ids)
    return {
        number: _laid_over(report, [waiver for waiver in given if waiver.parameter_set_id == number])
        for number, report in rows.list_newest_reports(session, parameter_set_ids).items()
    }


CODES = {
    "known-cause": "The cause is known and harmless",
    "limit-too-tight": "The limit is tighter than this case needs",
    "data-limited": "Better data are not available in time",
    "mission-need": "The mission needs the set despite this",
    "other": "Another reason",
}
LEAST_LETTERS = 20
LONGEST_DAYS = 30
DAY_S = 86400.0


def waive(  # noqa: PLR0913, PLR0917 - a waiver has all of these, and a form gives them one by one
    session: Session,
    actor: Actor,
    parameter_set_id: int,
    gate: str,
    code: str,
    reason: str,
    expires_utc: str,
    proof: PasswordProof,
    seen_version: int | None,
) -> Waiver:
    """Let a set pass in spite of a gate that blocks it, as a person who gives the password again."""
    user_id = require_person(actor, "waive a gate")
    require_role(actor, "analyst", "approver")
    row = session.get_known(ParameterSet, parameter_set_id)
    require_seen(session, row, seen_version)
    until = _checked(gate, code, reason, expires_utc)
    report = _get_blocking_report(session, parameter_set_id, row.name, gate)
    confirmations.require(session, actor, proof)
    waiver = Waiver(
        parameter_set_id=row.id,
        gate_report_id=report.id,
        gate=gate,
        code=code,
        reason=reason.strip(),
        expires_utc=until,
        made_utc=utc_now(),
        made_by=user_id,
        printed_name=actor.printed_name,
    )
    session.put(waiver)
    told: dict[str, Any] = {"set": row.name, "gate": gate, "code": code, "expires_utc": until, "report": report.sha256}
    audit.append(session, actor, "waived a gate of", f"parameter-sets/{row.id}/waivers", None, told, waiver.reason)
    staleness.make_stale_of_set(session, actor, row.id, f"its gate {gate} was waived")
    return waiver


def _checked(gate: str, code: str, reason: str, expires_utc: str) -> str:
    """Check a waiver, and return its expiry as the store writes it."""
    refuse_control_characters(reason=reason)
    if gate not in GATES:
        raise RefusedInputError(f"There is no gate {gate!r}; choose from {', '.join(GATES)}.")
    if code not in CODES:
        raise RefusedInputError(f"There is no reason code {code!r}; choose from {', '.join(CODES)}.")
    if len(reason.strip()) < LEAST_LETTERS:
        raise RefusedInputError(
            f"Enter a reason of at least {LEAST_LETTERS} letters so that the approvers can judge it."
        )
    until = read_time(expires_utc)
    if not utc_now() < until <= utc_after(LONGEST_DAYS * DAY_S):
        raise RefusedInputError(f"The waiver cannot expire at {until}; give a future time within {LONGEST_DAYS} days.")
    return until


def _get_blocking_report(session: Session, parameter_set_id: int, name: str, gate: str) -> GateReport:
    report = find_valid_report(session, parameter_set_id)
    if report is None:
        raise ConflictError(
            f"{name} has no up-to-date gate report: assess it, then waive what blocks it.", code="no-gate-report"
        )
    found = lay_waivers(session, report)
    answer = next(one for one in found.gates if one.name == gate)
    if gate not in found.blocking:
        how = "waived already" if answer.waived else answer.status
        raise ConflictError(
            f"The gate {gate} does not block {name}: it is {how}. There is nothing to waive.",
            code="gate-does-not-block",
        )
    if answer.critical or not answer.waivable:
        why = "it is critical" if answer.critical else "the gate profile does not allow it to be waived"
        raise ForbiddenError(f"The gate {gate} cannot be waived: {why}. Recalibrate.", code="gate-not-waivable")
    return report
