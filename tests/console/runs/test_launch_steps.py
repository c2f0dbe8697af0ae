"""The launch page in steps: presets that keep what was typed, a clone's differences, the address, the dry run's forecast."""

import re

import pytest

from boresight.console.runs import presets
from boresight.console.runs.pages.launch import DEFAULTS, differences
from boresight.console.runs.presets import BUILT_IN
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.db.sessions import open_reading, open_writing
from tests.console.runs.test_launch import FORM

KEPT = {"preset_name": "Mondays", "preset_sentence": "On Mondays.", "intent": "save"}


def test_every_preset_is_offered_with_when_to_use_it(site, read):
    text = read(site.visitor("ada").get("/runs/new"))
    for offer in BUILT_IN:
        assert offer.name in text
        assert offer.sentence in text


def test_the_address_alone_fills_the_form(site):
    page = site.visitor("victor").get("/runs/new?sensor=1&set=1&preset=drift-tracking")
    assert 'name="method" value="sqrf" checked' in page
    assert 'name="variant" value="q" checked' in page
    assert 'aria-pressed="true">Drift tracking' in page
    assert 'name="method" value="ekf" checked' in site.visitor("victor").get("/runs/new?method=ekf&preset=enright")


def test_what_was_changed_stands_in_the_address_and_fills_the_form_again(site):
    page = site.visitor("ada").get(
        "/runs/new?sensor=1&set=1&validation_set_id=&method=sqrf&preset=drift-tracking&free-1=f_m&free-1=b2_per_m2"
        "&label=%22quoted%22+%3Cb%3E&replay_frames_per_s=5&linearisations=2&match_rule=flight"
    )
    assert 'name="method" value="sqrf" checked' in page
    assert re.findall(r'name="free-1" value="(\w+)" checked', page) == ["f_m", "b2_per_m2"]
    assert 'value="&#34;quoted&#34; &lt;b&gt;"' in page
    assert 'id="replay_frames_per_s" name="replay_frames_per_s" inputmode="decimal" value="5"' in page
    assert 'value="flight" selected' in page
    assert "selected" not in page[page.index('id="validation_set_id"') : page.index('id="step-method"')]
    assert "checked" not in "".join(
        re.findall(r'<input[^>]*name="free-1"[^>]*>', site.visitor("ada").get("/runs/new?free-1="))
    )


def test_the_form_tells_how_it_begins_whatever_the_address_changes(site):
    ada = site.visitor("ada")
    begun = re.compile('data-begun="([^"]*)"')
    plain, changed = (begun.search(ada.get(f"/runs/new{query}"))[1] for query in ("", "?label=x&linearisations=2"))
    assert plain == changed
    assert f"&amp;linearisations={DEFAULTS['linearisations']}&amp;" in plain
    assert "csrf" not in plain
    assert "variant=q&amp;" in begun.search(ada.get("/runs/new?preset=drift-tracking"))[1]


def test_a_check_that_is_refused_is_an_answer(site, read):
    answer = site.visitor("ada").post("/runs/new", **{**FORM, "free-1": []}, intent="check")
    assert answer.status_code == 200
    assert "No parameter is free" in read(answer.text)


def test_a_preset_goes_over_the_settings_and_keeps_data_free_parameters_and_label(site):
    form = {**FORM, "intent": "preset"}
    page = site.visitor("ada").post("/runs/new?preset=suspect-matches", **form).text
    assert 'name="method" value="batch" checked' in page
    assert 'value="huber" selected' in page
    assert 'value="drift test"' in page
    assert len(re.findall(r'name="free-1" value="\w+" checked', page)) == 2


def test_an_unknown_preset_is_said_to_be_so(site):
    answer = site.visitor("ada").get("/runs/new?preset=magic", status=404)
    assert "There is no preset" in answer


def test_a_clone_shows_what_was_changed_of_its_run(site, read):
    ada = site.visitor("ada")
    number = ada.post("/runs/new", **FORM, intent="queue").headers["location"].removeprefix("/runs/")
    same = read(ada.get(f"/runs/new?clone={number}"))
    changed = {**FORM, "linearisations": "2", "free-1": ["f_m"], "intent": "check"}
    other = read(ada.post(f"/runs/new?clone={number}", **changed).text)
    assert "No setting differs." in same
    assert f"Changed from run #{number}" in other
    assert "Linearisations a frame 4 2" in other
    assert "Free parameters f_m, b2_per_m2 f_m" in other


def test_differences_are_told_in_the_words_of_the_form():
    before, now = {"method": "batch"}, {"method": "svd", "singular_values": [1, 3], "leave_out_doubles": True}
    told = {one.title: (one.before, one.now) for one in differences(before, now)}
    assert told["Method"] == ("Batch", "Singular values")
    assert told["Singular values"][1] == "σ1 and σ3: the same by another name"
    assert told["Leave out doubles and unreliable stars"] == ("no", "yes")
    assert differences(now, now) == []


def test_settings_are_kept_as_a_preset_and_offered_at_once(site, read):
    answer = site.visitor("ada").post("/runs/new?sensor=1", **FORM, **KEPT)
    page = site.visitor("ada").get(answer.headers["location"])
    assert answer.headers["location"].startswith("/runs/new?sensor=1&preset=")
    assert "Mondays, version 1" in read(page)
    with open_reading(site.engine) as session:
        row = presets.list_presets(session)[0]
    assert (row.name, row.document["variant"], row.document["free"]) == ("Mondays", "q", ["f_m", "b2_per_m2"])


def test_a_preset_without_a_sentence_is_refused_and_everything_stays_typed(site, read):
    answer = site.visitor("ada").post("/runs/new", **FORM, **{**KEPT, "preset_sentence": ""})
    assert answer.status_code == 422
    assert "when to use Mondays" in read(answer.text)
    assert 'value="Mondays"' in answer.text
    assert 'value="drift test"' in answer.text


def test_a_viewer_cannot_keep_a_preset(site):
    answer = site.visitor("victor").post("/runs/new", **FORM, **KEPT)
    assert answer.status_code == 403


def test_a_set_that_cannot_be_looked_into_leaves_the_dry_run_its_size(site, read):
    text = read(site.visitor("ada").post("/runs/new", **FORM, intent="check").text)
    assert "No sigma can be foretold" in text
    assert "a guess before the first run" in text or "of this method" in text


@pytest.fixture
def seen(site, monkeypatch):
    forecast = {
        "sentence": "2 parameters, 1 weakly observable with this coverage.",
        "free": ["f_m", "b2_per_m2"],
        "sigma": {"f_m": 1e-6, "b2_per_m2": None},
        "typical_sigma": {"f_m": 8e-6, "b2_per_m2": 1000.0},
        "weak": 1,
        "weak_directions": ["f and b2 move together."],
        "help": ["Hold b2 fixed, and every direction of the others is known."],
        "observability": None,
        "frames_sampled": 40,
        "frames": 40,
        "at": "fitted",
    }
    monkeypatch.setattr(type(site.app.state.sight), "forecast", lambda *_: forecast)


def test_the_dry_run_shows_predicted_sigmas_weak_directions_and_what_would_help(site, read, seen):  # noqa: ARG001 - seen is what it shows
    text = read(site.visitor("ada").post("/runs/new", **FORM, intent="check").text)
    assert "2 parameters, 1 weakly observable with this coverage." in text
    assert "from 40 of 40 frames" in text
    row = re.search(r"f_m ([0-9.]+) ([0-9.]+) (mm|µm) ([0-9.]+)", text)
    assert float(row[2]) / float(row[1]) == pytest.approx(8)
    assert float(row[4]) == pytest.approx(1 / 8, abs=0.006)
    assert "b2_per_m2 open" in text
    assert "f and b2 move together." in text
    assert "Hold b2 fixed" in text


def test_a_check_holds_no_lock_that_writers_wait_for(site):
    visitor = site.visitor("ada")
    with open_writing(site.engine) as session:
        session.get_one(TelemetrySet, 1)
        answer = visitor.post("/runs/new", **FORM, intent="check")
    assert answer.status_code == 200
