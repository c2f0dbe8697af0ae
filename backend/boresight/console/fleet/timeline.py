"""The state of a sensor at a time with its sources, and its timeline: every event, in order and in words.

The state at T is, of each kind, the newest row that is not after T: rows are only ever added, so nothing is replayed. T
is when a thing was recorded here; `learned_later` names what happened before T and was recorded after it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from boresight.console.approvals import queries as approval_rows
from boresight.console.approvals.tables import Approval, GateProfile, Signature, Waiver
from boresight.console.fleet import queries as sensor_rows
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.console.uplinks import queries as uplink_rows
from boresight.console.uplinks.tables import Package, TableDefinition, Uplink
from boresight.errors import RefusedInputError
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.db.times import read_time

METHODS = {"bytes": "compared byte by byte", "crc": "compared by CRC"}


@dataclass(frozen=True)
class TimelineEvent:
    """One line of a sensor's timeline."""

    id: int
    at_utc: str
    kind: str
    state: str | None
    parameter_set_id: int | None
    parameter_set: str | None
    who: str | None
    sentence: str
    said: str | None
    sha256: str | None
    happened_utc: str | None
    subject: str | None


@dataclass(frozen=True)
class EventText:
    """The text of an event."""

    kind: str
    sentence: str
    set_id: int | None = None
    person: int | None = None
    state: str | None = None
    said: str | None = None
    sha256: str | None = None
    subject: str | None = None


@dataclass(frozen=True)
class TimelineReader:
    """Reads the rows of a sensor's events as text, with the names that they refer to."""

    names: Mapping[int, str]
    people: Mapping[int, str]
    requests: Mapping[int, Approval]
    first_promotions: Mapping[int, int]

    @classmethod
    def from_sensor(cls, session: Session, sensor_id: int) -> TimelineReader:
        """Read the names that a sensor's events refer to."""
        return cls(
            sensor_rows.read_set_names(session, sensor_id),
            sensor_rows.read_printed_names(session),
            sensor_rows.list_requests(session, sensor_id),
            sensor_rows.read_first_promotions(session, sensor_id),
        )

    def read(self, key: sensor_rows.Key, row: Any) -> TimelineEvent:
        """Describe the row behind a key."""
        told = READERS[sensor_rows.KINDS[key.kind]](self, row)
        return TimelineEvent(
            id=key.row_id * len(sensor_rows.KINDS) + key.kind,
            at_utc=key.at_utc,
            kind=told.kind,
            state=told.state,
            parameter_set_id=told.set_id,
            parameter_set=None if told.set_id is None else self.names[told.set_id],
            who=getattr(row, "printed_name", None) or (None if told.person is None else self.people.get(told.person)),
            sentence=told.sentence,
            said=told.said or None,
            sha256=told.sha256,
            happened_utc=row.typed_evidence.happened_utc if isinstance(row, Uplink) else None,
            subject=told.subject,
        )

    def name(self, set_id: int) -> str:
        """Return a set's name."""
        return self.names[set_id]


def _definition(reader: TimelineReader, row: TableDefinition) -> EventText:  # noqa: ARG001 - every reader is asked alike
    sentence = f"Table definition {row.number} came into force."
    return EventText("table definition", sentence, None, row.created_by, None, row.reason, row.sha256)


def _profile(reader: TimelineReader, row: GateProfile) -> EventText:  # noqa: ARG001 - every reader is asked alike
    sentence = f"Gate profile {row.number} came into force."
    return EventText("gate profile", sentence, None, row.created_by, None, row.reason, row.sha256)


def _request(reader: TimelineReader, row: Approval) -> EventText:
    name = reader.name(row.parameter_set_id)
    asked = f"to roll back to {name}" if row.kind == "ROLLBACK" else f"to make {name} the baseline"
    told = EventText("request", f"Request {row.id} {asked}; now {row.state}.", row.parameter_set_id)
    return replace(told, person=row.submitted_by, said=row.reason, subject=f"approvals/{row.id}")


def _waiver(reader: TimelineReader, row: Waiver) -> EventText:
    sentence = f"The gate {row.gate} was waived for {reader.name(row.parameter_set_id)} until {row.expires_utc[:10]}."
    return EventText("waiver", sentence, row.parameter_set_id, row.made_by, None, f"{row.code}: {row.reason}")


def _signature(reader: TimelineReader, row: Signature) -> EventText:
    set_id = reader.requests[row.approval_id].parameter_set_id
    did = "approved" if row.decision == "APPROVE" else "refused"
    where = f", at the console of {row.console}" if row.console else ""
    told = EventText(
        "signature", f"Request {row.approval_id} for {reader.name(set_id)} was {did}{where}.", set_id, row.user_id
    )
    said = f"{row.meaning}: {row.comment}" if row.comment else row.meaning
    return replace(told, state=row.decision, said=said, sha256=row.shown_sha256, subject=f"approvals/{row.approval_id}")


def _promotion(reader: TimelineReader, row: Promotion) -> EventText:
    name, request = reader.name(row.parameter_set_id), reader.requests.get(row.approval_id or 0)
    told = EventText("promotion", f"{name} became the baseline.", row.parameter_set_id, row.promoted_by, "BASELINE")
    if request is None:
        return replace(told, kind="ground calibration", sentence=f"{name} is the baseline that came with the sensor.")
    told = replace(
        told,
        said=row.reason or request.reason,
        subject=f"approvals/{request.id}",
        sha256=request.binding.set_sha256,
    )
    if reader.first_promotions[row.parameter_set_id] != row.id:
        return replace(told, kind="roll-back", sentence=f"{name} became the baseline again.")
    return told


def _package(reader: TimelineReader, row: Package) -> EventText:
    sentence = f"Package {row.id} of {reader.name(row.parameter_set_id)} was built."
    told = EventText("package", sentence, row.parameter_set_id, row.created_by, None, None, row.sha256)
    return replace(told, subject=f"packages/{row.id}")


def _uplink(reader: TimelineReader, row: Uplink) -> EventText:
    name, evidence = reader.name(row.parameter_set_id), row.typed_evidence
    said = evidence.sentence if row.method else None
    sentence = f"{name} was recorded as {row.onboard_state} on board, {describe_source(row)}. {said or ''}".rstrip()
    if row.c_sd is not None:
        c_sd = f"Its update of C_SD was recorded as {row.c_sd}{f': {row.c_sd_said}' if row.c_sd_said else ''}."
        sentence = f"{sentence} {c_sd}" if row.is_step else f"{name}, {row.onboard_state} on board: {c_sd}"
    told = EventText("read-back" if row.method else "uplink", sentence, row.parameter_set_id, row.recorded_by)
    return replace(
        told, state=row.onboard_state if row.is_step else None, said=row.source, sha256=evidence.shown_sha256
    )


def describe_source(row: Uplink) -> str:
    """Describe the source of a record: a comparison, a signature, or a person's statement."""
    if row.method is not None:
        return METHODS[row.method]
    return "signed" if row.printed_name else "by statement"


READERS: Mapping[str, Callable[[TimelineReader, Any], EventText]] = {
    "table definition": _definition,
    "gate profile": _profile,
    "request": _request,
    "waiver": _waiver,
    "signature": _signature,
    "promotion": _promotion,
    "package": _package,
    "uplink": _uplink,
}


Records = Sequence[tuple[ParameterSet, Uplink]]


@dataclass(frozen=True)
class AsOf:
    """The state of a sensor at a time, as recorded by then."""

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
        """Ground and on-board state in one line, as two separate facts."""
        ground = "no baseline" if self.baseline is None else f"baseline {self.baseline.name}"
        mismatched = ", ".join(
            f"{row.name} MISMATCH" for row, known in self.on_board if known.onboard_state == "MISMATCH"
        )
        if self.active is not None:
            board = f", on board {self.active[0].name} ACTIVE: {'differs' if self.differs else 'the same'}"
        else:
            board = "; no set is known to be active on board"
        return f"{ground}{board}{'; ' + mismatched if mismatched else ''}"


def get_state_at(session: Session, sensor_id: int, time: str | None = None) -> AsOf:
    """Return the baseline and the set on board at a time, with their sources."""
    time_utc = utc_now() if time is None else read_time(time)
    sensor = session.get_known(Sensor, sensor_id)
    promotion = sensor_rows.find_promotion_at(session, sensor_id, time_utc)
    approval = (
        None if promotion is None or promotion.approval_id is None else session.get(Approval, promotion.approval_id)
    )
    return AsOf(
        sensor=sensor,
        time_utc=time_utc,
        baseline=None if promotion is None else session.get_one(ParameterSet, promotion.parameter_set_id),
        promotion=promotion,
        approval=approval,
        signatures=[] if approval is None else approval_rows.list_signatures(session, approval.id),
        on_board=uplink_rows.list_records_until(session, sensor_id, time_utc),
        learned_later=_list_learned_later(session, sensor_id, time_utc),
        profile=sensor_rows.find_in_force_at(session, GateProfile, sensor_id, time_utc),
        definition=sensor_rows.find_in_force_at(session, TableDefinition, sensor_id, time_utc),
    )


def _list_learned_later(session: Session, sensor_id: int, time_utc: str) -> Records:
    return [
        (row, record)
        for row, record in sensor_rows.list_records_after(session, sensor_id, time_utc)
        if (record.typed_evidence.happened_utc or record.recorded_utc) <= time_utc
    ]


def list_events(
    session: Session,
    sensor_id: int,
    *,
    until: str | None = None,
    before_id: int | None = None,
    limit: int | None = None,
) -> list[TimelineEvent]:
    """Return what happened to a sensor, newest first; the next page starts before the last one's id."""
    session.get_known(Sensor, sensor_id)
    found = sensor_rows.list_event_keys(
        session,
        sensor_id,
        until_utc=None if until is None else read_time(until),
        before=None if before_id is None else _find_key(session, sensor_id, before_id),
        limit=limit,
    )
    reader = TimelineReader.from_sensor(session, sensor_id)
    return [reader.read(key, row) for key, row in sensor_rows.read_rows_at(session, sensor_id, found).items()]


def _find_key(session: Session, sensor_id: int, event_id: int) -> sensor_rows.Key:
    """Return the key of an event."""
    row_id, kind = divmod(event_id, len(sensor_rows.KINDS))
    if (key := sensor_rows.find_event_key(session, sensor_id, kind, row_id)) is None:
        raise RefusedInputError(
            "This sensor has no event at this cursor; start again without a cursor.", code="unknown-cursor"
        )
    return key


def happened_on(time: str | None) -> dict[str, str]:
    """Return the time that a record states for its event; empty where none was given."""
    if time is None or not time.strip():
        return {}
    happened_utc = read_time(time)
    if happened_utc > utc_now():
        raise RefusedInputError(f"{time.strip()} is in the future; give a past time in UTC.")
    return {"happened_utc": happened_utc}
