"""An event of a sensor's history in words: what happened, to which set, who did it and in whose words.

One reader a kind of `boresight.store.timeline.KINDS`; a row is told in the same way wherever it is listed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from boresight.store import timeline as rows
from boresight.store.sessions import Session
from boresight.store.tables import (
    Approval,
    GateProfile,
    Package,
    Promotion,
    Signature,
    TableDefinition,
    Uplink,
    Waiver,
)

METHODS = {"bytes": "compared byte by byte", "crc": "compared by CRC"}


@dataclass(frozen=True)
class Event:
    """One line of a sensor's timeline.

    Parameters
    ----------
    id
        Stands for the event in cursors; grows within a kind, not over all kinds.
    at_utc
        When it was recorded.
    kind
        `table definition`, `gate profile`, `request`, `waiver`, `signature`, `ground calibration`, `promotion`,
        `roll-back`, `package`, `uplink` or `read-back`.
    state
        The state word that it brought; None where it brought none.
    parameter_set_id, parameter_set
        The set that it is about; None of what holds for the sensor.
    who
        Printed name; None where nobody in person did it.
    sentence
        What happened.
    said
        Reason, meaning, comment or source, in the person's words.
    sha256
        What it stands for: the document, the package or what was shown when it was signed.
    happened_utc
        When it happened, where its source puts that before `at_utc`.
    subject
        Address of the thing in the REST interface: `approvals/3`.
    """

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
class Told:
    """What a kind's reader makes of a row."""

    kind: str
    sentence: str
    set_id: int | None = None
    person: int | None = None
    state: str | None = None
    said: str | None = None
    sha256: str | None = None
    subject: str | None = None


@dataclass(frozen=True)
class Reader:
    """What the rows of a sensor's events refer to."""

    names: Mapping[int, str]
    people: Mapping[int, str]
    requests: Mapping[int, Approval]
    first_promotions: Mapping[int, int]

    @classmethod
    def of_sensor(cls, session: Session, sensor_id: int) -> Reader:
        """Read the names that a sensor's events speak of."""
        return cls(
            rows.set_names(session, sensor_id),
            rows.printed_names(session),
            rows.requests_of(session, sensor_id),
            rows.first_promotions(session, sensor_id),
        )

    def read(self, key: rows.Key, row: Any) -> Event:
        """Tell the row behind a key."""
        told = READERS[rows.KINDS[key.kind]](self, row)
        return Event(
            id=key.row_id * len(rows.KINDS) + key.kind,
            at_utc=key.at_utc,
            kind=told.kind,
            state=told.state,
            parameter_set_id=told.set_id,
            parameter_set=None if told.set_id is None else self.names[told.set_id],
            who=getattr(row, "printed_name", None) or (None if told.person is None else self.people.get(told.person)),
            sentence=told.sentence,
            said=told.said or None,
            sha256=told.sha256,
            happened_utc=(getattr(row, "evidence", None) or {}).get("happened_utc"),
            subject=told.subject,
        )

    def name(self, set_id: int) -> str:
        """Return a set's name."""
        return self.names[set_id]


def _definition(reader: Reader, row: TableDefinition) -> Told:  # noqa: ARG001 - every reader is asked alike
    sentence = f"Table definition {row.number} came into force."
    return Told("table definition", sentence, None, row.created_by, None, row.reason, row.sha256)


def _profile(reader: Reader, row: GateProfile) -> Told:  # noqa: ARG001 - every reader is asked alike
    sentence = f"Gate profile {row.number} came into force."
    return Told("gate profile", sentence, None, row.created_by, None, row.reason, row.sha256)


def _request(reader: Reader, row: Approval) -> Told:
    name = reader.name(row.parameter_set_id)
    asked = f"rolling back to {name}" if row.kind == "ROLLBACK" else f"making {name} the baseline"
    told = Told("request", f"Request {row.id} asked for {asked}; it is {row.state}.", row.parameter_set_id)
    return replace(told, person=row.submitted_by, said=row.reason, subject=f"approvals/{row.id}")


def _waiver(reader: Reader, row: Waiver) -> Told:
    sentence = f"The gate {row.gate} was waived for {reader.name(row.parameter_set_id)} until {row.expires_utc[:10]}."
    return Told("waiver", sentence, row.parameter_set_id, row.made_by, None, f"{row.code}: {row.reason}")


def _signature(reader: Reader, row: Signature) -> Told:
    set_id = reader.requests[row.approval_id].parameter_set_id
    did = "approved" if row.decision == "APPROVE" else "refused"
    where = f", at the console of {row.console}" if row.console else ""
    told = Told(
        "signature", f"Request {row.approval_id} for {reader.name(set_id)} was {did}{where}.", set_id, row.user_id
    )
    said = f"{row.meaning}: {row.comment}" if row.comment else row.meaning
    return replace(told, state=row.decision, said=said, sha256=row.shown_sha256, subject=f"approvals/{row.approval_id}")


def _promotion(reader: Reader, row: Promotion) -> Told:
    name, request = reader.name(row.parameter_set_id), reader.requests.get(row.approval_id or 0)
    told = Told("promotion", f"{name} became the baseline.", row.parameter_set_id, row.promoted_by, "BASELINE")
    if request is None:
        return replace(told, kind="ground calibration", sentence=f"{name} is the baseline that came with the sensor.")
    told = replace(told, said=request.reason, subject=f"approvals/{request.id}", sha256=request.bound.get("set_sha256"))
    if reader.first_promotions[row.parameter_set_id] != row.id:
        return replace(told, kind="roll-back", sentence=f"{name} became the baseline again.")
    return told


def _package(reader: Reader, row: Package) -> Told:
    sentence = f"Package {row.id} of {reader.name(row.parameter_set_id)} was built."
    told = Told("package", sentence, row.parameter_set_id, row.created_by, None, None, row.sha256)
    return replace(told, subject=f"packages/{row.id}")


def _uplink(reader: Reader, row: Uplink) -> Told:
    name, evidence = reader.name(row.parameter_set_id), row.evidence or {}
    said = evidence.get("sentence") if row.method else None
    sentence = f"{name} was recorded as {row.onboard_state} on board, {how_known(row)}. {said or ''}".rstrip()
    told = Told("read-back" if row.method else "uplink", sentence, row.parameter_set_id, row.recorded_by)
    return replace(told, state=row.onboard_state, said=row.source, sha256=evidence.get("shown_sha256"))


def how_known(row: Uplink) -> str:
    """Say what a record rests on: a comparison, a signature, or somebody's word."""
    if row.method is not None:
        return METHODS[row.method]
    return "signed" if row.printed_name else "by statement"


READERS: Mapping[str, Callable[[Reader, Any], Told]] = {
    "table definition": _definition,
    "gate profile": _profile,
    "request": _request,
    "waiver": _waiver,
    "signature": _signature,
    "promotion": _promotion,
    "package": _package,
    "uplink": _uplink,
}
