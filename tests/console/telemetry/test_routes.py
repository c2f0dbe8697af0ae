"""Uploads: streamed, limited, refused with row and column, and nothing left behind."""

from __future__ import annotations

import csv
import dataclasses
import io
from pathlib import Path

import httpx
import numpy as np
import pytest

from boresight.console.runs.tables import Run
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.telemetry.writing import write_csv
from tests.served import PASSWORD, House, add_people, serving, settings_in
from tests.sites import codes


def _files_left(house: House) -> list[Path]:
    return list((house.app.state.settings.data_folder / "uploads").iterdir())


def test_an_upload_is_created_with_its_quality_report(house):
    sensor = house.new_sensor()
    answer = house.upload(house.person("ada"), sensor["id"], purpose="validation")
    body = answer.json()
    assert answer.status_code == 201
    assert answer.headers["location"] == f"/api/v1/telemetry-sets/{body['id']}"
    assert (body["sensor_id"], body["purpose"], body["name"]) == (sensor["id"], "validation", "telemetry.csv")
    assert body["frames"] == 30
    assert body["stars"] == body["quality"]["stars"]
    assert _files_left(house) == []


def test_the_bytes_come_back_as_they_were_uploaded(house):
    _, set_id = house.ready_sensor()
    answer = house.person("victor").get(f"/api/v1/telemetry-sets/{set_id}/file")
    assert answer.content == house.telemetry_csv
    assert 'filename="telemetry.csv"' in answer.headers["content-disposition"]


def test_an_image_under_another_name_is_told_that_centroids_are_read(house):
    answer = house.upload(
        house.person("ada"), house.new_sensor()["id"], b"SIMPLE  =    T".ljust(2880), file_name="a.csv"
    )
    assert answer.status_code == 422
    assert "FITS image" in answer.json()["detail"]
    assert "boresight extract" in answer.json()["detail"]
    assert _files_left(house) == []


@pytest.mark.parametrize(("row", "column"), [(4, "row_px"), (None, "col_px")], ids=["a word", "a missing column"])
def test_a_bad_file_is_refused_with_its_row_and_column(house, row, column):
    rows = list(csv.reader(io.StringIO(house.telemetry_csv.decode())))
    place = rows[0].index(column)
    if row is None:
        rows = [[*cells[:place], *cells[place + 1 :]] for cells in rows]
    else:
        rows[row - 1][place] = "twelve"
    content = "".join(",".join(row) + "\n" for row in rows).encode()
    sensor = house.new_sensor()
    answer = house.upload(house.person("ada"), sensor["id"], content)
    body = answer.json()
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert (row, column) in {(place["row"], place["column"]) for place in body["errors"]}
    listed = house.person("ada").get("/api/v1/telemetry-sets", params={"sensor_id": sensor["id"]})
    assert listed.json()["items"] == []
    assert _files_left(house) == []


@pytest.mark.parametrize(
    "content",
    [b"", b" \n", b"\xff\xfe\x00", b"PK\x03\x04", b"frame\n1\n", b"frame\n\xff\n", b"PAR1 and then nothing"],
)
def test_a_refused_file_is_called_what_its_sender_calls_it(house, content):
    answer = house.upload(
        house.person("ada"), house.new_sensor()["id"], content, file_name="C:\\downlink\\pass 7 (2).csv"
    )
    assert answer.status_code == 422
    assert answer.json()["detail"].startswith("pass 7 (2).csv")


def test_a_request_without_a_file_says_how_to_send_one(house):
    client = house.person("ada")
    wrong = client.post("/api/v1/telemetry-sets", json={"sensor_id": 1})
    empty = client.post("/api/v1/telemetry-sets", data={"sensor_id": "1"})
    two = client.post(
        "/api/v1/telemetry-sets", data={"sensor_id": "1"}, files=[("file", ("a.csv", b"a")), ("file", ("b.csv", b"b"))]
    )
    assert [answer.status_code for answer in (wrong, empty, two)] == [422, 422, 422]
    assert "multipart/form-data" in wrong.json()["detail"]
    assert two.json()["code"] == "one-file-at-a-time"


def test_an_upload_that_breaks_off_is_refused(house):
    half = b'--b\r\nContent-Disposition: form-data; name="file"; filename="t.csv"\r\n\r\nframe,exposure'
    answer = house.person("ada").post(
        "/api/v1/telemetry-sets", content=half, headers={"Content-Type": "multipart/form-data; boundary=b"}
    )
    assert answer.status_code == 422
    assert _files_left(house) == []


def test_an_upload_for_no_sensor_says_which_field(house):
    for sensor_id in ("one", "", "-1"):
        answer = house.upload(house.person("ada"), sensor_id)
        assert (answer.status_code, "sensor_id" in answer.json()["detail"]) == (422, True)
    assert house.upload(house.person("ada"), 987654).status_code == 404


def test_who_only_looks_may_not_upload(house):
    sensor = house.new_sensor()
    assert house.upload(house.person("victor"), sensor["id"]).status_code == 403
    assert house.upload(house.key("ada", "runs"), sensor["id"]).status_code == 403
    assert house.upload(house.key("ada", "telemetry-sets"), sensor["id"]).status_code == 201


def test_nothing_is_written_for_nobody(house, monkeypatch):
    def refuse(*_args: object) -> None:
        pytest.fail("a part of the body was taken")

    monkeypatch.setattr("boresight.console.telemetry.dependencies._Form", refuse)
    assert house.upload(house.anybody(), 1).status_code == 401


@pytest.mark.parametrize("announced", [True, False])
def test_a_file_over_the_limit_is_refused_while_it_is_read(tmp_path, announced):
    settings = settings_in(tmp_path, upload_limit_mb="1.5")
    add_people(settings)
    content = (
        b'--b\r\nContent-Disposition: form-data; name="file"; filename="t.csv"\r\n\r\n'
        + b"1,2\n" * 900_000
        + b"\r\n--b--\r\n"
    )
    with serving(settings) as (address, _), httpx.Client(base_url=address, timeout=60) as client:
        session = client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).json()
        headers = {"X-CSRF-Token": session["csrf_token"], "Content-Type": "multipart/form-data; boundary=b"}
        body = content if announced else iter([content[:2_000_000], content[2_000_000:]])
        answer = client.post("/api/v1/telemetry-sets", content=body, headers=headers)
        assert answer.status_code == 413
        assert "1.5 MB" in answer.json()["detail"]
        assert list((tmp_path / "uploads").iterdir()) == []


def test_a_copy_of_the_original_file_never_goes_out_of_date(house):
    _, set_id = house.ready_sensor()
    address, client = f"/api/v1/telemetry-sets/{set_id}/file", house.person("ada")
    tag = client.get(address).headers["etag"]
    for known in (tag, f"W/{tag}", f'"x", {tag}', "*"):
        again = client.get(address, headers={"If-None-Match": known})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert client.get(address, headers={"If-None-Match": '"x"'}).status_code == 200


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


def test_an_upload_leads_to_its_quality_report_and_a_scripted_one_is_told_where_to_go(site, table, read):
    visitor = site.visitor("ada")
    answer = upload(visitor, table)
    assert answer.status_code == 303
    scripted = upload(visitor, table, headers={"X-Boresight-Upload": "1"})  # the same bytes are the set that is there
    assert (scripted.status_code, scripted.headers["location"]) == (201, answer.headers["location"])
    page = visitor.get(answer.headers["location"])
    assert "pass.csv" in read(page)
    for title in ("Detector coverage", "Radial coverage", "Stars in an exposure", "Magnitudes", "Findings", "Origin"):
        assert title in read(page)
    assert "no-run-yet" in codes(page)


def test_lists_print_a_file_name_and_a_label_as_they_were_typed(site, table):
    name = "night 1,000 at -5.csv"
    upload(site.visitor("ada"), table, name)
    with open_writing(site.engine) as session:
        session.get(Run, 1).label = name
        session.get(Run, 1).telemetry_set_id = 3
        audit.append(session, COMMAND_LINE, "named", "runs/1")
    visitor = site.visitor("ada")
    assert f">{name}</a>" in visitor.get("/telemetry")
    page = visitor.get("/runs")
    assert page.count(f'title="{name}"') == page.count(f">{name}<") == 2  # the label's cell and the data's


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


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("content", "name", "fields", "sentence"),
    [
        (b"", "void.csv", {}, "void.csv is empty"),
        (b"a,b\n1,2\n", "columns.csv", {}, "columns.csv: column frame: the column is missing"),
        (b"TIME,STAR1_ROW,STAR1_COL\n2026-01-01T00:00:00Z,1,2\n", "wide.csv", {}, "import wide.csv --profile openc3 "),
        (b"PAR1", "cut.parquet", {}, "cut.parquet"),
        (b"x", "pass.csv", {"sensor_id": ""}, "Choose the sensor"),
        (b"x", "", {}, "No file was chosen"),
    ],
)
def test_what_is_no_telemetry_is_refused_in_one_sentence(site, read, content, name, fields, sentence):
    answer = upload(site.visitor("ada"), content, name, **fields)
    assert answer.status_code == 422
    assert sentence in read(answer.text)


def test_who_may_not_upload_reads_which_role_is_needed_and_nothing_comes_without_the_log_ins_token(site, table):
    visitor = site.visitor("victor")
    assert 'type="file"' not in visitor.get("/telemetry")
    assert upload(visitor, table).status_code == 403
    forged = upload(site.visitor("ada"), table, csrf_token="another", headers={"accept": "text/html"})
    assert forged.status_code == 403
    with open_reading(site.engine) as session:
        assert len(telemetry_sets.list_telemetry_sets(session)) == 2


def test_a_figures_numbers_add_up_to_the_usable_stars(site, table):
    visitor = site.visitor("ada")
    address = upload(visitor, table).headers["location"]
    rows = list(csv.reader(io.StringIO(visitor.get(f"{address}/figures/radial-coverage.csv"))))
    with open_reading(site.engine) as session:
        quality = session.get_known(TelemetrySet, int(address.rsplit("/", 1)[1])).quality
    assert sum(int(row[1]) for row in rows[1:]) == quality["usable"]
    assert visitor.send("GET", f"{address}/figures/nothing.csv").status_code == 404


def test_an_archived_set_leaves_the_list_until_it_is_asked_for(site, table, read):
    visitor = site.visitor("ada")
    address = upload(visitor, table).headers["location"]
    assert visitor.post(f"{address}/archive").status_code == 303
    listed = read(visitor.get("/telemetry")).split("Upload a set")[0]
    assert "pass.csv" not in listed.replace("pass.csv is archived", "")
    assert "archived" in read(visitor.get("/telemetry?archived=1"))
    for sensor in ("99", "99999999999"):
        assert 'class="empty"' in visitor.get(f"/telemetry?sensor={sensor}")


def test_the_runs_that_fitted_and_validated_with_a_set_are_its_lineage(site, table):
    visitor = site.visitor("ada")
    set_id = int(upload(visitor, table).headers["location"].rsplit("/", 1)[1])
    fitted = site.add_run(telemetry_set_id=set_id)
    judged = site.add_run(validation_set_id=set_id)
    lineage = visitor.get(f"/telemetry/{set_id}").split("Runs that used this telemetry set")[1]
    assert f"#{fitted}</a></th><td>calibration" in lineage
    assert f"#{judged}</a></th><td>validation" in lineage
