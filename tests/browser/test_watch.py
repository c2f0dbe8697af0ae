"""A drift alarm handled: seen by the operator at night, acknowledged, understood by the analyst, over by a promotion."""

import re

import numpy as np
import pytest
from playwright.sync_api import expect

from boresight.console.alarms import rules
from boresight.console.fleet import service as sensors
from boresight.console.runs.tables import Run
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.db.sessions import open_engine, open_writing
from boresight.settings import read_settings
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document
from tests.browser.people import PRINTED_NAMES
from tests.missions import add_run, add_set, make_baseline

pytestmark = pytest.mark.browser

NUMBER = 5  # of the simulated sensors; the others here use the first


@pytest.fixture(scope="module")
def store(installation):
    engine = open_engine(read_settings(installation.environment).database_url)
    yield engine
    engine.dispose()


@pytest.fixture(scope="module")
def drifting(store):
    rng = np.random.default_rng(4)
    with open_writing(store) as session:
        document = sensor_document(st16_sensor(NUMBER))
        sensor = sensors.register_sensor(session, COMMAND_LINE, document, simulated=True)
        for month in range(10):
            data = add_set(session, sensor.id, 30.0 * month, temperature_c=20 + 6 * np.sin(month))
            run = add_run(session, data, rng, 0.05 * month * np.eye(8)[0])
            if month == 2:
                make_baseline(session, run)
        rules.update_alarms(session, [sensor.id])
        return sensor.id


def recalibrated(store, sensor_id):
    with open_writing(store) as session:
        newest = session.query(Run).filter_by(sensor_id=sensor_id).order_by(Run.id.desc()).first()
        make_baseline(session, newest)
        rules.update_alarms(session, [sensor_id])


def test_a_drift_alarm_is_seen_handled_understood_and_over(people, store, drifting):
    with people.seat("operator") as window:
        window.open("/")
        expect(window.page.locator(".tile-serious", has_text="ST16-5")).to_contain_text("It drifts: alarm")
        window.shoot("80-overview-drift", wide=True)
        window.page.locator("#live-mine").get_by_role("link", name=re.compile("ST16-5 drifts")).click()
        window.page.wait_for_url(re.compile(r"/alarms/\d+$"))
        address = re.sub(".*(/alarms/.*)", r"\1", window.page.url)
        window.holds_in_themes_and_widths("alarm")
        window.page.get_by_label("Take care of it").select_option(label=PRINTED_NAMES["analyst"])
        window.page.get_by_role("button", name="Assign").click()
        window.page.get_by_label("Comment").fill("Seen on the night shift; the day shift recalibrates.")
        window.page.get_by_role("button", name="Acknowledge").click()
        expect(window.page.locator(".subtitle")).to_have_text("acknowledged, active")
        window.shoot("81-alarm-acknowledged")
    with people.seat("analyst") as window:
        window.open(f"/sensors/{drifting}/trend")
        expect(window.page.locator("#advice")).to_contain_text("Recalibrate: PS-ST16-5-1 does not hold any more.")
        window.figures_drawn()
        window.shoot("82-trend", wide=True)
        window.open("/alarms")
        expect(window.page.get_by_role("table")).to_contain_text(PRINTED_NAMES["analyst"])
        recalibrated(store, drifting)
        window.open(address)
        expect(window.page.locator(".subtitle")).to_have_text("closed")
        window.shoot("83-alarm-closed")
