"""A server with a fleet in it, and the numbers of everything there, so that what is made up often names something."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import requests
import schemathesis
from schemathesis import APIOperation

from tests.console.operations import GOOD, ask
from tests.fuzz.judge import Asker
from tests.served import PASSWORD, PEOPLE, House

ASKERS = ("adele", "ada", None)  # administrator, analyst, anonymous
FURNITURE = (
    "compare_runs", "launch_campaign", "save_preset", "submit_parameter_set", "promote_parameter_set", "get_gate_report",
    "set_table_definition", "get_package", "sign_over_the_shoulder", "get_uplink", "activate_parameter_set", "revoke_api_key",
    "redeliver", "get_alarm", "list_run_notes", "archive_telemetry_set", "cancel_run", "record_uplink",
)  # fmt: skip
LISTS = {
    "sensor_id": "sensors",
    "telemetry_set_id": "telemetry-sets",
    "run_id": "runs",
    "campaign_id": "campaigns",
    "preset_id": "presets",
    "profile_id": "import-profiles",
    "parameter_set_id": "parameter-sets",
    "approval_id": "approvals",
    "uplink_id": "uplinks",
    "package_id": "packages",
    "alarm_id": "alarms",
    "key_id": "api-keys",
    "address_id": "message-addresses",
    "webhook_id": "webhooks",
    "user_id": "users",
}
ALSO = {"validation_set_id": "telemetry_set_id", "assigned_to": "user_id", "run": "run_id", "history": "run_id"}
SPARE = 12
SHUTS_OUT = (":disable", ":change-roles", ":change-password", ":end-sessions")


@dataclass
class World:
    house: House
    operations: dict[str, APIOperation]
    askers: list[Asker]
    ids: dict[str, list[int]]
    spare: list[int]
    pairs: list[tuple[int, int]]  # a sensor, and a telemetry set of it

    def number(self, name: str, path: str, random_: random.Random) -> int | None:
        """Return the number of something that there is, by the name of a parameter; None where nothing has such a number.

        What shuts a person out is done to spare people only: the run itself must go on.
        """
        if name == "user_id" and path.endswith(SHUTS_OUT):
            return random_.choice(self.spare)
        known = self.ids.get(ALSO.get(name, name))
        return random_.choice(known) if known else None

    def read(self, path: str) -> requests.Response:
        return self.askers[0].send({"method": "GET", "url": f"{self.house.address}/api/v1/{path}"})

    def close(self) -> None:
        for asker in self.askers:
            asker.session.close()


def furnished(house: House) -> World:
    for name in FURNITURE:
        who, options = GOOD[name](house)
        ask(house.person(who), name, options)
    document = house.person("adele").get("/api/v1/openapi.json").json()
    schema = schemathesis.openapi.from_dict(document)
    schema.config.update(base_url=house.address)
    found = [result.ok() for result in schema.get_all_operations()]
    operations = {operation.definition.raw["operationId"]: operation for operation in found}
    assert len(operations) == sum(map(len, document["paths"].values()))
    spare = [_person(house, f"spare-{number}") for number in range(SPARE)]
    askers = [Asker(house.address, name) for name in ASKERS]
    for asker in askers:
        asker.log_in()
    ids = {name: _numbers(house, noun) for name, noun in LISTS.items()}
    ids["delivery_id"] = [1, 2, 3]
    ids["user_id"] += spare
    sets = house.person("adele").get("/api/v1/telemetry-sets?limit=200").json()["items"]
    pairs = [(one["sensor_id"], one["id"]) for one in sets]
    return World(house, operations, askers, ids, spare, pairs)


def _person(house: House, name: str) -> int:
    person = {"name": name, "printed_name": name.title(), "password": PASSWORD, "roles": list(PEOPLE["victor"])}
    answer = house.person("adele").post("/api/v1/users", json=person)
    assert answer.status_code == 201, answer.text
    return int(answer.json()["id"])


def _numbers(house: House, noun: str) -> list[int]:
    items: list[Mapping[str, Any]] = house.person("adele").get(f"/api/v1/{noun}?limit=200").json()["items"]
    return [item["id"] for item in items if item["id"] is not None]
