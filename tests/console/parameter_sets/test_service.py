"""Parameter sets: what they are made of, and who submits and withdraws them."""

from collections.abc import Callable, Mapping
from typing import Any

import pytest

from boresight.console import transitions
from boresight.console.approvals import service as approvals
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.errors import (
    BoresightError,
    ConflictError,
    ForbiddenError,
    NotFoundError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
)
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing

People = Mapping[str, Actor]
Candidate = Callable[..., ParameterSet]
FinishedRun = Callable[..., Run]


def test_a_candidate_says_all_that_it_is_and_is_named_by_its_hash(engine: Engine, candidate: Candidate) -> None:
    row = candidate()
    with open_reading(engine) as session:
        run = session.get_one(Run, row.run_id)
        document = transitions.get_parameter_set(session, row.id).document
    assert (row.name, row.ground_state, row.onboard_state) == ("PS-ST16-1-1", "CANDIDATE", "NOT SENT")
    assert compute_sha256(document) == row.sha256
    assert document["parameters"]["f_m"] == 0.016001
    assert (document["run_id"], document["result_sha256"]) == (run.id, run.result_sha256)
    assert document["units"]["f_m"] == "m"
    assert {"sensor", "camera_model", "sigma", "covariance", "inputs", "status", "advice", "name"} <= set(document)


def test_the_same_run_makes_one_set(engine: Engine, people: People, blobs: BlobStore, candidate: Candidate) -> None:
    row = candidate()
    with open_writing(engine) as session:
        assert row.run_id is not None
        assert parameter_sets.create_from_run(session, people["bo"], blobs, row.run_id).id == row.id


def test_numbers_follow_one_another(candidate: Candidate) -> None:
    assert [candidate().number for _ in range(3)] == [1, 2, 3]


@pytest.mark.parametrize(
    ("made", "error", "says"),
    [
        ({"state": "FAILED"}, ConflictError, r"is FAILED; a parameter set is made of a run that SUCCEEDED"),
        ({"state": "RUNNING"}, ConflictError, r"is RUNNING"),
        (
            {"status": "diverged", "advice": ["Use more stars."]},
            RefusedInputError,
            r"ended diverged.* Use more stars\.",
        ),
        ({"status": "rank_deficient"}, RefusedInputError, r"ended rank_deficient"),
        ({"status": "too_few_stars"}, RefusedInputError, r"ended too_few_stars"),
        ({"parameters": {"f_m": 0.016, "m0_px": None}}, RefusedInputError, r"no number for m0_px, n0_px"),
    ],
)
def test_a_run_that_is_no_calibration_makes_no_set(
    session: Session,
    people: People,
    blobs: BlobStore,
    finished_run: FinishedRun,
    made: dict[str, Any],
    error: type[BoresightError],
    says: str,
) -> None:
    run = finished_run(session, **made)
    with pytest.raises(error, match=says):
        parameter_sets.create_from_run(session, people["ana"], blobs, run.id)
    assert len(parameter_sets.list_parameter_sets(session)) == 1


def test_max_iterations_makes_a_set_that_says_so(
    session: Session, people: People, blobs: BlobStore, finished_run: FinishedRun
) -> None:
    run = finished_run(session, status="max_iterations", advice=["It had not come to rest."])
    document = parameter_sets.create_from_run(session, people["ana"], blobs, run.id).document
    assert (document["status"], document["advice"]) == ("max_iterations", ["It had not come to rest."])


def test_a_result_altered_on_the_disk_makes_no_set(
    session: Session, people: People, blobs: BlobStore, finished_run: FinishedRun
) -> None:
    run = finished_run(session)
    blobs.path(str(run.result_sha256)).write_bytes(b"{}")
    with pytest.raises(ConflictError, match="altered"):
        parameter_sets.create_from_run(session, people["ana"], blobs, run.id)


def test_what_does_not_exist_is_not_found(session: Session, people: People, blobs: BlobStore) -> None:
    with pytest.raises(NotFoundError, match="no run 99"):
        parameter_sets.create_from_run(session, people["ana"], blobs, 99)
    with pytest.raises(NotFoundError, match="no parameter set 99"):
        transitions.get_parameter_set(session, 99)


@pytest.mark.parametrize("name", ["cy", "dee", "eve", "root"])
def test_only_an_analyst_makes_and_submits(
    session: Session, people: People, blobs: BlobStore, finished_run: FinishedRun, name: str
) -> None:
    run = finished_run(session)
    with pytest.raises(ForbiddenError, match="role analyst"):
        parameter_sets.create_from_run(session, people[name], blobs, run.id)
    row = parameter_sets.create_from_run(session, people["ana"], blobs, run.id)
    with pytest.raises(ForbiddenError, match="role analyst"):
        approvals.submit(session, people[name], blobs, row.id, "better", row.version)
    assert row.ground_state == "CANDIDATE"


def test_nobody_in_particular_cannot_submit(engine: Engine, candidate: Candidate, blobs: BlobStore) -> None:
    row = candidate()
    with open_writing(engine) as session, pytest.raises(ForbiddenError, match="answer for this"):
        approvals.submit(session, COMMAND_LINE, blobs, row.id, "better", row.version)


def test_a_request_binds_set_run_and_incumbent(engine: Engine, submitted: Callable[[], ParameterSet]) -> None:
    row = submitted()
    with open_reading(engine) as session:
        approval = approvals.list_approvals(session)[0]
        incumbent = set_queries.baseline(session, row.sensor_id)
        run = session.get_one(Run, row.run_id)
        assert incumbent is not None
    hashes = {"set_sha256": row.sha256, "run_result_sha256": run.result_sha256, "incumbent_sha256": incumbent.sha256}
    assert hashes.items() <= approval.bound.items()
    assert set(approval.bound) - set(hashes) == {
        "gate_report_sha256",
        "profile_sha256",
        "table_definition_sha256",
        "waivers",
    }


def test_a_transition_needs_the_version_that_was_seen(
    engine: Engine, people: People, candidate: Candidate, blobs: BlobStore
) -> None:
    row = candidate()
    with open_writing(engine) as session, pytest.raises(PreconditionRequiredError, match="If-Match"):
        approvals.submit(session, people["ana"], blobs, row.id, "better", None)


def test_an_old_version_is_told_who_changed_what_and_when(
    engine: Engine, people: People, submitted: Callable[[], ParameterSet]
) -> None:
    row = submitted()
    with open_writing(engine) as session, pytest.raises(StaleError) as refusal:
        approvals.withdraw(session, people["ana"], row.id, 1)
    assert "you saw v1, it is v2" in str(refusal.value)
    assert "Ana submitted it at 20" in str(refusal.value)


def test_a_submission_needs_its_reason(engine: Engine, people: People, candidate: Candidate, blobs: BlobStore) -> None:
    row = candidate()
    with open_writing(engine) as session, pytest.raises(RefusedInputError, match="Give the reason"):
        approvals.submit(session, people["ana"], blobs, row.id, "  ", row.version)


def test_what_is_submitted_is_not_submitted_again(
    engine: Engine, people: People, submitted: Callable[[], ParameterSet], blobs: BlobStore
) -> None:
    row = submitted()
    with open_writing(engine) as session, pytest.raises(ConflictError, match="is SUBMITTED: Ana submitted it"):
        approvals.submit(session, people["bo"], blobs, row.id, "better", row.version)


def test_the_submitter_withdraws_and_may_submit_again(
    engine: Engine, people: People, approved: Callable[[], ParameterSet], blobs: BlobStore
) -> None:
    row = approved()
    with open_writing(engine) as session:
        withdrawn = approvals.withdraw(session, people["ana"], row.id, row.version, "found a mistake")
        assert withdrawn.ground_state == "WITHDRAWN"
        assert approvals.list_approvals(session)[0].state == "WITHDRAWN"
        assert approvals.submit(session, people["ana"], blobs, row.id, "no mistake", withdrawn.version).state == "OPEN"


def test_another_analyst_does_not_withdraw(
    engine: Engine, people: People, submitted: Callable[[], ParameterSet]
) -> None:
    row = submitted()
    with open_writing(engine) as session, pytest.raises(ForbiddenError, match="administrator"):
        approvals.withdraw(session, people["bo"], row.id, row.version)


def test_a_candidate_has_nothing_to_withdraw_or_promote(engine: Engine, people: People, candidate: Candidate) -> None:
    row = candidate()
    with open_writing(engine) as session, pytest.raises(ConflictError, match="not submitted"):
        approvals.withdraw(session, people["ana"], row.id, row.version)
    with open_writing(engine) as session, pytest.raises(ConflictError, match="is CANDIDATE, not APPROVED"):
        approvals.promote(session, people["dee"], row.id, row.version)
