"""What raises alarms and returns them to normal: rules on the store as it is now; only what differs is written.

========== ======== ==========================================================================================
`DRIFT`    serious  the parameters do not hold any more (`console.fleet.trend`), 0.1 % false alarms for each look;
                    a shift against a ground calibration alone is no drift
`AGE`      caution  the baseline is older than `fleet.OLD_DAYS`
`MISMATCH` critical a read-back of one of the sensor's sets did not match what was sent
`CHAIN`    critical the audit log, or a row that it seals, is not as it was written
`CLOCK`    serious  the clock jumped by `JUMP_S`, or nobody ran for `AWAY_S`: nothing expires until somebody acknowledges it
`HEAD`     serious  the head of the audit log cannot be written to where it is kept, or is overdue to be signed or time-stamped
`FILES`    critical a stored file that rows name was altered on the disk, or is missing
`BACKUP`   serious  the newest scheduled backup failed or could not be restored, or none has succeeded for two intervals
`INGEST`   serious  the sensor's policy for new telemetry was paused: a runaway was stopped, and a person resumes it
`LINK`     serious  a mission control system was not reached several times in a row, so no telemetry comes or no event goes
========== ======== ==========================================================================================

No sentence contains anything that changes with time alone, so evaluating the rules again changes nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

from boresight.console.alarms import queries
from boresight.console.alarms.service import close_if_over, record_step
from boresight.console.alarms.tables import Alarm
from boresight.console.fleet import queries as sensors_rows
from boresight.console.fleet import queries as trends
from boresight.console.fleet.status import OLD_DAYS, DriftVerdict, count_days_since, get_drift_verdicts
from boresight.console.ingest import queries as ingest_rows
from boresight.console.ingest.tables import IngestPolicy
from boresight.console.mission_control import queries as link_rows
from boresight.console.mission_control.tables import FAILURES_TOLD, MissionControlLink
from boresight.mission_control.systems import TITLES
from boresight.platform.actors import SYSTEM
from boresight.platform.blobs.files import BadFile
from boresight.platform.db.sessions import Session, utc_now, utc_text

ANCHOR = "audit/ANCHOR"
BACKUP = "backups/BACKUP"
CHAIN = "audit/CHAIN"
FILES = "blobs/FILES"
HEAD = "audit/HEAD"
LINK = "mission-control/LINK"
FILES_NAMED = 100


@dataclass(frozen=True)
class AlarmCause:
    """A condition that a rule found."""

    source: str
    sensor_id: int | None
    kind: str
    level: str
    sentence: str
    details: Mapping[str, Any] = field(default_factory=dict)


def evaluate_rules(session: Session, sensor_ids: Sequence[int] | None = None) -> list[AlarmCause]:
    """Return the causes for alarms on the fleet, or on some of its sensors."""
    baselines, stamps = (
        sensors_rows.list_baseline_heads(session, sensor_ids),
        trends.read_trend_stamps(session, sensor_ids),
    )
    onboard, fleet = (
        sensors_rows.list_onboard_heads(session, sensor_ids),
        sensors_rows.list_sensor_heads(session, sensor_ids),
    )
    drifts = get_drift_verdicts(session, fleet, baselines, stamps)
    in_force = {row.sensor_id: row for row in ingest_rows.list_policies_in_force(session)}
    failing = link_rows.read_failing(session, FAILURES_TOLD)
    return [
        found
        for sensor in fleet
        for found in (
            *_check_mismatches(sensor, onboard.get(sensor.id, ())),
            *_check_drift(sensor, drifts[sensor.id]),
            *_check_age(sensor, baselines.get(sensor.id)),
            *_check_ingest(sensor, in_force.get(sensor.id)),
            *_check_feed(sensor, in_force.get(sensor.id), failing.get(sensor.id)),
        )
    ]


def name_source(sensor_id: int, kind: str) -> str:
    """Return the name of an alarm's source."""
    return f"sensors/{sensor_id}/{kind}"


def check_chain(state: str, sentence: str) -> AlarmCause | None:
    """Return the alarm cause from the last verification of the audit log, None where it found nothing."""
    return AlarmCause(CHAIN, None, "CHAIN", "critical", sentence) if state == "broken" else None


def check_head(fault: str) -> AlarmCause | None:
    """Return the alarm cause if the head of the audit log cannot be written; None otherwise."""
    return AlarmCause(HEAD, None, "HEAD", "serious", fault) if fault else None


def check_anchors(overdue: str) -> AlarmCause | None:
    """Return the alarm cause if the head of the audit log is overdue to be signed or time-stamped; None otherwise."""
    return AlarmCause(ANCHOR, None, "HEAD", "serious", overdue) if overdue else None


def check_events(session: Session) -> AlarmCause | None:
    """Return the alarm cause if a mission control system is told no events; None otherwise."""
    link = link_rows.read_failing(session, FAILURES_TOLD).get(None)
    if link is None:
        return None
    sentence = f"Events cannot be sent to {TITLES[link.system]}: {link.fault}"
    return AlarmCause(
        LINK, None, "LINK", "serious", sentence, {"system": link.system, "told_audit_id": link.told_audit_id}
    )


def check_backups(fault: str) -> AlarmCause | None:
    """Return the alarm cause if a scheduled backup failed or is missing; None otherwise."""
    return AlarmCause(BACKUP, None, "BACKUP", "serious", fault) if fault else None


def check_files(bad: Sequence[BadFile]) -> AlarmCause | None:
    """Return the alarm cause from the bad files that rows still name, None where there are none."""
    if not bad:
        return None
    more = f", and {len(bad) - 1} more" if len(bad) > 1 else ""
    sentence = f"The stored file {bad[0]}{more}: it is not used; restore it from a backup, and check the disk."
    details = {
        "files": [{"sha256": one.sha256, "what": one.what, "used_by": list(one.used_by)} for one in bad[:FILES_NAMED]]
    }
    return AlarmCause(FILES, None, "FILES", "critical", sentence, details)


def _check_drift(sensor: Any, found: DriftVerdict) -> Iterator[AlarmCause]:
    if found.verdict == "DRIFT":
        sentence = f"{sensor.name} drifts. {found.sentence}"
        yield AlarmCause(name_source(sensor.id, "DRIFT"), sensor.id, "DRIFT", "serious", sentence, found.document)


def _check_age(sensor: Any, baseline: Any) -> Iterator[AlarmCause]:
    age_d = count_days_since(baseline)
    if baseline is None or baseline.baseline_from_utc is None or age_d is None or age_d <= OLD_DAYS:
        return
    due_utc = utc_text(datetime.fromisoformat(baseline.baseline_from_utc) + timedelta(days=OLD_DAYS))
    sentence = (
        f"{baseline.name} of {sensor.name} has exceeded its age limit of {OLD_DAYS:.0f} days since "
        f"{due_utc[:10]}: recalibrate."
    )
    details = {"parameter_set_id": baseline.id, "due_utc": due_utc}
    yield AlarmCause(name_source(sensor.id, "AGE"), sensor.id, "AGE", "caution", sentence, details)


def _check_ingest(sensor: Any, policy: IngestPolicy | None) -> Iterator[AlarmCause]:
    if policy is not None and policy.state == "PAUSED" and policy.pause_code != "PERSON":
        sentence = f"Ingest of {sensor.name} is paused: {policy.pause_reason}"
        details = {"policy_id": policy.id, "code": policy.pause_code, "paused_utc": policy.paused_utc}
        yield AlarmCause(name_source(sensor.id, "INGEST"), sensor.id, "INGEST", "serious", sentence, details)


def _check_feed(sensor: Any, policy: IngestPolicy | None, link: MissionControlLink | None) -> Iterator[AlarmCause]:
    if link is None or policy is None or policy.state != "ACTIVE":
        return
    if policy.feed:
        sentence = f"Telemetry of {sensor.name} cannot be pulled: {link.fault}"
        details = {"policy_id": policy.id, "system": link.system, "succeeded_utc": link.succeeded_utc}
        yield AlarmCause(name_source(sensor.id, "LINK"), sensor.id, "LINK", "serious", sentence, details)


def _check_mismatches(sensor: Any, onboard: Sequence[Any]) -> Iterator[AlarmCause]:
    bad = [row for row in onboard if row.onboard_state == "MISMATCH"]
    if bad:
        names = ", ".join(row.name for row in bad)
        sentence = f"The read-back of {names} does not match what was sent: check the difference, then send it again."
        details = {"parameter_set_ids": [row.id for row in bad]}
        yield AlarmCause(name_source(sensor.id, "MISMATCH"), sensor.id, "MISMATCH", "critical", sentence, details)


GRAVITY = {"caution": 0, "serious": 1, "critical": 2}


def update_alarms(session: Session, sensor_ids: Sequence[int] | None = None) -> int:
    """Evaluate the alarm rules for the fleet, or for some sensors, and return how many alarms changed."""
    return _settle(session, *_compare_sensors(session, sensor_ids)) + _unshelve_overdue(session)


def update_installation_alarms(session: Session, found: Mapping[str, AlarmCause | None]) -> int:
    """Update the alarms that belong to no sensor from what was just found, by source; None means that nothing is wrong."""
    return _settle(session, *_compare_installation(session, found))


def find_changed_sensors(session: Session, sensor_ids: Sequence[int] | None = None) -> list[int]:
    """Return the sensors, of all or of some, for which `update_alarms` would change an alarm; it only reads."""
    found, known = _compare_sensors(session, sensor_ids)
    shelved = {row.sensor_id for row in queries.list_overdue_shelves(session)}
    moved = {(found.get(source) or known[source]).sensor_id for source in _find_differences(found, known)}
    return sorted(sensor_id for sensor_id in shelved | moved if sensor_id is not None)


def has_installation_changed(session: Session, found: Mapping[str, AlarmCause | None]) -> bool:
    """Whether `update_installation_alarms` would change an alarm; reads only."""
    overdue = any(row.sensor_id is None for row in queries.list_overdue_shelves(session))
    return overdue or bool(_find_differences(*_compare_installation(session, found)))


def find_active(session: Session, source: str) -> Alarm | None:
    """Return the active alarm of a source."""
    row = queries.list_open_alarms(session).get(source)
    return row if row is not None and row.active else None


def list_files_in_alarm(session: Session) -> list[str]:
    """Return the files of the active `FILES` alarm, which are checked before it returns to normal."""
    row = find_active(session, FILES)
    return [] if row is None else [str(one["sha256"]) for one in row.evidence["files"]]


Compared = tuple[Mapping[str, AlarmCause], Mapping[str, Alarm]]


def _find_differences(found: Mapping[str, AlarmCause], known: Mapping[str, Alarm]) -> set[str]:
    """Return the sources whose alarm does not match the current condition."""
    news = {source for source, one in found.items() if source not in known or _is_news(known[source], one)}
    return news | {source for source, row in known.items() if row.active and source not in found}


def _compare_sensors(session: Session, sensor_ids: Sequence[int] | None) -> Compared:
    """Return the current causes and the open alarms of sensors, by source."""
    known = {
        source: row
        for source, row in queries.list_open_alarms(session).items()
        if row.sensor_id is not None and (sensor_ids is None or row.sensor_id in sensor_ids)
    }
    return {one.source: one for one in evaluate_rules(session, sensor_ids)}, known


def _compare_installation(session: Session, found: Mapping[str, AlarmCause | None]) -> Compared:
    """Return the current causes and the open alarms of the installation, for these sources."""
    known = {source: row for source, row in queries.list_open_alarms(session).items() if source in found}
    return {source: one for source, one in found.items() if one is not None}, known


def _settle(session: Session, found: Mapping[str, AlarmCause], known: Mapping[str, Alarm]) -> int:
    """Raise, renew or return to normal each alarm that differs from its condition."""
    changed = [_raise(session, one) for source, one in found.items() if source not in known]
    changed += [_renew(session, known[source], one) for source, one in found.items() if source in known]
    changed += [_return(session, row) for source, row in known.items() if source not in found]
    return sum(changed)


def _is_news(row: Alarm, found: AlarmCause) -> bool:
    """Whether an open alarm differs from the current condition."""
    return not row.active or (row.sentence, row.level) != (found.sentence, found.level)


def _raise(session: Session, found: AlarmCause) -> bool:
    row = Alarm(
        source=found.source,
        sensor_id=found.sensor_id,
        kind=found.kind,
        level=found.level,
        sentence=found.sentence,
        evidence=dict(found.details),
        active=1,
        acknowledged=0,
        raised_utc=utc_now(),
        version=0,
    )
    session.put(row)
    record_step(session, SYSTEM, row, "RAISED", found.sentence)
    return True


def _renew(session: Session, row: Alarm, found: AlarmCause) -> bool:
    """Update an open alarm to the current condition; it is unacknowledged again if that came back or became graver."""
    again = not row.active or GRAVITY[found.level] > GRAVITY[row.level]
    if not _is_news(row, found):
        return False
    row.level, row.sentence, row.evidence = found.level, found.sentence, dict(found.details)
    if again:
        row.active, row.acknowledged, row.returned_utc = 1, 0, None
    record_step(session, SYSTEM, row, "RAISED AGAIN" if again else "COMMENTED", found.sentence)
    return True


def _return(session: Session, row: Alarm) -> bool:
    if not row.active:
        return False
    row.active, row.returned_utc = 0, utc_now()
    record_step(session, SYSTEM, row, "RETURNED", "The condition is over.")
    close_if_over(session, SYSTEM, row)
    return True


def _unshelve_overdue(session: Session) -> int:
    overdue = queries.list_overdue_shelves(session)
    for row in overdue:
        row.shelved_until_utc = None
        record_step(session, SYSTEM, row, "UNSHELVED", "Its shelving has ended.")
    return len(overdue)


CLOCK = "clock/CLOCK"
JUMP_S = 60.0
AWAY_S = 86_400.0


def _steady_s() -> float:
    """Return the seconds of a clock that cannot be set, if possible one that goes on while the machine sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


class Clock:
    """The wall clock, compared with a clock that cannot be set."""

    def __init__(self, wall_s: Callable[[], float] = time.time, steady_s: Callable[[], float] = _steady_s) -> None:
        self._wall_s = wall_s
        self._steady_s = steady_s
        self._agreed_s = wall_s() - steady_s()

    def now_s(self) -> float:
        """Return the wall clock's seconds."""
        return self._wall_s()

    def moved_s(self) -> float:
        """Return by how much the wall clock was set since the last `agree`."""
        return self._wall_s() - self._steady_s() - self._agreed_s

    def has_jumped(self) -> bool:
        """Whether it was set by more than an ordinary correction."""
        return abs(self.moved_s()) > JUMP_S

    def agree(self) -> None:
        """Accept the wall clock as right."""
        self._agreed_s = self._wall_s() - self._steady_s()


OURS = Clock()


def is_held(session: Session) -> bool:
    """Whether expiry is suspended because the clock jumped and nobody has acknowledged it."""
    row = find_active(session, CLOCK)
    return OURS.has_jumped() or (row is not None and not row.acknowledged)


def is_acknowledged(session: Session) -> bool:
    """Whether the active `CLOCK` alarm was acknowledged."""
    row = find_active(session, CLOCK)
    return row is not None and bool(row.acknowledged)


def check_clock(seen_s: float | None) -> AlarmCause | None:
    """Return the alarm cause if the clock jumped or no server ran for long; None otherwise."""
    now = _text(OURS.now_s())
    if OURS.has_jumped():
        moved_s = OURS.moved_s()
        way = "forward" if moved_s > 0 else "back"
        sentence = (
            f"The server clock was set {way} by {abs(moved_s):.0f} s and now shows {now}. Requests do not expire until "
            "this alarm is acknowledged."
        )
        return AlarmCause(CLOCK, None, "CLOCK", "serious", sentence, {"moved_s": round(moved_s), "now_utc": now})
    if seen_s is not None and abs(OURS.now_s() - seen_s) > AWAY_S:
        seen = _text(seen_s)
        sentence = (
            f"The server clock shows {now}, but a server last ran at {seen}. Requests do not expire until this alarm is "
            "acknowledged."
        )
        return AlarmCause(CLOCK, None, "CLOCK", "serious", sentence, {"seen_utc": seen, "now_utc": now})
    return None


def _text(seconds: float) -> str:
    return utc_text(datetime.fromtimestamp(seconds, UTC))
