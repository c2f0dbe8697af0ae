"""Alignments of two sensors: asked for, claimed by a server, computed outside of any transaction, and ended once.

    request --> QUEUED --claim--> RUNNING --finish--> SUCCEEDED | FAILED
                  ^                  |
                  `------------------'   its server stopped; after `MOST_ATTEMPTS` attempts FAILED

Every write is fenced by the attempt: an end that comes after the lease has lapsed and another server took over writes nothing.
What goes on board is asked for and signed in `approval`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD, parse_times
from boresight.calibration.alignment.align import AlignmentOptions
from boresight.calibration.alignment.result import Alignment as AlignmentResult
from boresight.calibration.alignment.result import parse_alignment
from boresight.calibration.calibration import to_plain
from boresight.console.alignments import queries
from boresight.console.alignments.tables import Alignment, AlignmentSummary, parse_summary
from boresight.console.fleet.tables import Sensor
from boresight.console.runs import queries as run_rows
from boresight.console.runs.queries import ClaimedRun
from boresight.console.runs.results import refuse_choice
from boresight.console.runs.service import get_run
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet, find_quality
from boresight.errors import ConflictError, RefusedInputError
from boresight.estimation.alignment import log_rotation
from boresight.estimation.attitude import to_matrix
from boresight.platform.actors import SYSTEM, Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Session, utc_after, utc_now
from boresight.verdicts.gates.judgement import GateReport, parse_report

#: What one side may have, so that an alignment takes a server less than a minute; `boresight align` has no such limits.
MOST_FRAMES, MOST_STARS = 20_000, 400_000
#: Alignments that wait at a time.
MOST_WAITING = 50
#: Who asks for alignments, and submits them.
ALIGNER = "analyst"
LEASE_S = 900.0
MOST_ATTEMPTS = 3
#: Former alignments of a pair that a page compares.
HISTORY = 20


@dataclass(frozen=True)
class ClaimedSide:
    """A side of a claimed alignment: what its run was made of, and its result."""

    run: ClaimedRun
    result_sha256: str


@dataclass(frozen=True)
class ClaimedAlignment:
    """What the computation of an alignment needs."""

    alignment_id: int
    attempt: int
    a: ClaimedSide
    b: ClaimedSide
    options: AlignmentOptions


@dataclass(frozen=True)
class ComputedAlignment:
    """A computed alignment: the address of its stored JSON, the verdict of its gates, and the figures of lists."""

    sha256: str
    verdict: str
    summary: AlignmentSummary


@dataclass(frozen=True)
class PastAlignment:
    """A former alignment of the same sensors, and how this one differs from it about x, y, z of B.

    `change_arcsec`, `in_sigmas`: of the rotation between the frames, over the root of both variances.
    """

    row: Alignment
    summary: AlignmentSummary
    change_arcsec: list[float]
    in_sigmas: list[float]


def parse_options(given: Mapping[str, Any]) -> AlignmentOptions:
    """Read the choices of an alignment; refuses names and values that make no sense."""
    if unknown := set(given) - {one.name for one in fields(AlignmentOptions)}:
        known = ", ".join(one.name for one in fields(AlignmentOptions))
        raise RefusedInputError(f"An alignment has no option {min(unknown)!r}: choose from {known}.")
    return AlignmentOptions(**given)


def may_align(actor: Actor) -> bool:
    """Whether an actor may ask for alignments, and that they go on board."""
    return ALIGNER in actor.roles


def request_alignment(
    session: Session, actor: Actor, run_a_id: int, run_b_id: int, given: Mapping[str, Any]
) -> Alignment:
    """Queue the alignment of the sensors of two runs that succeeded; the same one while it has not ended."""
    require_role(actor, ALIGNER)
    require_scope(actor, "runs")
    parse_options(given)
    a, b = (_get_usable_run(session, run_id) for run_id in (run_a_id, run_b_id))
    names = [session.get_known(Sensor, one.sensor_id).name for one in (a, b)]
    if a.sensor_id == b.sensor_id:
        raise RefusedInputError(
            f"Runs {a.id} and {b.id} are both of {names[0]}: choose runs of two different sensors on one body."
        )
    _refuse_other_times(session, a, b, names, parse_options(given))
    if (known := queries.find_under_way(session, a.id, b.id, given)) is not None:
        return known
    if queries.count_waiting(session) >= MOST_WAITING:
        raise ConflictError(f"{MOST_WAITING} alignments are already waiting; try again when some have finished.")
    row = session.put(
        Alignment(
            sensor_a_id=a.sensor_id,
            sensor_b_id=b.sensor_id,
            run_a_id=a.id,
            run_b_id=b.id,
            options=dict(given),
            created_utc=utc_now(),
            created_by=actor.user_id,
            state="QUEUED",
        )
    )
    on_record = {"sensors": names, "runs": [a.id, b.id], "results": [a.result_sha256, b.result_sha256]}
    audit.append(session, actor, "requested", f"alignments/{row.id}", None, {**on_record, "options": dict(given)})
    return row


def _get_usable_run(session: Session, run_id: int) -> Run:
    run = get_run(session, run_id)
    refuse_choice(run)
    if run.state != "SUCCEEDED" or run.result_sha256 is None:
        raise ConflictError(
            f"Run {run_id} is {run.state}; only runs that SUCCEEDED can be aligned: choose another run."
        )
    sets = _list_sets(session, run)
    for one in sets:
        if one.archived_utc is not None:
            raise ConflictError(
                f"{one.name} was archived on {one.archived_utc[:10]}; upload it again to use it, and calibrate with it."
            )
    frames, stars = sum(one.frames for one in sets), sum(one.stars for one in sets)
    if frames > MOST_FRAMES or stars > MOST_STARS:
        raise RefusedInputError(
            f"Run {run_id} has {frames:,} frames with {stars:,} stars; the server aligns at most {MOST_FRAMES:,} frames "
            f"and {MOST_STARS:,} stars: calibrate a shorter set, or use `boresight align`."
        )
    return run


def _list_sets(session: Session, run: Run) -> list[TelemetrySet]:
    return [session.get_known(TelemetrySet, number) for number in (run.telemetry_set_id, *run.joint_set_ids)]


def _refuse_other_times(session: Session, a: Run, b: Run, names: Sequence[str], options: AlignmentOptions) -> None:
    """Refuse what cannot have a pair; where the hours overlap the computation tells whether there are any."""
    spans = []
    for run, name in zip((a, b), names, strict=True):
        times = [find_quality(one.quality).time for one in _list_sets(session, run)]
        known = [time for time in times if time is not None]
        if not known:
            raise RefusedInputError(
                f"The telemetry of {name} in run {run.id} has no times, which are needed to pair attitudes: choose a run of "
                "telemetry that has them."
            )
        spans.append([tuple(parse_times([time.start_utc, time.end_utc])) for time in known])
    apart_s = np.timedelta64(round(1e6 * max(options.tolerance_s, options.longest_gap_s)), "us")
    if not any(of_a[0] <= of_b[1] + apart_s and of_b[0] <= of_a[1] + apart_s for of_a in spans[0] for of_b in spans[1]):
        raise RefusedInputError(
            f"{names[0]} in run {a.id} and {names[1]} in run {b.id} have no common times: choose runs on telemetry of the "
            "same hours."
        )


def is_any_due(session: Session) -> bool:
    """Whether there is an alignment to compute."""
    return queries.is_any_due(session, utc_now())


def claim(session: Session) -> ClaimedAlignment | None:
    """Claim the oldest alignment that waits under its next attempt; one that ended its servers FAILED, and None is returned."""
    row = queries.find_due(session, utc_now())
    if row is None:
        return None
    if row.attempt >= MOST_ATTEMPTS:
        said = f"The server stopped {row.attempt} times during the computation; align shorter sets, or use `boresight align`."
        _end(session, row, "FAILED", reason=said)
        return None
    row.state, row.attempt = "RUNNING", row.attempt + 1
    row.started_utc, row.lease_until_utc = utc_now(), utc_after(LEASE_S)
    a, b = (_claim_side(session, run_id) for run_id in (row.run_a_id, row.run_b_id))
    return ClaimedAlignment(row.id, row.attempt, a, b, parse_options(row.options))


def _claim_side(session: Session, run_id: int) -> ClaimedSide:
    (claimed,) = run_rows.list_claimed_runs(session, [run_id])
    return ClaimedSide(claimed, str(get_run(session, run_id).result_sha256))


def put_back(session: Session, claimed: ClaimedAlignment) -> None:
    """Queue an alignment again whose server stops in good order."""
    row = session.get_known(Alignment, claimed.alignment_id)
    if _is_held(row, claimed):
        row.state, row.lease_until_utc = "QUEUED", None


def _is_held(row: Alignment, claimed: ClaimedAlignment) -> bool:
    return row.state == "RUNNING" and row.attempt == claimed.attempt


def finish(session: Session, blobs: BlobStore, claimed: ClaimedAlignment, made: ComputedAlignment) -> bool:
    """Write a result, unless another attempt holds the alignment."""
    row = session.get_known(Alignment, claimed.alignment_id)
    if not _is_held(row, claimed):
        return False
    register_blob(session, blobs, made.sha256, "application/json")
    row.result_sha256, row.verdict, row.summary = made.sha256, made.verdict, to_plain(made.summary)
    _end(session, row, "SUCCEEDED", sha256=made.sha256, verdict=made.verdict)
    return True


def fail(session: Session, claimed: ClaimedAlignment, reason: str) -> bool:
    """Write why there is no result, unless another attempt holds the alignment."""
    row = session.get_known(Alignment, claimed.alignment_id)
    if not _is_held(row, claimed):
        return False
    _end(session, row, "FAILED", reason=reason)
    return True


def _end(session: Session, row: Alignment, state: str, *, reason: str | None = None, **told: Any) -> None:
    before = row.state
    row.state, row.reason, row.ended_utc, row.lease_until_utc = state, reason, utc_now(), None
    audit.append(session, SYSTEM, "ended", f"alignments/{row.id}", {"state": before}, {"state": state, **told}, reason)


def read_document(session: Session, blobs: BlobStore, alignment_id: int) -> dict[str, Any]:
    """Return the alignment JSON of one that succeeded, with its gate report: nobody may change it."""
    row = session.get_known(Alignment, alignment_id)
    if row.result_sha256 is None:
        why = f" ({row.reason.rstrip('.')})" if row.reason else ""
        remedy = "align again" if row.state == "FAILED" else "wait until it ends"
        raise ConflictError(f"Alignment {row.id} is {row.state}{why} and has no result; {remedy}.")
    try:
        document: dict[str, Any] = blobs.document(row.result_sha256)
        parse_alignment(document)
        parse_report(document["gate_report"])
    except (ValueError, KeyError, RefusedInputError):
        raise ConflictError(
            f"The stored alignment {row.result_sha256[:12]} cannot be read: align again, or restore the store from a backup."
        ) from None
    return document


def read_result(session: Session, blobs: BlobStore, alignment_id: int) -> tuple[AlignmentResult, GateReport]:
    """Return the result of an alignment that succeeded, and what its gates answered then."""
    document = read_document(session, blobs, alignment_id)
    return parse_alignment(document), parse_report(document["gate_report"])


def list_history(session: Session, row: Alignment) -> list[PastAlignment]:
    """Return the alignments of the same sensors, newest first, each against this one; without this one itself."""
    if row.summary is None:
        return []
    own = parse_summary(row.summary)
    others = queries.list_of_pair(session, row.sensor_a_id, row.sensor_b_id, HISTORY + 1)
    return [_compare(own, one, parse_summary(one.summary)) for one in others if one.id != row.id and one.summary]


def _compare(own: AlignmentSummary, row: Alignment, former: AlignmentSummary) -> PastAlignment:
    q = np.array([own.quaternion, former.quaternion], np.float64)
    turned = to_matrix(q)
    change = log_rotation(turned[:1] @ np.swapaxes(turned[1:], 1, 2))[0] * ARCSEC_PER_RAD
    sigma = np.hypot(own.sigma_arcsec, former.sigma_arcsec)
    return PastAlignment(row, former, change.tolist(), (change / sigma).tolist())
