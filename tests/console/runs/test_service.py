"""Launching fixes all that a run needs and refuses what does not belong together; stopping and reading keep to the rows."""

import math
import re
from dataclasses import replace

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
import pytest

from boresight.calibration.calibration import parse_calibration, to_plain
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.result import TrendEntry
from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.runs import comparisons, presets
from boresight.console.runs import queries as rows
from boresight.console.runs import service as runs
from boresight.console.runs.comparisons import UnlikeModelsError, compare, document, read_run_ids, table
from boresight.console.runs.dry_runs import estimate_seconds_per_star, predict_duration_s
from boresight.console.runs.presets import BUILT_IN
from boresight.console.runs.tables import RecordedProgress, Run, parse_progress
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import open_writing, utc_now
from boresight.verdicts.verdict import RunSummary, parse_run_summary, summarise_run
from tests.console.conftest import _result
from tests.refusals import has_code


@pytest.fixture
def session(engine, people):  # noqa: ARG001 - people are made in a transaction of their own, before this one begins
    with open_writing(engine) as session:
        yield session


@pytest.fixture
def add_set(session, blobs, people):
    def add(sensor_id=1, **columns):
        sha256 = register_blob(session, blobs, blobs.put(str(columns).encode()), "text/csv").sha256
        number = len(session.query(TelemetrySet).all()) + 1
        defaults = {"name": f"set-{number}", "purpose": "calibration", "frames": 100, "stars": 1200, "quality": {}}
        row = TelemetrySet(
            sensor_id=sensor_id,
            original_sha256=sha256,
            table_sha256=sha256,
            uploaded_utc=utc_now(),
            **defaults | columns,
        )
        session.add(row)
        session.flush()
        audit.append(session, people["ana"], "brought in", f"telemetry-sets/{row.id}")
        return row

    return add


@pytest.fixture
def launch(session, people, add_set):
    add_set()

    def launch(settings=None, *, actor=people["ana"], sensor_id=1, telemetry_set_id=1, **options):
        return runs.launch(session, actor, sensor_id, telemetry_set_id, settings or {"method": "sqrf"}, **options)

    return launch


def test_a_launched_run_is_queued_with_everything_fixed(session, people, launch):
    run = launch({"method": "sqrf", "free": ["f_m"]}, label=" night pass ")
    assert (run.state, run.method, run.label, run.attempt) == ("QUEUED", "sqrf", "night pass", 0)
    assert run.settings["linearisations"] == 6  # defaults are written out: a later default changes no old run
    assert run.launched_by == people["ana"].user_id
    session.get_one(Sensor, 1).document = {"edited": True}
    assert rows.find_run(session, run.id).sensor_document["name"] == "ST16-1"
    record = audit.find_last_change(session, f"runs/{run.id}")
    assert (record.action, record.actor) == ("launched", "Ana")


def test_a_dry_run_says_what_it_would_be_and_queues_nothing(session, launch, add_set):
    quality = {"usable": 800, "usable_exposures": 150, "warnings": ["30 % of the stars are unmatched."]}
    other = add_set(quality=quality, purpose="validation")
    summary = launch(telemetry_set_id=other.id, validation_set_id=1, validate_only=True)
    assert summary["pairs"] == 2 * 800 - 3 * 150
    assert set(summary["free"]) == set(session.get_known(Sensor, 1).document["initial"])
    assert summary["warnings"] == ["30 % of the stars are unmatched."]
    assert summary["predicted_s"] > 0
    assert runs.list_runs(session) == []


def test_a_dry_run_warns_of_few_arcs_and_of_no_validation(launch, add_set):
    tiny = add_set(frames=1, stars=5)
    warnings = launch(telemetry_set_id=tiny.id, validate_only=True)["warnings"]
    assert re.findall(r"\d+", warnings[0]) == ["7", "8"]
    assert "validation set" in warnings[1]


def test_the_predicted_time_follows_the_newest_runs_of_the_method(session, launch):
    run = launch()
    rows.claim(session, "owner", 30.0, 1)
    rows.finish(session, run.id, 1, "SUCCEEDED", summary={"seconds": 3.0, "stars": 1000})
    assert estimate_seconds_per_star(session, "sqrf") == pytest.approx(3e-3)
    assert launch(validate_only=True)["predicted_s"] == pytest.approx(3.6, rel=0.02)
    assert estimate_seconds_per_star(session, "batch") < 1e-3


def test_a_replayed_run_lasts_as_long_as_its_downlink():
    assert predict_duration_s(CalibrationSettings(replay_frames_per_s=10.0), 200, 0, 1e-5) == pytest.approx(
        20.0, rel=0.01
    )


@pytest.mark.parametrize("name", ["eve", "cy", "root"])
def test_only_an_analyst_launches_and_cancels_and_a_key_needs_the_scope_of_runs(session, people, launch, name):
    run = launch()
    with pytest.raises(ForbiddenError, match="analyst"):
        launch(actor=people[name])
    with pytest.raises(ForbiddenError, match="analyst"):
        runs.cancel(session, people[name], run.id)
    key = replace(people["ana"], credential="key:abc", scopes=frozenset({"sensors"}))
    with pytest.raises(ForbiddenError, match="scope runs"):
        launch(actor=key)
    assert launch(actor=replace(key, scopes=frozenset({"runs"}))).state == "QUEUED"


def test_telemetry_of_another_sensor_is_refused(session, launch, add_set):
    other = sensors.register_sensor(session, COMMAND_LINE, session.get_one(Sensor, 1).document | {"name": "ST16-2"})
    foreign = add_set(sensor_id=other.id)
    with pytest.raises(RefusedInputError, match="ST16-1", check=has_code("other-sensor")):
        launch(telemetry_set_id=foreign.id)
    with pytest.raises(RefusedInputError, check=has_code("other-sensor")):
        launch(validation_set_id=foreign.id)


@pytest.mark.parametrize(
    ("given", "error", "says"),
    [
        ({"settings": {"method": "guess"}}, RefusedInputError, "method"),
        ({"settings": {"colour": 1}}, RefusedInputError, "colour"),
        ({"settings": {"free": ["f_m", "zoom"]}}, RefusedInputError, "no parameter zoom"),
        ({"label": "x" * 201}, RefusedInputError, "201 characters"),
        ({"validation_set_id": 1}, RefusedInputError, "cannot validate"),
        ({"sensor_id": 99}, NotFoundError, "99"),
        ({"telemetry_set_id": 99}, NotFoundError, "99"),
        ({"validation_set_id": 99}, NotFoundError, "99"),
        ({"telemetry_set_id": 2}, ConflictError, "archived on 2026-10-01"),
    ],
)
def test_what_cannot_be_launched_is_refused_by_name(session, launch, add_set, given, error, says):
    add_set(archived_utc="2026-10-01T00:00:00.000000Z")
    with pytest.raises(error, match=says):
        launch(**given)
    assert runs.list_runs(session) == []


def test_a_queued_run_is_cancelled_at_once_and_only_once(session, people, launch):
    run = launch()
    ended = runs.cancel(session, people["bo"], run.id, "wrong set")
    assert (ended.state, ended.reason.partition(" by ")[2]) == ("CANCELLED", "Bo: wrong set")
    assert audit.find_last_change(session, f"runs/{run.id}").reason == "wrong set"
    with pytest.raises(ConflictError, match="CANCELLED already"):
        runs.cancel(session, people["bo"], run.id)


def test_a_running_run_is_asked_to_stop_and_asking_again_changes_nothing(session, people, launch):
    run = launch()
    rows.claim(session, "owner", 30.0, 1)
    assert runs.cancel(session, people["ana"], run.id).state == "CANCELLING"
    assert runs.cancel(session, people["bo"], run.id).reason.endswith(" Ana.")


def test_the_list_is_paged_newest_first_and_filtered(session, people, launch):
    numbers = [launch({"method": method}).id for method in ("batch", "sqrf", "batch", "sqrf")]
    runs.cancel(session, people["ana"], numbers[0])
    page = runs.list_runs(session, limit=3)
    assert [run.id for run in page] == numbers[:0:-1]
    assert [run.id for run in runs.list_runs(session, before_id=page[-1].id)] == numbers[:1]
    assert [run.id for run in runs.list_runs(session, method="batch", state="QUEUED")] == [numbers[2]]
    assert len(runs.list_runs(session, state=["QUEUED", "CANCELLED"], sensor_id=1)) == 4
    assert runs.list_runs(session, sensor_id=2) == []
    assert runs.count_by_state(session)["QUEUED"] == 3
    with pytest.raises(RefusedInputError, match="DONE", check=has_code("unknown-state")):
        runs.list_runs(session, state="DONE")


def test_the_result_is_what_there_is_so_far_and_then_the_stored_file(session, blobs, launch):
    run = launch()
    assert runs.find_result(session, blobs, run.id) is None
    rows.claim(session, "owner", 30.0, 1)
    rows.record_progress(session, run.id, 1, {"fraction": 0.5, "message": "", "partial": {"status": "running"}})
    assert runs.find_result(session, blobs, run.id) == {"status": "running"}
    content = orjson.dumps(_result())
    rows.finish(session, run.id, 1, "SUCCEEDED", None, blobs.put(content), {"status": "converged"}, len(content))
    assert runs.find_result(session, blobs, run.id) == _result()
    assert session.get_one(Run, run.id).summary == {"status": "converged"}


def test_rows_of_older_versions_read_as_what_they_say_and_damaged_ones_are_told_by_member(launch):
    old = {"status": "converged", "trend": {"camera_model": "inverted_wang"}, "moonlight": 1}
    assert parse_run_summary(old) == RunSummary(status="converged", trend=TrendEntry(camera_model="inverted_wang"))
    assert parse_run_summary(None) == RunSummary()
    assert parse_progress({"fraction": 0.5}) == RecordedProgress(fraction=0.5)
    assert parse_progress(launch().progress) == RecordedProgress()
    damaged = parse_run_summary({"trend": {"names": 1}})
    assert (damaged.status, damaged.level) == ("damaged", "serious")
    assert "trend.names" in (damaged.advice or "")
    assert "fraction" in (parse_progress({"fraction": "half"}).message or "")
    whole = summarise_run(parse_calibration(_result()))
    assert parse_run_summary(orjson.loads(orjson.dumps(to_plain(whole)))) == whole


def test_the_log_tells_the_run_in_order_and_can_be_followed(session, launch):
    run = launch()
    rows.claim(session, "owner", 30.0, 1)
    lines = runs.list_log_lines(session, run.id)
    assert [(line.state, line.attempt) for line in lines] == [("QUEUED", 0), ("RUNNING", 1)]
    assert lines[1].message.endswith(" owner")
    assert runs.list_log_lines(session, run.id, after_id=lines[0].id) == lines[1:]
    with pytest.raises(NotFoundError, match="no run 99"):
        runs.list_log_lines(session, 99)


def test_a_result_keeps_the_models_order_however_the_store_sorts_its_keys():
    names = ["f_m", "m0_px", "a1_rad"]
    stored = {"parameter_names": names, "parameters": {"a1_rad": 3, "f_m": 1, "m0_px": 2}, "inputs": {"z": 1}}
    ordered = runs._in_model_order(stored)
    assert list(ordered["parameters"]) == names
    assert ordered == stored


@pytest.fixture
def save(session, people):
    def save(name="Ours", sentence="On Mondays.", actor="ana", **settings):
        return presets.save_preset(session, people[actor], name, sentence, settings)

    return save


@pytest.mark.parametrize("offer", BUILT_IN, ids=lambda offer: offer.key)
def test_every_preset_of_boresight_has_whole_settings_and_one_sentence_on_when_to_use_it(offer):
    assert CalibrationSettings.parse(offer.settings).document() == offer.settings
    assert offer.sentence.endswith(".")
    assert offer.sentence.count(". ") <= 1
    assert len(offer.sentence) > 30


def test_boresights_presets_differ_in_key_name_and_settings():
    for name in ("key", "name", "sentence"):
        assert len({getattr(offer, name) for offer in BUILT_IN}) == len(BUILT_IN)
    assert len({str(offer.settings) for offer in BUILT_IN}) == len(BUILT_IN)


def test_a_saved_preset_is_offered_with_every_setting_written_out(session, save):
    row = save(method="sqrf", variant="q")
    offer = presets.list_offers(session)[-1]
    assert (offer.key, offer.name, offer.sentence) == (str(row.id), "Ours, version 1", "On Mondays.")
    assert (offer.settings["method"], offer.settings["linearisations"]) == ("sqrf", 6)
    assert presets.get_offer(session, offer.key) == offer
    record = audit.find_last_change(session, f"presets/{row.id}")
    assert (record.action, record.after["settings"]) == ("saved", offer.settings)


def test_saving_under_the_same_name_makes_the_next_version_and_leaves_the_first_as_it_was(session, save):
    first, second = save(), save(robust="huber")
    assert (first.number, second.number) == (1, 2)
    assert [offer.key for offer in presets.list_offers(session) if offer not in BUILT_IN] == [str(second.id)]
    assert presets.get_offer(session, str(first.id)).settings["robust"] == "none"


def test_what_an_archived_version_said_can_still_be_read_and_an_older_one_comes_forward(session, people, save):
    first, second = save(), save(robust="huber")
    presets.archive_preset(session, people["ana"], second.id)
    presets.archive_preset(session, people["ana"], second.id)
    assert presets.list_offers(session)[-1].key == str(first.id)
    assert presets.get_offer(session, str(second.id)).settings["robust"] == "huber"
    assert [row.id for row in presets.list_presets(session)] == [first.id]
    assert [row.id for row in presets.list_presets(session, archived=True)] == [second.id, first.id]
    assert audit.find_last_change(session, f"presets/{second.id}").action == "archived"


def test_the_same_again_is_no_new_version_unless_it_was_archived(session, people, save):
    row = save()
    with pytest.raises(ConflictError, match=r"Version 1 .*Ours", check=has_code("identical-version")):
        save()
    presets.archive_preset(session, people["ana"], row.id)
    assert save().number == 2


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"name": " "}, "Give the preset a name"),
        ({"name": "n" * 61}, "up to 60 characters"),
        ({"sentence": ""}, "when to use Ours"),
        ({"name": "quick LOOK"}, "is a built-in preset; choose another name"),
        ({"name": "a\x07b"}, "U.0007"),
        ({"method": "magic"}, "choose from batch"),
    ],
)
def test_a_preset_that_would_not_do_is_refused(save, given, said):
    with pytest.raises(RefusedInputError, match=said):
        save(**given)


def test_only_an_analyst_saves_and_archives(session, people, save):
    row = save()
    for name in ("eve", "cy", "dee", "root"):
        with pytest.raises(ForbiddenError, match="analyst", check=has_code("role-missing")):
            save(actor=name)
        with pytest.raises(ForbiddenError, match="analyst", check=has_code("role-missing")):
            presets.archive_preset(session, people[name], row.id)


@pytest.mark.parametrize("key", ["99", "no-such", "-1", "9" * 30])
def test_a_preset_that_there_is_not_is_said_to_be_so(session, key):
    with pytest.raises(NotFoundError, match="preset"):
        presets.get_offer(session, key)


def test_settings_given_beside_a_preset_go_over_its_own(session):
    name, settings = presets.choose_settings(session, "drift-tracking", {"process_noise_sigma": 0.1})
    assert name == "Drift tracking"
    assert (settings["variant"], settings["process_noise_sigma"]) == ("q", 0.1)
    assert presets.choose_settings(session, None, {"method": "ekf"}) == (None, {"method": "ekf"})


@pytest.fixture
def run_on(session, blobs, finished_run, tmp_path):
    def make(exposures, step=0.0, sigma=1e-6):
        row = finished_run(session)
        place = np.concatenate([np.random.default_rng(number).uniform(0, 1000, (4, 2)) for number in exposures])
        columns = {"frame": np.repeat(exposures, 4), "exposure": np.zeros(4 * len(exposures), dtype=int)}
        path = tmp_path / "table"
        arrow_parquet.write_table(pa.table({**columns, "row_px": place[:, 0], "col_px": place[:, 1]}), path)
        stored = register_blob(session, blobs, blobs.put(path), "application/octet-stream").sha256
        found = session.query(TelemetrySet).filter_by(table_sha256=stored).first()
        if found is None:
            found = TelemetrySet(
                sensor_id=1, name=f"TS-{exposures[0]}-{exposures[-1]}", purpose="calibration", original_sha256=stored,
                table_sha256=stored, frames=len(exposures), stars=len(place), quality={}, uploaded_utc=utc_now(),
            )  # fmt: skip
            session.add(found)
            session.flush()
        matrix = np.diag(np.full(8, sigma**2)).tolist()
        initial = row.sensor_document["initial"]
        names = list(initial)
        made = finished_run(
            session,
            parameters={**initial, "f_m": initial["f_m"] + step},
            sigma=dict.fromkeys(names, sigma),
            covariance={"names": names, "matrix": matrix},
        )
        made.telemetry_set_id = found.id
        session.flush()
        return made.id

    return make


@pytest.mark.parametrize(
    ("exposures", "kind", "sigma"),
    [
        (range(50, 90), "disjoint", math.hypot(1, 2)),
        (range(10), "inside", math.sqrt(4 - 1)),
        (range(20, 60), "partly", math.sqrt(0.5 * 4 + 0.5 * 1)),
    ],
)
def test_the_sigma_of_a_difference_follows_from_the_data_that_are_shared(
    session, blobs, run_on, exposures, kind, sigma
):
    reference = run_on(list(range(40)), sigma=1e-6)
    other = run_on(list(exposures), step=6e-6, sigma=2e-6)
    written = document(compare(session, blobs, [reference, other]))
    assert written["runs"][1]["shared_data"]["kind"] == kind
    row = written["parameters"][0]
    assert row["differences"] == [None, pytest.approx(6e-6)]
    assert row["sigmas_of_difference"] == [None, pytest.approx(sigma * 1e-6)]
    assert row["separations"][1] == pytest.approx(6 / sigma)


def test_two_good_estimates_of_the_same_data_have_no_sigma_between_them(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(40)), step=1e-7)]
    written = document(compare(session, blobs, runs))
    assert written["runs"][1]["shared_data"]["kind"] == "same"
    assert written["parameters"][0]["separations"] == [None, None]
    assert written["runs"][1]["joint"] is None
    assert written["radial"][1]["sigma_px"][10] is None
    assert written["radial"][1]["difference_px"][10] is not None


def test_the_radial_difference_is_that_of_the_focal_lengths(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(50, 90)), step=1.6e-5)]
    curve = compare(session, blobs, runs).radial()[1]
    at = 60
    assert curve.difference_px[at] == pytest.approx(-1e-3 * curve.radius_px[at], rel=2e-3)
    assert compare(session, blobs, runs, runs[1]).radial()[0].difference_px[at] == pytest.approx(
        1e-3 * curve.radius_px[at], rel=2e-3
    )


def test_another_reference_turns_every_difference_round_and_comes_first_in_the_table(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(50, 90)), step=3e-6)]
    written = [document(compare(session, blobs, runs, reference)) for reference in runs]
    there, back = (each["parameters"][0] for each in written)
    assert there["differences"][1] == pytest.approx(-back["differences"][0])
    assert back["differences"][1] is None
    assert written[0]["assumption"] == comparisons.ASSUMPTION
    columns = table(compare(session, blobs, runs, runs[1]))
    assert columns["run"] == [runs[1], runs[0]] * 8
    assert {len(column) for column in columns.values()} == {16}
    assert columns["shared_data"][1] == "disjoint"
    gone = session.query(TelemetrySet).order_by(TelemetrySet.id.desc()).first()
    blobs.path(gone.table_sha256).unlink()
    assert "cannot" in compare(session, blobs, runs).sentences[1]


def test_unlike_models_are_refused_with_both_runs_and_what_to_convert(session, blobs, people, finished_run, run_on):
    first, second = run_on(list(range(40))), finished_run(session)
    made = parameter_sets.create_from_run(session, people["ana"], blobs, first)
    second.sensor_document = {**second.sensor_document, "camera_model": "pinhole_radial"}
    session.flush()
    with pytest.raises(UnlikeModelsError, match="inverted_wang") as refusal:
        compare(session, blobs, [first, second.id])
    assert refusal.value.sets == [(made.id, made.name)]


def test_what_cannot_be_compared_is_refused(session, blobs, run_on):
    runs = [run_on(list(range(40))), run_on(list(range(50, 90)))]
    with pytest.raises(RefusedInputError, check=has_code("too-few-runs")):
        compare(session, blobs, runs[:1])
    with pytest.raises(RefusedInputError, check=has_code("reference-not-compared")):
        compare(session, blobs, runs, 999)
    with pytest.raises(NotFoundError, match="run 999"):
        compare(session, blobs, [*runs, 999])
    with pytest.raises(NotFoundError, check=has_code("number-too-large")):
        read_run_ids(["9" * 5000])
