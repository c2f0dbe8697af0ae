"""Sets that their gates block, for requests about gates."""

from typing import Any

from boresight.platform.db.sessions import utc_after
from tests.served import PASSWORD, House

Made = tuple[str, dict[str, Any]]  # who asks, and path values with request options

TIGHT = {"name": "parameter-shift", "limit": 0.001, "marginal": 0.001}  # blocks whatever moved at all


def tight_profile(house: House, sensor_id: int) -> None:
    body = {"gates": [TIGHT], "reason": "To be tried."}
    address, headers = f"/api/v1/sensors/{sensor_id}/gate-profiles", {"If-Match": '"v0"'}
    answer = house.person("adele").post(address, json=body, headers=headers)
    assert answer.status_code == 201, answer.text


def blocked(house: House) -> dict[str, Any]:
    row = house.candidate()
    tight_profile(house, row["sensor_id"])
    report = house.person("ada").post(f"/api/v1/parameter-sets/{row['id']}:assess")
    assert report.json()["blocking"] == [TIGHT["name"]], report.text
    return row


def a_waiver(**changed: Any) -> dict[str, Any]:
    body = {
        "gate": TIGHT["name"],
        "code": "limit-too-tight",
        "reason": "The limit was only set to be tried.",
        "expires_utc": utc_after(3600.0),
        "password": PASSWORD,
    }
    return body | changed


def set_profile(house: House) -> Made:
    body = {"gates": [TIGHT], "reason": "To be tried."}
    return "adele", {"sensor_id": house.new_sensor()["id"], "json": body, "headers": {"If-Match": '"v0"'}}


def try_profile(house: House) -> Made:
    return "victor", {"sensor_id": house.candidate()["sensor_id"], "json": {"gates": [TIGHT]}}


def waive(house: House) -> Made:
    row = blocked(house)
    headers = {"If-Match": f'"v{row["version"]}"'}
    return "ada", {"parameter_set_id": row["id"], "json": a_waiver(), "headers": headers}
