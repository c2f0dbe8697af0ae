"""Campaigns and presets over REST: queued once, dry-run, followed, stopped, and a dry run of a run that foretells."""

import csv
import io
import re

import pytest

from boresight.console.campaigns import service
from boresight.console.fleet import service as sensors
from boresight.console.pages.tables import csv_file
from boresight.console.runs import presets
from boresight.console.runs.tables import Run
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document
from tests.console.campaigns import campaigns
from tests.sites import codes


def test_a_dry_run_foretells_the_sigmas_that_the_run_then_has(house):
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id, "settings": {"method": "batch"}, "validate_only": True}
    said = house.person("ada").post("/api/v1/runs", json=order).json()
    forecast = said["forecast"]
    assert forecast["sentence"].startswith("8 parameters, ")
    assert forecast["weak"] == sum(sigma > 0.5 for sigma in house.result["observability"]["sigma_of_direction"])
    for name, sigma in house.result["sigma"].items():
        assert forecast["sigma"][name] == pytest.approx(sigma, rel=0.1)
    low, high = said["predicted_range_s"]
    assert low <= said["predicted_s"] <= high


def test_a_campaign_is_launched_once_under_one_key_and_followed_where_it_says(house):
    client = house.key("ada", "runs")
    order = campaigns.launch(house)[1]
    assert house.key("ada", "telemetry-sets").post("/api/v1/campaigns", **order).status_code == 403
    first, second = (client.post("/api/v1/campaigns", **order, headers={"Idempotency-Key": "one"}) for _ in range(2))
    assert (first.status_code, second.json()) == (202, first.json())
    assert second.headers["idempotent-replayed"] == "true"
    read = client.get(first.headers["location"])
    assert (read.json()["state"], read.json()["counts"]["QUEUED"], read.json()["fraction"]) == ("UNDER WAY", 1, 0.0)
    lines = client.get(first.headers["location"] + "/results").json()["items"]
    run = client.get(f"/api/v1/runs/{lines[0]['run_id']}").json()
    assert (run["label"], run["state"]) == ("Monday", "QUEUED")


def test_a_dry_run_of_a_campaign_names_who_would_be_left_out(house):
    bare, ready = house.new_sensor(), house.ready_sensor()[0]
    order = campaigns.launch(house, sensors=[{"sensor_id": bare["id"]}, {"sensor_id": ready}], validate_only=True)[1]
    said = house.person("ada").post("/api/v1/campaigns", **order).json()
    assert (said["sensors"], said["runs"]) == (2, 1)
    why = f"{bare['name']} has no calibration set; upload one and launch it again."
    assert said["refused"] == [{"sensor_id": bare["id"], "sensor": bare["name"], "refusal": why}]


def test_a_preset_is_chosen_by_its_key_and_settings_go_over_its_own(house):
    number = campaigns.preset(house)[1]["preset_id"]
    _, options = campaigns.campaign(house, preset=str(number), settings={"minimum_stars": 5})
    read = house.person("victor").get(f"/api/v1/campaigns/{options['campaign_id']}").json()
    assert (read["settings"]["robust"], read["settings"]["minimum_stars"]) == ("huber", 5)
    assert read["preset"].endswith("version 1")


def test_cancelling_a_campaign_ends_its_runs_moves_its_tag_and_is_chained(house):
    _, options = campaigns.campaign(house)
    client, address = house.person("ada"), f"/api/v1/campaigns/{options['campaign_id']}"
    stopped = client.post(f"{address}:cancel", headers=options["headers"], json={"reason": "Monday is over."})
    assert (stopped.status_code, stopped.json()["state"]) == (200, "CANCELLED")
    assert stopped.headers["etag"] != options["headers"]["If-Match"]
    line = client.get(f"{address}/results").json()["items"][0]
    assert (line["state"], "Monday is over." in line["reason"]) == ("CANCELLED", True)
    assert client.post(f"{address}:cancel", headers={"If-Match": stopped.headers["etag"]}).status_code == 409
    found = client.get("/api/v1/audit/verification").json()
    assert found["ok"], found["sentence"]


def test_results_come_in_pages(house):
    sensors = [{"sensor_id": house.ready_sensor()[0]} for _ in range(3)]
    _, options = campaigns.campaign(house, sensors=sensors)
    client, address = house.person("victor"), f"/api/v1/campaigns/{options['campaign_id']}/results"
    first = client.get(address, params={"limit": 2}).json()
    second = client.get(address, params={"limit": 2, "cursor": first["next"]}).json()
    assert [line["sensor_id"] for line in (*first["items"], *second["items"])] == [one["sensor_id"] for one in sensors]
    assert second["next"] is None


def test_boresights_presets_come_first_and_archived_ones_only_where_asked(house):
    _, options = campaigns.preset(house)
    client = house.person("ada")
    listed = client.get("/api/v1/presets").json()["items"]
    client.post(f"/api/v1/presets/{options['preset_id']}:archive", headers=options["headers"])
    assert listed[0]["key"] == "first-calibration"
    assert listed[0]["id"] is None
    keys = [
        {one["key"] for one in client.get("/api/v1/presets", params=asked).json()["items"]}
        for asked in ({}, {"archived": True})
    ]
    assert str(options["preset_id"]) not in keys[0]
    assert str(options["preset_id"]) in keys[1]


NEWEST = dict.fromkeys(("calibration-1", "validation-1"), "newest")
FORM = {"sensors": ["1", "2"], "label": "after eclipse", "method": "batch", **NEWEST}


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


def test_the_form_begins_with_every_sensor_that_has_telemetry_on_its_newest_sets(site, bare, read):
    assert codes(site.visitor("victor").get("/campaigns")) == ["no-campaign"]
    page = site.visitor("ada").get("/campaigns/new?preset=drift-tracking")
    assert 'name="sensors" value="1" checked' in page
    assert f'name="sensors" value="{bare}">' in page
    assert "newest: TS-calibration" in read(page)
    assert "none: upload one first" in read(page)
    assert 'name="variant" value="q" checked' in page


def test_a_check_names_the_sensors_that_can_have_no_run_and_queues_nothing(site, bare, read):  # noqa: ARG001 - the second sensor is the one named
    answer = site.visitor("ada").post("/campaigns/new", **FORM, intent="check")
    text = read(answer.text)
    assert "1 of 2" in text
    assert "has no calibration set" in text
    assert 'value="after eclipse"' in answer.text
    with open_reading(site.engine) as session:
        assert service.list_campaigns(session) == []


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ({"label": ""}, "Give the campaign a label"),
        ({"sensors": []}, "at least one sensor"),
        ({"sensors": ["2"]}, "No run can be launched for any sensor of the campaign"),
        ({"minimum_stars": "many"}, "is not a whole number"),
        ({"calibration-1": "2", "validation-1": "2"}, "cannot validate a calibration that was made from it"),
    ],
)
def test_a_refusal_keeps_what_was_typed(site, bare, read, typed, said):  # noqa: ARG001 - the second sensor may be chosen
    answer = site.visitor("ada").post("/campaigns/new", **{**FORM, "sensors": ["1"], **typed}, intent="queue")
    assert answer.status_code == 422
    assert said in read(answer.text)
    if "minimum_stars" in typed:
        assert 'value="many"' in answer.text
    if "label" in typed:
        tried = site.visitor("ada").post("/campaigns/new", **{**FORM, **typed}, intent="check")
        assert (tried.status_code, said in read(tried.text)) == (200, True)


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
    assert re.search("2 of 2 ended, 2 failed", text)
    assert "No exposure has 4 usable matched stars." in text
    assert "has no calibration set" in text
    assert f"/runs/{number}" in page
    assert 'data-campaign="ended"' in page
    assert "after eclipse" in read(site.visitor("victor").get("/campaigns"))


def test_results_are_a_table_and_the_same_as_csv_in_radians(site, launched, read):
    summary = {"rms_initial_arc_rad": 1e-4, "rms_final_arc_rad": 2e-5, "weak_directions": 1}
    _end(site, "SUCCEEDED", summary={"level": "normal", "status": "converged", **summary})
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


def test_the_failed_are_launched_again_and_all_can_be_cancelled_but_by_no_viewer(site, launched, read):
    ada, victor = site.visitor("ada"), site.visitor("victor")
    for move in ("cancel", "launch-failed"):
        victor.post(f"{launched}/{move}")
    with open_reading(site.engine) as session:
        assert service.list_campaigns(session)[0].counts["QUEUED"] == 1
    _end(site, "LOST", "Its server went away.")
    ada.post(f"{launched}/launch-failed")
    assert "QUEUED 1" in read(ada.get(launched))
    ada.post(f"{launched}/cancel", reason="wrong set")
    text = read(ada.get(launched))
    assert "CANCELLED 1" in text
    assert "QUEUED 1" not in text


def test_presets_are_listed_with_what_they_change_and_archived_by_an_analyst(site, read):
    with open_writing(site.engine) as session:
        row = presets.save_preset(session, site.actor("ada"), "Mondays", "On Mondays.", {"robust": "huber"})
    ada = site.visitor("ada")
    assert "Loss Huber on arcs: limits the effect of false stars, only for comparison" in read(ada.get("/presets"))
    site.visitor("victor").post(f"/presets/{row.id}/archive")
    assert "Archived" not in read(ada.get("/presets"))
    ada.post(f"/presets/{row.id}/archive")
    assert "Archived" in read(ada.get("/presets"))


def test_the_list_of_campaigns_can_be_had_as_csv(site, launched):
    visitor = site.visitor("victor")
    assert 'href="/campaigns.csv?" download data-hotkey="e"' in visitor.get("/campaigns")
    (row,) = csv.DictReader(io.StringIO(visitor.get("/campaigns.csv")))
    assert (f"/campaigns/{row['campaign']}", row["label"], row["sensors"]) == (launched, "after eclipse", "2")
    assert row["launched_by"] == "Ada Analyst"
