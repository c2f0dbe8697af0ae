"""Retention of telemetry: the files of a set are removed once nothing needs them; its row, and all that was made of it, stay.

A set stays, whatever its age, while one of these holds; the first that does is the reason that people are shown:

1. it was uploaded, or a run with it ended, within the time of the policy;
2. it is a validation set in use, which gates may hold out, or the newest calibration set in use of its sensor;
3. a run that used it, to fit or to be held out, is needed: a parameter set was made of it, it has not ended, an alignment rests
   on it, or it has a result and is not archived; and so is what such a run started from;
4. a gate report held its frames out;
5. a decision on new telemetry is open on it.

So whoever wants a set to go archives its runs. The removal is judged again inside its own transaction, which writes to the audit
log and marks row and files; the files themselves go after the commit, under the lock of a writer, who finds them marked still. A
file that another set or a note names stays. The same bytes uploaded again bring a set back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from boresight.console.retention import queries
from boresight.console.runs.tables import TERMINAL_RUN_STATES
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.actors import Actor, require_role
from boresight.platform.audit import log as audit
from boresight.platform.blobs import files
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, open_writing, utc_after, utc_now

DAY_S = 86_400.0
SWEPT_S = 7 * DAY_S  # files removed so lately are looked for again: a server may have been killed before they went


@dataclass(frozen=True)
class RetainedSet:
    """A telemetry set, with the reason why its files stay; None where they go."""

    row: TelemetrySet
    reason: str | None
    size_bytes: int


@dataclass(frozen=True)
class RetentionPreview:
    """What a policy would remove now, and why the rest stays."""

    keep_days: float
    sets: Sequence[RetainedSet]
    removed: int

    @property
    def going(self) -> Sequence[RetainedSet]:
        """The sets whose files go."""
        return [one for one in self.sets if one.reason is None]

    @property
    def going_bytes(self) -> int:
        """How much they take; a file that two of them share counts twice."""
        return sum(one.size_bytes for one in self.going)


def preview(session: Session, keep_days: float) -> RetentionPreview:
    """Judge every set; only reads."""
    if keep_days <= 0:
        raise RefusedInputError(
            "Telemetry is kept forever on this server. Enter a number of days to preview what would be removed."
        )
    rows = queries.list_sets(session)
    reasons = _find_reasons(session, rows, utc_after(-keep_days * DAY_S), f"{keep_days:g} days")
    sizes = dict(files.list_sizes(session, sorted({address for row in rows for address in _list_files(row)})))
    judged = [
        RetainedSet(row, reasons.get(row.id), sum(sizes.get(address, 0) for address in _list_files(row)))
        for row in rows
    ]
    return RetentionPreview(keep_days, judged, queries.count_removed(session))


def _list_files(row: TelemetrySet) -> list[str]:
    return [one for one in dict.fromkeys((row.original_sha256, row.table_sha256, row.source_sha256)) if one is not None]


def _find_reasons(session: Session, rows: Sequence[TelemetrySet], since_utc: str, words: str) -> Mapping[int, str]:
    """Return the first reason to stay of each set that has one."""
    needed, ended_utc = _find_needed_runs(session)
    in_use = [row for row in rows if row.archived_utc is None and row.purpose == "calibration"]
    newest = {row.sensor_id: row.id for row in in_use}
    used_by: dict[int, list[int]] = {}
    for set_id, run_id in queries.list_uses(session):
        used_by.setdefault(set_id, []).append(run_id)
    validated, undecided = queries.list_validation_tables(session), queries.list_undecided(session)
    reasons: dict[int, str] = {}
    for row in rows:
        runs = sorted(used_by.get(row.id, ()), reverse=True)
        if row.uploaded_utc >= since_utc or any(ended_utc.get(run_id, "") >= since_utc for run_id in runs):
            reasons[row.id] = f"It was uploaded or used within {words}."
        elif row.purpose == "validation" and row.archived_utc is None:
            reasons[row.id] = "It is an active validation set that gates may use."
        elif newest.get(row.sensor_id) == row.id:
            reasons[row.id] = "It is the newest calibration set of its sensor."
        elif of_runs := [f"Run {run_id} used it, and {needed[run_id]}." for run_id in runs if run_id in needed]:
            reasons[row.id] = of_runs[0]
        elif row.table_sha256 in validated:
            reasons[row.id] = "Its frames were used as held-out data for the gates of a parameter set."
        elif row.id in undecided:
            reasons[row.id] = f"Decision {undecided[row.id]} on it is open."
    return reasons


def _find_needed_runs(session: Session) -> tuple[dict[int, str], dict[int, str]]:
    """Return why each run that is needed is, and when each run ended."""
    runs = queries.list_runs(session)
    named, aligned = queries.read_set_names(session), queries.list_aligned_runs(session)
    archived = queries.list_archived_runs(session)
    needed: dict[int, str] = {}
    for run in runs:
        if run.id in named:
            needed[run.id] = f"{named[run.id]} was created from it"
        elif run.state not in TERMINAL_RUN_STATES:
            needed[run.id] = f"the run is {run.state}"
        elif run.id in aligned:
            needed[run.id] = f"alignment {aligned[run.id]} depends on it"
        elif run.result_sha256 is not None and run.choice_of is None and run.id not in archived:
            needed[run.id] = "the run has a result and is not archived"
    for run in reversed(runs):  # a run starts from an earlier one, so each is reached in time
        if run.id in needed and run.prior_run_id is not None:
            needed.setdefault(run.prior_run_id, f"run {run.id} started from it")
    return needed, {run.id: run.ended_utc or "" for run in runs}


def remove(engine: Engine, blobs: BlobStore, actor: Actor, set_id: int, keep_days: float) -> int:
    """Remove the files of a set that still goes, first in the store and then on the disk; returns their size."""
    require_role(actor, "administrator")
    with open_writing(engine) as session:
        row = session.get_known(TelemetrySet, set_id)
        reason = _find_reasons(
            session, queries.list_sets(session), utc_after(-keep_days * DAY_S), f"{keep_days:g} days"
        )
        if row.removed_utc is not None or row.id in reason:
            raise ConflictError(
                f"The files of {row.name} are kept: {reason.get(row.id, 'They were removed before.')} Reload the list."
            )
        row.removed_utc = utc_now()
        row.archived_utc = row.archived_utc or row.removed_utc
        gone = files.mark_removed(session, _list_files(row))
        told = {"name": row.name, "keep_days": keep_days, "files": [sha256 for sha256, _ in gone]}
        audit.append(session, actor, "removed the files", f"telemetry-sets/{row.id}", None, told)
    discard(engine, blobs, [sha256 for sha256, _ in gone])
    return sum(size for _, size in gone)


def discard(engine: Engine, blobs: BlobStore, addresses: Sequence[str]) -> None:
    """Take files off the disk that are marked as removed, while nobody can bring them back."""
    for sha256 in addresses:
        with open_writing(engine) as session:
            if files.find_removed(session, sha256) is not None:
                blobs.remove(sha256)


def list_swept(session: Session) -> Sequence[str]:
    """Return the files that were removed lately."""
    return files.list_removed(session, utc_after(-SWEPT_S))
