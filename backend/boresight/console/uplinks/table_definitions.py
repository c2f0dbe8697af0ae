"""Table definitions: how a sensor's camera lies in the table on board. Every version is kept; the newest is in force.

Another definition is another set of bytes and another rounding, so setting one makes the sensor's undecided requests stale.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from boresight.cameras import CAMERA_MODELS
from boresight.console.approvals import staleness
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.transitions import DocumentInForce, require_change, require_seen_document
from boresight.console.uplinks import queries as rows
from boresight.console.uplinks.tables import TableDefinition
from boresight.errors import RefusedInputError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.db.documents import canonical, compute_sha256
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import refuse_control_characters
from boresight.telemetry.sensors import parse_sensor
from boresight.uplink import table_definition

LARGEST_DOCUMENT = 200_000


def find_definition_in_force(session: Session, sensor_id: int) -> TableDefinition | None:
    """Return the definition that a sensor's sets are exported by; None where the mission configured none."""
    return rows.find_definition_in_force(session, sensor_id)


def list_definitions(session: Session, sensor_id: int) -> Sequence[TableDefinition]:
    """Return a sensor's definitions, newest first."""
    session.get_known(Sensor, sensor_id)
    return rows.list_definitions(session, sensor_id)


def parse_stored(session: Session, row: TableDefinition) -> table_definition.TableDefinition:
    """Return a stored definition, parsed."""
    sensor = session.get_one(Sensor, row.sensor_id)
    return table_definition.parse_definition(row.document, parse_sensor(sensor.document))


def parse_for(session: Session, sensor_id: int, document: Mapping[str, Any]) -> table_definition.TableDefinition:
    """Read a definition that is not stored, as `set_definition` would."""
    sensor = session.get_known(Sensor, sensor_id)
    definition = table_definition.parse_definition(document, parse_sensor(sensor.document))
    if len(canonical(document)) > LARGEST_DOCUMENT:
        raise RefusedInputError(f"The table definition has more than {LARGEST_DOCUMENT:,} characters: shorten it.")
    return definition


@dataclass(frozen=True)
class FilledTable:
    """A definition with the baseline's numbers in it.

    `image`: (length_bytes,) bytes.
    """

    definition: table_definition.TableDefinition
    image: bytes
    decoded: table_definition.Decoded
    effect: Mapping[str, float]
    filled_with: str


def lay_out(session: Session, sensor_id: int, document: Mapping[str, Any]) -> FilledTable:
    """Lay the sensor's baseline out by a definition, stored or not."""
    definition = parse_for(session, sensor_id, document)
    sensor = parse_sensor(session.get_known(Sensor, sensor_id).document)
    camera, baseline = CAMERA_MODELS[sensor.camera_model], set_rows.find_baseline(session, sensor_id)
    values = dict(zip(camera.parameter_names, sensor.initial.tolist(), strict=True))
    if baseline is not None:
        values = baseline.document["parameters"]
    image = table_definition.encode(definition, values, table_definition.NO_TURN)
    held = table_definition.quantised(definition, values)
    return FilledTable(
        definition=definition,
        image=image,
        decoded=table_definition.decode(definition, image),
        effect=table_definition.quantisation_effect(camera, sensor, values, held),
        filled_with="the sensor file" if baseline is None else baseline.name,
    )


def set_definition(
    session: Session,
    actor: Actor,
    sensor_id: int,
    document: Mapping[str, Any],
    reason: str,
    seen_number: int | None,
) -> TableDefinition:
    """Put a definition into force for a sensor."""
    complete = check_definition(session, actor, sensor_id, document, reason, seen_number)
    return put_into_force(session, actor, sensor_id, complete, reason)


def check_definition(
    session: Session, actor: Actor, sensor_id: int, document: Mapping[str, Any], reason: str, seen_number: int | None
) -> dict[str, Any]:
    """Return a definition as it would be stored, if this actor may put it into force now."""
    require_role(actor, "analyst", "administrator")
    require_scope(actor, "sensors")
    refuse_control_characters(reason=reason)
    sensor, current = session.get_known(Sensor, sensor_id), rows.find_definition_in_force(session, sensor_id)
    in_force = DocumentInForce(f"table definition of {sensor.name}", None, 0, None)
    if current is not None:
        in_force = replace(
            in_force, subject=f"table-definitions/{current.id}", number=current.number, sha256=current.sha256
        )
    require_seen_document(session, in_force, seen_number)
    parse_for(session, sensor_id, document)
    require_change(in_force, document, reason)
    return dict(document)


def put_into_force(
    session: Session,
    actor: Actor,
    sensor_id: int,
    document: Mapping[str, Any],
    reason: str,
    proposal: ChangeProposal | None = None,
) -> TableDefinition:
    """Put a definition into force, in the name of its proposer where there is one."""
    parse_for(session, sensor_id, document)
    sensor, current = session.get_known(Sensor, sensor_id), rows.find_definition_in_force(session, sensor_id)
    row = TableDefinition(
        sensor_id=sensor_id,
        number=1 if current is None else current.number + 1,
        document=dict(document),
        sha256=compute_sha256(dict(document)),
        reason=reason.strip(),
        created_utc=utc_now(),
        created_by=actor.user_id if proposal is None else proposal.proposed_by,
    )
    session.put(row)
    before = None if current is None else {"number": current.number, "sha256": current.sha256}
    after = {"sensor": sensor.name, "number": row.number, "sha256": row.sha256, "document": row.document}
    after |= {} if proposal is None else {"proposal": proposal.id}
    audit.append(session, actor, "defined", f"table-definitions/{row.id}", before, after, row.reason)
    staleness.make_stale_of_sensor(session, actor, sensor_id, f"the table definition became version {row.number}")
    return row
