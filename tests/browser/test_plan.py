"""A plan of pointings by keyboard: the form is filled and sent, the plan stands beside it, the CSV comes down, the page holds."""

import pytest
from playwright.sync_api import expect

from boresight.console.fleet import service as sensors
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.db.sessions import open_engine, open_writing
from boresight.settings import read_settings
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document

LINES = "10 5 0\n120 -40 30\n200 60 90\n300 20 45"


@pytest.fixture
def sensor_id(installation):
    engine = open_engine(read_settings(installation.environment).database_url)
    with open_writing(engine) as session:
        document = sensor_document(st16_sensor(6)) | {"name": "ST16-PLANNED"}
        number = sensors.register_sensor(session, COMMAND_LINE, document, simulated=True).id
    engine.dispose()
    return number


def test_a_plan_is_asked_for_by_keyboard_read_and_taken_along(people, sensor_id):
    address = f"/sensors/{sensor_id}"
    with people.seat("analyst") as window:
        page = window.page
        window.open(address)
        page.get_by_role("link", name="Plan", exact=True).press("Enter")
        page.wait_for_url(f"**{address}/plan")
        window.holds_in_themes_and_widths("plan")
        page.get_by_label("Minutes").focus()
        page.keyboard.press("ControlOrMeta+a")
        page.keyboard.type("5")
        page.get_by_text("Candidate pointings and criterion").press("Enter")
        page.get_by_label("Attitudes that may be chosen").fill(LINES)
        page.get_by_label("Sun (°)").fill("0")
        page.get_by_label("Moon (°)").fill("0")
        page.get_by_label("Minutes").press("Enter")
        table = page.get_by_role("table", name="Pointings in order")
        expect(table).to_be_visible()
        assert 1 < table.get_by_role("row").count() <= 6
        expect(page.locator(".page-head .status").first).to_contain_text("gate")
        expect(page.get_by_label("Minutes")).to_have_value("5")
        expect(page.get_by_role("table", name="One σ of each parameter")).to_contain_text("f_m")
        assert window.barriers() == []
        window.shoot("90-plan", wide=True)
        with page.expect_download() as coming:
            page.get_by_role("button", name="Download CSV").press("Enter")
        assert coming.value.path().read_text().splitlines()[0].count("ra_deg") == 1
        page.get_by_label("Minutes").fill("1440")
        page.get_by_role("button", name="Plan").press("Enter")
        expect(page.locator(".notice")).to_contain_text("dwells")
        assert window.barriers() == []
        window.forgive("status of 422")
