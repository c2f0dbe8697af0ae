"""The campaign pages: launch, the bar, what failed and why, results with their CSV; and the presets' page."""

import csv
import io
import re

import pytest

from boresight.console.campaigns import service as campaigns
from boresight.console.fleet import service as sensors
from boresight.console.pages.tables import csv_file
from boresight.console.runs import presets
from boresight.console.runs.tables import Run
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document

FORM = {
    "sensors": ["1", "2"],
    "calibration-1": "newest",
    "validation-1": "newest",
    "label": "after eclipse",
    "method": "batch",
}


@pytest.fixture
def bare(site):
    with open_writing(site.engine) as session:
        return sensors.register_sensor(session, COMMAND_LINE, sensor_document(st16_sensor(2))).id


@pytest.fixture
def launched(site, bare):  # noqa: ARG001 - the second sensor is part of it
    answer = site.visitor("ada").post("/campaigns/new", **FORM, intent="queue")
    assert answer.status_code == 303, answer.text
    return answer.headers["location"]


def _end(site, state, reason=None, summary=None):
    with open_writing(site.engine) as session:
        run = session.query(Run).order_by(Run.id.desc()).first()
        run.state, run.reason, run.summary = state, reason, summary
        audit.append(session, COMMAND_LINE, "ended", f"runs/{run.id}")
        return run.id


def test_before_the_first_campaign_the_list_says_what_to_do(site, read):
    assert "No campaign yet" in read(site.visitor("victor").get("/campaigns"))


def test_the_form_begins_with_every_sensor_that_has_telemetry_on_its_newest_sets(site, bare, read):
    page = site.visitor("ada").get("/campaigns/new?preset=drift-tracking")
    assert 'name="sensors" value="1" checked' in page
    assert f'name="sensors" value="{bare}">' in page
    assert "newest: TS-calibration" in read(page)
    assert "none: upload one first" in read(page)
    assert 'name="variant" value="q" checked' in page


def test_a_check_names_the_sensors_that_can_have_no_run_and_queues_nothing(site, bare, read):  # noqa: ARG001 - the second sensor is the one named
    answer = site.visitor("ada").post("/campaigns/new", **FORM, intent="check")
    text = read(answer.text)
    assert "1 of 2 sensors" in text
    assert "has no calibration set" in text
    assert 'value="after eclipse"' in answer.text
    with open_reading(site.engine) as session:
        assert campaigns.list_campaigns(session) == []


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ({"label": ""}, "Give the campaign a label"),
        ({"sensors": []}, "at least one sensor"),
        ({"sensors": ["2"]}, "No sensor of the campaign can have a run"),
        ({"minimum_stars": "many"}, "is not a whole number"),
        ({"calibration-1": "2", "validation-1": "2"}, "cannot validate a calibration made from itself"),
    ],
)
def test_a_refusal_keeps_what_was_typed(site, bare, read, typed, said):  # noqa: ARG001 - the second sensor may be chosen
    answer = site.visitor("ada").post("/campaigns/new", **{**FORM, "sensors": ["1"], **typed}, intent="queue")
    assert answer.status_code == 422
    assert said in read(answer.text)
    if "minimum_stars" in typed:
        assert 'value="many"' in answer.text


def test_a_check_without_a_label_is_answered_with_the_sentence(site, read):
    answer = site.visitor("ada").post("/campaigns/new", **{**FORM, "label": ""}, intent="check")
    assert answer.status_code == 200
    assert "Give the campaign a label" in read(answer.text)


def test_what_was_changed_stands_in_the_address_and_fills_the_form_again(site, bare):
    ada = site.visitor("ada")
    page = ada.get(
        f"/campaigns/new?sensors={bare}&calibration-1=1&validation-1=&label=x+y&method=ekf&forgetting_factor=.9"
    )
    begun = re.search('data-begun="([^"]*)"', page)[1]
    assert re.findall(r'name="sensors" value="(\d+)" checked', page) == [str(bare)]
    assert '<option value="1" selected>' in page
    assert '<option value="" selected>none' in page
    assert 'value="x y"' in page
    assert 'value="ekf" checked' in page
    assert 'name="forgetting_factor" inputmode="decimal" value=".9"' in page
    assert "sensors=1&amp;calibration-1=newest&amp;validation-1=newest" in begun
    assert 'name="sensors" value="1" checked' not in ada.get("/campaigns/new?sensors=")


def test_a_preset_keeps_sensors_and_label(site):
    page = site.visitor("ada").post("/campaigns/new?preset=wu", **{**FORM, "sensors": ["1"]}, intent="preset").text
    assert 'name="method" value="svd" checked' in page
    assert 'name="sensors" value="1" checked' in page
    assert 'value="after eclipse"' in page


def test_a_campaign_shows_one_bar_its_counts_and_what_failed_with_the_cause(site, launched, read):
    number = _end(site, "FAILED", "No exposure has 4 usable matched stars.")
    page = site.visitor("victor").get(launched)
    text = read(page)
    assert page.count("<progress") == 1
    assert "2 of 2 ended, 2 failed or not launched" in text
    assert "No exposure has 4 usable matched stars." in text
    assert "has no calibration set" in text
    assert f"/runs/{number}" in page
    assert 'data-campaign="ended"' in page
    assert "after eclipse" in read(site.visitor("victor").get("/campaigns"))


def test_results_are_a_table_and_the_same_as_csv_in_radians(site, launched, read):
    _end(
        site,
        "SUCCEEDED",
        summary={
            "level": "normal",
            "status": "converged",
            "rms_initial_arc_rad": 1e-4,
            "rms_final_arc_rad": 2e-5,
            "weak_directions": 1,
        },
    )
    victor = site.visitor("victor")
    text = read(victor.get(launched))
    lines = list(csv.DictReader(io.StringIO(victor.get(f"{launched}/results.csv"))))
    assert "converged 100 20" in text.replace(".0", "")
    assert [line["state"] for line in lines] == ["NOT LAUNCHED", "SUCCEEDED"]
    assert (float(lines[1]["rms_final_arc_rad"]), lines[1]["weak_directions"]) == (2e-5, "1")
    assert lines[1]["validation_rms_final_arc_rad"] == ""


@pytest.mark.parametrize("text", ["=1+1", "+x", "-x", "@x", "\tx", "\rx"])
def test_a_text_that_looks_like_a_formula_stays_a_text(text):
    written = csv_file("results", ["words", "number"], [{"words": text, "number": -1.5}]).body.decode()
    assert list(csv.reader(io.StringIO(written)))[1] == [f"'{text}", "-1.5"]


def test_the_failed_are_launched_again_and_all_can_be_cancelled(site, launched, read):
    ada = site.visitor("ada")
    _end(site, "LOST", "Its server went away.")
    ada.post(f"{launched}/launch-failed")
    assert "QUEUED 1" in read(ada.get(launched))
    ada.post(f"{launched}/cancel", reason="wrong set")
    text = read(ada.get(launched))
    assert "CANCELLED 1" in text
    assert "QUEUED 1" not in text


@pytest.mark.parametrize("move", ["cancel", "launch-failed"])
def test_a_viewer_reads_and_changes_nothing(site, launched, move):
    victor = site.visitor("victor")
    victor.post(f"{launched}/{move}")
    with open_reading(site.engine) as session:
        assert campaigns.list_campaigns(session)[0].counts["QUEUED"] == 1


def test_presets_are_listed_with_what_they_change_and_archived_by_an_analyst(site, read):
    with open_writing(site.engine) as session:
        row = presets.save_preset(session, site.actor("ada"), "Mondays", "On Mondays.", {"robust": "huber"})
    ada = site.visitor("ada")
    assert "Loss Huber: bounds what a false star may say" in read(ada.get("/presets"))
    site.visitor("victor").post(f"/presets/{row.id}/archive")
    assert "Archived" not in read(ada.get("/presets"))
    ada.post(f"/presets/{row.id}/archive")
    assert "Archived" in read(ada.get("/presets"))


def test_the_list_of_campaigns_can_be_had_as_csv(site, launched):
    visitor = site.visitor("victor")
    assert 'href="/campaigns.csv" download data-hotkey="e"' in visitor.get("/campaigns")
    (row,) = csv.DictReader(io.StringIO(visitor.get("/campaigns.csv")))
    assert (f"/campaigns/{row['campaign']}", row["label"], row["sensors"]) == (launched, "after eclipse", "2")
    assert row["launched_by"] == "Ada Analyst"
