"""A table definition for the sensor of these tests, and the way of a set to the spacecraft."""

from pathlib import Path
from typing import Any

from boresight.console import list_queries as lists
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks import table_definitions
from boresight.console.uplinks.read_backs import SentTable, get_sent_table, read_back
from boresight.console.uplinks.tables import TableDefinition, Uplink
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from tests.console.conftest import PASSWORD
from tests.passwords import proved

NAMES = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
DOCUMENT: dict[str, Any] = {
    "table_id": "STR_CAM",
    "flight_software_version": "4.2.1",
    "length_bytes": 68,
    "fields": [
        {"name": name.upper(), "parameter": name, "offset_bytes": 8 * place, "type": "float64"}
        for place, name in enumerate(NAMES)
    ],
    "crc": {"name": "CRC-16/CCITT-FALSE", "offset_bytes": 64, "over": [0, 64]},
}


def define(engine: Engine, actor: Actor, **changed: Any) -> TableDefinition:
    with open_writing(engine) as session:
        current = table_definitions.find_definition_in_force(session, 1)
        seen = 0 if current is None else current.number
        return table_definitions.set_definition(session, actor, 1, DOCUMENT | changed, "As flown.", seen)


def advance(engine: Engine, actor: Actor, *states: str, set_id: int = 1) -> None:
    for state in states:
        if state == "VERIFIED":
            _tell_crc(engine, actor, set_id)
            continue
        with open_writing(engine) as session:
            if state == "ACTIVE":
                seen = session.get_one(ParameterSet, set_id).version
                uplinks.activate(
                    session, actor, set_id, "pass 4711", "I saw it.", proved(session, actor, PASSWORD), seen
                )
            else:
                uplinks.record(session, actor, set_id, state, "pass 4711")


def _tell_crc(engine: Engine, actor: Actor, set_id: int) -> None:
    with open_reading(engine) as session:
        known = table_definitions.find_definition_in_force(session, 1)
    if known is None:
        define(engine, COMMAND_LINE)
    told = sent_table(engine, set_id).crc or ""
    with open_writing(engine) as session:
        seen = session.get_one(ParameterSet, set_id).version
        read_back(session, actor, FolderBlobStore(Path("nowhere")), set_id, told, "pass 4711", seen)


def sent_table(engine: Engine, set_id: int = 1) -> SentTable:
    with open_reading(engine) as session:
        return get_sent_table(session, FolderBlobStore(Path("nowhere")), session.get_one(ParameterSet, set_id))


def newest(engine: Engine, set_id: int = 1) -> Uplink:
    with open_reading(engine) as session:
        return lists.list_newest(session, Uplink, set=set_id, limit=1)[0]


def onboard(engine: Engine, set_id: int = 1) -> str:
    with open_reading(engine) as session:
        return session.get_one(ParameterSet, set_id).onboard_state


def promote_by_hand(session: Session, row: ParameterSet, at_utc: str) -> None:
    for other in session.query(ParameterSet).filter_by(sensor_id=row.sensor_id, ground_state="BASELINE"):
        other.ground_state = "SUPERSEDED"
    session.flush()
    row.ground_state, row.baseline_from_utc = "BASELINE", at_utc
    session.add(Promotion(sensor_id=row.sensor_id, parameter_set_id=row.id, at_utc=at_utc))
    session.flush()
    audit.append(session, COMMAND_LINE, "promoted", f"parameter-sets/{row.id}")
