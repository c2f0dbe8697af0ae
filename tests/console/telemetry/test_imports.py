"""Mapping profiles over REST: versions that never change, a preview before anything is stored, and what the set remembers."""

import gzip
import hashlib
import re

from boresight.console.telemetry.tables import ImportProfile
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_writing, utc_now
from boresight.telemetry.imports.profile import parse_profile
from tests.telemetry.imports.conftest import VECTORS

PROFILE = {
    "name": "acme",
    "frames": {"column": "F"},
    "row": {"column": "Y", "origin": 1},
    "col": {"column": "X", "origin": 1},
}
TEXT = "F,X,Y\n2,31,41\n1,11,21\n1,51,61\n"


def save(client, **changes):
    return client.post("/api/v1/import-profiles", json={**PROFILE, **changes})


def upload(house, text=TEXT, *, sensor_id=None, query="", **fields):
    form = {"sensor_id": str(sensor_id or house.new_sensor()["id"]), **fields}
    files = {"file": ("stars.txt", text)}
    return house.person("ada").post(f"/api/v1/telemetry-sets{query}", data=form, files=files)


def test_a_name_has_versions_and_each_says_what_it_said(house):
    ada = house.person("ada")
    first = save(ada).json()
    assert (first["number"], first["sha256"]) == (1, parse_profile(PROFILE).sha256)
    assert save(ada).status_code == 409
    second = save(ada, description="another").json()
    assert second["number"] == 2
    assert ada.get(f"/api/v1/import-profiles/{first['id']}").json()["document"] == first["document"]
    listed = ada.get("/api/v1/import-profiles").json()["items"]
    assert {"contract", "tetra3"} <= {one["key"] for one in listed}
    assert [one["number"] for one in listed if one["name"] == "acme"] == [2, 1]
    assert save(ada, name="contract").status_code == 422
    assert save(ada, rows={}).status_code == 422
    assert save(house.person("victor")).status_code == 403


def test_a_preview_shows_rows_and_stores_nothing_and_the_import_remembers_file_and_profile(house):
    saved = save(house.person("ada"), name="mine").json()
    sensor_id = house.new_sensor()["id"]
    shown = upload(house, sensor_id=sensor_id, query="?validate_only=true", profile="mine")
    assert shown.status_code == 200
    rows = shown.json()["import_record"]["rows"]
    assert [(row["row"], row["telemetry"]["row_px"], row["source"]["Y"]) for row in rows] == [
        (3, 20, "21"),
        (4, 60, "61"),
        (2, 40, "41"),
    ]
    listed = house.person("ada").get(f"/api/v1/telemetry-sets?sensor_id={sensor_id}").json()["items"]
    assert listed == []
    made = upload(house, sensor_id=sensor_id, profile=saved["key"]).json()
    record = made["import_record"]
    assert record["profile"] == {"name": "mine", "version": saved["number"], "sha256": saved["sha256"]}
    assert made["source_sha256"] == record["sources"][0]["sha256"] == hashlib.sha256(TEXT.encode()).hexdigest()
    source = house.person("ada").get(f"/api/v1/telemetry-sets/{made['id']}/source")
    assert source.content == TEXT.encode()
    again = upload(house, sensor_id=sensor_id, profile=saved["key"]).json()
    assert again["id"] == made["id"]


def test_a_refused_import_names_row_and_column_of_the_file_and_leaves_nothing(house):
    sensor_id = house.new_sensor()["id"]
    save(house.person("ada"), name="refused")
    refused = upload(house, TEXT.replace("11", "x"), sensor_id=sensor_id, profile="refused")
    assert refused.status_code == 422
    fault = refused.json()["errors"][0]
    assert (fault["row"], fault["column"]) == (3, "X")
    assert upload(house, sensor_id=sensor_id, profile="nobody").status_code == 404
    assert house.person("ada").get(f"/api/v1/telemetry-sets?sensor_id={sensor_id}").json()["items"] == []


def test_a_file_of_another_program_becomes_a_set(house):
    files = {"file": ("img.axy", (VECTORS / "astrometry-net.axy").read_bytes())}
    form = {"sensor_id": str(house.new_sensor()["id"]), "profile": "astrometry-axy", "time": "2017-05-08T03:00:00Z"}
    made = house.person("ada").post("/api/v1/telemetry-sets", data=form, files=files)
    assert made.status_code == 201, made.text
    assert made.json()["stars"] == 40


def test_a_number_that_json_cannot_hold_is_not_saved_and_a_profile_that_is_read_no_more_takes_no_page_away(house):
    ada = house.person("ada")
    assert save(ada, name="endless", time={"column": "T", "offset_s": "nan"}).status_code == 422
    with open_writing(house.app.state.engine) as session:
        row = ImportProfile(
            name="outdated", number=1, document={"name": "outdated"}, sha256="0" * 64, created_utc=utc_now()
        )
        session.put(row)
        audit.append(session, SYSTEM, "saved", f"import-profiles/{row.id}")
        profile_id = row.id
    offered = re.compile(rf'<option value="{profile_id}"[^>]*>outdated')
    for page in ("/telemetry", "/import-profiles"):
        shown = ada.get(page)
        assert shown.status_code == 200
        assert not offered.search(shown.text)
    token = {"csrf_token": ada.headers["X-CSRF-Token"]}
    assert ada.post(f"/import-profiles/{profile_id}/archive", data=token).status_code == 303


def test_a_table_of_another_program_is_led_to_the_profile_that_imports_it(house):
    sensor_id, vector = house.new_sensor()["id"], VECTORS / "photutils.ecsv"
    refused = upload(house, vector.read_bytes(), sensor_id=sensor_id)
    assert refused.status_code == 422
    fault = refused.json()["errors"][0]
    assert (fault["column"], "photutils" in fault["detail"]) == ("profile", True)
    shown = upload(house, vector.read_bytes(), sensor_id=sensor_id, query="?validate_only=true", profile="photutils")
    assert shown.status_code == 200, shown.json()
    unnamed = upload(house, "0 1.5 2.5\n0 3.5 4.5\n", sensor_id=sensor_id)
    assert unnamed.status_code == 422
    assert "header" in unnamed.json()["detail"]
    assert house.person("ada").get(f"/api/v1/telemetry-sets?sensor_id={sensor_id}").json()["items"] == []


def test_tables_compressed_by_gzip_are_kept_as_they_came(house):
    sensor_id, packed = house.new_sensor()["id"], gzip.compress(TEXT.encode(), mtime=0)
    save(house.person("ada"), name="packed")
    made = upload(house, packed, sensor_id=sensor_id, profile="packed")
    assert made.status_code == 201, made.json()
    assert made.json()["source_sha256"] == hashlib.sha256(packed).hexdigest()
    plain = gzip.compress(b"frame,exposure,row_px,col_px\n0,0,1.5,2.5\n", mtime=0)
    form, files = {"sensor_id": str(sensor_id)}, {"file": ("pass.csv.gz", plain)}
    whole = house.person("ada").post("/api/v1/telemetry-sets", data=form, files=files)
    assert (whole.status_code, whole.json()["stars"]) == (201, 1)
    assert house.person("ada").get(f"/api/v1/telemetry-sets/{whole.json()['id']}/file").content == plain
