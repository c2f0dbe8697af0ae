"""Gate reports: a set held against its sensor's limits and against the incumbent.

A report is made in three steps, because seeing held-out frames under two sets takes seconds and there is one writer::

    gather   reading transaction    what the verdict rests on, with its hashes     (`gate_evidence`)
    examine  no transaction         measure and judge
    record   writing transaction    stored if none of the hashes moved meanwhile

A report holds for the hashes it is bound to; when set, run, profile, incumbent or table definition moved it holds no longer,
and `latest_report` does not know it. A set that is submitted without one gets a light report: what its own run says. Waivers
are no part of a report: they are laid over it whenever it is read, so one that expires blocks again.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from boresight.calibration.options import CalibrationSettings
from boresight.errors import BoresightError, CorruptFileError, NotFoundError, StaleError
from boresight.services import audit
from boresight.services.actors import Actor, require_role, require_scope
from boresight.services.calibration_document import read_result
from boresight.services.gate_evidence import Case, bound_now, gather
from boresight.services.gate_profiles import ensure_profile
from boresight.services.transitions import get_parameter_set, whose_baseline
from boresight.sky.catalogue import Catalogue
from boresight.store import gates as rows
from boresight.store.blobs import BlobStore
from boresight.store.documents import sha256_of
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import GateReport, Waiver
from boresight.telemetry.limits import STORED
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import Sensor, parse_sensor
from boresight.verdicts import gates
from boresight.verdicts.gates.assessment import started_from
from boresight.verdicts.gates.held_out import held_out_scores, of_result

NO_SET = "There are no held-out frames: upload a validation set that neither this set nor the incumbent was fitted to."
NOT_SEEN = "The held-out frames were not seen under this set and the incumbent: assess the set."
ASSESSORS = ("analyst", "approver", "operator", "administrator")


@dataclass(frozen=True)
class Assessment:
    """A report that is not stored yet.

    Parameters
    ----------
    parameter_set_id
        Whose it is.
    document
        The report with what it is bound to.
    """

    parameter_set_id: int
    document: dict[str, Any]


def measure(session: Session, blobs: BlobStore, catalogue: Catalogue | None, parameter_set_id: int) -> Assessment:
    """Gather and examine in one; the session is only read."""
    return examine(gather(session, parameter_set_id), blobs, catalogue)


def examine(case: Case, blobs: BlobStore, catalogue: Catalogue | None, cache_folder: Path | None = None) -> Assessment:
    """Measure and judge a case.

    Parameters
    ----------
    catalogue
        Where directions come from; None sees no frames and takes what the run itself says of its validation.
    cache_folder
        Where lost-in-space identification keeps its tables.
    """
    sensor = parse_sensor(case.sensor_document)
    result = None if case.result_sha256 is None else read_result(blobs, case.result_sha256)
    held_out, why = _seen(case, blobs, sensor, result, catalogue, cache_folder)
    evidence = gates.Evidence(
        sensor=sensor,
        candidate=case.candidate,
        incumbent=case.incumbent,
        result=result,
        made_with=case.made_with,
        held_out=held_out,
        no_held_out=why,
        definition=case.definition,
    )
    report = gates.judge(gates.parse_profile(case.profile), gates.measure(evidence))
    seen = None if held_out is None or case.held_out is None else {"name": case.held_out[0], "sha256": case.held_out[1]}
    return Assessment(case.parameter_set_id, {**report, "held_out": seen, "bound": case.bound})


def _seen(
    case: Case,
    blobs: BlobStore,
    sensor: Sensor,
    result: Mapping[str, Any] | None,
    catalogue: Catalogue | None,
    cache_folder: Path | None,
) -> tuple[Mapping[str, Any] | None, str]:
    """Return the scores on held-out frames, or None with the reason; what the run compared already is not seen again."""
    if case.incumbent is not None and result is not None and started_from(result, case.incumbent):
        own = of_result(result)
        if own is not None:
            return own, ""
    if case.held_out is None:
        return None, NO_SET
    if catalogue is None:
        return None, NOT_SEEN
    name, sha256 = case.held_out
    incumbent = case.candidate if case.incumbent is None else case.incumbent
    try:
        settings = CalibrationSettings.parse(case.settings or {})
        frames = read_telemetry(blobs.path(sha256), f"{name}.parquet", STORED)
        return held_out_scores(frames, sensor, catalogue, incumbent, case.candidate, settings, cache_folder), ""
    except CorruptFileError:
        raise  # no evidence is made of, or in spite of, a file that was altered
    except BoresightError as refusal:
        return None, f"The held-out set {name} could not be used: {refusal}"


def record_report(session: Session, actor: Actor, assessment: Assessment) -> GateReport:
    """Store a report; the same one again is the row that is there.

    Raises
    ------
    ForbiddenError
        When the actor has no part in approving, or a key lacks the scope.
    StaleError
        When anything that it rests on moved while it was made.
    """
    require_role(actor, *ASSESSORS)
    require_scope(actor, "parameter-sets")
    return _record(session, actor, assessment)


def _record(session: Session, actor: Actor, assessment: Assessment) -> GateReport:
    """Store a report if what it rests on is as it was."""
    row = get_parameter_set(session, assessment.parameter_set_id)
    profile = ensure_profile(session, actor, row.sensor_id)
    bound = assessment.document["bound"]
    moved = [_word(name) for name, now in bound_now(session, row).items() if bound[name] != now]
    if moved:
        since = whose_baseline(session, row.sensor_id)
        raise StaleError(f"The {' and the '.join(moved)} moved while {row.name} was assessed.{since} Do it again.")
    sha256 = sha256_of(assessment.document)
    newest = rows.newest_reports(session, [row.id]).get(row.id)
    if newest is not None and newest.sha256 == sha256:
        return newest
    report = GateReport(
        parameter_set_id=row.id,
        gate_profile_id=profile.id,
        verdict=assessment.document["verdict"],
        document=assessment.document,
        sha256=sha256,
        created_utc=utc_now(),
        created_by=actor.user_id,
    )
    session.add(report)
    session.flush()
    told = {"set": row.name, "verdict": report.verdict, "blocking": report.document["blocking"], "sha256": sha256}
    audit.append(session, actor, "assessed", f"parameter-sets/{row.id}/gate-report", None, told)
    return report


def _word(name: str) -> str:
    return name.removesuffix("_sha256").replace("_", " ")


def latest_report(session: Session, parameter_set_id: int) -> GateReport | None:
    """Return a set's newest report if what it rests on is as it was; None otherwise."""
    report = newest_report(session, parameter_set_id)
    return None if report is None or moved_since(session, report) else report


def newest_report(session: Session, parameter_set_id: int, sha256: str | None = None) -> GateReport | None:
    """Return a set's newest report, or the one with a hash, whether or not it still holds."""
    if sha256 is not None:
        return rows.report_with(session, parameter_set_id, sha256)
    return rows.newest_reports(session, [parameter_set_id]).get(parameter_set_id)


def get_report(session: Session, parameter_set_id: int, sha256: str | None = None) -> GateReport:
    """Return a set's newest report, or the one with a hash; refuse where there is none."""
    row = get_parameter_set(session, parameter_set_id)
    report = newest_report(session, parameter_set_id, sha256)
    if report is None and sha256 is not None:
        raise NotFoundError(
            f"{row.name} (parameter set {row.id}) has no gate report {sha256}; leave sha256 out for the newest."
        )
    if report is None:
        raise NotFoundError(f"{row.name} (parameter set {row.id}) has no gate report; POST :assess.")
    return report


def moved_since(session: Session, report: GateReport) -> list[str]:
    """Name what moved of all that a report rests on; it holds while nothing did."""
    bound, now = report.document["bound"], bound_now(session, get_parameter_set(session, report.parameter_set_id))
    return [_word(name) for name in now if bound[name] != now[name]]


def report_for_submission(
    session: Session, actor: Actor, blobs: BlobStore, parameter_set_id: int, assessment: Assessment | None = None
) -> GateReport:
    """Return the report that a request binds: the one given, the one that holds, or a light one from the run's own result.

    Raises
    ------
    StaleError
        When anything that the given one rests on moved while it was made.
    """
    if assessment is not None:
        return _record(session, actor, assessment)
    known = latest_report(session, parameter_set_id)
    return known or _record(session, actor, measure(session, blobs, None, parameter_set_id))


def with_waivers(session: Session, report: GateReport, bound: Collection[int] | None = None) -> dict[str, Any]:
    """Return a report with the waivers laid over it: who waived what, what blocks, and the verdict in words.

    Parameters
    ----------
    bound
        Numbers of the waivers that a request binds: the report as it was signed, whatever expired since. None: as it stands now.
    """
    return _laid_over(report, rows.waivers(session, [report.parameter_set_id]), bound)


def _laid_over(report: GateReport, waivers: Collection[Waiver], bound: Collection[int] | None = None) -> dict[str, Any]:
    now = utc_now()
    holding = [waiver for waiver in waivers if (waiver.expires_utc > now if bound is None else waiver.id in bound)]
    waived = {waiver.gate for waiver in holding}
    return gates.summarised(report.document, waived, {waiver.gate for waiver in waivers})


def verdicts(session: Session, parameter_set_ids: Collection[int]) -> dict[int, str]:
    """Return the verdict, in words, of each of some sets that was ever assessed; waivers stay in it for ever."""
    given = rows.waivers(session, parameter_set_ids)
    return {
        number: _laid_over(report, [waiver for waiver in given if waiver.parameter_set_id == number])["words"]
        for number, report in rows.newest_reports(session, parameter_set_ids).items()
    }
