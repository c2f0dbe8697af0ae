"""A table definition for the sensor of these tests, and its sets at a state on board."""

from typing import Any

from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks import read_backs, table_definitions
from boresight.console.uplinks import service as uplinks
from boresight.platform.db.sessions import Session, open_reading, open_writing
from tests.console.uplinks.services import DOCUMENT
from tests.passwords import proved
from tests.sites import PASSWORD


def define(site: Any) -> None:
    with open_writing(site.engine) as session:
        table_definitions.set_definition(session, site.actor("ada"), 1, DOCUMENT, "As flown.", 0)


def advance(site: Any, *states: str, set_id: int = 1) -> None:
    for state in states:
        with open_reading(site.engine) as session:
            undefined = table_definitions.find_definition_in_force(session, 1) is None
        if state == "VERIFIED" and undefined:
            define(site)
        with open_writing(site.engine) as session:
            _step(session, site, set_id, state)


def _step(session: Session, site: Any, set_id: int, state: str) -> None:
    olga, source, row = site.actor("olga"), f"pass for {state}", session.get_one(ParameterSet, set_id)
    if state == "VERIFIED":
        sent = read_backs.get_sent_table(session, site.blobs, row).content
        site.blobs.put(sent)
        read_backs.read_back(session, olga, site.blobs, set_id, sent, source, row.version)
    elif state == "ACTIVE":
        uplinks.activate(session, olga, set_id, source, "I saw it.", proved(session, olga, PASSWORD), row.version)
    else:
        uplinks.record(session, olga, set_id, state, source)


def table(site: Any, set_id: int = 1) -> bytes:
    with open_reading(site.engine) as session:
        return read_backs.get_sent_table(session, site.blobs, session.get_one(ParameterSet, set_id)).content


def version(site: Any, set_id: int = 1) -> str:
    with open_reading(site.engine) as session:
        return str(session.get_one(ParameterSet, set_id).version)


def send_dump(site: Any, visitor: Any, dump: bytes, **typed: str) -> Any:
    data = {"csrf_token": visitor.csrf_token, "source": "TM 4711", "version": version(site), **typed}
    files = {"file": ("dump.bin", dump, "application/octet-stream")}
    return visitor.send("POST", "/parameter-sets/1/uplink/read-back", data=data, files=files)
