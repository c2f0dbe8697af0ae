"""A launch in a fleet that no menu holds: a sensor is found by name and chosen, and what was typed stays."""

import os
import re

import pytest
from playwright.sync_api import expect

from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.sessions import open_engine, open_writing
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document
from tests.browser.installation import Installation
from tests.browser.people import PRINTED_NAMES, People, password_of
from tests.console.fleet.fleets import add_fleet
from tests.stores import url_in

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def analyst(tmp_path_factory, pytestconfig, browser):
    kernels = os.environ.get("NUMBA_CACHE_DIR") or str(pytestconfig.cache.mkdir("kernels"))
    made = Installation(tmp_path_factory.mktemp("large"), kernels)
    printed = ("--printed-name", PRINTED_NAMES["analyst"], "--password-stdin")
    made.command("user", "add", "analyst", "--role", "analyst", *printed, typed=password_of("analyst"))
    engine = open_engine(url_in(made.folder / "data"))
    with open_writing(engine) as session:
        add_fleet(session, FolderBlobStore(made.folder / "data" / "blobs"), sensor_document(st16_sensor(1)), 250)
    engine.dispose()
    made.start()
    with People(made, browser).seat("analyst") as window:
        yield window
    made.stop()


def test_a_sensor_of_a_large_fleet_is_found_and_chosen_and_what_was_typed_stays(analyst):
    page = analyst.page
    sensor, label = page.get_by_label("Sensor", exact=True), page.get_by_label("Label")
    analyst.open("/runs/new")
    expect(sensor.locator("option:checked")).to_have_text("ST-0000")
    label.fill("after eclipse")
    page.get_by_label("Find a sensor").fill("st-0249")
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("find=st-0249.*sensor=250"))
    expect(sensor.locator("option:checked")).to_have_text("ST-0249")
    expect(label).to_have_value("after eclipse")
    expect(page.get_by_label("Calibration set").locator("option:checked")).to_contain_text("ST-0249 · calibration")
    expect(page.locator("[data-parameters-of]")).to_have_count(1)
    analyst.fits()
    assert analyst.barriers() == []
    page.get_by_label("Find a sensor").fill("")
    page.get_by_role("button", name="Find").click()
    expect(page.locator("#sensor_id option")).to_have_count(201)
    sensor.select_option(label="ST-0007")
    expect(page).to_have_url(re.compile("sensor=8"))
    expect(page.get_by_label("Calibration set").locator("option:checked")).to_contain_text("ST-0007 · calibration")
    expect(label).to_have_value("after eclipse")
    page.go_back()
    expect(sensor.locator("option:checked")).to_have_text("ST-0249")
    expect(page.get_by_label("Calibration set").locator("option:checked")).to_contain_text("ST-0249 · calibration")
