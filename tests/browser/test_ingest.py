"""New telemetry on the pages: a file is dropped into the watched folder, the console says what it makes of it, a person decides."""

import json
import re

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser

SENSOR, SOON_MS = "Watched ST16", 240_000


def register(window, document):
    window.open("/sensors")
    window.page.get_by_label("Sensor file (JSON)").fill(json.dumps(document | {"name": SENSOR}))
    window.page.get_by_role("button", name="Register").click()
    window.page.wait_for_url(re.compile(r"/sensors/\d+$"))
    return int(window.page.url.rpartition("/")[2])


@pytest.mark.full
def test_a_file_in_the_watched_folder_becomes_a_question_that_a_person_answers(people, files, installation):
    telemetry = (files / "calibration.csv").read_bytes()
    with people.seat("analyst") as window:
        sensor_id = register(window, json.loads((files / "sensor.json").read_text()))
        page = window.page
        window.open(f"/sensors/{sensor_id}/ingest")
        page.get_by_label("Reason").last.fill("Two passes a day.")
        page.get_by_role("button", name="Draft version 1").click()
        page.get_by_role("button", name="Rehearse on past data").click()
        expect(page.get_by_text("No past set has a calibration to judge")).to_be_visible()
    with people.seat("administrator") as window:
        window.open(f"/sensors/{sensor_id}/ingest")
        window.page.get_by_role("button", name=re.compile("^Enable")).click()
        window.page.get_by_role("dialog").get_by_role("button", name=re.compile("^Enable policy")).click()
        expect(window.page.get_by_text("The policy is in force.")).to_be_visible()
    place = installation.watched / SENSOR
    place.mkdir()
    (place / ".pass-1.csv").write_bytes(telemetry)
    (place / ".pass-1.csv").rename(place / "pass-1.csv")
    with people.seat("analyst") as window:
        page = window.page
        window.open(f"/ingest?sensor={sensor_id}")
        for _ in range(60):
            if decisions := window.read(f"/api/v1/ingest-decisions?sensor_id={sensor_id}")["items"]:
                break
            page.wait_for_timeout(500)
        window.open(f"/ingest/{decisions[0]['id']}")
        expect(page.locator(".page-head .status").first).to_have_text("ASKED", timeout=SOON_MS)
        expect(page.get_by_role("table", name="Does the telemetry set agree with the forecast?")).to_contain_text(
            "outside"
        )
        window.shoot("ingest-asked")
        page.get_by_role("button", name="Submit the parameter set for approval").first.click()
        dialog = page.get_by_role("dialog")
        dialog.get_by_label("Reason").fill("It moved since the ground.")
        dialog.get_by_role("button", name="Submit the parameter set for approval").click()
        expect(page.locator(".page-head .status").first).to_have_text("ANSWERED")
        page.get_by_role("link", name=re.compile(r"^Request \d+$")).click()
        page.wait_for_url(re.compile(r"/approvals/\d+$"))
    assert (place / "done" / "pass-1.csv").read_bytes() == telemetry
