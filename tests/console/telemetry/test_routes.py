"""Uploads: streamed, limited, refused with row and column, and nothing left behind."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.served import PASSWORD, House, add_people, serving, settings_in

Spoil = Callable[[list[list[str]]], None]


def _files_left(house: House) -> list[Path]:
    return list((house.app.state.settings.data_folder / "uploads").iterdir())


def test_an_upload_is_created_with_its_quality_report(house: House) -> None:
    sensor = house.new_sensor()
    answer = house.upload(house.person("ada"), sensor["id"], purpose="validation")
    body = answer.json()
    assert answer.status_code == 201
    assert answer.headers["location"] == f"/api/v1/telemetry-sets/{body['id']}"
    assert (body["sensor_id"], body["purpose"], body["name"]) == (sensor["id"], "validation", "telemetry.csv")
    assert body["frames"] == 30
    assert body["stars"] == body["quality"]["stars"]
    assert _files_left(house) == []


def test_the_bytes_come_back_as_they_were_uploaded(house: House) -> None:
    _, set_id = house.ready_sensor()
    answer = house.person("victor").get(f"/api/v1/telemetry-sets/{set_id}/file")
    assert answer.content == house.telemetry_csv
    assert 'filename="telemetry.csv"' in answer.headers["content-disposition"]


def test_the_same_bytes_again_are_the_set_that_is_there(house: House) -> None:
    sensor_id, set_id = house.ready_sensor()
    assert house.upload(house.person("ada"), sensor_id).json()["id"] == set_id


def test_an_uploaded_image_is_told_that_centroids_are_read(house: House) -> None:
    answer = house.upload(
        house.person("ada"), house.new_sensor()["id"], b"SIMPLE  =    T".ljust(2880), file_name="a.fits"
    )
    assert answer.status_code == 422
    assert "FITS image" in answer.json()["detail"]
    assert "centroids, not images" in answer.json()["detail"]
    assert _files_left(house) == []


def _with_text(rows: list[list[str]]) -> None:
    rows[3][rows[0].index("row_px")] = "twelve"


def _without_column(rows: list[list[str]]) -> None:
    k = rows[0].index("col_px")
    for row in rows:
        del row[k]


SPOILT: list[tuple[str, Spoil, int | None, str]] = [
    ("text in a number", _with_text, 4, "row_px"),
    ("a missing column", _without_column, None, "col_px"),
]


@pytest.mark.parametrize(("what", "spoil", "row", "column"), SPOILT)
def test_a_bad_file_is_refused_with_its_row_and_column(
    house: House, what: str, spoil: Spoil, row: int | None, column: str
) -> None:
    rows = list(csv.reader(io.StringIO(house.telemetry_csv.decode())))
    spoil(rows)
    content = "".join(",".join(row) + "\n" for row in rows).encode()
    sensor = house.new_sensor()
    answer = house.upload(house.person("ada"), sensor["id"], content)
    body = answer.json()
    assert answer.status_code == 422, what
    assert answer.headers["content-type"] == "application/problem+json"
    assert (row, column) in {(place["row"], place["column"]) for place in body["errors"]}
    listed = house.person("ada").get("/api/v1/telemetry-sets", params={"sensor_id": sensor["id"]})
    assert listed.json()["items"] == []
    assert _files_left(house) == []


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"PAR1 and then nothing"])
def test_what_is_no_telemetry_is_refused_in_a_sentence(house: House, content: bytes) -> None:
    name = "telemetry.parquet" if content.startswith(b"PAR1") else "telemetry.csv"
    answer = house.upload(house.person("ada"), house.new_sensor()["id"], content, file_name=name)
    assert answer.status_code == 422
    assert answer.json()["detail"].endswith(".")


@pytest.mark.parametrize("content", [b"", b" \n", b"\xff\xfe\x00", b"PK\x03\x04", b"frame\n1\n", b"frame\n\xff\n"])
def test_a_refused_file_is_called_what_its_sender_calls_it(house: House, content: bytes) -> None:
    answer = house.upload(
        house.person("ada"), house.new_sensor()["id"], content, file_name="C:\\downlink\\pass 7 (2).csv"
    )
    assert answer.status_code == 422
    assert answer.json()["detail"].startswith("pass 7 (2).csv")


def test_a_request_without_a_file_says_how_to_send_one(house: House) -> None:
    client = house.person("ada")
    wrong = client.post("/api/v1/telemetry-sets", json={"sensor_id": 1})
    empty = client.post("/api/v1/telemetry-sets", data={"sensor_id": "1"})
    two = client.post(
        "/api/v1/telemetry-sets", data={"sensor_id": "1"}, files=[("file", ("a.csv", b"a")), ("file", ("b.csv", b"b"))]
    )
    assert [answer.status_code for answer in (wrong, empty, two)] == [422, 422, 422]
    assert "multipart/form-data" in wrong.json()["detail"]
    assert "One file at a time" in two.json()["detail"]


def test_an_upload_that_breaks_off_is_refused(house: House) -> None:
    half = b'--b\r\nContent-Disposition: form-data; name="file"; filename="t.csv"\r\n\r\nframe,exposure'
    answer = house.person("ada").post(
        "/api/v1/telemetry-sets", content=half, headers={"Content-Type": "multipart/form-data; boundary=b"}
    )
    assert answer.status_code == 422
    assert _files_left(house) == []


@pytest.mark.parametrize("sensor_id", ["one", "", "-1"])
def test_an_upload_for_no_sensor_says_which_field(house: House, sensor_id: Any) -> None:
    answer = house.upload(house.person("ada"), sensor_id)
    assert answer.status_code == 422
    assert "sensor_id" in answer.json()["detail"]


def test_an_upload_for_an_unknown_sensor_is_not_found(house: House) -> None:
    assert house.upload(house.person("ada"), 987654).status_code == 404


def test_who_only_looks_may_not_upload(house: House) -> None:
    sensor = house.new_sensor()
    assert house.upload(house.person("victor"), sensor["id"]).status_code == 403
    assert house.upload(house.key("ada", "runs"), sensor["id"]).status_code == 403
    assert house.upload(house.key("ada", "telemetry-sets"), sensor["id"]).status_code == 201


def test_nothing_is_written_for_nobody(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_args: object) -> None:
        pytest.fail("a part of the body was taken")

    monkeypatch.setattr("boresight.console.telemetry.dependencies._Form", refuse)
    assert house.upload(house.anybody(), 1).status_code == 401


@pytest.mark.parametrize("announced", [True, False])
def test_a_file_over_the_limit_is_refused_while_it_is_read(tmp_path: Path, announced: bool) -> None:
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
        assert "limit of 1.5 MB" in answer.json()["detail"]
        assert list((tmp_path / "uploads").iterdir()) == []


def test_archived_sets_are_listed_only_when_asked(house: House) -> None:
    sensor_id, set_id = house.ready_sensor()
    client = house.person("ada")
    seen = {"If-Match": client.get(f"/api/v1/telemetry-sets/{set_id}").headers["etag"]}
    assert client.post(f"/api/v1/telemetry-sets/{set_id}:archive", headers=seen).json()["archived_utc"]
    params = {"sensor_id": sensor_id}
    assert client.get("/api/v1/telemetry-sets", params=params).json()["items"] == []
    found = client.get("/api/v1/telemetry-sets", params={**params, "archived": True}).json()["items"]
    assert [row["id"] for row in found] == [set_id]


def test_a_copy_of_the_original_file_never_goes_out_of_date(house: House) -> None:
    _, set_id = house.ready_sensor()
    address, client = f"/api/v1/telemetry-sets/{set_id}/file", house.person("ada")
    tag = client.get(address).headers["etag"]
    for known in (tag, f"W/{tag}", f'"x", {tag}', "*"):
        again = client.get(address, headers={"If-None-Match": known})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert client.get(address, headers={"If-None-Match": '"x"'}).status_code == 200
