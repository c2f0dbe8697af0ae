"""What people do on the pages, a function each: upload, queue, submit, sign."""

import io
import re
import zipfile
from pathlib import Path
from typing import Any

from playwright.sync_api import expect

from tests.browser.window import Window

NAMES = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
DOCUMENT = {
    "table_id": "STR_CAM",
    "flight_software_version": "4.2.1",
    "length_bytes": 68,
    "fields": [
        {"name": name.upper(), "parameter": name, "offset_bytes": 8 * place, "type": "float64"}
        for place, name in enumerate(NAMES)
    ],
    "crc": {"name": "CRC-16/ARC", "offset_bytes": 64, "over": [0, 64]},
}


def look_at_views(window: Window) -> None:
    """Keep every figure of a request in sight until it counts as opened; the views are unfolded."""
    for view in window.page.locator("[data-view]").all():
        view.locator("plot-figure").scroll_into_view_if_needed()
        expect(view.locator("[data-opened]")).to_have_text("opened")


def register_with_table(window: Window, document: dict[str, Any]) -> int:
    """Register a sensor over REST with the layout of its table on board; returns its number."""
    window.open("/")
    token = window.page.locator("input[name=csrf_token]").first.input_value()

    def post(address, body, **headers):
        answer = window.page.request.post(address, data=body, headers={"X-CSRF-Token": token, **headers})
        assert answer.ok, answer.text()
        return answer.json()

    made = post("/api/v1/sensors", document)
    definition = {"document": DOCUMENT, "reason": "As flown."}
    post(f"/api/v1/sensors/{made['id']}/table-definitions", definition, **{"If-Match": '"v0"'})
    return made["id"]


def sent_table(window: Window, set_id: int | str) -> bytes:
    newest = window.read(f"/api/v1/packages?parameter_set_id={set_id}")["items"][0]
    content = window.page.request.get(f"/api/v1/packages/{newest['id']}/content").body()
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        return packed.read("table.bin")


def choose_upload(window: Window, sensor_id: int, path: Path, purpose: str = "calibration") -> None:
    window.open("/telemetry")
    window.page.locator("#sensor_id").select_option(str(sensor_id))
    window.page.get_by_role("radio", name=purpose).check()
    window.page.get_by_label("Telemetry file").set_input_files(path)


def upload(window: Window, sensor_id: int, path: Path, purpose: str = "calibration") -> int:
    choose_upload(window, sensor_id, path, purpose)
    window.page.get_by_role("button", name="Upload and check").click()
    window.page.wait_for_url(re.compile(r"/telemetry/\d+$"))
    return _number(window)


def queue(window: Window, label: str) -> int:
    window.page.get_by_label("Label").fill(label)
    expect(window.page.locator("[data-dry-run] dl.facts")).to_be_visible()
    window.page.get_by_role("button", name="Queue run").click()
    window.page.wait_for_url(re.compile(r"/runs/\d+$"))
    return _number(window)


def choose_filter(window: Window, frames_per_s: float) -> None:
    window.page.get_by_role("radio", name=re.compile("^Square-root filter")).check()
    window.page.get_by_label("Replay pace").fill(str(frames_per_s))


def ends_as(window: Window, state: str) -> None:
    expect(window.page.locator("#run-head .page-head .status").first).to_have_text(state)


def make_set(window: Window, run_id: int) -> int:
    window.open(f"/runs/{run_id}")
    window.page.get_by_role("button", name="Create parameter set").click()
    window.page.wait_for_url(re.compile(r"/parameter-sets/\d+$"))
    return _number(window)


def submit(window: Window, reason: str) -> int:
    window.page.get_by_label("Reason").fill(reason)
    window.page.get_by_role("button", name=re.compile("^Submit")).click()
    window.page.wait_for_url(re.compile(r"/approvals/\d+$"))
    return _number(window)


def sign(window: Window, button: str, password: str, comment: str = "") -> None:
    window.page.locator("#sign").get_by_label("Comment", exact=True).first.fill(comment)
    window.page.locator("#password").fill(password)
    window.page.locator("#sign").get_by_role("button", name=re.compile(f"^{button}")).first.click()
    window.page.get_by_role("dialog").get_by_role("button", name=re.compile(f"^{button}")).click()


def _number(window: Window) -> int:
    return int(window.page.url.rpartition("/")[2])
