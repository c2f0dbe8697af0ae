"""What a link has brought and told: no row of an archive is taken twice, none that comes late is lost, and failures are waited out.

Let T be the end of the newest range that was taken, L the look-back and [a, b) the next range:

    a = max(begins, T - L),  b = min(now, T + longest)

Of the archive's rows in [a, b) those are new whose times are not among the times taken within L. They are taken once the newest
of them is `settle` old, or the oldest `longest`: until then a pass is under way, and is not cut. What is taken, its times and T are
written in one transaction with the decision on it, on the version of the link that was read; a second server that was as fast is
refused by that version. A row that arrives up to L after its time, as one of an on-board recorder, is new then and is taken.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
import numpy.typing as npt

from boresight.console.audit.queries import name_subjects
from boresight.console.ingest.rules import PolicyRules
from boresight.console.mission_control import queries as rows
from boresight.console.mission_control.tables import MissionControlLink
from boresight.errors import ConflictError
from boresight.mission_control.archive import ArchiveRows, count_us, write_time
from boresight.mission_control.yamcs import YamcsEvent
from boresight.platform.audit import queries as audit_rows
from boresight.platform.audit.subjects import AuditAction
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Session, utc_after, utc_now

MINUTE_US, HOUR_US = 60_000_000, 3_600_000_000
FIRST_WAIT_S, LONGEST_WAIT_S = 15.0, 3600.0
RECORDS_A_TURN = 200
MOST_MESSAGE = 1000


@dataclass(frozen=True)
class Range:
    """What an archive is asked for next, and by what it is known that nobody else took it meanwhile."""

    link_id: int
    version: int
    start_us: int
    stop_us: int
    taken_us: npt.NDArray[np.int64]


def open_link(session: Session, system: str, sensor_id: int | None, begins_utc: str) -> MissionControlLink:
    """Return the link of a sensor, or that of events; a new one begins at a time, another system's goes on from where that came."""
    row = rows.find_event_link(session, system) if sensor_id is None else rows.find_link(session, sensor_id)
    if row is None:
        row = MissionControlLink(
            system=system, sensor_id=sensor_id, begins_utc=begins_utc, asked_to_utc=begins_utc, due_utc=utc_now()
        )
        if sensor_id is None:
            row.told_audit_id = audit_rows.read_newest_id(session)
        session.put(row)
    elif row.system != system:
        row.system, row.failures, row.fault = system, 0, ""
    return row


def plan_range(row: MissionControlLink, rules: PolicyRules, now_us: int) -> Range:
    """Return what is asked for next."""
    begins_us, asked_to_us = (count_us(datetime.fromisoformat(at)) for at in (row.begins_utc, row.asked_to_utc))
    start_us = max(begins_us, asked_to_us - int(rules.lookback_hours * HOUR_US))
    stop_us = min(now_us, asked_to_us + int(rules.longest_hours * HOUR_US))
    return Range(row.id, row.version, start_us, stop_us, unpack_times(row.taken))


def choose_new(found: ArchiveRows, asked: Range, rules: PolicyRules, now_us: int) -> ArchiveRows | None:
    """Return the rows that are new; None while a pass is under way."""
    new = found.without(asked.taken_us)
    if not new.lines:
        return new
    oldest_us, newest_us = int(new.times_us[0]), int(new.times_us[-1])
    is_over = newest_us <= now_us - int(rules.settle_minutes * MINUTE_US)
    is_long = oldest_us <= now_us - int(rules.longest_hours * HOUR_US)
    return new if is_over or is_long else None


def note_taken(session: Session, asked: Range, new: ArchiveRows, rules: PolicyRules) -> None:
    """Put on record what was taken of a range; refuse where another server took it."""
    row = _read_again(session, asked)
    kept_us = np.unique(np.concatenate([asked.taken_us, new.times_us]))
    asked_to_us = max(asked.stop_us, count_us(datetime.fromisoformat(row.asked_to_utc)))
    row.taken = pack_times(kept_us[kept_us >= asked_to_us - int(rules.lookback_hours * HOUR_US)])
    row.asked_to_utc = write_time(asked_to_us)
    _record_success(row, rules.pull_minutes * 60.0)


def note_waiting(session: Session, asked: Range, rules: PolicyRules) -> None:
    """Put on record that the archive answered and a pass is under way."""
    _record_success(_read_again(session, asked), rules.pull_minutes * 60.0)


def _read_again(session: Session, asked: Range) -> MissionControlLink:
    row = session.get_known(MissionControlLink, asked.link_id)
    if row.version != asked.version:
        raise ConflictError("Another server has already processed this range of the archive; there is nothing to do.")
    return row


def _record_success(row: MissionControlLink, wait_s: float) -> None:
    row.failures, row.fault, row.succeeded_utc, row.due_utc = 0, "", utc_now(), utc_after(wait_s)
    row.version += 1


def note_failure(session: Session, link_id: int, sentence: str) -> MissionControlLink:
    """Put a failure on record, and wait twice as long as after the one before."""
    row = session.get_known(MissionControlLink, link_id)
    row.failures += 1
    row.fault = sentence
    row.due_utc = utc_after(min(LONGEST_WAIT_S, FIRST_WAIT_S * 2.0 ** min(row.failures - 1, 20)))
    row.version += 1
    return row


def pack_times(times_us: npt.NDArray[np.int64]) -> bytes:
    """Write sorted times as compressed steps: those of a steady rate take next to nothing."""
    return zlib.compress(np.diff(times_us, prepend=np.int64(0)).astype("<i8").tobytes()) if times_us.size else b""


def unpack_times(content: bytes) -> npt.NDArray[np.int64]:
    """Read packed times."""
    return np.cumsum(np.frombuffer(zlib.decompress(content), "<i8")) if content else np.zeros(0, np.int64)


def list_new_events(session: Session, row: MissionControlLink) -> tuple[Sequence[YamcsEvent], int]:
    """Return the events that are to be told, oldest first, and the number of the newest record that was looked at."""
    records = rows.list_records_after(session, row.told_audit_id, RECORDS_A_TURN)
    names = name_subjects(session, {record.subject for record in records})
    events = [event for record in records if (event := make_event(record, names[record.subject])) is not None]
    return events, records[-1].id if records else row.told_audit_id


def make_event(record: AuditRecord, name: str) -> YamcsEvent | None:
    """Return the event that an audit record is for those who operate: a request, a promotion, an alarm; None for any other."""
    subject, outcome = record.subject, record.outcome
    if record.action == AuditAction.OPENED and subject.noun == "approvals" and subject.part is None:
        kind, severity, said = "approvals.opened", "WATCH", "A request waits for signatures"
    elif record.action == AuditAction.PROMOTED:
        kind, severity, said = "parameter-sets.promoted", "INFO", "A parameter set is the baseline"
    elif record.action in {AuditAction.ALARM_RAISED, AuditAction.ALARM_RAISED_AGAIN}:
        kind = "alarms.raised"
        severity = {"critical": "CRITICAL", "serious": "DISTRESS"}.get(outcome.level or "", "WARNING")
        said = f"Alarm {outcome.kind}"
    elif record.action == AuditAction.ALARM_RETURNED:
        kind, severity, said = "alarms.returned", "INFO", f"Alarm {outcome.kind} returned to normal"
    else:
        return None
    message = f"{said}: {name}{f'. {record.reason}' if record.reason else ''}"
    extra = {"object": record.object, "action": record.action, "actor": record.actor, "audit_hash": record.hash}
    return YamcsEvent(record.at_utc, record.id, kind, severity, message[:MOST_MESSAGE], extra)


def note_told(session: Session, link_id: int, record_id: int) -> None:
    """Put on record up to which audit record a system was told."""
    row = session.get_known(MissionControlLink, link_id)
    row.told_audit_id = max(row.told_audit_id, record_id)
    _record_success(row, 0.0)
