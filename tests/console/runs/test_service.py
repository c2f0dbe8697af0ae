"""Launching fixes all that a run needs and refuses what does not belong together; stopping and reading keep to the rows."""

from dataclasses import replace

import orjson
import pytest

from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor
from boresight.console.runs import queries as rows
from boresight.console.runs import service as runs
from boresight.console.runs.dry_runs import estimate_seconds_per_star, predict_duration_s
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import open_writing, utc_now
from tests.console.conftest import _result


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
    record = audit.last_change(session, f"runs/{run.id}")
    assert (record.action, record.actor) == ("launched", "Ana")


def test_a_dry_run_says_what_it_would_be_and_queues_nothing(session, launch, add_set):
    quality = {"usable": 800, "usable_exposures": 150, "warnings": ["30 % of the stars are unmatched."]}
    other = add_set(quality=quality, purpose="validation")
    summary = launch(telemetry_set_id=other.id, validation_set_id=1, validate_only=True)
    assert summary["pairs"] == 2 * 800 - 3 * 150
    assert set(summary["free"]) == set(sensors.get_sensor(session, 1).document["initial"])
    assert summary["warnings"] == ["30 % of the stars are unmatched."]
    assert summary["predicted_s"] > 0
    assert runs.list_runs(session) == []


def test_a_dry_run_warns_of_few_arcs_and_of_no_validation(launch, add_set):
    tiny = add_set(frames=1, stars=5)
    warnings = launch(telemetry_set_id=tiny.id, validate_only=True)["warnings"]
    assert warnings[0].startswith("About 7 arcs for 8 parameters is little")
    assert "validation set" in warnings[1]


def test_the_predicted_time_follows_the_newest_runs_of_the_method(session, launch):
    run = launch()
    rows.claim(session, "owner", 30.0, 1)
    rows.finish(session, run.id, 1, "SUCCEEDED", summary={"seconds": 3.0, "stars": 1000})
    assert estimate_seconds_per_star(session, "sqrf") == pytest.approx(3e-3)
    assert launch(validate_only=True)["predicted_s"] == pytest.approx(3.6, rel=0.02)
    assert estimate_seconds_per_star(session, "batch") < 1e-3


def test_a_replayed_run_lasts_as_long_as_its_downlink():
    assert predict_duration_s({"replay_frames_per_s": 10.0}, 200, 0, 1e-5) == pytest.approx(20.0, rel=0.01)


@pytest.mark.parametrize("name", ["eve", "cy", "root"])
def test_only_an_analyst_launches_and_cancels(session, people, launch, name):
    run = launch()
    with pytest.raises(ForbiddenError, match="analyst"):
        launch(actor=people[name])
    with pytest.raises(ForbiddenError, match="analyst"):
        runs.cancel(session, people[name], run.id)


def test_a_key_needs_the_scope_of_runs(people, launch):
    key = replace(people["ana"], credential="key:abc", scopes=frozenset({"sensors"}))
    with pytest.raises(ForbiddenError, match="scope runs"):
        launch(actor=key)
    assert launch(actor=replace(key, scopes=frozenset({"runs"}))).state == "QUEUED"


def test_telemetry_of_another_sensor_is_refused(session, launch, add_set):
    other = sensors.register_sensor(session, COMMAND_LINE, session.get_one(Sensor, 1).document | {"name": "ST16-2"})
    foreign = add_set(sensor_id=other.id)
    with pytest.raises(RefusedInputError, match="of another sensor; choose a set of ST16-1"):
        launch(telemetry_set_id=foreign.id)
    with pytest.raises(RefusedInputError, match="of another sensor"):
        launch(validation_set_id=foreign.id)


def test_an_archived_set_is_refused_with_its_day(launch, add_set):
    old = add_set(archived_utc="2026-10-01T00:00:00.000000Z")
    with pytest.raises(ConflictError, match="archived on 2026-10-01"):
        launch(telemetry_set_id=old.id)


def test_a_set_cannot_validate_itself(launch):
    with pytest.raises(RefusedInputError, match="cannot validate"):
        launch(validation_set_id=1)


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        ({"method": "guess"}, "method"),
        ({"colour": 1}, "colour"),
        ({"free": ["f_m", "zoom"]}, "no parameter zoom"),
    ],
)
def test_settings_that_cannot_be_used_are_refused_by_name(session, launch, settings, names):
    with pytest.raises(RefusedInputError, match=names):
        launch(settings)
    assert runs.list_runs(session) == []


def test_a_label_that_is_too_long_is_refused(launch):
    with pytest.raises(RefusedInputError, match="201 characters"):
        launch(label="x" * 201)


@pytest.mark.parametrize("ask", [{"sensor_id": 99}, {"telemetry_set_id": 99}, {"validation_set_id": 99}])
def test_what_does_not_exist_is_not_found(launch, ask):
    with pytest.raises(NotFoundError, match="99"):
        launch(**ask)


def test_a_queued_run_is_cancelled_at_once_and_only_once(session, people, launch):
    run = launch()
    ended = runs.cancel(session, people["bo"], run.id, "wrong set")
    assert (ended.state, ended.reason) == ("CANCELLED", "Cancelled by Bo: wrong set")
    assert audit.last_change(session, f"runs/{run.id}").reason == "wrong set"
    with pytest.raises(ConflictError, match="CANCELLED already"):
        runs.cancel(session, people["bo"], run.id)


def test_a_running_run_is_asked_to_stop_and_asking_again_changes_nothing(session, people, launch):
    run = launch()
    rows.claim(session, "owner", 30.0, 1)
    assert runs.cancel(session, people["ana"], run.id).state == "CANCELLING"
    assert runs.cancel(session, people["bo"], run.id).reason == "Cancelled by Ana."


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
    with pytest.raises(RefusedInputError, match="DONE is no state"):
        runs.list_runs(session, state="DONE")


def test_the_result_is_what_there_is_so_far_and_then_the_stored_file(session, blobs, launch):
    run = launch()
    assert runs.result(session, blobs, run.id) is None
    rows.claim(session, "owner", 30.0, 1)
    rows.record_progress(session, run.id, 1, {"fraction": 0.5, "message": "", "partial": {"status": "running"}})
    assert runs.result(session, blobs, run.id) == {"status": "running"}
    content = orjson.dumps(_result())
    rows.finish(session, run.id, 1, "SUCCEEDED", None, blobs.put(content), {"status": "converged"}, len(content))
    assert runs.result(session, blobs, run.id) == _result()
    assert session.get_one(Run, run.id).summary == {"status": "converged"}


def test_the_log_tells_the_run_in_order_and_can_be_followed(session, launch):
    run = launch()
    rows.claim(session, "owner", 30.0, 1)
    lines = runs.log_lines(session, run.id)
    assert [line.message for line in lines] == ["QUEUED", "RUNNING: attempt 1 on owner"]
    assert runs.log_lines(session, run.id, after_id=lines[0].id) == lines[1:]
    with pytest.raises(NotFoundError, match="no run 99"):
        runs.log_lines(session, 99)


def test_a_result_keeps_the_models_order_however_the_store_sorts_its_keys():
    names = ["f_m", "m0_px", "a1_rad"]
    stored = {"parameter_names": names, "parameters": {"a1_rad": 3, "f_m": 1, "m0_px": 2}, "inputs": {"z": 1}}
    ordered = runs._in_model_order(stored)
    assert list(ordered["parameters"]) == names
    assert ordered == stored
