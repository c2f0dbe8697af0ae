"""Sensors: registering star trackers, and choosing among them with a few queries of at most `MOST_CHOICES` names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from boresight.console.fleet import queries as rows
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets.service import create_ground_calibration
from boresight.console.transitions import name_subject, require_seen
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import refuse_control_characters
from boresight.telemetry.sensors import parse_sensor, sensor_document

MOST_CHOICES = 200  # a larger fleet is searched by name instead
LONGEST_NAME = 64

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,63}")  # becomes part of PS-<sensor>-<n> and of file names
LASTING = ("name", "camera_model", "detector", "parity")  # a parameter set has no meaning under another one


def register_sensor(
    session: Session,
    actor: Actor,
    document: Mapping[str, Any],
    *,
    simulated: bool = False,
    truth: Mapping[str, float] | None = None,
) -> Sensor:
    """Add a star tracker, with its ground calibration `PS-<sensor>-0` as baseline."""
    require_role(actor, "analyst", "administrator")
    require_scope(actor, "sensors")
    description = parse_sensor(document)
    require_new_name(session, description.name)
    row = Sensor(
        name=description.name,
        document=sensor_document(description),
        created_utc=utc_now(),
        created_by=actor.user_id,
        simulated=int(simulated),
        truth=None if truth is None else dict(truth),
    )
    session.put(row)
    audit.append(session, actor, "registered", name_subject(row), None, row.document)
    create_ground_calibration(session, actor, row, description)
    return row


def require_new_name(session: Session, name: str) -> None:
    """Refuse a name that no sensor may have, or that one has."""
    if not NAME.fullmatch(name):
        raise RefusedInputError(f"{name!r} is not a sensor name: use up to 64 letters, digits, spaces and . _ -.")
    if rows.find_sensor(session, name) is not None:
        raise ConflictError(f"A sensor {name} exists already; edit it, or choose another name.")


def edit_sensor(
    session: Session, actor: Actor, sensor_id: int, document: Mapping[str, Any], seen_version: int | None
) -> Sensor:
    """Change what runs launched from now on start from; runs and parameter sets of before stay as they are."""
    require_role(actor, "analyst", "administrator")
    require_scope(actor, "sensors")
    row = session.get_known(Sensor, sensor_id)
    require_seen(session, row, seen_version)
    before, after = row.document, sensor_document(parse_sensor(document))
    for field in LASTING:
        if before[field] != after[field]:
            raise RefusedInputError(f"The {field} of {row.name} cannot change; register a new sensor for it.")
    row.document = after
    row.version += 1
    audit.append(session, actor, "edited", name_subject(row), before, after)
    return row


def count(session: Session) -> int:
    """Count the fleet."""
    return rows.count_holding(session, "")


@dataclass(frozen=True)
class SensorChoices:
    """The sensors that a chooser offers."""

    names: Mapping[int, str]
    is_all: bool
    find: str
    found: int
    fitting: int
    fleet: int


def list_choices(session: Session, *, find: str = "", keep: Iterable[int] = ()) -> SensorChoices:
    """Return the choices: a small fleet whole, of a larger one those in `keep` and the first whose name contains `find`."""
    refuse_control_characters(find=find)
    find = find.strip()[:LONGEST_NAME]
    first = rows.read_names_holding(session, "", MOST_CHOICES + 1)
    if len(first) <= MOST_CHOICES:
        return SensorChoices(first, is_all=True, find=find, found=len(first), fitting=len(first), fleet=len(first))
    found = dict(list((rows.read_names_holding(session, find, MOST_CHOICES) if find else first).items())[:MOST_CHOICES])
    kept = rows.read_names(session, set(keep) - found.keys())
    kept = dict(sorted(kept.items(), key=lambda one: one[1]))
    fleet = count(session)
    fitting = rows.count_holding(session, find) if find else fleet
    return SensorChoices(kept | found, is_all=False, find=find, found=len(found), fitting=fitting, fleet=fleet)
