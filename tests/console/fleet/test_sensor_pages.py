"""The list of sensors, registering one, and a sensor's page."""

import html
import io
import json
import math
import re
import shutil
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import csv as pa_csv
from sqlalchemy import func, select

from boresight.calibration.advice_kinds import ADVICE_KINDS
from boresight.cameras import CAMERA_MODELS
from boresight.console import list_queries as lists
from boresight.console.fleet import queries as sensor_queries
from boresight.console.fleet import service as sensors
from boresight.console.fleet.pages.sensor import baseline_values
from boresight.console.fleet.pages.sensors import EXAMPLE, FIELDS, compute_optics, read_document
from boresight.console.fleet.service import MOST_CHOICES
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import (
    ConflictError,
    ForbiddenError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
)
from boresight.library.results import tabulate
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_now
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.telemetry.sensors import parse_sensor
from tests.refusals import has_code
from tests.sites import codes, put_documentation
from tests.stores import open_migrated, url_in


def test_the_documented_example_registers_as_it_is(site, read):
    visitor = site.visitor("ada")
    page = visitor.get("/sensors?example=1")
    assert "ST16-7" in page
    answer = visitor.post("/sensors", document=EXAMPLE)
    assert answer.status_code == 303
    assert "Baseline PS-ST16-7-0" in read(visitor.get(answer.headers["location"]))


def test_every_field_of_the_example_is_explained():
    assert set(json.loads(EXAMPLE)) <= {name for name, _ in FIELDS}
    assert parse_sensor(read_document(EXAMPLE)).camera_model == "inverted_wang"


def test_a_few_numbers_make_a_sensor_file_that_registers_with_its_field_drawn(site, read):
    visitor = site.visitor("ada")
    address = "/sensors?name=Tripod&rows=768&columns=1024&pixel_pitch_um=6.9&focal_length_mm=35&latitude_deg=52.2&longitude_deg=4.4"
    page = visitor.get(f"{address}&parity=-1&describe=1")
    assert "1\u202f024 by 768" in page
    assert "upright image" in page
    text = html.unescape(re.search(r'<textarea id="document"[^>]*>(.*?)</textarea>', page, re.DOTALL)[1])
    assert json.loads(text)["site"] == {"latitude_deg": 52.2, "longitude_deg": 4.4}
    answer = visitor.post("/sensors", document=text)
    assert answer.status_code == 303
    assert "Baseline PS-Tripod-0" in read(visitor.get(answer.headers["location"]))
    assert "mirrored image" in visitor.get(f"{address}&parity=1&describe=1")


def test_every_fault_of_the_numbers_is_told_beside_what_was_typed(site):
    page = site.visitor("ada").get("/sensors?rows=many&columns=5&pixel_pitch_um=3&sheet=&latitude_deg=95&describe=1")
    assert page.count('class="fault"') >= 4
    assert page.count('aria-describedby="describe-faults"') >= 3
    assert 'value="many"' in page
    assert '<svg class="plot sketch"' not in page


def stars_of(catalogue, name="t.csv"):
    """A tracker's centroids without names as a file, and the tracker."""
    scenario = calibration_scenario(1, 8)
    stars = simulate(scenario, np.random.default_rng(1), catalogue)
    stream = io.BytesIO()
    pa_csv.write_csv(tabulate(stars).select(["frame", "exposure", "row_px", "col_px", "magnitude"]), stream)
    return {"file": (name, stream.getvalue())}, scenario.sensor


def counts(site):
    """Rows of every table that something could be stored in."""
    with open_reading(site.engine) as session:
        return [
            session.scalar(select(func.count()).select_from(table))
            for table in (Sensor, TelemetrySet, AuditRecord, Blob)
        ]


def test_uploaded_stars_fill_the_form_and_store_nothing(site, catalogue, catalogue_folder):
    own = site.settings.catalogue_folder
    shutil.rmtree(own, ignore_errors=True)
    own.symlink_to(catalogue_folder)  # with the tables that other tests have made
    files, truth = stars_of(catalogue)
    visitor, before = site.visitor("ada"), counts(site)
    form = {
        "csrf_token": visitor.csrf_token,
        "rows": "1944",
        "columns": "2592",
        "pixel_pitch_um": "2.2",
        "name": "Found",
    }
    answer = visitor.send("POST", "/sensors/propose", data=form, files=files)
    assert answer.status_code == 200, answer.text
    typed = dict(re.findall(r'id="new-(\w+)" name="\w+"[^>]*? value="([^"]*)"', answer.text))
    assert float(typed["focal_length_mm"]) == pytest.approx(1e3 * truth.initial[0], rel=0.01)
    assert (typed["rows"], typed["columns"], typed["pixel_pitch_um"]) == ("1944", "2592", "2.2")
    text = html.unescape(re.search(r'<textarea id="document"[^>]*>(.*?)</textarea>', answer.text, re.DOTALL)[1])
    assert json.loads(text)["parity"] == truth.parity
    assert counts(site) == before
    assert list((site.settings.data_folder / "uploads").iterdir()) == []
    assert visitor.post("/sensors", document=text).status_code == 303


def test_stars_that_cannot_be_solved_and_people_who_may_not_register_are_refused(site, catalogue):
    visitor = site.visitor("ada")
    form = {"csrf_token": visitor.csrf_token, "rows": "many"}
    answer = visitor.send("POST", "/sensors/propose", data=form, files=stars_of(catalogue)[0])
    assert answer.status_code == 422
    assert 'value="many"' in answer.text
    assert visitor.send("POST", "/sensors/propose", data=form).status_code in {415, 422}
    form = {"csrf_token": "another's"}
    assert visitor.send("POST", "/sensors/propose", data=form, files=stars_of(catalogue)[0]).status_code == 403
    viewer = site.visitor("victor")
    form = {"csrf_token": viewer.csrf_token}
    assert viewer.send("POST", "/sensors/propose", data=form, files=stars_of(catalogue)[0]).status_code == 403


def test_a_refused_sensor_keeps_the_text_and_names_every_fault(site, read):
    text = EXAMPLE.replace("2.2e-6", "2.2").replace('"parity": 1', '"parity": 7') + "   "
    answer = site.visitor("ada").post("/sensors", document=text)
    assert answer.status_code == 422
    assert "pixel_pitch_m" in read(answer.text)
    assert "parity" in read(answer.text)
    assert re.search(r'<textarea[^>]*aria-invalid="true"', answer.text)
    assert answer.text.count('class="fault"') == 2
    assert "&#34;parity&#34;: 7" in answer.text


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "There is no sensor file"),
        ('{"name": "A",\n oops}', "This is not JSON at line 2"),
        ("[1, 2]", "one JSON object"),
        ("[" * 100_000, "nested too deep"),
    ],
)
def test_what_is_no_sensor_file_is_refused_in_one_sentence(site, read, text, sentence):
    answer = site.visitor("ada").post("/sensors", document=text)
    assert answer.status_code == 422
    assert sentence in read(answer.text)


def test_a_chosen_file_counts_before_typed_text(site):
    visitor = site.visitor("ada")
    files = {"file": ("tracker.json", EXAMPLE.replace("ST16-7", "FROM-FILE"), "application/json")}
    data = {"csrf_token": visitor.csrf_token, "document": "{}"}
    assert visitor.send("POST", "/sensors", data=data, files=files).status_code == 303
    with open_reading(site.engine) as session:
        assert "FROM-FILE" in {row.name for row in sensor_queries.list_sensors(session)}


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "PNG image"), ('{"name": "é"}'.encode("latin-1"), "UTF-8")],
)
@pytest.mark.parametrize("page", ["/sensors", "/sensors/1/table-definition"])
def test_a_chosen_file_that_is_no_text_is_called_what_it_is(site, read, page, content, words):
    visitor = site.visitor("ada")
    files = {"file": ("tracker.json", content, "application/json")}
    answer = visitor.send("POST", page, data={"csrf_token": visitor.csrf_token, "document": ""}, files=files)
    assert answer.status_code == 422
    assert words in read(answer.text)


def test_the_parameters_stand_in_model_order_with_the_truth_of_a_simulated_sensor(site):
    page = site.visitor("victor").get("/sensors/1")
    table = page[page.index("Parameters of the baseline") :].split("</table>")[0]
    assert re.findall(r'<code class="quiet">(\w+)</code>', table) == [
        "f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y",
    ]  # fmt: skip
    assert "Truth" in table
    assert ("± σ" in table, "Typical σ" in table) == (False, True)  # of a ground calibration nothing is measured


def test_a_calibrated_baseline_shows_its_sigma_and_its_change_from_the_ground(site):
    with open_writing(site.engine) as session:
        made = parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 1)
        ground = set_queries.find_baseline(session, 1)
        ground.ground_state = "SUPERSEDED"
        session.flush()
        session.get_one(ParameterSet, made.id).ground_state = "BASELINE"
    table = site.visitor("victor").get("/sensors/1").split("Parameters of the baseline")[1].split("</table>")[0]
    assert "± σ" in table
    assert "Change" in table


def test_a_sensor_shows_what_is_declared_and_what_is_not(site, read):
    ada = site.visitor("ada")
    undeclared = json.loads(EXAMPLE) | {"name": "plain", "readout": None, "declared": {"directions": "j2000"}}
    address = ada.post("/sensors", document=json.dumps(undeclared)).headers["location"]
    text = read(ada.get(address))
    assert "Readout not declared" in text
    assert re.search("Directions of the telemetry j2000: [^,]*, [^:]*, where the file gives them", text)
    registered = read(ada.get(ada.post("/sensors", document=EXAMPLE).headers["location"]))
    assert "Readout rolling shutter, corrected in the telemetry" in registered
    assert "Refraction by the air none" in registered
    assert "not declared" not in registered


def test_values_are_the_sensor_files_where_there_is_no_baseline(site):
    with open_reading(site.engine) as session:
        sensor = session.get_known(Sensor, 1)
        assert {it.name: it.value for it in baseline_values(sensor, None)} == sensor.document["initial"]


def test_the_field_of_view_follows_from_f_and_the_detector():
    camera, detector = CAMERA_MODELS["pinhole_radial"], {"rows": 1000, "columns": 2000, "pixel_pitch_m": 1e-5}
    x = dict(zip(camera.parameter_names, camera.plain(1000.0, 499.5, 999.5, 1e-5).tolist(), strict=True))
    optics = compute_optics(camera, detector, x)
    assert optics.columns_deg == pytest.approx(2 * math.degrees(math.atan(1.0)))
    assert optics.pixel_urad == pytest.approx(1000.0)
    assert (optics.principal_row_px, optics.principal_col_px) == (499.5, 999.5)


def test_what_was_baseline_at_a_time_is_answered_and_nonsense_refused(site, read):
    visitor = site.visitor("victor")
    assert (
        "Baseline PS-ST16-1-0"
        in read(visitor.get("/sensors/1?at=2100-01-01T00:00:00Z")).split("State at a given time")[1]
    )
    assert "none yet" in read(visitor.get("/sensors/1?at=2000-01-01T00:00:00Z"))
    assert "not-a-time" in codes(visitor.get("/sensors/1?at=yesterday"))


def test_an_edit_of_an_older_version_is_refused_and_the_text_kept(site):
    visitor = site.visitor("ada")
    with open_reading(site.engine) as session:
        document = dict(session.get_known(Sensor, 1).document)
    text = json.dumps(document | {"centroid_sigma_px": 0.25})
    assert visitor.post("/sensors/1", document=text, version="1").status_code == 303
    answer = visitor.post("/sensors/1", document=text.replace("0.25", "0.35"), version="1")
    assert answer.status_code == 412
    assert "&#34;centroid_sigma_px&#34;: 0.35" in answer.text
    with open_reading(site.engine) as session:
        assert session.get_known(Sensor, 1).document["centroid_sigma_px"] == 0.25


def evaluation(**changes):
    return {
        "frames": 16,
        "availability": {"initial": 0.4375, "final": 1.0},
        "matched_star_ratio": 5.656,
        "rms_arc_rad": {"initial": 632.5e-6, "final": 83.81e-6},
        "flight_tolerance_rad": 422e-6,
        "intervals": {
            "availability": {"initial": [0.323, 0.552], "final": [0.954, 1.0]},
            "matched_star_ratio": [4.209, None],
            "rms_arc_rad": {"initial": [582.2e-6, 682.1e-6], "final": [81.2e-6, 86.5e-6]},
            "rms_ratio": [0.12, 0.15],
        },
    } | changes


def read_panel(page, read):
    return read(page).split("Before and after")[1].split("Parameter sets and baselines")[0]


def test_a_sensor_shows_what_its_newest_validated_run_would_change_with_intervals(site, read, results):
    validated = site.add_run("batch", state="SUCCEEDED", result=results["batch"] | {"validation": evaluation()})
    site.add_run("batch", state="SUCCEEDED", result=results["batch"], validation_set_id=None)
    panel = read_panel(site.visitor("victor").get("/sensors/1"), read)
    assert f"#{validated}" in panel
    assert "on its validation set" in panel
    numbers = ("43.8", "32.3 to 55.2", "100.0", "95.4 to 100.0", "5.66", "above 4.21", "632.5", "83.8", "81.2 to 86.5")
    assert [words for words in (*numbers, "422 µrad") if words not in panel.replace("\u202f", " ")] == []


def test_without_a_validation_set_the_calibration_set_is_quoted_and_said_to_be_the_fitted_one(site, read, results):
    result = results["batch"] | {
        "validation": None,
        "evaluation": evaluation(availability={"initial": 0.2, "final": 0.98}),
    }
    visitor = site.visitor("ada")
    visitor.post("/sensors", document=EXAMPLE)
    assert "no-run-yet" in codes(visitor.get("/sensors/2"))
    site.add_run("batch", state="SUCCEEDED", result=result, validation_set_id=None, sensor_id=2)
    panel = read_panel(visitor.get("/sensors/2"), read)
    assert "on its calibration set" in panel
    for words in ("20.0", "98.0", "5.66"):
        assert words in panel


@pytest.fixture
def document(session) -> dict[str, Any]:
    return deepcopy(session.get_known(Sensor, 1).document)


def test_a_new_sensor_has_its_ground_calibration_as_baseline(session, document):
    ground = set_queries.find_baseline(session, 1)
    assert (ground.name, ground.number, ground.run_id) == ("PS-ST16-1-0", 0, None)
    assert ground.document["parameters"] == document["initial"]
    assert ground.document["sigma"] == document["typical_sigma"]
    assert ground.document["status"] == "ground calibration"
    assert "Declared, not measured" in ground.document["advice"][0]
    assert compute_sha256(ground.document) == ground.sha256
    names, declared = ground.document["covariance"]["names"], document["typical_sigma"]
    assert ground.document["covariance"]["matrix"] == pytest.approx(np.diag([declared[name] ** 2 for name in names]))


@pytest.mark.parametrize("name", ["bo", "cy", "dee", "eve", "root"])
def test_analysts_and_administrators_register(session, people, document, name):
    document["name"] = "ST16-2"
    if people[name].roles & {"analyst", "administrator"}:
        truth = {"f_m": 0.0161}
        row = sensors.register_sensor(session, people[name], document, simulated=True, truth=truth)
        assert (row.name, row.simulated, row.truth) == ("ST16-2", 1, truth)
        with pytest.raises(ConflictError, match="sensor ST16-2 exists already"):
            sensors.register_sensor(session, people[name], document)
    else:
        with pytest.raises(ForbiddenError, match=r"analyst.*administrator", check=has_code("role-missing")):
            sensors.register_sensor(session, people[name], document)


def test_a_bad_document_leaves_no_sensor_and_no_set(engine, people):
    with open_writing(engine) as session:
        bad = deepcopy(session.get_known(Sensor, 1).document) | {"name": "ST16-2", "parity": 0}
    with pytest.raises(RefusedInputError), open_writing(engine) as session:
        sensors.register_sensor(session, people["ana"], bad)
    with open_writing(engine) as session:
        assert [row.name for row in sensor_queries.list_sensors(session)] == ["ST16-1"]
        assert len(lists.list_newest(session, ParameterSet)) == 1


@pytest.mark.parametrize("name", ["../../etc", "a/b", "<b>", "x" * 65, "-x"])
def test_a_name_that_makes_no_file_name_is_refused(session, people, document, name):
    with pytest.raises(RefusedInputError, match="name"):
        sensors.register_sensor(session, people["ana"], document | {"name": name})


def test_an_edit_changes_what_runs_start_from_and_leaves_the_sets(session, people, document):
    before = set_queries.find_baseline(session, 1)
    sha256 = before.sha256
    document["initial"]["f_m"] = 0.0161
    row = sensors.edit_sensor(session, people["ana"], 1, document, 1)
    assert (row.version, row.document["initial"]["f_m"]) == (2, 0.0161)
    assert set_queries.find_baseline(session, 1).sha256 == sha256
    record = audit.find_last_change(session, "sensors/1")
    assert (record.before["initial"]["f_m"], record.after["initial"]["f_m"]) == (0.016, 0.0161)


@pytest.mark.parametrize("change", [{"name": "ST16-9"}, {"parity": -1}])
def test_what_a_sensor_keeps_for_life_is_not_edited(session, people, document, change):
    with pytest.raises(RefusedInputError, match=f"The {next(iter(change))} of ST16-1 cannot change"):
        sensors.edit_sensor(session, people["ana"], 1, document | change, 1)


def test_two_editors_do_not_overwrite_one_another(session, people, document):
    with pytest.raises(PreconditionRequiredError):
        sensors.edit_sensor(session, people["ana"], 1, document, None)
    sensors.edit_sensor(session, people["ana"], 1, document, 1)
    with pytest.raises(StaleError, match="Ana edited", check=has_code("changed-since-read")):
        sensors.edit_sensor(session, people["bo"], 1, document, 1)


FLEET = [f"{orbit}_{plane}.{number:03d}" for orbit in ("GEO", "leo") for plane in "ab" for number in range(130)]
SOUGHT = st.one_of(
    st.text(alphabet="GEOgeolLab_.0123456789%*[]\\/'\" -", max_size=6), st.sampled_from(FLEET), st.just("x" * 400)
)


def _add(session: Session, names: list[str]) -> None:
    session.add_all(Sensor(name=name, document={"name": name}, created_utc=utc_now()) for name in names)
    audit.append(session, COMMAND_LINE, "brought in", "sensors")


@pytest.fixture(scope="module")
def large(tmp_path_factory) -> Iterator[Engine]:
    engine = open_migrated(url_in(tmp_path_factory.mktemp("large")))
    with open_writing(engine) as session:
        _add(session, FLEET)
    yield engine
    engine.dispose()


def _fitting(find: str) -> list[str]:
    return sorted(name for name in FLEET if find.strip()[:64].lower() in name.lower())


def test_a_fleet_that_can_be_looked_over_is_offered_whole_whatever_is_sought_and_with_one_more_is_large(session):
    _add(session, [f"A{number}" for number in range(MOST_CHOICES - 1)])
    found = sensors.list_choices(session, find="no such", keep=[1])
    assert found.is_all
    assert list(found.names.values()) == sorted(found.names.values())
    assert len(found.names) == found.found == found.fitting == found.fleet == MOST_CHOICES
    _add(session, ["one more"])
    found = sensors.list_choices(session)
    assert not found.is_all
    assert (len(found.names), found.fitting) == (MOST_CHOICES, MOST_CHOICES + 1)


@given(find=SOUGHT, keep=st.sets(st.one_of(st.integers(1, 3 * len(FLEET)), st.integers()), max_size=8))
def test_of_a_large_fleet_the_first_that_hold_the_text_are_offered_and_what_is_kept(large, find, keep):
    with open_reading(large) as session:
        found = sensors.list_choices(session, find=find, keep=keep)
        every = sensor_queries.read_names(session)
    fitting = _fitting(find)
    kept = sorted({every[number] for number in keep if number in every} - set(fitting[:MOST_CHOICES]))
    assert not found.is_all
    assert (found.fitting, found.fleet) == (len(fitting), len(FLEET))
    assert found.found == min(len(fitting), MOST_CHOICES)
    assert list(found.names.values()) == kept + fitting[:MOST_CHOICES]
    assert all(every[number] == name for number, name in found.names.items())


@given(ids=st.sets(st.one_of(st.integers(1, 3 * len(FLEET)), st.integers()), max_size=12))
def test_names_are_those_of_the_numbers_that_there_are(large, ids):
    with open_reading(large) as session:
        every = sensor_queries.read_names(session)
        assert sensor_queries.read_names(session, ids) == {number: every[number] for number in ids if number in every}
    assert sorted(every.values()) == sorted(FLEET)


def test_a_control_character_in_what_is_sought_is_refused_with_its_place(large):
    with (
        open_reading(large) as session,
        pytest.raises(RefusedInputError, match=r"^The find .*U\+0000", check=has_code("control-character")),
    ):
        sensors.list_choices(session, find="GE\x00O")


def test_whether_to_recalibrate_leads_to_its_section_of_the_guide(site, tmp_path, monkeypatch):
    put_documentation(tmp_path, monkeypatch)
    for address in ("/sensors/1", "/sensors/1/trend"):
        (code,) = re.findall(
            r"respond-to-advice\.html#advice-trend-([a-z-]+)\"", site.visitor("ada").get(f"{address}?guide=1")
        )
        assert f"trend_{code.replace('-', '_')}" in ADVICE_KINDS
