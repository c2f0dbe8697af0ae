"""Queries on what needs a telemetry set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sqlalchemy as sa

from boresight.console.alignments.tables import Alignment
from boresight.console.approvals.tables import GateReport
from boresight.console.ingest.tables import IngestDecision
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import ArchivedRun, JointSet, Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.db.sessions import Session
from boresight.verdicts.gates import parse_held_out

UNDECIDED = ("CALIBRATING", "UNCONFIRMED", "ASKED")


def list_sets(session: Session) -> Sequence[TelemetrySet]:
    """Return the telemetry sets whose files are there, oldest first."""
    return session.scalars(
        sa.select(TelemetrySet).where(TelemetrySet.removed_utc.is_(None)).order_by(TelemetrySet.id)
    ).all()


def count_removed(session: Session) -> int:
    """Count the telemetry sets whose files were removed."""
    return session.scalar(sa.select(sa.func.count(TelemetrySet.removed_utc))) or 0


def list_uses(session: Session) -> list[tuple[int, int]]:
    """Return set and run for each use of a set: fitted, fitted with others, or held out."""
    fitted = sa.select(Run.telemetry_set_id, Run.id)
    validated = sa.select(Run.validation_set_id, Run.id).where(Run.validation_set_id.is_not(None))
    further = sa.select(JointSet.telemetry_set_id, JointSet.run_id)
    return [
        (set_id, run_id)
        for query in (fitted, validated, further)
        for set_id, run_id in session.execute(query)
        if set_id
    ]


@dataclass(frozen=True)
class RunFacts:
    """What of a run decides whether it needs its telemetry."""

    id: int
    state: str
    ended_utc: str | None
    result_sha256: str | None
    prior_run_id: int | None
    choice_of: int | None


def list_runs(session: Session) -> list[RunFacts]:
    """Return every run, oldest first."""
    columns = (Run.id, Run.state, Run.ended_utc, Run.result_sha256, Run.prior_run_id, Run.choice_of)
    return [RunFacts(*row) for row in session.execute(sa.select(*columns).order_by(Run.id))]


def list_archived_runs(session: Session) -> set[int]:
    """Return the runs that are archived."""
    return set(session.scalars(sa.select(ArchivedRun.run_id)))


def read_set_names(session: Session) -> dict[int, str]:
    """Return the name of the newest parameter set of each run that one was made of."""
    query = sa.select(ParameterSet.run_id, ParameterSet.name).where(ParameterSet.run_id.is_not(None))
    return {run_id: name for run_id, name in session.execute(query.order_by(ParameterSet.id)) if run_id is not None}


def list_aligned_runs(session: Session) -> dict[int, int]:
    """Return the newest alignment, that has not failed, of each run that one rests on."""
    rows = session.execute(
        sa.select(Alignment.id, Alignment.run_a_id, Alignment.run_b_id)
        .where(Alignment.state != "FAILED")
        .order_by(Alignment.id)
    )
    return {run_id: row[0] for row in rows for run_id in row[1:]}


def list_validation_tables(session: Session) -> set[str]:
    """Return the tables of the frames that gates held out, by their SHA-256."""
    documents = session.scalars(sa.select(GateReport.document))
    return {used.sha256 for document in documents if (used := parse_held_out(document)) is not None}


def list_undecided(session: Session) -> dict[int, int]:
    """Return the ingest decision that is open on each set that has one."""
    query = sa.select(IngestDecision.telemetry_set_id, IngestDecision.id)
    query = query.where(IngestDecision.telemetry_set_id.is_not(None), IngestDecision.state.in_(UNDECIDED))
    return {set_id: number for set_id, number in session.execute(query) if set_id is not None}
