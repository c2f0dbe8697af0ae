"""Alignments over REST: two trackers to the end, who may ask, what is refused, and what a stopped server leaves."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from boresight.calibration.alignment.result import parse_alignment
from boresight.console.alignments import queries, service
from boresight.console.alignments.tables import Alignment
from boresight.console.jobs import alignment_thread
from boresight.console.runs.tables import Run
from boresight.errors import CancelledError, RefusedInputError
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from tests.console.alignments.pairs import TURN, aligned, ask, ended, read, run_of, submitted, trackers
from tests.served import PASSWORD


@pytest.fixture(scope="module")
def pair(house, tmp_path_factory):
    return [run_of(house, one) for one in trackers(tmp_path_factory.getbasetemp())]


@pytest.fixture
def still(house):
    """The house while its thread computes nothing, so that a test does."""
    house.app.state.alignment_thread.close()
    yield house
    house.app.state.alignment_thread.start()


def test_two_runs_become_an_alignment_with_both_rotations_its_gates_and_its_records(house, pair):
    answer = ask(house, *pair, headers={"Idempotency-Key": "pair-1"})
    row = answer.json()
    assert (answer.status_code, row["state"], row["result_sha256"]) == (202, "QUEUED", None)
    assert answer.headers["location"] == f"/api/v1/alignments/{row['id']}"
    again = ask(house, *pair, headers={"Idempotency-Key": "pair-1"})
    assert (again.json()["id"], again.headers["idempotent-replayed"]) == (row["id"], "true")
    row = ended(house, row["id"])
    assert (row["state"], row["attempt"], row["reason"]) == ("SUCCEEDED", 1, None)

    document = house.person("victor").get(f"/api/v1/alignments/{row['id']}/result").json()
    found = parse_alignment(document)
    error = (Rotation.from_quat(found.quaternion) * Rotation.from_rotvec(TURN).inv()).as_rotvec()
    P = np.array(found.covariance_rad2)[:3, :3]
    assert chi2.sf(error @ np.linalg.solve(P, error), 3) > 0.001
    assert max(found.to_load.sigma_arcsec) < 15 < min(found.sigma_arcsec)
    assert (found.a.parameters, found.b.parameters) == ("calibration", "calibration")
    assert (row["verdict"], row["summary"]["pairs_used"]) == (document["gate_report"]["verdict"], found.pairs_used)
    assert row["summary"]["load_quaternion"] == found.to_load.quaternion

    drawn = house.person("victor").get(f"/api/v1/alignments/{row['id']}/figure").json()
    assert {one["name"] for one in drawn["data"]} >= {"pairs", "alignment"}
    numbers = house.person("victor").get(f"/api/v1/alignments/{row['id']}/figure/data").text
    assert numbers.count("\n") == len(found.residuals.time_utc) + 1
    with open_reading(house.app.state.engine) as session:
        end, asked = [one for one in audit.list_records(session) if one.object == f"alignments/{row['id']}"]
        assert (asked.action, asked.after["runs"], end.action) == ("requested", pair, "ended")
        assert (end.after["sha256"], end.after["verdict"]) == (row["result_sha256"], row["verdict"])
        assert audit.verify(session).ok


def test_lists_are_of_either_sensor_and_a_state(house):
    row = aligned(house)
    victor = house.person("victor")
    for sensor_id in (row["sensor_a_id"], row["sensor_b_id"]):
        listed = victor.get("/api/v1/alignments", params={"sensor_id": sensor_id, "state": "SUCCEEDED"}).json()
        assert [one["id"] for one in listed["items"]] == [row["id"]]
    assert (
        victor.get("/api/v1/alignments", params={"sensor_id": row["sensor_a_id"], "state": "FAILED"}).json()["items"]
        == []
    )


def test_who_may_ask_and_a_dry_run_leaves_nothing(house, pair):
    assert ask(house, *pair, who="victor").status_code == 403
    body = {"run_a_id": pair[0], "run_b_id": pair[1]}
    assert house.key("ada", "sensors").post("/api/v1/alignments", json=body).status_code == 403
    before = house.person("ada").get("/api/v1/alignments").json()["items"]
    tried = ask(house, *pair, params={"validate_only": "true"})
    assert (tried.status_code, tried.headers["x-validate-only"]) == (200, "true")
    assert house.person("ada").get("/api/v1/alignments").json()["items"] == before


def test_one_sensor_runs_without_result_and_other_hours_are_refused(house):
    first = house.finished()
    with open_reading(house.app.state.engine) as session:
        run = session.get_one(Run, first)
        order = {"sensor_id": run.sensor_id, "telemetry_set_id": run.telemetry_set_id, "settings": {"method": "batch"}}
    second = house.person("ada").post("/api/v1/runs", json=order).json()["id"]
    assert ask(house, first, second).status_code == 409
    house.end(second)
    assert ask(house, first, second).status_code == 422
    failed = house.launched()["id"]
    house.end(failed, "FAILED")
    assert ask(house, first, failed).status_code == 409
    assert ask(house, first, 10**6).status_code == 404

    made = trackers(house.app.state.settings.data_folder)[0]
    moved = dataclasses.replace(made, csv=made.csv.replace(b"2026-10-01", b"2026-10-03"))
    assert moved.csv != made.csv
    other = run_of(house, moved)
    assert ask(house, first, other).status_code == 422


def test_options_are_checked_and_kept(house, pair):
    assert ask(house, *pair, options={"tolerance_s": 1e6}).status_code == 422
    assert ask(house, *pair, options={"colour": "red"}).status_code == 422
    row = ask(house, *pair, options={"temperature": 1, "drift": False}).json()
    assert row["options"] == {"temperature": 1, "drift": False}
    done = ended(house, row["id"])
    document = house.person("victor").get(f"/api/v1/alignments/{row['id']}/result").json()
    assert (done["state"], [one["kind"] for one in document["terms"]]) == ("SUCCEEDED", ["temperature"])


def test_more_than_a_server_computes_is_refused(house, pair, monkeypatch):
    monkeypatch.setattr(service, "MOST_FRAMES", 5)
    assert ask(house, *pair).status_code == 422
    monkeypatch.undo()
    monkeypatch.setattr(service, "MOST_WAITING", 0)
    assert ask(house, *pair).status_code == 409


def _claim(house):
    with open_writing(house.app.state.engine) as session:
        return service.claim(session)


def test_the_same_is_not_queued_twice(still, pair):
    number = ask(still, *pair, options={"robust": False}).json()["id"]
    assert ask(still, *pair, options={"robust": False}).json()["id"] == number
    assert still.person("ada").get(f"/api/v1/alignments/{number}/result").status_code == 409


def test_without_a_common_pair_it_fails_and_says_why(house, pair, monkeypatch):
    def never(*_):
        raise RefusedInputError("No attitudes of the two frames are at the same time.")

    monkeypatch.setattr(alignment_thread, "align_sides", never)
    row = ended(house, ask(house, *pair, options={"tolerance_s": 0.25}).json()["id"])
    assert (row["state"], row["verdict"]) == ("FAILED", None)
    assert row["reason"].startswith("No attitudes")


def test_a_server_that_stops_leaves_it_to_the_next_and_a_late_end_writes_nothing(still, pair):
    number = ask(still, *pair, options={"robust": True}).json()["id"]
    first, sources = _claim(still), still.app.state.forecast_sources
    with pytest.raises(CancelledError):
        alignment_thread.compute(first, sources, lambda: True)
    with open_writing(still.app.state.engine) as session:
        service.put_back(session, first)
    assert read(still, number)["state"] == "QUEUED"
    second = _claim(still)
    assert (second.alignment_id, second.attempt) == (number, 2)
    made = alignment_thread.compute(second, sources, lambda: False)
    with open_writing(still.app.state.engine) as session:
        assert not service.finish(session, sources.blobs, first, made)
        assert not service.fail(session, first, "late")
        assert service.finish(session, sources.blobs, second, made)
        assert not service.finish(session, sources.blobs, second, made)
    assert read(still, number)["attempt"] == 2


def test_one_that_ends_every_server_fails(still, pair):
    number = ask(still, *pair, options={"drift": True}).json()["id"]
    with open_writing(still.app.state.engine) as session:
        row = session.get_one(Alignment, number)
        row.state, row.attempt, row.lease_until_utc = "RUNNING", service.MOST_ATTEMPTS, "2020-01-01T00:00:00Z"
        audit.append(session, SYSTEM, "began", f"alignments/{number}")
    assert _claim(still) is None
    assert read(still, number)["state"] == "FAILED"


def _sign(house, row, who, verb="approve", **more):
    body = {"meaning": "I approve this alignment.", "password": PASSWORD, **more}
    place = f"/api/v1/alignment-requests/{row['id']}:{verb}"
    return house.person(who).post(place, json=body, headers={"If-Match": f'"v{row["version"]}"'})


def test_an_alignment_goes_on_board_by_one_who_submits_and_another_who_signs(house):
    row = submitted(house)
    assert (row["state"], row["signed_by"]) == ("OPEN", None)
    again = house.person("ada").post(f"/api/v1/alignments/{row['alignment_id']}:submit", json={"reason": "Again."})
    assert again.status_code == 409
    assert _sign(house, row, "ada").status_code == 403
    assert _sign(house, row, "victor").status_code == 403
    assert _sign(house, row, "alan", password="wrong").status_code in {401, 403}
    assert _sign(house, {**row, "version": 9}, "alan").status_code == 412
    assert _sign(house, row, "alan", "refuse").status_code == 422
    signed = _sign(house, row, "alan").json()
    assert (signed["state"], signed["version"], signed["result_sha256"]) == ("APPROVED", 2, row["result_sha256"])
    assert _sign(house, signed, "alan").status_code == 409
    listed = house.person("victor").get(f"/api/v1/alignments/{row['alignment_id']}/requests").json()["items"]
    assert [one["id"] for one in listed] == [row["id"]]
    with open_reading(house.app.state.engine) as session:
        kept = session.get_one(Alignment, row["alignment_id"])
        alignment, request = queries.find_approved(session, kept.run_a_id)
        assert (alignment.id, request.id) == (row["alignment_id"], row["id"])
        assert queries.find_approved(session, kept.run_b_id) is None
        said = [one.action for one in audit.list_records(session) if one.object == f"alignment-requests/{row['id']}"]
        assert sorted(said) == ["approved", "submitted"]
        assert audit.verify(session).ok


def test_one_that_a_gate_blocks_is_not_submitted_and_an_open_one_is_taken_back(house):
    row = aligned(house)
    blocking = house.person("victor").get(f"/api/v1/alignments/{row['id']}/result").json()["gate_report"]["blocking"]
    asked = house.person("ada").post(f"/api/v1/alignments/{row['id']}:submit", json={"reason": "Because."})
    assert (asked.status_code, bool(blocking)) == (409, True)
    request = submitted(house)
    place = f"/api/v1/alignment-requests/{request['id']}:withdraw"
    seen = {"If-Match": f'"v{request["version"]}"'}
    assert house.person("alan").post(place, json={"reason": "Mine?"}, headers=seen).status_code == 403
    assert house.person("ada").post(place, json={"reason": "A later one."}, headers=seen).json()["state"] == "WITHDRAWN"
