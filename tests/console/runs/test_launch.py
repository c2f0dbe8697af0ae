"""The launch form."""

import re
from pathlib import Path

import pytest

from boresight.calibration.evaluation.forecast import Forecast
from boresight.calibration.options import OPTIONS, CalibrationSettings
from boresight.console.fleet.tables import Sensor
from boresight.console.runs import presets
from boresight.console.runs import service as runs
from boresight.console.runs.dry_runs import estimate_run_speed
from boresight.console.runs.pages.launch import DEFAULTS, differences
from boresight.console.runs.presets import BUILT_IN
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import register_blob
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.sessions import open_reading, open_writing, utc_now
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_parquet
from tests.calibration.conftest import telemetry
from tests.calibration.sets import st16_sensor
from tests.estimation.fields import GROUND
from tests.sites import codes, strip_tags
from tests.test_refusals import says_what_to_do

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


BATCH_FORM = {
    **{name: value for name, value in FORM.items() if name != "variant"},
    "method": "batch",
    "robust": "huber",
    "huber_threshold": "2,5",
    "minimum_stars": "6",
    "match_rule": "flight",
    "flight_tolerance_urad": "85",
    "leave_out_doubles": "on",
}
SVD_FORM = FORM | {"method": "svd", "star_model": "2", "singular_values": "1,3", "gain_form": "gain"}
UKF_FORM = FORM | {"method": "ukf", "variant": "no-refit", "forgetting_factor": "0.99", "robust": "huber"}


@pytest.mark.parametrize(
    ("form", "chosen", "cloned"),
    [
        (
            FORM,
            {"variant": "q", "linearisations": 4, "replay_frames_per_s": 5.0, "free": ["f_m", "b2_per_m2"]}
            | {"process_noise_sigma": 0.03},
            ['name="method" value="sqrf" checked', 'name="variant" value="q" checked', 'value="f_m" checked'],
        ),
        (
            BATCH_FORM,
            {"robust": "huber", "huber_threshold": 2.5, "minimum_stars": 6, "match_rule": "flight"}
            | {"flight_tolerance_urad": 85.0, "leave_out_doubles": True},
            [
                'value="huber" selected',
                'value="2.5"',
                'value="flight" selected',
                'value="85"',
                'value="on" checked',
                'panel-details" open>',
            ],
        ),
        (
            SVD_FORM,
            {"star_model": 2, "singular_values": [1, 3], "gain_form": "gain"},
            ['value="2" selected', 'value="1,3" selected', 'value="gain" selected'],
        ),
        (
            UKF_FORM,
            {"variant": "no-refit", "forgetting_factor": 0.99, "robust": "none", "process_noise_sigma": 0.03},
            ['value="0.99"'],
        ),
    ],
    ids=["filter", "batch", "singular values", "other filter"],
)
def test_queueing_stores_the_settings_as_typed_and_a_clone_starts_from_them(site, form, chosen, cloned):
    ada = site.visitor("ada")
    run_id = int(ada.post("/runs/new", **form, intent="queue").headers["location"].removeprefix("/runs/"))
    with open_reading(site.engine) as session:
        run = runs.get_run(session, run_id)
    assert (run.state, run.label, run.validation_set_id) == ("QUEUED", "drift test", 2)
    chosen = {"method": form["method"], **chosen}
    assert {name: run.settings[name] for name in chosen} == chosen
    page = ada.get(f"/runs/new?clone={run_id}")
    assert [place for place in cloned if place not in page] == []
    assert 'value="g_y" checked' not in page


def test_a_run_is_queued_as_the_form_would_offer_it(site):
    ada = site.visitor("ada")
    run_id = int(ada.post("/runs/new?sensor=1&set=1", intent="offered").headers["location"].removeprefix("/runs/"))
    with open_reading(site.engine) as session:
        queued = session.get_known(Run, run_id)
    assert (queued.telemetry_set_id, queued.validation_set_id) == (1, 2)
    assert queued.settings["free"]
    assert site.visitor("victor").post("/runs/new?sensor=1&set=1", intent="offered").status_code == 403


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ({"linearisations": "many"}, "Linearisations per frame: 'many' is not a whole number"),
        ({"process_noise_sigma": "lots"}, "Drift per frame: 'lots' is not a number"),
        ({"free-1": []}, "No parameter is free"),
        ({"linearisations": "0"}, "give a whole number from 1"),
        ({"validation_set_id": "1"}, "cannot validate a calibration that was made from it"),
        ({"replay_frames_per_s": "nan"}, "give a number from 0"),
        (BATCH_FORM | {"huber_threshold": "wide"}, "Huber threshold: 'wide' is not a number"),
        (BATCH_FORM | {"minimum_stars": "3"}, "give a whole number from 4"),
        (BATCH_FORM | {"flight_tolerance_urad": "0"}, "give a number from 0.1"),
        (BATCH_FORM | {"error": "cosine"}, "has no weights for a robust loss"),
    ],
)
def test_a_refusal_keeps_everything_that_was_typed(site, read, typed, said):
    ada, form = site.visitor("ada"), FORM | typed
    answer = ada.post("/runs/new", **form, intent="queue")
    assert answer.status_code == 422
    assert said in read(answer.text)
    for name in ("label", "linearisations", "huber_threshold", "minimum_stars", "flight_tolerance_urad", "error"):
        assert name not in form or f'value="{form[name]}"' in answer.text.replace("2.5", "2,5")
    assert ('<details class="panel-details" open>' in answer.text) == ("robust" in form)
    tried = ada.post("/runs/new", **form, intent="check")
    assert (tried.status_code, said in read(tried.text)) == (200, True)


def test_a_viewer_sees_why_the_button_is_blocked_and_is_refused(site):
    victor = site.visitor("victor")
    assert 'id="launch-blocked"' in victor.get("/runs/new")
    assert victor.post("/runs/new", **FORM, intent="queue").status_code == 403
    assert victor.post("/runs/new", **FORM, **KEPT).status_code == 403


def test_one_linearisation_is_marked_over_confident(site, read):
    page = site.visitor("ada").post("/runs/new", **{**FORM, "linearisations": "1"}, intent="check").text
    warning = page[page.index("<div data-overconfident") :].split(">")[0]
    assert "hidden" not in warning
    assert "over-confident" in read(page)


def test_every_choice_of_the_settings_and_every_preset_has_words_on_the_page(site, read):
    page = site.visitor("ada").get("/runs/new")
    for name, option in OPTIONS.items():
        if name == "free":
            continue
        assert f'name="{name}"' in page, name
        for word in option.words:
            assert re.search(rf'(name="{name}" value="{word}")|(<option value="{word}"[ >])', page), (name, word)
    text = read(page)
    assert OPTIONS["singular_values"].hint in text
    for offer in BUILT_IN:
        assert offer.name in text
        assert offer.sentence in text


def test_more_options_are_closed_until_one_differs_from_the_usual(site):
    ada = site.visitor("ada")
    assert '<details class="panel-details">' in ada.get("/runs/new")
    assert '<details class="panel-details">' in ada.post("/runs/new", **FORM, intent="check").text
    assert '<details class="panel-details" open>' in ada.post("/runs/new", **BATCH_FORM, intent="check").text


def test_a_check_names_the_choices_that_differ_from_the_usual(site, read):
    text = read(site.visitor("ada").post("/runs/new", **BATCH_FORM, intent="check").text)
    assert "minimum_stars 6" in text
    assert "robust huber" in text
    assert "forgetting_factor" not in text[text.index("Other settings") :]


def _count(site):
    with open_reading(site.engine) as session:
        return len(runs.list_runs(session))


KEPT = {"preset_name": "Mondays", "preset_sentence": "On Mondays.", "intent": "save"}


def test_the_address_alone_fills_the_form(site):
    page = site.visitor("victor").get("/runs/new?sensor=1&set=1&preset=drift-tracking")
    assert 'name="method" value="sqrf" checked' in page
    assert 'name="variant" value="q" checked' in page
    assert 'aria-pressed="true">Drift tracking' in page
    assert 'name="method" value="ekf" checked' in site.visitor("victor").get("/runs/new?method=ekf&preset=enright")
    site.visitor("victor").get("/runs/new?preset=magic", status=404)


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


def test_a_preset_goes_over_the_settings_and_keeps_data_free_parameters_and_label(site):
    form = {**FORM, "intent": "preset"}
    page = site.visitor("ada").post("/runs/new?preset=suspect-matches", **form).text
    assert 'name="method" value="batch" checked' in page
    assert 'value="stars" selected' in page
    assert 'value="drift test"' in page
    assert len(re.findall(r'name="free-1" value="\w+" checked', page)) == 2


def test_a_clone_shows_what_was_changed_of_its_run(site):
    ada = site.visitor("ada")
    number = ada.post("/runs/new", **FORM, intent="queue").headers["location"].removeprefix("/runs/")
    same = ada.get(f"/runs/new?clone={number}")
    changed = {**FORM, "linearisations": "2", "free-1": ["f_m"], "intent": "check"}
    other = ada.post(f"/runs/new?clone={number}", **changed).text
    assert 'data-changes="0"' in same
    changes = strip_tags(other.split('data-changes="2"')[1].split("</section>")[0])
    assert f"run #{number}" in changes
    assert f"{OPTIONS['linearisations'].title} 4 2" in changes
    assert "f_m, b2_per_m2 f_m" in changes


def test_differences_are_told_in_the_words_of_the_form():
    before = CalibrationSettings(method="batch")
    now = CalibrationSettings(method="svd", singular_values=(1, 3), leave_out_doubles=True)
    told = {one.title: (one.before, one.now) for one in differences(before, now)}
    assert told["Method"] == ("Batch", "Singular values")
    assert told["Singular values"][1] == OPTIONS["singular_values"].words["1,3"]
    assert told[OPTIONS["leave_out_doubles"].title] == ("no", "yes")
    assert differences(now, now) == []


def test_settings_are_kept_as_a_preset_and_offered_at_once(site, read):
    answer = site.visitor("ada").post("/runs/new?sensor=1", **FORM, **KEPT)
    page = site.visitor("ada").get(answer.headers["location"])
    assert answer.headers["location"].startswith("/runs/new?sensor=1&preset=")
    assert "Mondays, version 1" in read(page)
    with open_reading(site.engine) as session:
        row = presets.list_presets(session)[0]
    assert (row.name, row.document["variant"], row.document["free"]) == ("Mondays", "q", ["f_m", "b2_per_m2"])


def test_a_preset_without_a_sentence_is_refused_and_everything_stays_typed(site):
    answer = site.visitor("ada").post("/runs/new", **FORM, **{**KEPT, "preset_sentence": ""})
    assert answer.status_code == 422
    assert "preset-without-sentence" in codes(answer.text)
    assert 'value="Mondays"' in answer.text
    assert 'value="drift test"' in answer.text


def test_a_set_that_cannot_be_looked_into_leaves_the_dry_run_its_size(site, read):
    page = site.visitor("ada").post("/runs/new", **FORM, intent="check").text
    assert 'class="forecast-line"' in page
    assert 'class="data forecast"' not in page
    assert re.search(r"about [^(]+\(.+ to .+\)", read(page))


@pytest.fixture
def seen(site, monkeypatch):
    forecast = Forecast(
        sentence="2 parameters, 1 weakly observable with this coverage.",
        free=["f_m", "b2_per_m2"],
        sigma={"f_m": 1e-6, "b2_per_m2": None},
        typical_sigma={"f_m": 8e-6, "b2_per_m2": 1000.0},
        weak=1,
        weak_directions=["f and b2 move together."],
        help=["Hold b2 fixed: every direction of the others is then known."],
        observability=None,
        frames_sampled=40,
        frames=40,
        at="fitted",
    )
    monkeypatch.setattr(type(site.app.state.forecast_sources), "forecast", lambda *_: forecast)


def test_the_dry_run_shows_predicted_sigmas_weak_directions_and_what_would_help(site, read, seen):  # noqa: ARG001 - seen is what it shows
    text = read(site.visitor("ada").post("/runs/new", **FORM, intent="check").text)
    assert "2 parameters, 1 weakly observable with this coverage." in text
    assert "40 of 40 frames" in text
    row = re.search(r"f_m ([0-9.]+) ([0-9.]+) (mm|µm) ([0-9.]+)", text)
    assert float(row[2]) / float(row[1]) == pytest.approx(8)
    assert float(row[4]) == pytest.approx(1 / 8, abs=0.006)
    assert "b2_per_m2 not determined" in text
    assert "f and b2 move together." in text
    assert "Hold b2 fixed" in text


def test_a_check_holds_no_lock_that_writers_wait_for(site):
    visitor = site.visitor("ada")
    with open_writing(site.engine) as session:
        session.get_one(TelemetrySet, 1)
        answer = visitor.post("/runs/new", **FORM, intent="check")
    assert answer.status_code == 200


SETTINGS = {"method": "batch", "match": "given"}


@pytest.fixture
def forecast_sources(blobs, catalogue):
    return ForecastSources(blobs, lambda: catalogue, Path("nowhere"))


@pytest.fixture
def session(engine, people, blobs, tmp_path):
    write_parquet(telemetry(1, frames=30), tmp_path / "table.parquet")
    with open_writing(engine) as session:
        sha256 = register_blob(session, blobs, blobs.put(tmp_path / "table.parquet"), "text/csv").sha256
        columns = {"original_sha256": sha256, "table_sha256": sha256, "uploaded_utc": utc_now()}
        session.add(
            TelemetrySet(sensor_id=1, name="set-1", purpose="calibration", frames=30, stars=720, quality={}, **columns)
        )
        session.get_one(Sensor, 1).document = {
            **sensor_document(st16_sensor(1)),
            "initial": dict(zip(sensor_document(st16_sensor(1))["initial"], GROUND.tolist(), strict=True)),
        }
        session.flush()
        audit.append(session, people["ana"], "brought in", "telemetry-sets/1")
        yield session


def _asked(session, people, forecast_sources, **settings):
    return runs.launch(
        session, people["ana"], 1, 1, {**SETTINGS, **settings}, validate_only=True, forecast_sources=forecast_sources
    )


def test_a_dry_run_foretells_every_free_parameters_sigma_and_says_it_in_words(session, people, forecast_sources):
    forecast = _asked(session, people, forecast_sources, free=["f_m", "b2_per_m2"])["forecast"]
    assert list(forecast.sigma) == ["f_m", "b2_per_m2"]
    assert all(0 < sigma < forecast.typical_sigma[name] for name, sigma in forecast.sigma.items())
    assert forecast.weak == 0
    assert re.findall(r"\d+|all", forecast.sentence) == ["2", "all"]
    assert (forecast.frames_sampled, forecast.frames, forecast.at) == (30, 30, "fitted")


def test_a_forecast_is_kept_until_a_setting_or_the_sensor_changes(session, people, forecast_sources):
    first = _asked(session, people, forecast_sources)["forecast"]
    assert _asked(session, people, forecast_sources)["forecast"] is first
    assert _asked(session, people, forecast_sources, method="sqrf")["forecast"] is not first
    sensor = session.get_one(Sensor, 1)
    sensor.document = {**sensor.document, "centroid_sigma_px": 2 * sensor.document["centroid_sigma_px"]}
    wider = _asked(session, people, forecast_sources)["forecast"]
    session.refresh(sensor)
    assert wider is not first


def test_only_the_latest_forecasts_are_kept(blobs, catalogue, monkeypatch):
    monkeypatch.setattr("boresight.platform.jobs.forecasts.KEPT", 3)
    forecast_sources = ForecastSources(blobs, lambda: catalogue, Path("nowhere"))
    for number in range(5):
        forecast_sources.forecast(f"{number:064}", {}, CalibrationSettings())
    assert len(forecast_sources._made) == 3


def test_a_table_that_is_gone_is_a_sentence_of_the_forecast_and_no_refusal(session, people, forecast_sources, blobs):
    blobs.path(session.get_one(TelemetrySet, 1).table_sha256).unlink()
    forecast = _asked(session, people, forecast_sources)["forecast"]
    assert forecast.at is None
    assert "is missing" in forecast.sentence
    assert says_what_to_do(forecast.sentence)


def test_without_stars_to_look_at_the_dry_run_still_tells_its_size(session, people, blobs):
    blind = ForecastSources(blobs, lambda: None, Path("nowhere"))
    assert _asked(session, people, None)["forecast"] is None
    forecast = _asked(session, people, blind)["forecast"]
    assert (forecast.at, "catalogue" in forecast.sentence) == (None, True)
    assert _asked(session, people, blind)["frames"] == 30


def _add_run(session, people, seconds, **settings):
    made = runs.launch(session, people["ana"], 1, 1, {**SETTINGS, **settings})
    row = session.get_one(Run, made.id)
    row.state, row.summary = "SUCCEEDED", {"seconds": seconds, "stars": 1000, "frames": 100}
    session.flush()
    audit.append(session, people["ana"], "ended", f"runs/{row.id}")


def test_the_time_is_told_with_the_spread_of_past_runs_and_how_many_they_were(session, people):
    guess = estimate_run_speed(session, "batch")
    for seconds in range(1, 12):
        _add_run(session, people, seconds)
        alone = estimate_run_speed(session, "batch")
        assert seconds > 1 or (alone.runs, alone.low, alone.high) == (1, 0.5e-3, 2e-3)  # within a factor of two
    pace = estimate_run_speed(session, "batch")
    summary = _asked(session, people, None)
    assert guess.runs == 0
    assert guess.low < guess.s_per_star < guess.high
    assert (pace.runs, pace.s_per_star, pace.low, pace.high) == (11, 6e-3, pytest.approx(2e-3), pytest.approx(10e-3))
    low, high = summary["predicted_range_s"]
    assert low < summary["predicted_s"] < high
    assert summary["predicted_s"] == pytest.approx(0.72 * 6, abs=0.1)
    assert summary["paced_by"] == 11


def test_the_wait_of_a_replay_is_not_taken_for_computing(session, people):
    replay = {"method": "sqrf", "replay_frames_per_s": 10.0}
    _add_run(session, people, 10.5, **replay)
    assert estimate_run_speed(session, "sqrf").s_per_star == pytest.approx(0.5e-3)
    assert _asked(session, people, None, **replay)["predicted_s"] == pytest.approx(3.0 + 0.72 * 0.5 + 0.02, abs=0.01)
    _add_run(session, people, 9.0, **replay)
    assert estimate_run_speed(session, "sqrf").low > 0


def test_replays_are_left_out_where_a_run_computed_as_fast_as_it_could(session, people):
    _add_run(session, people, 2.0, method="sqrf")
    for _ in range(3):
        _add_run(session, people, 10.5, method="sqrf", replay_frames_per_s=10.0)
    pace = estimate_run_speed(session, "sqrf")
    assert (pace.runs, pace.s_per_star) == (1, 2e-3)
