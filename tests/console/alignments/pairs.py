"""Two trackers on one simulated body with a run of each, and alignments as the tests of every route and of the pages make them."""

import dataclasses
import time
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.settings import read_settings
from boresight.simulation import scenes
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_csv
from tests.served import PASSWORD, House

Made = tuple[str, dict[str, Any]]
TURN = np.radians([20.0, 60.0, -30.0])
FRAMES = 30
_aligned: dict[str, int] = {}  # by server: one is enough for all who only read it


@dataclasses.dataclass(frozen=True)
class Tracker:
    """A tracker on the body: its sensor file, its telemetry as CSV, and its calibration from it."""

    document: dict[str, Any]
    csv: bytes
    result: dict[str, Any]


@cache
def trackers(folder: Any) -> list[Tracker]:
    """Simulate and calibrate two trackers that are turned by TURN against each other and expose at the same times."""
    catalogue = load_catalogue(read_settings().catalogue_folder)
    a, b = (scenes.calibration_scenario(number, FRAMES) for number in (1, 2))
    exposures = scenes.expose(a)
    of_b = dataclasses.replace(exposures, attitude=Rotation.from_rotvec(TURN).as_matrix() @ exposures.attitude)
    made = []
    for seed, scenario, seen in ((0, a, exposures), (1, b, of_b)):
        telemetry = scenes.simulate(scenario, np.random.default_rng(seed), catalogue, seen)
        path = folder / f"tracker-{seed}.csv"
        write_csv(telemetry, path)
        found = calibrate(telemetry, scenario.sensor, catalogue, CalibrationSettings(method="batch"))
        made.append(Tracker(sensor_document(scenario.sensor), path.read_bytes(), found.to_dict()))
    return made


def run_of(house: House, tracker: Tracker) -> int:
    """Register a tracker, upload its telemetry, and end a run of it with its calibration."""
    ada = house.person("ada")
    named = {**tracker.document, "name": house.sensor_file()["name"]}
    sensor_id = ada.post("/api/v1/sensors", json=named).json()["id"]
    stored = house.upload(ada, sensor_id, tracker.csv)
    assert stored.status_code == 201, stored.text
    order = {"sensor_id": sensor_id, "telemetry_set_id": stored.json()["id"], "settings": {"method": "batch"}}
    run_id = int(ada.post("/api/v1/runs", json=order).json()["id"])
    dataclasses.replace(house, result=tracker.result).end(run_id)
    return run_id


def ask(house: House, run_a_id: int, run_b_id: int, who: str = "ada", **more: Any) -> Any:
    headers = more.pop("headers", {})
    params = more.pop("params", {})
    body = {"run_a_id": run_a_id, "run_b_id": run_b_id, **more}
    return house.person(who).post("/api/v1/alignments", json=body, headers=headers, params=params)


def read(house: House, alignment_id: int) -> dict[str, Any]:
    return dict(house.person("victor").get(f"/api/v1/alignments/{alignment_id}").json())


def ended(house: House, alignment_id: int, seconds: float = 60.0) -> dict[str, Any]:
    """Wait until the server has computed an alignment."""
    until_s = time.monotonic() + seconds
    while (row := read(house, alignment_id))["state"] in {"QUEUED", "RUNNING"}:
        assert time.monotonic() < until_s, row
        time.sleep(0.02)
    return row


def aligned(house: House) -> dict[str, Any]:
    """Align two sensors that saw the same sky in the same frame."""
    answer = ask(house, house.finished(), house.finished())
    assert answer.status_code == 202, answer.text
    row = ended(house, answer.json()["id"])
    assert row["state"] == "SUCCEEDED", row
    return row


def _good(house: House) -> Made:
    if house.address not in _aligned:
        _aligned[house.address] = aligned(house)["id"]
    return "victor", {"alignment_id": _aligned[house.address]}


def aligned_well(house: House) -> dict[str, Any]:
    """An alignment that no gate blocks."""
    made = trackers(house.app.state.settings.data_folder)
    return ended(house, ask(house, *(run_of(house, one) for one in made)).json()["id"])


def submitted(house: House) -> dict[str, Any]:
    """A request for an alignment that is open."""
    row = aligned_well(house)
    body = {"reason": "Both trackers were calibrated again."}
    answer = house.person("ada").post(f"/api/v1/alignments/{row['id']}:submit", json=body)
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def _signing(name: str) -> Any:
    def make(house: House) -> Made:
        row = submitted(house)
        body = {"meaning": "I approve it.", "password": PASSWORD, "comment": "No."}
        if name == "withdraw":
            body = {"reason": "Another run is better."}
        headers = {"If-Match": f'"v{row["version"]}"'}
        return "ada" if name == "withdraw" else "alan", {"request_id": row["id"], "json": body, "headers": headers}

    return make


def _to_submit(house: House) -> Made:
    row = aligned_well(house)
    return "ada", {"alignment_id": row["id"], "json": {"reason": "Both trackers were calibrated again."}}


GOOD = {
    "list_alignments": lambda _: ("victor", {}),
    "request_alignment": lambda house: (
        "ada",
        {"json": {"run_a_id": house.finished(), "run_b_id": house.finished()}},
    ),
    "get_alignment": _good,
    "get_alignment_result": _good,
    "get_alignment_figure": _good,
    "get_alignment_data": _good,
    "submit_alignment": _to_submit,
    "list_alignment_requests": _good,
    "list_all_alignment_requests": lambda _: ("victor", {"params": {"state": "OPEN"}}),
    "get_alignment_request": lambda house: ("victor", {"request_id": submitted(house)["id"]}),
    "approve_alignment": _signing("approve"),
    "refuse_alignment": _signing("refuse"),
    "withdraw_alignment": _signing("withdraw"),
}
