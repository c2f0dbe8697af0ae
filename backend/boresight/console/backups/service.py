"""Scheduled backups: one server at a time takes the one that is due, tries to restore it, and says what it found.

A backup is due at each time of the newest schedule, at once where that passed while no server ran. The row is claimed with a
lease: a server that ends leaves it to another one, which begins again under the next attempt, and one of which the lease was
taken writes nothing more. Where nothing was written the next
try is after `RETRY_S`; what was written and does not verify is as large as a good one, and the next is taken when it is due.

A backup has SUCCEEDED only when it was restored and verified. Old ones are removed as the schedule says, never the newest that
succeeded; of those that failed only one
that nothing newer has followed stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from boresight.console.backups import queries
from boresight.console.backups.tables import Backup, BackupSchedule
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.actors import SYSTEM, Actor, refuse_key, require_role
from boresight.platform.audit import log as audit
from boresight.platform.backups.generations import Generations, choose_kept
from boresight.platform.db.backup import BackupSummary, RestoreFindings
from boresight.platform.db.sessions import Session, utc_after, utc_now, utc_text
from boresight.platform.db.times import seconds_between

LEASE_S = 120.0
RETRY_S = 900.0
MOST_ATTEMPTS = 3
LATE = 2.0  # intervals without a backup that succeeded, after which one is missing
GRACE_S = 3600.0
EVERY_HOURS = (1, 2, 3, 4, 6, 8, 12, 24)
MOST_KEPT = 1000


@dataclass(frozen=True)
class ClaimedBackup:
    """A backup that this server takes, under its attempt."""

    backup_id: int
    attempt: int
    destination: str
    name: str
    former_name: str | None


@dataclass(frozen=True)
class BackupNumbers:
    """How the backups of an installation stand, in numbers; None where there is none yet."""

    scheduled: bool
    newest_age_s: float | None
    newest_bytes: int | None
    test_age_s: float | None
    failed: bool


@dataclass(frozen=True)
class BackupOverview:
    """The schedule in force, the newest backup that was restored in a test, and what is wrong."""

    schedule: BackupSchedule | None
    newest: Backup | None
    fault: str


def set_schedule(
    session: Session, actor: Actor, destination: str, at_minute: int, every_hours: int, kept: Generations
) -> BackupSchedule:
    """Put a schedule in force; one with an empty destination ends the backups and removes none."""
    require_role(actor, "administrator")
    refuse_key(actor, "set the schedule of backups")
    if every_hours not in EVERY_HOURS or not 0 <= at_minute < 24 * 60:
        raise RefusedInputError(f"Give a time of the day and an interval of {', '.join(map(str, EVERY_HOURS))} hours.")
    counts = (kept.daily, kept.weekly, kept.monthly)
    if not all(0 <= count <= MOST_KEPT for count in counts) or not any(counts):
        raise RefusedInputError(
            f"Give the number of days, weeks and months for which backups are kept, from 1 to {MOST_KEPT}."
        )
    before = queries.find_schedule(session)
    row = session.put(
        BackupSchedule(
            destination=destination,
            at_minute=at_minute,
            every_hours=every_hours,
            keep_daily=kept.daily,
            keep_weekly=kept.weekly,
            keep_monthly=kept.monthly,
            created_utc=utc_now(),
            created_by=actor.user_id,
        )
    )
    audit.append(
        session,
        actor,
        "scheduled",
        "backups",
        None if before is None else _list_values(before),
        _list_values(row),
    )
    return row


def _list_values(row: BackupSchedule) -> dict[str, object]:
    names = ("destination", "at_minute", "every_hours", "keep_daily", "keep_weekly", "keep_monthly")
    return {name: getattr(row, name) for name in names}


def find_schedule(session: Session) -> BackupSchedule | None:
    """Return the schedule in force; None where no backups are scheduled."""
    row = queries.find_schedule(session)
    return row if row is not None and row.destination else None


def find_slot(schedule: BackupSchedule, now_utc: str) -> str:
    """Return the newest time of a schedule up to now."""
    now = datetime.fromisoformat(now_utc)
    first = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(minutes=schedule.at_minute)
    every = timedelta(hours=schedule.every_hours)
    return utc_text(first + (now - first) // every * every)


def is_any_due(session: Session, now_utc: str | None = None) -> bool:
    """Whether a backup is to be taken, or to be taken over from a server that is gone."""
    now = now_utc or utc_now()
    schedule = find_schedule(session)
    under_way = queries.find_newest(session, "RUNNING", "TESTING")
    if under_way is not None:
        return (under_way.lease_until_utc or "") < now
    if schedule is None:
        return False
    newest = queries.find_newest(session, schedule_id=schedule.id)
    if newest is None or newest.written_utc is not None:
        return newest is None or newest.due_utc < find_slot(schedule, now)
    return seconds_between(newest.ended_utc or newest.started_utc, now) >= RETRY_S


def claim(session: Session) -> ClaimedBackup | None:
    """Claim what is due; None where another server was first, or where it ended its servers and FAILED."""
    now = utc_now()
    if not is_any_due(session, now):
        return None
    row = queries.find_newest(session, "RUNNING", "TESTING")
    if row is not None and row.attempt >= MOST_ATTEMPTS:
        _end(
            session,
            row,
            "FAILED",
            f"The server stopped {row.attempt} times during the backup: look into the server's log.",
        )
        return None
    if row is None:
        schedule = find_schedule(session)
        if schedule is None:
            return None
        slot = find_slot(schedule, now)
        row = Backup(schedule_id=schedule.id, due_utc=slot, state="RUNNING", attempt=0, name="", started_utc=now)
        audit.append(session, SYSTEM, "began", "backups", None, {"due_utc": slot})
    former = row.name or None
    row.state, row.attempt, row.started_utc, row.lease_until_utc = "RUNNING", row.attempt + 1, now, utc_after(LEASE_S)
    row.name = f"boresight-{now[:19].replace('-', '').replace(':', '')}Z-{row.attempt}.backup"
    session.put(row)
    return ClaimedBackup(row.id, row.attempt, get_destination(session, row), row.name, former)


def renew(session: Session, claimed: ClaimedBackup) -> bool:
    """Renew a claim; False where another server has it."""
    row = _find_held(session, claimed)
    if row is not None:
        row.lease_until_utc = utc_after(LEASE_S)
    return row is not None


def put_back(session: Session, claimed: ClaimedBackup) -> None:
    """Leave a backup to the next server, because this one stops in good order; that is no attempt."""
    row = _find_held(session, claimed)
    if row is not None:
        row.lease_until_utc, row.attempt = "", row.attempt - 1


def _find_held(session: Session, claimed: ClaimedBackup) -> Backup | None:
    row = session.get_known(Backup, claimed.backup_id)
    return row if row.state in {"RUNNING", "TESTING"} and row.attempt == claimed.attempt else None


def record_written(
    session: Session, claimed: ClaimedBackup, taken: BackupSummary, size_bytes: int, key_id: str
) -> bool:
    """Record that a backup is in its place, to be tested; False where another server has it."""
    row = _find_held(session, claimed)
    if row is None:
        return False
    row.state, row.written_utc, row.lease_until_utc = "TESTING", utc_now(), utc_after(LEASE_S)
    row.size_bytes, row.key_id, row.files, row.head = size_bytes, key_id, taken.blobs, taken.head
    return True


def record_test(session: Session, claimed: ClaimedBackup, found: RestoreFindings) -> None:
    """Record what the restore test found, which ends the backup."""
    row = _find_held(session, claimed)
    if row is not None:
        row.tested_utc = utc_now()
        _end(session, row, "SUCCEEDED" if found.is_ok else "FAILED", found.sentence)


def fail(session: Session, claimed: ClaimedBackup, sentence: str) -> None:
    """Record why there is no backup."""
    row = _find_held(session, claimed)
    if row is not None:
        _end(session, row, "FAILED", sentence)


def _end(session: Session, row: Backup, state: str, sentence: str) -> None:
    row.state, row.sentence, row.ended_utc, row.lease_until_utc = state, sentence, utc_now(), None
    told = {"state": state, "name": row.name, "size_bytes": row.size_bytes, "key": row.key_id, "head": row.head}
    audit.append(session, SYSTEM, "ended", f"backups/{row.id}", None, told, sentence)


def record_retest(session: Session, actor: Actor, name: str, found: RestoreFindings) -> None:
    """Record a restore test that a person asked for."""
    row = get_by_name(session, name)
    before = {"state": row.state, "tested_utc": row.tested_utc}
    if row.state not in {"SUCCEEDED", "FAILED"}:
        return
    row.state, row.sentence, row.tested_utc = "SUCCEEDED" if found.is_ok else "FAILED", found.sentence, utc_now()
    after = {"state": row.state, "tested_utc": row.tested_utc}
    audit.append(session, actor, "tested", f"backups/{row.id}", before, after, found.sentence)


def get_by_name(session: Session, name: str) -> Backup:
    """Return the backup with a file name; refuse an unknown one."""
    row = queries.find_by_name(session, name)
    if row is None:
        raise NotFoundError(f"There is no backup {name!r} on record; choose one of `boresight backup list`.")
    return row


def get_destination(session: Session, row: Backup) -> str:
    """Return the place where a backup was stored."""
    return session.get_known(BackupSchedule, row.schedule_id).destination


def list_backups(session: Session, limit: int | None = None, before_id: int | None = None) -> Sequence[Backup]:
    """Return the backups, all or the newest before one, newest first."""
    return queries.list_newest(session, limit, before_id)


def list_superfluous(session: Session) -> list[Backup]:
    """Return the backups whose files are to be removed by the schedule in force."""
    schedule = find_schedule(session)
    if schedule is None:
        return []
    rows = queries.list_stored(session, schedule.destination)
    good = [row.started_utc for row in rows if row.state == "SUCCEEDED"]
    kept = choose_kept(good, Generations(schedule.keep_daily, schedule.keep_weekly, schedule.keep_monthly))
    kept |= {row.started_utc for row in rows[-1:]}
    return [row for row in rows if row.started_utc not in kept]


def record_removed(session: Session, backup_id: int) -> None:
    """Record that the file of a backup was removed."""
    row = session.get_known(Backup, backup_id)
    row.removed_utc = utc_now()
    audit.append(session, SYSTEM, "removed", f"backups/{row.id}", None, {"name": row.name})


def find_fault(session: Session) -> str:
    """Return a sentence on what is wrong with the backups, the same as long as it is; empty where nothing is."""
    schedule = find_schedule(session)
    if schedule is None:
        return ""
    newest = queries.find_newest(session, "SUCCEEDED", "FAILED")
    if newest is not None and newest.state == "FAILED":
        return f"The backup of {newest.due_utc[:16]} UTC failed: {newest.sentence}"
    good = queries.find_newest(session, "SUCCEEDED")
    since = max(schedule.created_utc, good.started_utc if good else "")
    if seconds_between(since, utc_now()) > LATE * 3600.0 * schedule.every_hours + GRACE_S:
        return f"No backup has succeeded since {since[:16]} UTC: start a server, and look into its log."
    return ""


def look(session: Session) -> BackupOverview:
    """Return how the backups stand, for pages."""
    return BackupOverview(find_schedule(session), queries.find_newest(session, "SUCCEEDED"), find_fault(session))


def measure(session: Session) -> BackupNumbers:
    """Return how the backups stand, for gauges and pages."""
    good = queries.find_newest(session, "SUCCEEDED")
    ended = queries.find_newest(session, "SUCCEEDED", "FAILED")
    now = utc_now()
    return BackupNumbers(
        scheduled=find_schedule(session) is not None,
        newest_age_s=None if good is None else seconds_between(good.started_utc, now),
        newest_bytes=None if good is None else good.size_bytes,
        test_age_s=None if good is None or good.tested_utc is None else seconds_between(good.tested_utc, now),
        failed=ended is not None and ended.state == "FAILED",
    )
