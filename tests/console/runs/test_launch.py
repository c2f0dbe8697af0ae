"""The launch form."""

import re

import pytest

from boresight.calibration.options import OPTIONS
from boresight.console.runs import service as runs
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.audit import log as audit
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.sessions import open_reading, open_writing, utc_now

FORM = {
    "sensor_id": "1",
    "telemetry_set_id": "1",
    "validation_set_id": "2",
    "method": "sqrf",
    "variant": "q",
    "linearisations": "4",
    "process_noise_sigma": "0,03",
    "replay_frames_per_s": "5",
    "label": "drift test",
    "free-1": ["f_m", "b2_per_m2"],
}


def test_the_form_begins_with_the_newest_set_of_either_purpose_and_the_sensor_s_free_parameters(site):
    page = site.visitor("ada").get("/runs/new")
    for number in ("1", "2"):
        assert f'<option value="{number}" data-sensor="1"' in page
    calibration = page[page.index('id="telemetry_set_id"') : page.index('id="validation_set_id"')]
    assert 'data-purpose="calibration" selected' in calibration
    assert len(re.findall(r'name="free-1" value="\w+" checked', page)) == 8


@pytest.mark.parametrize(("number", "place", "other"), [(3, "telemetry", "validation"), (4, "validation", "telemetry")])
def test_the_set_whose_page_one_came_from_is_chosen_for_its_purpose(site, number, place, other):
    with open_writing(site.engine) as session:
        for purpose in ("calibration", "validation", "calibration", "validation"):
            sha256 = site.blobs.put(f"{purpose} {number} {session.query(TelemetrySet).count()}".encode())
            session.add(Blob(sha256=sha256, size_bytes=1, media_type="text/csv", created_utc=utc_now()))
            session.flush()
            first = session.get_one(TelemetrySet, 1)
            columns = {"sensor_id": 1, "frames": 40, "stars": 760, "quality": first.quality, "uploaded_utc": utc_now()}
            session.add(
                TelemetrySet(name="TS", purpose=purpose, original_sha256=sha256, table_sha256=sha256, **columns)
            )
            session.flush()
            audit.append(session, site.actor("ada"), "brought in", "telemetry-sets")
    page = site.visitor("ada").get(f"/runs/new?sensor=1&set={number}")
    newest = {"telemetry": 5, "validation": 6}[other]
    assert _chosen(page, f"{place}_set_id") == str(number)
    assert _chosen(page, f"{other}_set_id") == str(newest)


def _chosen(page, field):
    select = page[page.index(f'id="{field}"') :]
    return re.search(r'<option value="(\d+)"[^>]*selected', select[: select.index("</select>")])[1]


def test_a_check_says_what_would_run_and_queues_nothing(site, read):
    before = _count(site)
    answer = site.visitor("ada").post("/runs/new", **FORM, intent="check")
    text = read(answer.text)
    assert answer.status_code == 200
    assert "2: f_m, b2_per_m2" in text
    assert "760" in text
    assert "One gap of 400 s." in text
    assert _count(site) == before


def test_queueing_stores_the_settings_as_typed_and_opens_the_run(site):
    answer = site.visitor("ada").post("/runs/new", **FORM, intent="queue")
    run_id = int(answer.headers["location"].removeprefix("/runs/"))
    with open_reading(site.engine) as session:
        run = runs.get_run(session, run_id)
    assert run.state == "QUEUED"
    assert run.label == "drift test"
    assert run.validation_set_id == 2
    chosen = {
        "method": "sqrf",
        "variant": "q",
        "linearisations": 4,
        "process_noise_sigma": 0.03,
        "replay_frames_per_s": 5.0,
        "free": ["f_m", "b2_per_m2"],
    }
    assert {name: run.settings[name] for name in chosen} == chosen


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ({"linearisations": "many"}, "Linearisations a frame: 'many' is not a whole number"),
        ({"process_noise_sigma": "lots"}, "Drift a frame: 'lots' is not a number"),
        ({"free-1": []}, "No parameter is free"),
        ({"linearisations": "0"}, "give a whole number from 1"),
        ({"validation_set_id": "1"}, "cannot validate a calibration made from itself"),
        ({"replay_frames_per_s": "nan"}, "give a number from 0"),
    ],
)
def test_a_refusal_keeps_everything_that_was_typed(site, read, typed, said):
    answer = site.visitor("ada").post("/runs/new", **{**FORM, **typed}, intent="queue")
    assert answer.status_code == 422
    assert said in read(answer.text)
    assert 'value="drift test"' in answer.text
    assert f'value="{typed.get("linearisations", "4")}"' in answer.text


def test_a_viewer_sees_why_the_button_is_blocked_and_is_refused(site):
    victor = site.visitor("victor")
    assert 'id="launch-blocked"' in victor.get("/runs/new")
    assert victor.post("/runs/new", **FORM, intent="queue").status_code == 403


def test_a_clone_starts_from_the_run_s_settings(site):
    ada = site.visitor("ada")
    location = ada.post("/runs/new", **FORM, intent="queue").headers["location"]
    page = ada.get(f"/runs/new?clone={location.removeprefix('/runs/')}")
    assert 'name="method" value="sqrf" checked' in page
    assert 'name="variant" value="q" checked' in page
    assert 'value="0.03"' in page
    assert 'value="f_m" checked' in page
    assert 'value="g_y" checked' not in page


def test_one_linearisation_is_marked_over_confident(site, read):
    page = site.visitor("ada").post("/runs/new", **{**FORM, "linearisations": "1"}, intent="check").text
    warning = page[page.index("<div data-overconfident") :].split(">")[0]
    assert "hidden" not in warning
    assert "over-confident" in read(page)


BATCH_FORM = {
    **{name: value for name, value in FORM.items() if name not in {"method", "variant"}},
    "method": "batch",
    "robust": "huber",
    "huber_threshold": "2,5",
    "minimum_stars": "6",
    "match_rule": "flight",
    "flight_tolerance_urad": "85",
    "leave_out_doubles": "on",
}


def test_every_choice_of_the_settings_has_words_on_the_page(site):
    page = site.visitor("ada").get("/runs/new")
    for name, option in OPTIONS.items():
        for word in option.words:
            assert re.search(rf'(name="{name}" value="{word}")|(<option value="{word}"[ >])', page), (name, word)
    for name in set(OPTIONS) - {"free"}:
        assert f'name="{name}"' in page, name


def test_more_options_are_closed_until_one_differs_from_the_usual(site):
    ada = site.visitor("ada")
    assert '<details class="panel-details">' in ada.get("/runs/new")
    assert '<details class="panel-details">' in ada.post("/runs/new", **FORM, intent="check").text
    assert '<details class="panel-details" open>' in ada.post("/runs/new", **BATCH_FORM, intent="check").text


def test_more_options_reach_the_run_and_its_clone(site):
    ada = site.visitor("ada")
    location = ada.post("/runs/new", **BATCH_FORM, intent="queue").headers["location"]
    with open_reading(site.engine) as session:
        settings = runs.get_run(session, int(location.removeprefix("/runs/"))).settings
    chosen = {
        "method": "batch",
        "robust": "huber",
        "huber_threshold": 2.5,
        "minimum_stars": 6,
        "match_rule": "flight",
        "flight_tolerance_urad": 85.0,
        "leave_out_doubles": True,
    }
    assert {name: settings[name] for name in chosen} == chosen
    page = ada.get(f"/runs/new?clone={location.removeprefix('/runs/')}")
    for place in (
        'value="huber" selected',
        'value="2.5"',
        'value="flight" selected',
        'value="85"',
        'value="on" checked',
    ):
        assert place in page
    assert '<details class="panel-details" open>' in page


def test_choices_of_a_filter_reach_the_run_and_those_of_the_batch_do_not(site):
    form = {**FORM, "method": "ukf", "variant": "no-refit", "forgetting_factor": "0.99", "robust": "huber"}
    location = site.visitor("ada").post("/runs/new", **form, intent="queue").headers["location"]
    with open_reading(site.engine) as session:
        settings = runs.get_run(session, int(location.removeprefix("/runs/"))).settings
    assert (settings["method"], settings["variant"], settings["forgetting_factor"]) == ("ukf", "no-refit", 0.99)
    assert settings["process_noise_sigma"] == 0.03
    assert settings["robust"] == "none"


def test_the_choices_of_singular_values_reach_the_run_and_its_clone(site):
    ada = site.visitor("ada")
    form = {**FORM, "method": "svd", "star_model": "2", "singular_values": "1,3", "gain_form": "gain"}
    location = ada.post("/runs/new", **form, intent="queue").headers["location"]
    with open_reading(site.engine) as session:
        settings = runs.get_run(session, int(location.removeprefix("/runs/"))).settings
    assert (settings["star_model"], settings["singular_values"], settings["gain_form"]) == (2, [1, 3], "gain")
    page = ada.get(f"/runs/new?clone={location.removeprefix('/runs/')}")
    for place in ('value="2" selected', 'value="1,3" selected', 'value="gain" selected'):
        assert place in page


def test_the_form_says_why_the_first_singular_value_adds_nothing(site, read):
    text = read(site.visitor("ada").get("/runs/new"))
    assert "σ1 adds nothing to the other two: the squares of the three add up to the number of stars" in text


def test_a_check_names_the_choices_that_differ_from_the_usual(site, read):
    text = read(site.visitor("ada").post("/runs/new", **BATCH_FORM, intent="check").text)
    assert "minimum_stars 6" in text
    assert "robust huber" in text
    assert "forgetting_factor" not in text[text.index("Other choices") :]


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ({"huber_threshold": "wide"}, "Huber threshold: 'wide' is not a number"),
        ({"minimum_stars": "3"}, "give a whole number from 4"),
        ({"flight_tolerance_urad": "0"}, "give a number from 0.1"),
        ({"error": "cosine"}, "has no weights to be robust by"),
    ],
)
def test_a_refusal_of_more_options_keeps_them_open_as_typed(site, read, typed, said):
    answer = site.visitor("ada").post("/runs/new", **{**BATCH_FORM, **typed}, intent="queue")
    assert answer.status_code == 422
    assert said in read(answer.text)
    assert '<details class="panel-details" open>' in answer.text
    for value in typed.values():
        assert f'value="{value}"' in answer.text


def _count(site):
    with open_reading(site.engine) as session:
        return len(runs.list_runs(session))
