"""The list of sensors, registering one, and a sensor's page."""

import json
import math
import re

import pytest

from boresight.console.fleet import queries as sensor_queries
from boresight.console.fleet import service as sensors
from boresight.console.fleet.pages.sensor import baseline_values, compute_optics
from boresight.console.fleet.pages.sensors import EXAMPLE, FIELDS, read_document
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.telemetry.sensors import parse_sensor


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
        assert "FROM-FILE" in {row.name for row in sensor_queries.sensors(session)}


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


def test_a_viewer_sees_who_may_register_and_the_server_refuses_the_form(site):
    visitor = site.visitor("victor")
    assert "<textarea" not in visitor.get("/sensors")
    answer = visitor.post("/sensors", document=EXAMPLE)
    assert answer.status_code == 403


def test_the_parameters_stand_in_model_order_with_the_truth_of_a_simulated_sensor(site):
    page = site.visitor("victor").get("/sensors/1")
    table = page[page.index("Parameters of the baseline") :].split("</table>")[0]
    assert re.findall(r'<code class="quiet">(\w+)</code>', table) == [
        "f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y",
    ]  # fmt: skip
    assert "Truth" in table


def test_a_ground_calibration_claims_no_measured_sigma(site):
    table = site.visitor("victor").get("/sensors/1").split("Parameters of the baseline")[1].split("</table>")[0]
    assert "± σ" not in table
    assert "Typical σ" in table


def test_a_calibrated_baseline_shows_its_sigma_and_its_change_from_the_ground(site):
    with open_writing(site.engine) as session:
        made = parameter_sets.create_from_run(session, site.actor("ada"), site.blobs, 1)
        ground = set_queries.baseline(session, 1)
        ground.ground_state = "SUPERSEDED"
        session.flush()
        session.get_one(ParameterSet, made.id).ground_state = "BASELINE"
    table = site.visitor("victor").get("/sensors/1").split("Parameters of the baseline")[1].split("</table>")[0]
    assert "± σ" in table
    assert "Change" in table


def test_values_are_the_sensor_files_where_there_is_no_baseline(site):
    with open_reading(site.engine) as session:
        sensor = sensors.get_sensor(session, 1)
        assert {it.name: it.value for it in baseline_values(sensor, None)} == sensor.document["initial"]


def test_the_field_of_view_follows_from_f_and_the_detector():
    optics = compute_optics({"rows": 1000, "columns": 2000, "pixel_pitch_m": 1e-5}, {"f_m": 0.01})
    assert optics.columns_deg == pytest.approx(2 * math.degrees(math.atan(1.0)))
    assert optics.pixel_urad == pytest.approx(1000.0)
    assert (optics.principal_row_px, optics.principal_col_px) == (499.5, 999.5)


def test_what_was_baseline_at_a_time_is_answered_and_nonsense_refused(site, read):
    visitor = site.visitor("victor")
    assert "Baseline PS-ST16-1-0" in read(visitor.get("/sensors/1?at=2100-01-01T00:00:00Z")).split("What was in use")[1]
    assert "none yet" in read(visitor.get("/sensors/1?at=2000-01-01T00:00:00Z"))
    assert "is no time" in read(visitor.get("/sensors/1?at=yesterday"))


def test_an_edit_of_an_older_version_is_refused_and_the_text_kept(site):
    visitor = site.visitor("ada")
    with open_reading(site.engine) as session:
        document = dict(sensors.get_sensor(session, 1).document)
    text = json.dumps(document | {"centroid_sigma_px": 0.25})
    assert visitor.post("/sensors/1", document=text, version="1").status_code == 303
    answer = visitor.post("/sensors/1", document=text.replace("0.25", "0.35"), version="1")
    assert answer.status_code == 412
    assert "&#34;centroid_sigma_px&#34;: 0.35" in answer.text
    with open_reading(site.engine) as session:
        assert sensors.get_sensor(session, 1).document["centroid_sigma_px"] == 0.25


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
        },
    } | changes


def panel_of(page, read):
    return read(page).split("Before and after")[1].split("Parameter sets and baselines")[0]


def test_a_sensor_shows_what_its_newest_validated_run_would_change_with_intervals(site, read, results):
    validated = site.add_run("batch", state="SUCCEEDED", result=results["batch"] | {"validation": evaluation()})
    site.add_run("batch", state="SUCCEEDED", result=results["batch"], validation_set_id=None)
    panel = panel_of(site.visitor("victor").get("/sensors/1"), read)
    assert f"#{validated}" in panel
    assert "on its validation set" in panel
    for words in (
        "43.8",
        "32.3 to 55.2",
        "100.0",
        "95.4 to 100.0",
        "5.66",
        "over 4.21",
        "632.5",
        "83.8",
        "81.2 to 86.5",
        "422 µrad",
    ):
        assert words in panel.replace("\u202f", " ")


def test_without_a_validation_set_the_calibration_set_is_quoted_and_said_to_be_the_fitted_one(site, read, results):
    result = results["batch"] | {
        "validation": None,
        "evaluation": evaluation(availability={"initial": 0.2, "final": 0.98}),
    }
    visitor = site.visitor("ada")
    visitor.post("/sensors", document=EXAMPLE)
    site.add_run("batch", state="SUCCEEDED", result=result, validation_set_id=None, sensor_id=2)
    panel = panel_of(visitor.get("/sensors/2"), read)
    assert "on its calibration set" in panel
    for words in ("20.0", "98.0", "5.66"):
        assert words in panel


def test_a_sensor_without_a_finished_run_says_what_to_do(site, read):
    visitor = site.visitor("ada")
    visitor.post("/sensors", document=EXAMPLE)
    panel = panel_of(visitor.get("/sensors/2"), read)
    assert "No finished run says yet" in panel
