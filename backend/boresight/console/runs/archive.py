"""Archiving runs: lists leave them out unless they are asked to show them; nothing is deleted, and it can be taken back."""

from __future__ import annotations

from boresight.console.runs import queries
from boresight.console.runs.results import refuse_choice
from boresight.console.runs.tables import TERMINAL_RUN_STATES, ArchivedRun, Run
from boresight.errors import ConflictError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, utc_now


def archive_run(session: Session, actor: Actor, run_id: int) -> Run:
    """Have lists leave out a run that has ended; one that is archived stays so."""
    run = _get(session, actor, run_id)
    if run.state not in TERMINAL_RUN_STATES:
        raise ConflictError(f"Run {run_id} is {run.state}; wait until it has ended, or cancel it.")
    if queries.find_archived(session, run_id) is None:
        session.put(ArchivedRun(run_id=run_id, archived_utc=utc_now()))
        audit.append(session, actor, "archived", f"runs/{run_id}")
    return run


def restore_run(session: Session, actor: Actor, run_id: int) -> Run:
    """Have lists show a run again."""
    run = _get(session, actor, run_id)
    if (row := queries.find_archived(session, run_id)) is not None:
        session.delete(row)
        audit.append(session, actor, "restored", f"runs/{run_id}")
    return run


def _get(session: Session, actor: Actor, run_id: int) -> Run:
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    run = session.get_known(Run, run_id)
    refuse_choice(run)
    return run
