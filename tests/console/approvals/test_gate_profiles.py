"""Gate profiles of stored sensors: who sets them, what they move, and what they would have blocked."""

from typing import Any

import pytest

from boresight.console import transitions
from boresight.console.approvals import gate_profiles, gates
from boresight.console.approvals import service as approvals
from boresight.errors import ForbiddenError, NotFoundError, PreconditionRequiredError, RefusedInputError, StaleError
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.verdicts.gates import DEFAULT_PROFILE

SHIFT = {"gates": [{"name": "parameter-shift", "limit": 1e-6, "marginal": 1e-6}]}


@pytest.fixture
def set_profile(engine, people):
    def act(who: str | Actor = "root", seen: int | None = 0, **given: Any):
        values = {"sensor_id": 1, "document": SHIFT, "reason": "To be tried.", **given}
        with open_writing(engine) as session:
            return gate_profiles.set_profile(
                session, people[who] if isinstance(who, str) else who, seen_number=seen, **values
            )

    return act


def test_the_default_is_in_force_until_another_is_set(engine, set_profile):
    with open_reading(engine) as session:
        row = gate_profiles.profile_in_force(session, 1)
        assert (row.number, row.document, row.id) == (0, DEFAULT_PROFILE, None)
        assert [one.number for one in gate_profiles.list_profiles(session, 1)] == [0]
    set_profile()
    with open_reading(engine) as session:
        assert [one.number for one in gate_profiles.list_profiles(session, 1)] == [1, 0]
        assert [one.number for one in gate_profiles.list_profiles(session, 1, before_number=1)] == [0]
        first = gate_profiles.list_profiles(session, 1)[1]
        assert (first.sha256, first.created_by) == (gate_profiles.DEFAULT_SHA256, None)


def test_the_default_is_written_once_however_often_it_is_needed(engine, people):
    with open_writing(engine) as session:
        numbers = {gate_profiles.ensure_profile(session, people["ana"], 1).id for _ in range(3)}
        assert len(numbers) == 1


@pytest.mark.parametrize("who", ["ana", "bo", "cy", "dee", "eve"])
def test_who_runs_signs_or_flies_sets_no_limits(set_profile, who):
    with pytest.raises(ForbiddenError, match="administrator"):
        set_profile(who)


def test_a_key_sets_limits_only_within_its_scope(set_profile, people):
    root = people["root"]
    key = Actor(root.user_id, "root", "Root", root.roles, "key:bs_1", frozenset({"runs"}))
    with pytest.raises(ForbiddenError, match="scope sensors"):
        set_profile(key)
    assert set_profile(COMMAND_LINE).number == 1


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"sensor_id": 99}, NotFoundError, "no sensor 99"),
        ({"reason": " "}, RefusedInputError, "Give the reason"),
        ({"document": {"gates": []}}, RefusedInputError, "in force already"),
        ({"document": {"gates": [{"name": "beauty"}]}}, RefusedInputError, "no gate 'beauty'"),
        ({"seen": None}, PreconditionRequiredError, "If-Match"),
        ({"seen": 3}, StaleError, "you saw v3, it is v0"),
    ],
)
def test_what_is_no_profile_is_refused(set_profile, given, error, words):
    with pytest.raises(error, match=words):
        set_profile(**given)


def test_the_audit_tells_the_thresholds_that_changed_before_and_after(set_profile, engine):
    set_profile()
    with open_reading(engine) as session:
        record = audit.last_change(session, "sensors/1/gate-profiles")
    assert record.before["parameter-shift limit"] is None
    assert record.after["parameter-shift limit"] == 1e-6
    assert record.after["version"] == 1
    assert set(record.after) == {"version", "sha256", "parameter-shift limit", "parameter-shift marginal"}


def test_other_limits_make_undecided_requests_stale(set_profile, submitted, engine):
    row = submitted()
    set_profile()
    with open_reading(engine) as session:
        request = approvals.list_approvals(session, parameter_set_id=row.id)[0]
        assert request.state == "STALE"
        assert transitions.get_parameter_set(session, row.id).ground_state == "CANDIDATE"


def test_a_dry_run_says_of_every_past_run_what_would_have_been_blocked_and_stores_nothing(
    engine, blobs, people, candidate, finished_run
):
    assessed = candidate()
    with open_writing(engine) as session:
        gates.report_for_submission(session, people["ana"], blobs, assessed.id)
        never_made = finished_run(session).id
        finished_run(session, state="FAILED")
    with open_reading(engine) as session:
        tried = gate_profiles.dry_run(session, blobs, 1, SHIFT)
    assert [(one.run.id, one.set_name) for one in tried] == [(never_made, None), (assessed.run_id, assessed.name)]
    assert [one.blocking for one in tried] == [[], ["parameter-shift"]]  # the first is where the sensor started
    assert [one.blocking_now for one in tried] == [[], []]
    assert [one.basis for one in tried] == ["the run's own result", "the set's gate report"]
    with open_reading(engine) as session:
        assert gate_profiles.profile_in_force(session, 1).number == 0


def test_a_dry_run_of_what_is_no_profile_is_refused(engine, blobs):
    with open_reading(engine) as session, pytest.raises(RefusedInputError, match="no gate 'beauty'"):
        gate_profiles.dry_run(session, blobs, 1, {"gates": [{"name": "beauty"}]})
