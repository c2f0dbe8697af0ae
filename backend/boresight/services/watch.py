"""The watch: it raises alarms and returns them to normal, and leaves the rest of them to people (`services.alarms`).

It compares the conditions of now with the alarms that are open and writes only what differs, so it may be called as often as
one likes, in any transaction: after a run ends, a promotion, a record on board, and every round of the server's upkeep.
Two servers that watch one store agree, for there is one writer at a time and one open alarm of a source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from boresight.services.actors import SYSTEM
from boresight.services.alarms import close_if_over, step
from boresight.services.conditions import CHAIN, FILES, Condition, conditions
from boresight.store import alarms as rows
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import Alarm

GRAVITY = {"caution": 0, "serious": 1, "critical": 2}


def watch(session: Session, sensor_ids: Sequence[int] | None = None) -> int:
    """Bring the alarms of the fleet, or of some sensors, in line with what is so now; return how many changed."""
    return _settle(session, *_compared(session, sensor_ids)) + _unshelve_overdue(session)


def watch_chain(session: Session, broken: Condition | None) -> int:
    """Do the same for the audit log, of which the last verification is known."""
    return watch_installation(session, {CHAIN: broken})


def watch_installation(session: Session, found: Mapping[str, Condition | None]) -> int:
    """Do the same for what is of no sensor, and was looked at just now: what is wrong by its source, None where nothing is."""
    return _settle(session, *_installation_compared(session, found))


def changed_sensors(session: Session, sensor_ids: Sequence[int] | None = None) -> list[int]:
    """Return the sensors, of all or of some, for which `watch` would change an alarm; reads only, so no writer waits."""
    found, known = _compared(session, sensor_ids)
    shelved = {row.sensor_id for row in rows.overdue_shelves(session)}
    moved = {(found.get(source) or known[source]).sensor_id for source in _differing(found, known)}
    return sorted(sensor_id for sensor_id in shelved | moved if sensor_id is not None)


def chain_changed(session: Session, broken: Condition | None) -> bool:
    """Whether `watch_chain` would change an alarm; reads only."""
    return installation_changed(session, {CHAIN: broken})


def installation_changed(session: Session, found: Mapping[str, Condition | None]) -> bool:
    """Whether `watch_installation` would change an alarm; reads only."""
    overdue = any(row.sensor_id is None for row in rows.overdue_shelves(session))
    return overdue or bool(_differing(*_installation_compared(session, found)))


def is_up(session: Session, source: str) -> bool:
    """Whether an alarm of a source is up."""
    row = rows.open_alarms(session).get(source)
    return row is not None and bool(row.active)


def files_in_alarm(session: Session) -> list[str]:
    """Return the files of an alarm that is up, so that they are looked at before it is said to be over."""
    row = rows.open_alarms(session).get(FILES)
    return [] if row is None or not row.active else [str(one["sha256"]) for one in row.evidence["files"]]


Compared = tuple[Mapping[str, Condition], Mapping[str, Alarm]]


def _differing(found: Mapping[str, Condition], known: Mapping[str, Alarm]) -> set[str]:
    """Return the sources of which what is so now and what the alarms say differ."""
    news = {source for source, one in found.items() if source not in known or _is_news(known[source], one)}
    return news | {source for source, row in known.items() if row.active and source not in found}


def _compared(session: Session, sensor_ids: Sequence[int] | None) -> Compared:
    """Return what is wrong with sensors, and their open alarms, by source."""
    known = {
        source: row
        for source, row in rows.open_alarms(session).items()
        if row.sensor_id is not None and (sensor_ids is None or row.sensor_id in sensor_ids)
    }
    return {one.source: one for one in conditions(session, sensor_ids)}, known


def _installation_compared(session: Session, found: Mapping[str, Condition | None]) -> Compared:
    """Return what is wrong with the installation, and its open alarms of these sources."""
    known = {source: row for source, row in rows.open_alarms(session).items() if source in found}
    return {source: one for source, one in found.items() if one is not None}, known


def _settle(session: Session, found: Mapping[str, Condition], known: Mapping[str, Alarm]) -> int:
    """Raise, renew or return what differs."""
    changed = [_raise(session, one) for source, one in found.items() if source not in known]
    changed += [_renew(session, known[source], one) for source, one in found.items() if source in known]
    changed += [_return(session, row) for source, row in known.items() if source not in found]
    return sum(changed)


def _is_news(row: Alarm, found: Condition) -> bool:
    """Whether an open alarm says something else than is so now."""
    return not row.active or (row.sentence, row.level) != (found.sentence, found.level)


def _raise(session: Session, found: Condition) -> bool:
    """Open an alarm."""
    row = Alarm(
        source=found.source,
        sensor_id=found.sensor_id,
        kind=found.kind,
        level=found.level,
        sentence=found.sentence,
        evidence=dict(found.evidence),
        active=1,
        acknowledged=0,
        raised_utc=utc_now(),
        version=0,
    )
    session.add(row)
    session.flush()
    step(session, SYSTEM, row, "RAISED", found.sentence)
    return True


def _renew(session: Session, row: Alarm, found: Condition) -> bool:
    """Say what is so now of an open alarm; one that came back or became graver wants to be seen again."""
    again = not row.active or GRAVITY[found.level] > GRAVITY[row.level]
    if not _is_news(row, found):
        return False
    row.level, row.sentence, row.evidence = found.level, found.sentence, dict(found.evidence)
    if again:
        row.active, row.acknowledged, row.returned_utc = 1, 0, None
    step(session, SYSTEM, row, "RAISED AGAIN" if again else "COMMENTED", found.sentence)
    return True


def _return(session: Session, row: Alarm) -> bool:
    """Say that it is over."""
    if not row.active:
        return False
    row.active, row.returned_utc = 0, utc_now()
    step(session, SYSTEM, row, "RETURNED", "The condition is over.")
    close_if_over(session, SYSTEM, row)
    return True


def _unshelve_overdue(session: Session) -> int:
    """Take from the shelf what was there until now."""
    overdue = rows.overdue_shelves(session)
    for row in overdue:
        row.shelved_until_utc = None
        step(session, SYSTEM, row, "UNSHELVED", "Its time on the shelf is over.")
    return len(overdue)
