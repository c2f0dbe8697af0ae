"""The list of telemetry sets, uploading one, and its quality report."""

import csv
import dataclasses
import io

import numpy as np
import pytest

from boresight.console.telemetry import service as telemetry_sets
from boresight.platform.db.sessions import open_reading
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.telemetry.read.readers import write_csv


@pytest.fixture(scope="module")
def table(tmp_path_factory, catalogue) -> bytes:
    scenario = dataclasses.replace(calibration_scenario(1), frames=20)
    path = tmp_path_factory.mktemp("telemetry") / "pass.csv"
    write_csv(simulate(scenario, np.random.default_rng(3), catalogue), path)
    return path.read_bytes()


@pytest.fixture
def site(site, catalogue):
    site.app.state.catalogue = lambda: catalogue
    return site


def upload(visitor, content, name="pass.csv", headers=None, **fields):
    data = {"csrf_token": visitor.csrf_token, "sensor_id": "1", "purpose": "calibration", **fields}
    return visitor.send("POST", "/telemetry", data=data, files={"file": (name, content)}, headers=headers)


def test_an_upload_leads_to_its_quality_report(site, table, read):
    visitor = site.visitor("ada")
    answer = upload(visitor, table)
    assert answer.status_code == 303
    page = visitor.get(answer.headers["location"])
    assert "pass.csv" in read(page)
    for title in ("Detector coverage", "Radial coverage", "Stars in an exposure", "Magnitudes", "Findings", "Origin"):
        assert title in read(page)
    assert "No run has used this set yet." in read(page)


def test_a_scripted_upload_is_told_where_to_go_and_follows_nothing(site, table):
    answer = upload(site.visitor("ada"), table, headers={"X-Boresight-Upload": "1"})
    assert answer.status_code == 201
    assert answer.headers["location"].startswith("/telemetry/")


def test_the_same_bytes_again_are_the_set_that_is_there(site, table):
    visitor = site.visitor("ada")
    assert upload(visitor, table).headers["location"] == upload(visitor, table).headers["location"]


def test_a_refused_file_shows_row_and_column_and_keeps_the_choices(site, table, read):
    lines = list(csv.reader(io.StringIO(table.decode())))
    lines[4][lines[0].index("row_px")] = "wide"
    answer = upload(site.visitor("ada"), "\n".join(map(",".join, lines)).encode(), purpose="validation")
    assert answer.status_code == 422
    assert "5 row_px" in read(answer.text)
    assert '<option value="1" selected>' in answer.text
    assert 'value="validation" checked' in answer.text
    with open_reading(site.engine) as session:
        assert len(telemetry_sets.list_telemetry_sets(session)) == 2


@pytest.mark.parametrize(
    ("content", "name", "fields", "sentence"),
    [
        (b"", "void.csv", {}, "void.csv is empty"),
        (b"a,b\n1,2\n", "columns.csv", {}, "columns.csv: column frame: the column is missing"),
        (b"PAR1", "cut.parquet", {}, "cut.parquet"),
        (b"x", "pass.csv", {"sensor_id": ""}, "Choose the sensor"),
        (b"x", "", {}, "No file was chosen"),
    ],
)
def test_what_is_no_telemetry_is_refused_in_one_sentence(site, read, content, name, fields, sentence):
    answer = upload(site.visitor("ada"), content, name, **fields)
    assert answer.status_code == 422
    assert sentence in read(answer.text)


def test_an_upload_without_this_log_ins_token_is_refused(site, table):
    answer = upload(site.visitor("ada"), table, csrf_token="another", headers={"accept": "text/html"})
    assert answer.status_code == 403
    with open_reading(site.engine) as session:
        assert len(telemetry_sets.list_telemetry_sets(session)) == 2


def test_who_may_not_upload_reads_which_role_is_needed(site, table):
    visitor = site.visitor("victor")
    assert 'type="file"' not in visitor.get("/telemetry")
    assert upload(visitor, table).status_code == 403


def test_a_figures_numbers_add_up_to_the_usable_stars(site, table):
    visitor = site.visitor("ada")
    address = upload(visitor, table).headers["location"]
    rows = list(csv.reader(io.StringIO(visitor.get(f"{address}/figures/radial-coverage.csv"))))
    with open_reading(site.engine) as session:
        quality = telemetry_sets.get_telemetry_set(session, int(address.rsplit("/", 1)[1])).quality
    assert sum(int(row[1]) for row in rows[1:]) == quality["usable"]
    assert visitor.send("GET", f"{address}/figures/nothing.csv").status_code == 404


def test_an_archived_set_leaves_the_list_until_it_is_asked_for(site, table, read):
    visitor = site.visitor("ada")
    address = upload(visitor, table).headers["location"]
    assert visitor.post(f"{address}/archive").status_code == 303
    listed = read(visitor.get("/telemetry")).split("Upload a set")[0]
    assert "pass.csv" not in listed.replace("pass.csv is archived", "")
    assert "archived" in read(visitor.get("/telemetry?archived=1"))


@pytest.mark.parametrize("sensor", ["99", "99999999999"])
def test_filters_that_fit_nothing_offer_to_show_everything(site, sensor):
    assert 'class="empty"' in site.visitor("victor").get(f"/telemetry?sensor={sensor}")


def test_the_runs_that_fitted_and_validated_with_a_set_are_its_lineage(site, table):
    visitor = site.visitor("ada")
    set_id = int(upload(visitor, table).headers["location"].rsplit("/", 1)[1])
    fitted = site.add_run(telemetry_set_id=set_id)
    judged = site.add_run(validation_set_id=set_id)
    lineage = visitor.get(f"/telemetry/{set_id}").split("Runs that used this set")[1]
    assert f"#{fitted}</a></th><td>fit" in lineage
    assert f"#{judged}</a></th><td>validate" in lineage
