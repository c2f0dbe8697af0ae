"""A set that does not match is diagnosed as it is uploaded, or when asked; what mends it is accepted on its page."""

import csv
import io

import pytest

from boresight.console.telemetry.service import mend_document
from tests.served import House


def _without_names(house: House, **exchanged: str) -> bytes:
    """The telemetry of the house without names and attitudes, some columns under the names of others."""
    rows = list(csv.reader(io.StringIO(house.telemetry_csv.decode())))
    kept = [place for place, name in enumerate(rows[0]) if name != "star_id" and not name.startswith("q_")]
    names = [exchanged.get(rows[0][place], rows[0][place]) for place in kept]
    lines = [names, *([row[place] for place in kept] for row in rows[1:])]
    return "".join(",".join(line) + "\n" for line in lines).encode()


@pytest.fixture(autouse=True)
def patience(house):
    """The first diagnosis of a server makes a table of star patterns and loads compiled loops."""
    house.person("ada").timeout = 120.0


@pytest.fixture
def exchanged(house):
    """A stored set whose rows and columns are exchanged, and its document."""
    content = _without_names(house, row_px="col_px", col_px="row_px")
    answer = house.upload(house.person("ada"), house.new_sensor()["id"], content)
    assert answer.status_code == 201, answer.text
    return answer.json()


def test_a_set_without_names_is_diagnosed_as_it_is_uploaded_and_stored_anew_as_it_is_to_be_read(house, exchanged):
    ada = house.person("ada")
    diagnosis = exchanged["quality"]["diagnosis"]
    assert diagnosis["causes"][0]["name"] == "swapped_axes"
    assert diagnosis["sentence"] in exchanged["quality"]["warnings"]
    page = f"/telemetry/{exchanged['id']}"
    assert 'id="diagnosis"' in ada.get(page).text
    form = {"csrf_token": ada.headers["X-CSRF-Token"]}
    accepted = ada.post(f"{page}/accept-mapping", data=form, headers={"Accept": "text/html"})
    assert accepted.status_code == 303, accepted.text
    number = int(accepted.headers["location"].rsplit("/", 1)[1].split("?")[0])
    mended = ada.get(f"/api/v1/telemetry-sets/{number}").json()
    assert mended["id"] != exchanged["id"]
    assert [cause["name"] for cause in mended["quality"]["diagnosis"]["causes"]] == ["none"]
    assert {"NO_MATCHES", "FEW_STARS"} & {one["code"] for one in mended["quality"]["findings"]} == set()
    run = {"sensor_id": mended["sensor_id"], "telemetry_set_id": number, "settings": {}}
    dry = ada.post("/api/v1/runs", params={"validate_only": "true"}, json=run).json()
    assert not any("arcs for" in sentence for sentence in dry["warnings"])


def test_the_sensor_is_mended_by_who_saw_its_version(house):
    ada, sensor = house.person("ada"), house.new_sensor()
    document = sensor["document"]
    wrong = document | {"initial": document["initial"] | {"f_m": 1.4 * document["initial"]["f_m"]}}
    edited = ada.put(f"/api/v1/sensors/{sensor['id']}", json=wrong, headers={"If-Match": f'"v{sensor["version"]}"'})
    assert edited.status_code == 200, edited.text
    number = house.upload(ada, sensor["id"], keep_here="1").json()["id"]  # other sensors have the right one
    before = ada.get(f"/api/v1/telemetry-sets/{number}").headers["etag"]
    answer = ada.post(f"/api/v1/telemetry-sets/{number}:diagnose")
    assert answer.status_code == 200, answer.text
    assert answer.json()["quality"]["diagnosis"]["causes"][0]["name"] == "focal_length"
    assert answer.headers["etag"] != before
    page, token = f"/telemetry/{number}", ada.headers["X-CSRF-Token"]
    stale = ada.post(f"{page}/accept-sensor", data={"csrf_token": token, "version": str(sensor["version"])})
    assert stale.status_code == 412
    form = {"csrf_token": token, "version": str(edited.json()["version"])}
    assert ada.post(f"{page}/accept-sensor", data=form).status_code == 303
    mended = ada.get(f"/api/v1/sensors/{sensor['id']}").json()["document"]
    assert mended["initial"]["f_m"] == pytest.approx(document["initial"]["f_m"], rel=0.01)
    assert {**mended, "initial": 0} == {**document, "initial": 0}
    assert ada.get(f"{page}/mended-sensor.json").json()["initial"] == mended["initial"]


@pytest.mark.full
def test_a_mirrored_sensor_is_registered_as_it_is_under_another_name_with_its_set(house):
    ada, sensor = house.person("ada"), house.new_sensor()
    mirrored = sensor["document"] | {"name": f"{sensor['name']} turned", "parity": -sensor["document"]["parity"]}
    turned = ada.post("/api/v1/sensors", json=mirrored).json()
    stored = house.upload(ada, turned["id"], _without_names(house), keep_here="1").json()
    page, form = f"/telemetry/{stored['id']}", {"csrf_token": ada.headers["X-CSRF-Token"]}
    assert (
        ada.post(f"/api/v1/telemetry-sets/{stored['id']}:diagnose").json()["quality"]["diagnosis"]["causes"][0]["name"]
        == "parity"
    )
    assert f'action="{page}/accept-as-new-sensor"' in ada.get(page).text
    assert ada.post(f"{page}/accept-sensor", data={**form, "version": "1"}).status_code == 422
    assert ada.post(f"{page}/accept-as-new-sensor", data={**form, "name": turned["name"]}).status_code == 409
    assert house.person("victor").post(f"{page}/accept-as-new-sensor", data={**form, "name": "x"}).status_code == 403
    made = ada.post(f"{page}/accept-as-new-sensor", data={**form, "name": f"{turned['name']} upright"})
    assert made.status_code == 303, made.text
    number = int(made.headers["location"].rsplit("/", 1)[1].split("?")[0])
    moved = ada.get(f"/api/v1/telemetry-sets/{number}").json()
    document = ada.get(f"/api/v1/sensors/{moved['sensor_id']}").json()["document"]
    assert document == mirrored | {"name": f"{turned['name']} upright", "parity": sensor["document"]["parity"]}
    assert moved["original_sha256"] == stored["original_sha256"]
    assert [one["name"] for one in moved["quality"]["diagnosis"]["causes"]] == ["none"]


def test_nobody_but_an_analyst_has_a_set_diagnosed_and_nothing_unknown_is_accepted(house):
    _, number = house.ready_sensor()
    assert house.person("victor").post(f"/api/v1/telemetry-sets/{number}:diagnose").status_code == 403
    ada = house.person("ada")
    form = {"csrf_token": ada.headers["X-CSRF-Token"], "version": "1", "name": "x"}
    for step in ("accept-sensor", "accept-mapping", "accept-as-new-sensor"):
        assert ada.post(f"/telemetry/{number}/{step}", data=form).status_code == 409
    assert ada.get(f"/telemetry/{number}/mended-sensor.json").status_code == 409


def test_of_a_sensor_only_what_is_named_is_mended():
    class Found:
        names = ("focal_length",)
        sensor_document = {"parity": -1, "initial": {"f_m": 2.0}, "magnitude_limit": 7.0}  # noqa: RUF012 - of one test

    document = {"parity": 1, "initial": {"f_m": 1.0}, "magnitude_limit": 5.0, "name": "x"}
    assert mend_document(document, Found()) == document | {"initial": {"f_m": 2.0}}
