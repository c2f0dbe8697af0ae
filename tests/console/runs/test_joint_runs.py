"""Runs of several telemetry sets and runs that start from an earlier calibration: what is kept of them, and what is refused."""

import pytest

from boresight.console.fleet import service as sensors
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import queries
from boresight.console.runs import service as runs
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import utc_now
from boresight.simulation.sensors import wu_sensor
from boresight.telemetry.sensors import sensor_document
from tests.console.conftest import SENSOR
from tests.refusals import has_code

FREE = list(SENSOR["initial"])


@pytest.fixture
def upload(session, blobs, people):
    def make(name, sensor_id=1, **columns):
        sha256 = register_blob(session, blobs, blobs.put(name.encode()), "text/csv").sha256
        values = {"purpose": "calibration", "frames": 10, "stars": 100, "quality": {}, "uploaded_utc": utc_now()}
        row = TelemetrySet(
            sensor_id=sensor_id, name=name, original_sha256=sha256, table_sha256=sha256, **values | columns
        )
        session.put(row)
        audit.append(session, people["ana"], "brought in", f"telemetry-sets/{row.id}")
        return row

    return make


@pytest.fixture
def launch(session, people):
    def make(first, *further, validate_only=False, sensor_id=1, validation=None, settings=None, **prior):
        return runs.launch(
            session,
            people["ana"],
            sensor_id,
            first.id,
            settings or {},
            joint_set_ids=[one.id for one in further],
            validation_set_id=None if validation is None else validation.id,
            validate_only=validate_only,
            **prior,
        )

    return make


def test_a_joint_run_keeps_its_sets_in_their_order_and_its_size_is_that_of_all(session, upload, launch):
    one, two, three = upload("one"), upload("two", frames=20, stars=150), upload("three")
    run = launch(one, three, two)
    assert (run.telemetry_set_id, run.joint_set_ids) == (one.id, [three.id, two.id])
    session.expire_all()
    assert session.get_one(Run, run.id).joint_set_ids == [three.id, two.id]
    waiting = next(each for each in queries.list_waiting_runs(session, 10) if each.run_id == run.id)
    assert (waiting.frames, waiting.stars) == (40, 350)
    assert [found.id for found in queries.list_runs_of_set(session, two.id, 5)[0]] == [run.id]
    assert [found.id for found in runs.list_runs(session, telemetry_set_id=three.id)] == [run.id]
    said = launch(one, two, validate_only=True)
    assert (said["frames"], said["stars"], said["joint_sets"]) == (30, 250, ["two"])


def test_a_claimed_run_brings_its_sets_and_what_its_prior_holds_from_its_first_beginning(
    session, upload, launch, finished_run
):
    first = finished_run(session)
    before = finished_run(session)
    before.telemetry_set_id, before.prior_run_id = upload("second").id, first.id
    session.flush()
    new, more = upload("third"), upload("fourth")
    run = launch(new, more, prior_run_id=before.id)
    claimed = queries.list_claimed_runs(session, [run.id])[0]
    assert [one.name for one in claimed.sets] == ["third", "fourth"]
    assert (claimed.prior.name, claimed.prior.result_sha256) == (f"run {before.id}", before.result_sha256)
    held = [session.get_one(TelemetrySet, number).original_sha256 for number in (1, before.telemetry_set_id)]
    assert claimed.prior.held_sha256s == held


def test_an_approved_set_may_be_started_from_and_is_remembered_by_its_name(session, make_set, upload, launch):
    named = make_set()
    named.ground_state = "APPROVED"
    session.flush()
    run = launch(upload("new"), prior_set_id=named.id)
    assert (run.prior_set_id, run.prior_run_id) == (named.id, named.run_id)
    assert queries.list_claimed_runs(session, [run.id])[0].prior.name == named.name


def test_what_the_prior_holds_is_left_out_and_said_so(session, upload, launch, finished_run):
    before, new = finished_run(session), upload("new")
    said = launch(
        session.get_one(TelemetrySet, before.telemetry_set_id), new, prior_run_id=before.id, validate_only=True
    )
    assert (said["left_out"], said["frames"], said["prior"]) == (["stars.csv"], 10, f"run {before.id}")
    assert any("stars.csv" in one for one in said["warnings"])


@pytest.fixture
def make_set(session, people, blobs, finished_run):
    def make() -> ParameterSet:
        run = finished_run(session, people["ana"].user_id)
        return parameter_sets.create_from_run(session, people["ana"], blobs, run.id)

    return make


@pytest.fixture
def other_sensor(session, people):
    return sensors.register_sensor(session, people["ana"], {**SENSOR, "name": "ST16-2"}).id


def test_sets_that_cannot_be_taken_together_are_refused(upload, launch, other_sensor):
    one, two = upload("one"), upload("two")
    archived, other = upload("old", archived_utc=utc_now()), upload("other", sensor_id=other_sensor)
    with pytest.raises(RefusedInputError, match=r"^other", check=has_code("other-sensor")):
        launch(one, other)
    with pytest.raises(ConflictError, match=r"^old", check=has_code("archived")):
        launch(one, archived)
    with pytest.raises(RefusedInputError, match=r"^two", check=has_code("named-twice")):
        launch(one, two, two)
    with pytest.raises(RefusedInputError, match=r"^two", check=has_code("validates-itself")):
        launch(one, two, validation=two)
    with pytest.raises(RefusedInputError, check=has_code("one-set-cannot-vary")):
        launch(one, settings={"vary": ["f_m"]})
    with pytest.raises(RefusedInputError, match="f_m", check=has_code("not-free")):
        launch(one, two, settings={"vary": ["f_m"], "free": ["b2_per_m2"]})


def test_what_cannot_be_started_from_is_refused(session, upload, launch, finished_run, other_sensor):
    before, new = finished_run(session), upload("new")
    elsewhere = upload("other", sensor_id=other_sensor)
    refused = {
        "another sensor": lambda: launch(elsewhere, sensor_id=other_sensor, prior_run_id=before.id),
        "not be counted twice": lambda: launch(session.get_one(TelemetrySet, 1), prior_run_id=before.id),
        "took part in": lambda: launch(new, validation=session.get_one(TelemetrySet, 1), prior_run_id=before.id),
        "frees f_m": lambda: launch(new, settings={"free": ["f_m"]}, prior_run_id=before.id),
        "vary between passes": lambda: launch(new, upload("more"), settings={"vary": ["f_m"]}, prior_run_id=before.id),
        "not both": lambda: launch(new, prior_run_id=before.id, prior_set_id=1),
        "ground calibration": lambda: launch(new, prior_set_id=1),
        "requires a prior": lambda: launch(new, settings={"prior_inflation": 2.0}),
        "cosine": lambda: launch(new, settings={"error": "cosine"}, prior_run_id=before.id),
    }
    for said, ask in refused.items():
        with pytest.raises(RefusedInputError, match=said):
            ask()
    with pytest.raises(NotFoundError):
        launch(new, prior_run_id=10**6)
    assert session.query(Run).count() == 1


def test_a_calibration_of_another_camera_model_or_without_an_end_or_archived_is_refused(
    session, people, upload, launch, finished_run
):
    model, gone = finished_run(session), finished_run(session)
    failed, new = finished_run(session, status="rank_deficient"), upload("new")
    queued = launch(new)
    model.sensor_document = sensor_document(wu_sensor())
    session.flush()
    runs.archive_run(session, people["ana"], gone.id)
    with pytest.raises(RefusedInputError, match="pinhole_radial", check=has_code("other-camera-model")):
        launch(new, prior_run_id=model.id)
    with pytest.raises(RefusedInputError, match="deficient", check=has_code("not-converged")):
        launch(new, prior_run_id=failed.id)
    with pytest.raises(ConflictError, match="is QUEUED"):
        launch(new, prior_run_id=queued.id)
    with pytest.raises(ConflictError, match="is archived"):
        launch(new, prior_run_id=gone.id)


def test_a_set_that_nobody_approved_is_refused_and_its_run_is_named(make_set, upload, launch):
    row = make_set()
    with pytest.raises(ConflictError, match=f"name run {row.run_id} itself"):
        launch(upload("new"), prior_set_id=row.id)
