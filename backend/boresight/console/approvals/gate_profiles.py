"""Gate profiles: the limits that a sensor's sets are held to. Every version is kept; the newest is in force.

Until somebody sets another, the default of `verdicts.gates` is version 0; its row is written when first needed. Only an
administrator, who neither runs nor signs, sets limits, and the sensor's undecided requests become stale by it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from boresight.calibration.calibration import parse_calibration
from boresight.console.approvals import queries as rows
from boresight.console.approvals import staleness
from boresight.console.approvals.tables import GateProfile
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.runs.results import read_result
from boresight.console.runs.tables import Run
from boresight.console.transitions import DocumentInForce, require_change, require_seen_document
from boresight.errors import BoresightError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import refuse_control_characters
from boresight.telemetry.sensors import parse_sensor
from boresight.verdicts import gates
from boresight.verdicts.gates import Measurement
from boresight.verdicts.gates.assessed_set import assess_calibration, ground_set
from boresight.verdicts.gates.assessment import take_scores

DEFAULT = gates.parse_profile({}).document()
DEFAULT_SHA256 = compute_sha256(DEFAULT)
RUNS_TRIED = 40
NO_VALIDATION = "The run had no validation set, so only the fitted frames could be used."


@dataclass(frozen=True)
class TriedProfile:
    """How a profile would have judged a past run."""

    run: Run
    parameter_set: str | None
    verdict: str
    blocking: list[str]
    verdict_now: str
    blocking_now: list[str]
    basis: str

    @property
    def run_id(self) -> int:
        """The number of the run."""
        return self.run.id


def get_profile_in_force(session: Session, sensor_id: int) -> GateProfile:
    """Return a sensor's profile; the default as version 0 where nobody set or needed one, a row that is not stored."""
    sensor = session.get_known(Sensor, sensor_id)
    return rows.find_newest_profile(session, sensor_id) or _default(sensor)


def _default(sensor: Sensor) -> GateProfile:
    return GateProfile(
        sensor_id=sensor.id,
        number=0,
        document=DEFAULT,
        sha256=DEFAULT_SHA256,
        reason="The default, until other limits are set.",
        created_utc=sensor.created_utc,
        created_by=None,
    )


def list_profiles(session: Session, sensor_id: int) -> Sequence[GateProfile]:
    """Return a sensor's profiles, newest first."""
    sensor = session.get_known(Sensor, sensor_id)
    return rows.list_profiles(session, sensor_id) or [_default(sensor)]


def ensure_profile(session: Session, actor: Actor, sensor_id: int) -> GateProfile:
    """Return the profile in force, its row written if it was not."""
    row = get_profile_in_force(session, sensor_id)
    return row if row.id is not None else _add(session, actor, row, None)


def set_profile(
    session: Session,
    actor: Actor,
    sensor_id: int,
    document: Mapping[str, Any],
    reason: str,
    seen_number: int | None,
) -> GateProfile:
    """Put a profile into force for a sensor."""
    complete = check_profile(session, actor, sensor_id, document, reason, seen_number)
    return put_into_force(session, actor, sensor_id, complete, reason)


def check_profile(
    session: Session, actor: Actor, sensor_id: int, document: Mapping[str, Any], reason: str, seen_number: int | None
) -> dict[str, Any]:
    """Return a profile complete, as it would be stored, if this actor may put it into force now."""
    require_role(actor, "administrator")
    require_scope(actor, "sensors")
    refuse_control_characters(reason=reason)
    current = get_profile_in_force(session, sensor_id)
    in_force = DocumentInForce("gate profile", name_profile(sensor_id), current.number, current.sha256)
    require_seen_document(session, in_force, seen_number)
    complete = gates.parse_profile(document).document()
    require_change(in_force, complete, reason)
    return complete


def put_into_force(
    session: Session,
    actor: Actor,
    sensor_id: int,
    complete: Mapping[str, Any],
    reason: str,
    proposal: ChangeProposal | None = None,
) -> GateProfile:
    """Put a complete profile into force, in the name of its proposer where there is one."""
    complete = gates.parse_profile(complete).document()
    current = ensure_profile(session, actor, sensor_id)
    row = GateProfile(
        sensor_id=sensor_id,
        number=current.number + 1,
        document=complete,
        sha256=compute_sha256(complete),
        reason=reason.strip(),
        created_utc=utc_now(),
        created_by=actor.user_id if proposal is None else proposal.proposed_by,
    )
    _add(session, actor, row, current, proposal)
    staleness.make_stale_of_sensor(session, actor, sensor_id, f"the gate profile became version {row.number}")
    return row


def name_profile(sensor_id: int) -> str:
    """Name a sensor's profiles as the audit log does, by their REST address."""
    return f"sensors/{sensor_id}/gate-profiles"


def _add(
    session: Session,
    actor: Actor,
    row: GateProfile,
    before: GateProfile | None,
    proposal: ChangeProposal | None = None,
) -> GateProfile:
    """Store a profile; the audit record holds the thresholds that changed, before and after."""
    session.put(row)
    told: dict[str, Any] = {"version": row.number, "sha256": row.sha256}
    told |= {} if proposal is None else {"proposal": proposal.id}
    earlier: dict[str, Any] | None = None
    if before is not None:
        earlier = {"version": before.number, "sha256": before.sha256}
        for old, new in zip(before.document["gates"], row.document["gates"], strict=True):
            for key in (key for key in new if old[key] != new[key]):
                earlier[f"{new['name']} {key}"], told[f"{new['name']} {key}"] = old[key], new[key]
    audit.append(session, actor, "set", name_profile(row.sensor_id), earlier, told, row.reason)
    return row


def dry_run(session: Session, blobs: BlobStore, sensor_id: int, document: Mapping[str, Any]) -> list[TriedProfile]:
    """Judge a sensor's newest runs by a profile that is not in force, to see what it would have blocked."""
    tried = gates.parse_profile(document)
    current = gates.parse_profile(get_profile_in_force(session, sensor_id).document)
    found = []
    for run in rows.list_runs_with_results(session, sensor_id, RUNS_TRIED):
        row = set_rows.find_set_of_run(session, run.id)
        report = None if row is None else rows.find_newest_report(session, row.id)
        basis = "the set's gate report" if report else "the run's own result"
        measured = gates.read_measurements(gates.parse_report(report.document)) if report else _measure(blobs, run)
        new, now = gates.judge(tried, measured), gates.judge(current, measured)
        judged = (new.verdict, new.blocking, now.verdict, now.blocking)
        found.append(TriedProfile(run, row.name if row else None, *judged, basis))
    return found


def _measure(blobs: BlobStore, run: Run) -> dict[str, Measurement]:
    try:
        sensor = parse_sensor(run.sensor_document)
        found = parse_calibration(read_result(blobs, str(run.result_sha256), run.id))
        inputs = gates.GateInputs(
            sensor=sensor,
            candidate=replace(assess_calibration(found, sensor), sensor=sensor.name),  # as for a set made from that run
            incumbent=ground_set(sensor),
            result=found,
            made_with=sensor,
            validation=take_scores(found),
            no_validation=NO_VALIDATION,
        )
    except (BoresightError, ValueError):
        return {}
    return gates.measure(inputs)
