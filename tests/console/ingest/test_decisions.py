"""What the watcher makes of calibrations that have ended: asked once at a time, kept quiet by an answer, closed by a promotion."""

from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import orjson
import pytest

from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval
from boresight.console.fleet.tables import Sensor
from boresight.console.fleet.trend_document import Advice
from boresight.console.ingest import policies, service
from boresight.console.ingest.change_tests import PolicyFinding, Reason
from boresight.console.ingest.folder import WatchedFolder
from boresight.console.ingest.rules import PolicyRules
from boresight.console.ingest.tables import IngestDecision, IngestPolicy
from boresight.console.jobs.ingest_watcher import IngestWatcher
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.actors import INGEST
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import open_reading, open_writing, utc_now, utc_text
from boresight.platform.jobs.forecasts import ForecastSources
from tests.console.conftest import SENSOR, _result
from tests.missions import add_run, add_set, make_baseline
from tests.passwords import approve

NAMES = list(SENSOR["initial"])
SIGMA = {name: 1e-3 * SENSOR["typical_sigma"][name] for name in NAMES}


class Pipeline:
    """Brings calibrated sets in as the folder would, and has the watcher decide on them."""

    def __init__(self, engine, blobs, people, tmp_path):
        self.engine, self.blobs, self.people = engine, blobs, people
        settings = SimpleNamespace(
            watched_folder=None,
            watch_settle_s=1.0,
            watch_bucket="",
            data_folder=tmp_path,
            upload_limit_mb=1.0,
            telemetry_limits=None,
        )
        sources = ForecastSources(blobs, lambda: None, tmp_path / "catalogue")
        self.watcher = IngestWatcher(engine, sources, settings, lambda: None)
        self.count = 0

    def enable(self, **rules):
        with open_writing(self.engine) as session:
            row = policies.draft(session, self.people["ana"], 1, PolicyRules(**rules).to_dict(), "x")
            policies.record_rehearsal(
                session, self.people["ana"], row.id, policies.compute_rehearsal(session, row.id), row.version
            )
            policies.enable(session, self.people["root"], row.id, row.version)
            return row.id

    def bring(self, day, moved=0.0, *, every=False, state="SUCCEEDED", status="converged"):
        """Bring in a set of a day, whose focal length, or every parameter, moved by so many of its sigmas; returns its decision."""
        self.count += 1
        at = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=day)
        span = {"start_utc": utc_text(at), "end_utc": utc_text(at + timedelta(minutes=9)), "span_s": 540.0}
        parameters = SENSOR["initial"] | {
            name: SENSOR["initial"][name] + moved * SIGMA[name] for name in (NAMES if every else ["f_m"])
        }
        matrix = [[SIGMA[a] ** 2 if a == b else 0.0 for b in NAMES] for a in NAMES]
        trend = {"camera_model": "inverted_wang", "names": NAMES, "parameters": parameters, "covariance": matrix}
        summary = {"status": status, "level": "normal", "stars": 5000, "trend": trend}
        summary |= {"rms_initial_arc_rad": 9e-5, "rms_final_arc_rad": 5e-5}
        result = _result() | {
            "parameters": parameters,
            "covariance": {"names": NAMES, "matrix": matrix},
            "sigma": SIGMA,
        }
        with open_writing(self.engine) as session:
            policy = service.rows.find_policy_in_force(session, 1)
            data = TelemetrySet(
                sensor_id=1, name=f"pass-{self.count}", purpose="calibration", frames=40, stars=5000,
                original_sha256=self._stored(session, b"t%d" % self.count), table_sha256=self._stored(session, b"t"),
                quality={"time": span}, uploaded_utc=utc_now(),
            )  # fmt: skip
            session.put(data)
            run = Run(
                sensor_id=1, telemetry_set_id=data.id, method="batch", settings={}, sensor_document=SENSOR, state=state,
                launched_utc=utc_now(), ended_utc=utc_now(), reason=None if state == "SUCCEEDED" else "No stars.",
                result_sha256=self._stored(session, orjson.dumps(result)), summary=summary,
            )  # fmt: skip
            session.put(run)
            sent = service.SentFile("FOLDER", data.name, f"{self.count:064d}", 1)
            row = service._open(session, INGEST, policy, sent, "CALIBRATING", "Queued.", data.id)
            row.run_id = run.id
            audit.append(session, INGEST, "launched", f"ingest-decisions/{row.id}")
            number = row.id
        self.watcher.decide()
        return self.read(number)

    def _stored(self, session, content):
        return register_blob(session, self.blobs, self.blobs.put(content), "application/json").sha256

    def read(self, number, table=IngestDecision):
        with open_reading(self.engine) as session:
            return session.get_one(table, number)

    def answer(self, row, answer, days=7.0, who="ana"):
        with open_writing(self.engine) as session:
            given = service.DecisionAnswer(answer, "Seen.", days)
            return service.answer(session, self.people[who], self.blobs, row.id, given, row.version)


@pytest.fixture
def pipeline(engine, blobs, people, tmp_path):
    return Pipeline(engine, blobs, people, tmp_path)


def _codes(row):
    return [one["code"] for one in row.evidence["reasons"]]


OUT = 1e5  # sigmas: beyond a ground calibration's spread too


def test_within_the_forecast_nothing_is_prepared_and_outside_a_set_with_its_gates_is(pipeline):
    pipeline.enable()
    quiet = pipeline.bring(0)
    assert (quiet.state, quiet.parameter_set_id, _codes(quiet)) == ("WITHIN FORECAST", None, ["HOLDS"])
    asked = pipeline.bring(1, OUT)
    prepared = pipeline.read(asked.parameter_set_id, ParameterSet)
    assert (asked.state, prepared.ground_state, prepared.run_id) == ("ASKED", "CANDIDATE", asked.run_id)
    assert asked.evidence["gates"]["verdict"] in {"PASS", "MARGINAL", "FAIL", "NO-DATA"}
    assert sum(one["recommended"] for one in asked.evidence["alternatives"]) == 1
    assert (asked.evidence["recalibrate"]["answer"], asked.evidence["advised"]) in {
        ("YES", "SUBMIT"),
        ("YES", "RECALIBRATE"),
    }
    pipeline.watcher.decide()
    assert pipeline.read(asked.id).version == asked.version  # looking again changes nothing
    with open_reading(pipeline.engine) as session:
        assert audit.verify(session).ok
        assert audit.find_last_change(session, f"ingest-decisions/{asked.id}").actor == "Ingest"


@pytest.mark.parametrize(
    ("answer", "blocking", "advised"),
    [
        ("YES", [], "SUBMIT"),
        ("YES", ["validation-rms-incumbent"], "RECALIBRATE"),
        ("YES", ["convergence"], "RECALIBRATE"),
        ("MORE DATA NEEDED", [], "MORE DATA"),
        ("NOT YET", [], "MORE DATA"),
    ],
)
def test_what_is_recommended_is_what_the_trend_advises(answer, blocking, advised):
    found = PolicyFinding("ASKED", (Reason("OUTSIDE", "It left the baseline."),))
    assert service.recommend(found, blocking, Advice(answer, "Said.", "trend_valid")) == advised


def test_one_question_a_sensor_a_newer_one_supersedes_it(pipeline):
    pipeline.enable(confirmations=2)
    assert pipeline.bring(0, OUT).state == "UNCONFIRMED"
    first = pipeline.bring(1, OUT)
    second = pipeline.bring(2, OUT)
    assert (pipeline.read(first.id).state, second.state) == ("SUPERSEDED", "ASKED")
    with pytest.raises(ConflictError, match="SUPERSEDED"):
        pipeline.answer(pipeline.read(first.id), "WAIT")


@pytest.mark.parametrize(("sets", "code", "advised"), [(0, "NO FORECAST", None), (9, "JUMP", "MORE DATA")])
def test_wait_keeps_the_same_change_quiet_and_lets_a_jump_through(pipeline, sets, code, advised):
    pipeline.enable()
    assert {pipeline.bring(day).state for day in range(sets)} <= {"WITHIN FORECAST"}
    asked = pipeline.bring(sets, OUT)
    answered = pipeline.answer(asked, "WAIT", 3.0)
    assert answered.quiet_until_utc > utc_now()
    found = [pipeline.bring(sets + day, OUT + day) for day in (1, 2)]
    assert [(one.state, _codes(one)[0]) for one in found] == [("WITHIN FORECAST", "ANSWERED WAIT")] * 2
    jump = pipeline.bring(sets + 3, 2 * OUT)
    assert (jump.state, advised in {None, jump.evidence["advised"]}) == ("ASKED", True)
    assert code in _codes(jump)


def test_more_data_asks_again_with_the_next_set(pipeline):
    pipeline.enable()
    pipeline.answer(pipeline.bring(0, OUT), "MORE DATA")
    again = pipeline.bring(1, OUT)
    assert (again.state, again.evidence["in_row"]) == ("ASKED", 2)


def test_a_submitted_request_keeps_quiet_and_its_promotion_moves_the_reference(pipeline):
    pipeline.enable()
    submitted = pipeline.answer(pipeline.bring(0, OUT), "SUBMIT")
    waiting = pipeline.bring(1, OUT)
    assert (waiting.state, _codes(waiting)[0]) == ("WITHIN FORECAST", "REQUEST OPEN")
    with open_writing(pipeline.engine) as session:
        approve(session, pipeline.people["cy"], session.get_one(Approval, submitted.approval_id))
        row = session.get_one(ParameterSet, submitted.parameter_set_id)
        approvals.promote(session, pipeline.people["dee"], row.id, row.version)
    held = pipeline.bring(2, OUT)
    assert (held.state, held.evidence["reference_id"]) == ("WITHIN FORECAST", submitted.parameter_set_id)
    assert _codes(held) == ["HOLDS"]


def test_a_question_whose_baseline_moved_is_closed(pipeline):
    pipeline.enable()
    first = pipeline.answer(pipeline.bring(0, OUT), "MORE DATA")
    open_one = pipeline.bring(1, OUT)
    with open_writing(pipeline.engine) as session:
        row = session.get_one(ParameterSet, first.parameter_set_id)
        approval = approvals.submit(session, pipeline.people["ana"], pipeline.blobs, row.id, "x", row.version)
        approve(session, pipeline.people["cy"], approval)
        row = session.get_one(ParameterSet, first.parameter_set_id)
        approvals.promote(session, pipeline.people["dee"], row.id, row.version)
    pipeline.watcher.decide()
    assert pipeline.read(open_one.id).state == "SUPERSEDED"


def test_runs_that_failed_or_did_not_converge_are_not_judged_and_three_of_them_stop_the_policy(pipeline):
    policy = pipeline.enable(failures_in_row=3)
    found = [
        pipeline.bring(0, state="FAILED"),
        pipeline.bring(1, status="diverged"),
        pipeline.bring(2, state="LOST"),
    ]
    assert [(one.state, _codes(one)) for one in found] == [
        ("NOT JUDGED", ["RUN"]),
        ("NOT JUDGED", ["UNUSABLE"]),
        ("NOT JUDGED", ["RUN"]),
    ]
    row = pipeline.read(policy, IngestPolicy)
    assert (row.state, row.pause_code) == ("PAUSED", "FAILURES")


def test_too_many_requests_stop_the_policy_and_the_last_question_stands(pipeline):
    policy = pipeline.enable(requests_per_week=1)
    pipeline.bring(0, OUT)
    second = pipeline.bring(1, OUT)
    row = pipeline.read(policy, IngestPolicy)
    assert (second.state, row.state, row.pause_code) == ("ASKED", "PAUSED", "TOO MANY REQUESTS")


def test_a_set_of_a_sensor_of_the_same_design_stops_the_policy_and_prepares_nothing(pipeline):
    with open_writing(pipeline.engine) as session:
        twin = Sensor(name="ST-TWIN", document=SENSOR | {"name": "ST-TWIN"}, created_utc=utc_now())
        session.put(twin)
        audit.append(session, INGEST, "brought in", f"sensors/{twin.id}")
        data = add_set(session, twin.id, 0.0)
        run = add_run(session, data, np.random.default_rng(1), 0.5, share=1e-3)
        make_baseline(session, run)
        number = twin.id
    policy = pipeline.enable()
    for day in range(9):
        pipeline.bring(day)
    found = pipeline.bring(9, moved=0.5 / 1e-3, every=True)
    assert (found.state, _codes(found)[:2], found.parameter_set_id) == ("NOT JUDGED", ["WRONG SENSOR", "OUTSIDE"], None)
    assert found.evidence["other_sensor_id"] == number
    assert "ST-TWIN" in found.sentence
    row = pipeline.read(policy, IngestPolicy)
    assert (row.state, row.pause_code, row.pause_reason) == ("PAUSED", "WRONG SENSOR", found.sentence)


def test_an_answer_needs_a_reason_and_days_within_bounds():
    for given in (
        ("NO", "x", 7.0),
        ("WAIT", " ", 7.0),
        ("WAIT", "x", 0.0),
        ("WAIT", "x", 91.0),
        ("WAIT", "x", float("nan")),
    ):
        with pytest.raises(RefusedInputError):
            service.DecisionAnswer(*given).check()


def test_a_folder_that_cannot_be_written_stops_the_policy(pipeline, tmp_path, monkeypatch):
    policy = pipeline.enable()
    place = tmp_path / "in" / "ST16-1"
    place.mkdir(parents=True)
    (place / "a.csv").write_text("frame\n?\n")
    pipeline.watcher._folder = WatchedFolder(tmp_path / "in", 0.0)
    pipeline.watcher._settings.image_limits, pipeline.watcher._settings.image_seconds = None, 1.0
    monkeypatch.setattr(
        WatchedFolder, "settle", lambda *_: (_ for _ in ()).throw(PermissionError(13, "Permission denied"))
    )
    pipeline.watcher.look()
    row = pipeline.read(policy, IngestPolicy)
    assert (row.state, row.pause_code) == ("PAUSED", "FOLDER")
    pipeline.watcher.look()
    with open_reading(pipeline.engine) as session:
        assert [one.state for one in session.query(IngestDecision)] == ["REFUSED"]
    assert (place / "a.csv").exists()
