"""A file that cannot be used is refused on the page with row, column and what to do, and nothing is stored."""

import json

import pytest
from playwright.sync_api import expect
from pyarrow import parquet
from pyarrow.csv import read_csv

from tests.browser.work import choose_upload

pytestmark = pytest.mark.browser

BAD_LINE = 18  # of the file, its head being the first


@pytest.fixture(scope="module")
def small_sensor(people, files):
    document = json.loads((files / "sensor.json").read_text())
    document |= {"name": "Small", "detector": {"rows": 600, "columns": 800, "pixel_pitch_m": 2.2e-6}}
    document["initial"] |= {"m0_px": 299.5, "n0_px": 399.5}
    with people.seat("analyst") as window:
        window.open("/sensors")
        window.page.get_by_label("Sensor file (JSON)").fill(json.dumps(document))
        window.page.get_by_role("button", name="Register").click()
        window.page.wait_for_url("**/sensors/*")
        return int(window.page.url.rpartition("/")[2])


@pytest.fixture
def words_for_a_number(files):
    lines = (files / "calibration.csv").read_text().splitlines()
    place = lines[0].replace('"', "").split(",").index("row_px")
    cells = lines[BAD_LINE - 1].split(",")
    cells[place] = "twelve"
    lines[BAD_LINE - 1] = ",".join(cells)
    path = files / "words.csv"
    path.write_text("\n".join(lines))
    return path


@pytest.fixture
def torn_parquet(files):
    path = files / "torn.parquet"
    parquet.write_table(read_csv(files / "calibration.csv"), path)
    path.write_bytes(path.read_bytes()[:-200])
    return path


def refused(window, sensor_id, path, name):
    address = "/api/v1/telemetry-sets?limit=200"
    before = window.read(address)["items"]
    choose_upload(window, sensor_id, path, "validation")
    window.page.get_by_role("button", name="Upload and check").click()
    told = window.page.locator("#upload-result")
    expect(told.get_by_role("alert")).to_be_visible()
    window.shoot(name)
    assert window.page.locator("#sensor_id").input_value() == str(sensor_id)
    expect(window.page.get_by_role("radio", name="validation")).to_be_checked()
    assert window.page.locator("#file").evaluate("input => input.files[0].name") == path.name
    assert window.read(address)["items"] == before
    window.forgive("422")
    return told


def test_words_in_a_column_of_numbers_are_refused_with_row_and_column(people, sensor_id, words_for_a_number):
    with people.seat("analyst") as window:
        told = refused(window, sensor_id, words_for_a_number, "30-words")
        fault = told.get_by_role("row").filter(has_text="twelve")
        expect(fault.get_by_role("cell").first).to_have_text(str(BAD_LINE))
        expect(fault.locator("code")).to_have_text("row_px")
        expect(fault.get_by_role("cell").last).to_contain_text("number")


def test_a_parquet_file_that_was_cut_short_is_refused_with_what_to_do(people, sensor_id, torn_parquet):
    with people.seat("analyst") as window:
        told = refused(window, sensor_id, torn_parquet, "31-torn")
        expect(told).to_contain_text("again")


def test_telemetry_of_another_sensor_is_refused_and_goes_to_that_sensor_by_one_press(
    people, telemetry, small_sensor, files
):
    with people.seat("analyst") as window:
        told = refused(window, small_sensor, files / "calibration.csv", "32-wrong-sensor")
        expect(told).to_contain_text("ST16-1")
        window.page.get_by_role("radio", name="calibration").check()  # as it is stored already
        told.get_by_role("button", name="Upload it to ST16-1 instead").click()
        window.page.wait_for_url(f"**/telemetry/{telemetry['calibration']}")


def test_a_sensor_file_with_a_mistake_stays_as_it_was_typed(people, files):
    with people.seat("analyst") as window:
        document = json.loads((files / "sensor.json").read_text())
        document["name"] = "Mistaken"
        document["initial"]["f_m"] = "sixteen"
        typed = json.dumps(document, indent=1)
        before = window.read("/api/v1/sensors")["items"]
        window.open("/sensors")
        window.page.get_by_label("Sensor file (JSON)").fill(typed)
        window.page.get_by_role("button", name="Register").click()
        expect(window.page.get_by_role("alert")).to_be_visible()
        expect(window.page.locator("#document-faults")).to_contain_text("f_m")
        expect(window.page.get_by_label("Sensor file (JSON)")).to_have_value(typed)
        window.shoot("33-sensor-refused")
        assert window.read("/api/v1/sensors")["items"] == before
        window.forgive("422")
