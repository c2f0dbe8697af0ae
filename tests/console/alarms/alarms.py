"""Alarms to handle and things to write notes on, for requests about them."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

from tests.console.uplinks import routes as onboard
from tests.served import House

Made = tuple[str, dict[str, Any]]  # who asks, and path values with request options


def alarm(house: House) -> dict[str, Any]:
    row = onboard.at(house, "SENT", "MISMATCH")
    found = house.person("ada").get("/api/v1/alarms", params={"sensor_id": row["sensor_id"], "kind": "MISMATCH"})
    (raised,) = found.json()["items"]
    return dict(raised)


def handled(**body: Any) -> Callable[[House], Made]:
    def make(house: House) -> Made:
        row = alarm(house)
        return "ada", {"alarm_id": row["id"], "json": body, "headers": {"If-Match": f'"v{row["version"]}"'}}

    return make


def _tomorrow() -> str:
    return (datetime.now(UTC) + timedelta(days=1)).isoformat()


def _shelve(house: House) -> Made:
    return handled(until_utc=_tomorrow(), reason="The pass is tomorrow.")(house)


def _unshelve(house: House) -> Made:
    who, options = _shelve(house)
    body, headers = options.pop("json"), options.pop("headers")
    answer = house.person(who).post(f"/api/v1/alarms/{options['alarm_id']}:shelve", json=body, headers=headers)
    return who, {**options, "headers": {"If-Match": answer.headers["etag"]}}


def _note(name: str, number: int) -> Made:
    return "ada", {name: number, "json": {"text": "Seen from the desk."}}


GOOD: dict[str, Callable[[House], Made]] = {
    "get_sensor_trend": lambda house: ("victor", {"sensor_id": house.new_sensor()["id"]}),
    "get_sensor_trend_figure": lambda house: ("victor", {"sensor_id": house.new_sensor()["id"]}),
    "get_sensor_trend_data": lambda house: ("victor", {"sensor_id": house.new_sensor()["id"]}),
    "list_alarms": lambda _: ("victor", {}),
    "get_alarm": lambda house: ("victor", {"alarm_id": alarm(house)["id"]}),
    "list_alarm_events": lambda house: ("victor", {"alarm_id": alarm(house)["id"]}),
    "acknowledge_alarm": handled(text="Seen."),
    "shelve_alarm": _shelve,
    "unshelve_alarm": _unshelve,
    "assign_alarm": handled(user_id=1),
    "comment_on_alarm": handled(text="A pass is asked for."),
    "list_run_notes": lambda house: ("victor", {"run_id": house.finished()}),
    "add_run_note": lambda house: _note("run_id", house.finished()),
    "list_sensor_notes": lambda house: ("victor", {"sensor_id": house.new_sensor()["id"]}),
    "add_sensor_note": lambda house: _note("sensor_id", house.new_sensor()["id"]),
    "list_parameter_set_notes": lambda house: ("victor", {"parameter_set_id": house.candidate()["id"]}),
    "add_parameter_set_note": lambda house: _note("parameter_set_id", house.candidate()["id"]),
}
BODIES: dict[str, dict[str, Any]] = {
    "acknowledge_alarm": {"json": {"text": "x"}},
    "shelve_alarm": {"json": {"until_utc": "2099-01-01", "reason": "x"}},
    "assign_alarm": {"json": {"user_id": None}},
    "comment_on_alarm": {"json": {"text": "x"}},
    "add_run_note": {"json": {"text": "x"}},
    "add_sensor_note": {"json": {"text": "x"}},
    "add_parameter_set_note": {"json": {"text": "x"}},
}
