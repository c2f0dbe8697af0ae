"""What an object of the audit log is called: the log knows its address in the REST API, a person knows its name."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

import sqlalchemy as sa

from boresight.console.access.tables import User
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.db.sessions import Session

#: Columns that name a row, by its noun.
NAMED = {
    "parameter-sets": ParameterSet.name,
    "sensors": Sensor.name,
    "telemetry-sets": TelemetrySet.name,
    "users": User.printed_name,
}
#: Words before the number of a row that has no name.
NUMBERED = {
    "alarms": "Alarm",
    "approvals": "Request",
    "campaigns": "Campaign",
    "change-proposals": "Proposal",
    "import-profiles": "Mapping profile",
    "keys": "Key",
    "packages": "Package",
    "presets": "Preset",
    "runs": "Run",
    "table-definitions": "Table layout",
    "uplinks": "On-board record",
    "webhooks": "Webhook",
}


def name_objects(session: Session, objects: Iterable[str]) -> dict[str, str]:
    """Return what objects are called, by their addresses; those that are not known here keep the address."""
    asked: dict[str, set[int]] = defaultdict(set)
    found = {}
    for address in objects:
        noun, _, rest = address.partition("/")
        number, _, part = rest.partition("/")
        found[address] = address
        if not number.isdecimal():
            continue
        if noun in NAMED and not part:
            asked[noun].add(int(number))
        elif noun in NUMBERED:
            thread = part.removeprefix("threads/")
            found[address] = f"{NUMBERED[noun]} {number}" + (
                f", thread {thread}" if part.startswith("threads/") else ""
            )
    for noun, numbers in asked.items():
        column = NAMED[noun]
        rows = session.execute(sa.select(column.class_.id, column).where(column.class_.id.in_(numbers)))
        found |= {f"{noun}/{number}": str(name) for number, name in rows}
    return found
