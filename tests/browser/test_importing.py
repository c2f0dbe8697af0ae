"""A file of another program: its rows are seen with what they mean before anything is stored, and the set remembers the file."""

import pytest
from playwright.sync_api import expect

from tests.browser.work import choose_upload
from tests.telemetry.imports.conftest import VECTORS

pytestmark = pytest.mark.browser


@pytest.mark.full
def test_a_preview_stores_nothing_and_the_upload_that_follows_keeps_the_file_it_came_from(people, sensor_id):
    with people.seat("analyst") as window:
        before = window.read("/api/v1/telemetry-sets?limit=200")["items"]
        choose_upload(window, sensor_id, VECTORS / "openstartracker.csv")
        window.page.get_by_label("Written by").select_option("openstartracker")
        window.page.get_by_role("button", name="Preview import").click()
        rows = window.page.get_by_role("region", name="First rows", exact=True).locator("tbody tr")
        expect(rows).to_have_count(10)
        window.shoot("09-import-preview")
        assert window.read("/api/v1/telemetry-sets?limit=200")["items"] == before
        window.page.get_by_role("button", name="Upload and check").click()
        window.page.wait_for_url("**/telemetry/*")
        made = window.read(f"/api/v1/telemetry-sets/{window.page.url.rsplit('/', 1)[1]}")
        assert made["import_record"]["profile"]["name"] == "openstartracker"
        expect(window.page.get_by_role("link", name="openstartracker.csv", exact=True)).to_have_attribute(
            "href", f"/api/v1/telemetry-sets/{made['id']}/source"
        )
