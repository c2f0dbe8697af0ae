"""Gate reports of stored sets: what they rest on, when they hold, what they say at submission and on lists."""

from collections.abc import Callable
from typing import Any

import pytest

from boresight.console.approvals import gate_profiles, gates
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.errors import ForbiddenError, NotFoundError, StaleError
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.verdicts.gates import DEFAULT_PROFILE


def limits(**gates: Any) -> dict[str, Any]:
    return {"gates": [{"name": name.replace("_", "-"), **entry} for name, entry in gates.items()]}


@pytest.fixture
def assess(engine, blobs, people):
    def run(parameter_set_id: int, who: str = "ana"):
        with open_reading(engine) as session:
            assessment = gates.measure(session, blobs, None, parameter_set_id)
        with open_writing(engine) as session:
            return gates.record_report(session, people[who], assessment)

    return run


def test_a_set_of_a_poor_run_is_not_blocked_by_the_default_profile(candidate: Callable[..., ParameterSet], assess):
    report = assess(candidate().id).document
    status = {answer["name"]: answer["status"] for answer in report["gates"]}
    assert report["schema"] == "boresight.gate-report/1"
    assert list(status) == [entry["name"] for entry in DEFAULT_PROFILE["gates"]]
    assert [status[name] for name in ("finite", "covariance", "sensor", "convergence")] == ["PASS"] * 4
    assert {status[name] for name in status if name.startswith(("validation", "availability", "matched"))} == {
        "NO-DATA"
    }
    assert (report["verdict"], report["blocking"]) == ("NO-DATA", [])
    assert all(answer["sentence"] for answer in report["gates"])


def test_a_report_binds_what_it_rests_on_and_is_recorded_in_the_audit(candidate, assess, engine):
    row = candidate()
    report = assess(row.id)
    bound = report.document["bound"]
    with open_reading(engine) as session:
        assert bound["incumbent_sha256"] == set_queries.baseline(session, 1).sha256
        assert bound["profile_sha256"] == gate_profiles.profile_in_force(session, 1).sha256
        record = audit.last_change(session, f"parameter-sets/{row.id}/gate-report")
    assert bound["set_sha256"] == row.sha256
    assert bound["table_definition_sha256"] is None
    assert record.after["sha256"] == report.sha256


def test_assessing_twice_gives_one_report(candidate, assess):
    row = candidate()
    assert assess(row.id).id == assess(row.id, "cy").id


def test_a_report_of_what_moved_meanwhile_is_refused(candidate, engine, blobs, people):
    row = candidate()
    with open_reading(engine) as session:
        assessment = gates.measure(session, blobs, None, row.id)
    with open_writing(engine) as session:
        gate_profiles.set_profile(session, people["root"], 1, limits(coverage={"limit": 0.2}), "More stars.", 0)
    with open_writing(engine) as session, pytest.raises(StaleError, match="The profile moved while PS-ST16-1-1"):
        gates.record_report(session, people["ana"], assessment)


def test_a_report_holds_until_the_profile_moves(candidate, assess, engine, people):
    row = candidate()
    with open_reading(engine) as session:
        assert gates.latest_report(session, row.id) is None
    report = assess(row.id)
    with open_reading(engine) as session:
        assert gates.latest_report(session, row.id).id == report.id
    with open_writing(engine) as session:
        gate_profiles.set_profile(session, people["root"], 1, limits(coverage={"limit": 0.2}), "More stars.", 0)
        assert gates.latest_report(session, row.id) is None


def test_the_baseline_has_nothing_to_be_compared_with(assess):
    report = assess(1).document
    answers = {answer["name"]: answer for answer in report["gates"]}
    assert answers["covariance"]["status"] == "PASS"
    assert answers["parameter-shift"]["status"] == "NO-DATA"
    assert "this one is the baseline" in answers["validation-rms-incumbent"]["sentence"]
    assert report["blocking"] == []


def test_a_viewer_records_no_report(candidate, assess):
    with pytest.raises(ForbiddenError, match="analyst or approver or operator or administrator"):
        assess(candidate().id, "eve")


def test_there_is_nothing_to_say_of_no_set(session, blobs):
    with pytest.raises(NotFoundError, match="no parameter set 99"):
        gates.measure(session, blobs, None, 99)


def test_a_submission_takes_the_report_that_holds_or_a_light_one(candidate, assess, engine, blobs, people):
    known, new = candidate(), candidate()
    report = assess(known.id)
    with open_writing(engine) as session:
        assert gates.report_for_submission(session, people["ana"], blobs, known.id).id == report.id
        light = gates.report_for_submission(session, people["ana"], blobs, new.id)
    assert light.parameter_set_id == new.id
    with open_reading(engine) as session:
        assert gates.verdicts(session, [1, known.id, new.id]) == {known.id: "NO-DATA", new.id: "NO-DATA"}
