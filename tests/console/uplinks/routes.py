"""Sets on their way to the spacecraft, for requests about what is on board."""

import struct
from collections.abc import Mapping
from typing import Any

from boresight.console.uplinks import table_definitions
from boresight.mission_control.systems import IMAGE, Link
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.db.sessions import open_writing
from tests.served import PASSWORD, House

Made = tuple[str, dict[str, Any]]  # who asks, and path values with request options


def _versioned(row: dict[str, Any]) -> dict[str, str]:
    return {"If-Match": f'"v{row["version"]}"'}


def at(house: House, *states: str) -> dict[str, Any]:
    found = house.person("ada").get("/api/v1/parameter-sets", params={"sensor_id": house.new_sensor()["id"]})
    row, client = found.json()["items"][0], house.person("olga")
    for state in states:
        step = {"parameter_set_id": row["id"], "onboard_state": state, "source": "Pass 1"}
        assert client.post("/api/v1/uplinks", json=step, headers=_versioned(row)).status_code == 201
        row = client.get(f"/api/v1/parameter-sets/{row['id']}").json()
    return row


def table(house: House, row: dict[str, Any]) -> bytes:
    names = list(row["document"]["parameters"])
    fields = [
        {"name": name, "parameter": name, "offset_bytes": 8 * place, "type": "float64"}
        for place, name in enumerate(names)
    ]
    document = {"table_id": "CAM", "flight_software_version": "1", "length_bytes": 8 * len(names), "fields": fields}
    with open_writing(house.app.state.engine) as session:
        table_definitions.set_definition(session, COMMAND_LINE, row["sensor_id"], document, "As flown.", 0)
    return struct.pack(f">{len(names)}d", *row["document"]["parameters"].values())


class KeptLink(Link):
    """A link that keeps nothing, and says where a table would lie."""

    def hand_over(self, name: str, sha256: str, files: Mapping[str, bytes]) -> tuple[str, ...]:
        assert IMAGE in files
        return (f"{self.store}/{name}/{sha256[:12]}/{IMAGE}",)


def hand_over(house: House) -> Made:
    row = at(house)
    table(house, row)
    assert house.person("olga").post(f"/api/v1/parameter-sets/{row['id']}:export").status_code == 201
    house.app.state.mission_control.links = {"yamcs": KeptLink("yamcs", "http://yamcs.invalid", "sat", "tables")}
    return "olga", {"parameter_set_id": row["id"], "json": {"system": "yamcs"}, "headers": _versioned(row)}


def read_back(house: House) -> Made:
    row = at(house, "SENT", "LOADED")
    files = {"file": ("dump.bin", table(house, row))}
    options = {"data": {"source": "Pass 1"}, "files": files, "headers": _versioned(row)}
    return "olga", {"parameter_set_id": row["id"], **options}


def verified(house: House) -> dict[str, Any]:
    who, options = read_back(house)
    client, set_id = house.person(who), options.pop("parameter_set_id")
    assert client.post(f"/api/v1/parameter-sets/{set_id}:read-back", **options).json()["onboard_state"] == "VERIFIED"
    row: dict[str, Any] = client.get(f"/api/v1/parameter-sets/{set_id}").json()
    return row


def activate(house: House) -> Made:
    row = verified(house)
    body = {"source": "Pass 1", "meaning": "I saw it.", "password": PASSWORD}
    return "olga", {"parameter_set_id": row["id"], "json": body, "headers": _versioned(row)}


def uplink(house: House) -> Made:
    who, options = read_back(house)
    client = house.person(who)
    made = client.post(f"/api/v1/parameter-sets/{options.pop('parameter_set_id')}:read-back", **options)
    assert made.status_code == 201, made.text
    return "victor", {"uplink_id": made.json()["id"]}
