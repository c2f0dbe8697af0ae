"""Presets and campaigns as the tests of every route make them."""

import itertools
from collections.abc import Callable
from typing import Any

from tests.served import House

_numbers = itertools.count(1)


def new_preset(house: House) -> tuple[str, dict[str, Any]]:  # noqa: ARG001 - every maker of requests is given the house
    return "ada", {
        "json": {"name": f"Ours {next(_numbers)}", "sentence": "On Mondays.", "settings": {"robust": "huber"}}
    }


def preset(house: House) -> tuple[str, dict[str, Any]]:
    made = house.person("ada").post("/api/v1/presets", **new_preset(house)[1])
    assert made.status_code == 201, made.text
    return "ada", {"preset_id": made.json()["id"], "headers": {"If-Match": made.headers["etag"]}}


def launch(house: House, **given: Any) -> tuple[str, dict[str, Any]]:
    return "ada", {"json": {"label": "Monday", "sensors": [{"sensor_id": house.ready_sensor()[0]}], **given}}


def campaign(house: House, **given: Any) -> tuple[str, dict[str, Any]]:
    made = house.person("ada").post("/api/v1/campaigns", **launch(house, **given)[1])
    assert made.status_code == 202, made.text
    return "ada", {"campaign_id": made.json()["id"], "headers": {"If-Match": made.headers["etag"]}}


def failed(house: House) -> tuple[str, dict[str, Any]]:
    who, options = campaign(house)
    address = f"/api/v1/campaigns/{options['campaign_id']}/results"
    house.end(house.person("ada").get(address).json()["items"][0]["run_id"], "FAILED")
    return who, options


GOOD: dict[str, Callable[[House], tuple[str, dict[str, Any]]]] = {
    "list_presets": lambda _: ("victor", {}),
    "save_preset": new_preset,
    "get_preset": lambda house: ("victor", {"preset_id": preset(house)[1]["preset_id"]}),
    "archive_preset": preset,
    "list_campaigns": lambda _: ("victor", {}),
    "launch_campaign": launch,
    "get_campaign": lambda house: ("victor", {"campaign_id": campaign(house)[1]["campaign_id"]}),
    "list_campaign_results": lambda house: ("victor", {"campaign_id": campaign(house)[1]["campaign_id"]}),
    "cancel_campaign": campaign,
    "relaunch_campaign": failed,
}
