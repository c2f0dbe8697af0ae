"""What was in force at a time, and who said so; and everything that ever happened to a sensor, in order.

History is rows that are only ever added, so the state at a time T needs no replay: it is, of each kind, the newest row
that is not after T,

    baseline(T) = the newest promotion,      on board(T) = of every set the newest record,
    limits(T) = the newest gate profile,     table(T) = the newest table definition.

`as_of` asks for these rows; `events` lists all of them. That the first is the fold of the second is a test.

T is the time at which a thing was recorded here: what people could know at T, and acted upon. Where a record says that
its event happened earlier (`happened_utc`), an answer for a time between the two also names it under `learned_later`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from boresight.errors import RefusedInputError
from boresight.services.history import Event, Reader
from boresight.services.sensors import get_sensor
from boresight.store import approvals as approval_rows
from boresight.store import sensors as sensor_rows
from boresight.store import timeline as rows
from boresight.store import uplinks as uplink_rows
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import (
    Approval,
    GateProfile,
    ParameterSet,
    Promotion,
    Sensor,
    Signature,
    TableDefinition,
    Uplink,
)
from boresight.store.times import read_time

Records = Sequence[tuple[ParameterSet, Uplink]]


@dataclass(frozen=True)
class AsOf:
    """What held for a sensor at a time, as it was recorded by then.

    Parameters
    ----------
    time_utc
        T, as the store writes times.
    baseline, promotion
        The baseline and the promotion that made it so; None before there was one.
    approval, signatures
        The request that the promotion carried out and who had signed it; none of a ground calibration.
    on_board
        Every set of which anything was recorded, with its newest record, in the order of recording.
    learned_later
        What was recorded after T of something that its source puts before T.
    profile, definition
        The gate profile and the table definition in force; None where none was given yet.
    """

    sensor: Sensor
    time_utc: str
    baseline: ParameterSet | None
    promotion: Promotion | None
    approval: Approval | None
    signatures: Sequence[Signature]
    on_board: Records
    learned_later: Records
    profile: GateProfile | None
    definition: TableDefinition | None

    @property
    def active(self) -> tuple[ParameterSet, Uplink] | None:
        """The set that was recorded as ACTIVE, with the record; None when that was not known."""
        return next((pair for pair in self.on_board if pair[1].onboard_state == "ACTIVE"), None)

    @property
    def differs(self) -> bool:
        """Whether another set was active on board than was baseline on the ground."""
        return self.active is not None and (self.baseline is None or self.active[0].id != self.baseline.id)

    @property
    def sentence(self) -> str:
        """Ground and board in one line: two facts that are never merged."""
        ground = "no baseline" if self.baseline is None else f"baseline {self.baseline.name}"
        mismatched = ", ".join(
            f"{row.name} MISMATCH" for row, known in self.on_board if known.onboard_state == "MISMATCH"
        )
        if self.active is not None:
            board = f"{self.active[0].name} ACTIVE: {'differs' if self.differs else 'the same'}"
        else:
            board = "no set known to be active"
        return f"{ground}, on board {board}{'; ' + mismatched if mismatched else ''}"


def as_of(session: Session, sensor_id: int, time: str | None = None) -> AsOf:
    """Say what was baseline and what was on board at a time, and who said so.

    Parameters
    ----------
    time
        ISO 8601, UTC when it names no zone; None is now.

    Raises
    ------
    NotFoundError
        When there is no such sensor.
    RefusedInputError
        When the time cannot be read.
    """
    time_utc = utc_now() if time is None else read_time(time)
    sensor = get_sensor(session, sensor_id)
    promotion = rows.promotion_at(session, sensor_id, time_utc)
    approval = (
        None if promotion is None or promotion.approval_id is None else session.get(Approval, promotion.approval_id)
    )
    return AsOf(
        sensor=sensor,
        time_utc=time_utc,
        baseline=None if promotion is None else session.get_one(ParameterSet, promotion.parameter_set_id),
        promotion=promotion,
        approval=approval,
        signatures=[] if approval is None else approval_rows.signatures(session, approval.id),
        on_board=uplink_rows.records_until(session, sensor_id, time_utc),
        learned_later=_learned_later(session, sensor_id, time_utc),
        profile=rows.in_force_at(session, GateProfile, sensor_id, time_utc),
        definition=rows.in_force_at(session, TableDefinition, sensor_id, time_utc),
    )


@dataclass(frozen=True)
class Board:
    """Ground and board of one sensor as numbers and states: what orders a fleet, without what each line says.

    Parameters
    ----------
    baseline_id
        The set that is baseline; None where there is none.
    on_board
        Every set of which anything was recorded, with what was recorded last, in the order of recording.
    """

    sensor_id: int
    name: str
    baseline_id: int | None
    on_board: Sequence[tuple[int, str]]


def boards(session: Session) -> list[Board]:
    """Return ground and board of every sensor now, by name, in three queries for the whole fleet."""
    baselines, recorded = sensor_rows.baseline_heads(session), uplink_rows.newest_states(session)
    return [
        Board(head.id, head.name, baselines[head.id].id if head.id in baselines else None, recorded.get(head.id, ()))
        for head in sensor_rows.sensor_heads(session)
    ]


def _learned_later(session: Session, sensor_id: int, time_utc: str) -> Records:
    """Return the records made after a time of what happened before it."""
    return [
        (row, record)
        for row, record in rows.records_after(session, sensor_id, time_utc)
        if ((record.evidence or {}).get("happened_utc") or record.recorded_utc) <= time_utc
    ]


def events(
    session: Session,
    sensor_id: int,
    *,
    until: str | None = None,
    before_id: int | None = None,
    limit: int | None = None,
) -> list[Event]:
    """Return what happened to a sensor, newest first; the next page starts before the last one's id.

    Raises
    ------
    NotFoundError
        When there is no such sensor.
    RefusedInputError
        When the time cannot be read, or no event has the id to go on from.
    """
    get_sensor(session, sensor_id)
    found = rows.keys(
        session,
        sensor_id,
        until_utc=None if until is None else read_time(until),
        before=None if before_id is None else _key(session, sensor_id, before_id),
        limit=limit,
    )
    reader = Reader.of_sensor(session, sensor_id)
    return [reader.read(key, row) for key, row in rows.rows_at(session, sensor_id, found).items()]


def _key(session: Session, sensor_id: int, event_id: int) -> rows.Key:
    """Return where an event stands."""
    row_id, kind = divmod(event_id, len(rows.KINDS))
    if (key := rows.key_of(session, sensor_id, kind, row_id)) is None:
        raise RefusedInputError("This sensor has no event to go on from; begin again without a cursor.")
    return key


def happened_on(time: str | None) -> dict[str, str]:
    """Return what a record keeps of when its event happened; nothing where no time was given.

    Raises
    ------
    RefusedInputError
        When it is no time, or still to come.
    """
    if time is None or not time.strip():
        return {}
    happened_utc = read_time(time)
    if happened_utc > utc_now():
        raise RefusedInputError(f"{time.strip()} is still to come; record what has happened, with its time in UTC.")
    return {"happened_utc": happened_utc}
