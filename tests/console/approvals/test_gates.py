"""Gate reports of stored sets: what they rest on, when they hold, what they say at submission and on lists."""

import json
import zipfile
from typing import Any

import pytest

from boresight.console import list_queries as lists
from boresight.console.approvals import gate_profiles, gates
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import queries as gate_rows
from boresight.console.approvals import service as approvals
from boresight.console.approvals.pages.gates import make_gates_panel
from boresight.console.approvals.tables import Approval
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.uplinks import packages
from boresight.errors import (
    ConflictError,
    ForbiddenError,
    NotFoundError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
    UnauthenticatedError,
)
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.db import sessions
from boresight.platform.db.sessions import open_reading, open_writing, utc_after, utc_now
from boresight.verdicts.gates import DEFAULT_PROFILE, BoundGateReport
from boresight.verdicts.gates.measurements import IS_INCUMBENT
from tests.console.conftest import PASSWORD
from tests.passwords import approve, proved
from tests.refusals import has_code


@pytest.fixture
def assess(engine, blobs, people):
    def run(parameter_set_id: int, who: str = "ana"):
        with open_reading(engine) as session:
            assessment = gates.measure(session, blobs, None, parameter_set_id)
        with open_writing(engine) as session:
            return gates.record_report(session, people[who], assessment)

    return run


def test_a_set_of_a_poor_run_is_not_blocked_by_the_default_profile(candidate, assess):
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
        assert bound["incumbent_sha256"] == set_queries.find_baseline(session, 1).sha256
        assert bound["profile_sha256"] == gate_profiles.get_profile_in_force(session, 1).sha256
        record = audit.find_last_change(session, f"parameter-sets/{row.id}/gate-report")
    assert bound["set_sha256"] == row.sha256
    assert bound["table_definition_sha256"] is None
    assert record.after["sha256"] == report.sha256


def test_a_report_of_what_moved_meanwhile_is_refused(candidate, set_profile, engine, blobs, people):
    row = candidate()
    with open_reading(engine) as session:
        assessment = gates.measure(session, blobs, None, row.id)
    set_profile()
    with (
        open_writing(engine) as session,
        pytest.raises(StaleError, match=r"profile.*PS-ST16-1-1", check=has_code("changed-while-assessed")),
    ):
        gates.record_report(session, people["ana"], assessment)


def test_a_report_holds_until_the_profile_moves(candidate, assess, engine, set_profile):
    row = candidate()
    with open_reading(engine) as session:
        assert gates.find_valid_report(session, row.id) is None
    report = assess(row.id)
    assert assess(row.id, "cy").id == report.id
    with open_reading(engine) as session:
        assert gates.find_valid_report(session, row.id).id == report.id
    set_profile()
    with open_reading(engine) as session:
        assert gates.find_valid_report(session, row.id) is None
        assert gates.list_moved_since(session, report) == ["profile_sha256"]


@pytest.mark.parametrize(("state", "shown"), [("SUBMITTED", ["incumbent_sha256"]), ("BASELINE", [])])
def test_a_page_warns_of_another_baseline_unless_the_set_is_that_baseline(
    candidate, assess, engine, people, state, shown
):
    row, other = candidate(), candidate()
    assess(row.id)
    with open_writing(engine) as session:
        for number, new in (
            (1, "SUPERSEDED"),
            (row.id, state),
            (row.id if state == "BASELINE" else other.id, "BASELINE"),
        ):
            session.get_one(ParameterSet, number).ground_state = new
            audit.append(session, people["root"], "exchanged", f"parameter-sets/{number}")
        panel = make_gates_panel(session, people["ana"], session.get_one(ParameterSet, row.id))
    assert panel.moved == shown


def test_the_baseline_has_nothing_to_be_compared_with(assess):
    report = assess(1).document
    answers = {answer["name"]: answer for answer in report["gates"]}
    assert answers["covariance"]["status"] == "PASS"
    assert answers["parameter-shift"]["status"] == "NO-DATA"
    assert IS_INCUMBENT in answers["validation-rms-incumbent"]["sentence"]
    assert report["blocking"] == []


def test_a_viewer_records_no_report(candidate, assess):
    with pytest.raises(
        ForbiddenError, match=r"analyst.*approver.*operator.*administrator", check=has_code("role-missing")
    ):
        assess(candidate().id, "eve")


def test_a_submission_takes_the_report_that_holds_or_a_light_one(candidate, assess, engine, blobs, people):
    known, new = candidate(), candidate()
    report = assess(known.id)
    with open_writing(engine) as session:
        assert gates.choose_report_for_submission(session, people["ana"], blobs, known.id).id == report.id
        light = gates.choose_report_for_submission(session, people["ana"], blobs, new.id)
    assert light.parameter_set_id == new.id
    with open_reading(engine) as session:
        found = gates.read_verdicts(session, [1, known.id, new.id])
    assert {number: one.verdict for number, one in found.items()} == {known.id: "NO-DATA", new.id: "NO-DATA"}


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
        row = gate_profiles.get_profile_in_force(session, 1)
        assert (row.number, row.document, row.id) == (0, DEFAULT_PROFILE, None)
        assert [one.number for one in gate_profiles.list_profiles(session, 1)] == [0]
    set_profile()
    with open_reading(engine) as session:
        assert [one.number for one in gate_profiles.list_profiles(session, 1)] == [1, 0]
        first = gate_profiles.list_profiles(session, 1)[1]
        assert (first.sha256, first.created_by) == (gate_profiles.DEFAULT_SHA256, None)


def test_the_default_is_written_once_however_often_it_is_needed(engine, people):
    with open_writing(engine) as session:
        numbers = {gate_profiles.ensure_profile(session, people["ana"], 1).id for _ in range(3)}
        assert len(numbers) == 1


def test_who_is_no_administrator_sets_no_limits_nor_a_key_beyond_its_scope(set_profile, people):
    for who in ("ana", "bo", "cy", "dee", "eve"):
        with pytest.raises(ForbiddenError, match="administrator"):
            set_profile(who)
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
        ({"document": {"gates": []}}, RefusedInputError, "already in force"),
        ({"document": {"gates": [{"name": "beauty"}]}}, RefusedInputError, "no gate 'beauty'"),
        ({"seen": None}, PreconditionRequiredError, "If-Match"),
        ({"seen": 3}, StaleError, "you saw v3, it is now v0"),
    ],
)
def test_what_is_no_profile_is_refused(set_profile, given, error, words):
    with pytest.raises(error, match=words):
        set_profile(**given)


def test_the_audit_tells_the_thresholds_that_changed_before_and_after(set_profile, engine):
    set_profile()
    with open_reading(engine) as session:
        record = audit.find_last_change(session, "sensors/1/gate-profiles")
    assert record.before["parameter-shift limit"] is None
    assert record.after["parameter-shift limit"] == 1e-6
    assert record.after["version"] == 1
    assert set(record.after) == {"version", "sha256", "parameter-shift limit", "parameter-shift marginal"}


def test_other_limits_make_undecided_requests_stale(set_profile, submitted, engine):
    row = submitted()
    set_profile()
    with open_reading(engine) as session:
        request = lists.list_newest(session, Approval, set=row.id)[0]
        assert request.state == "STALE"
        assert session.get_known(ParameterSet, row.id).ground_state == "CANDIDATE"


def test_a_dry_run_says_of_every_past_run_what_would_have_been_blocked_and_stores_nothing(
    engine, blobs, people, candidate, finished_run
):
    assessed = candidate()
    with open_writing(engine) as session:
        gates.choose_report_for_submission(session, people["ana"], blobs, assessed.id)
        never_made = finished_run(session).id
        finished_run(session, state="FAILED")
    with open_reading(engine) as session:
        tried = gate_profiles.dry_run(session, blobs, 1, SHIFT)
    assert [(one.run.id, one.parameter_set) for one in tried] == [(never_made, None), (assessed.run_id, assessed.name)]
    assert [one.blocking for one in tried] == [[], ["parameter-shift"]]  # the first is where the sensor started
    assert [one.blocking_now for one in tried] == [[], []]
    assert [one.basis for one in tried] == ["the run's own result", "the set's gate report"]
    with open_reading(engine) as session:
        assert gate_profiles.get_profile_in_force(session, 1).number == 0


def test_a_dry_run_of_what_is_no_profile_is_refused(engine, blobs):
    with open_reading(engine) as session, pytest.raises(RefusedInputError, match="no gate 'beauty'"):
        gate_profiles.dry_run(session, blobs, 1, {"gates": [{"name": "beauty"}]})


REASON = "The shift is the one that launch made; we know it."
DAY_S = 86400.0


@pytest.fixture
def blocked(engine, blobs, people, candidate, set_profile) -> ParameterSet:
    row = candidate()
    set_profile()
    with open_writing(engine) as session:
        report = gates.choose_report_for_submission(session, people["ana"], blobs, row.id)
    assert report.document["blocking"] == ["parameter-shift"]
    return row


@pytest.fixture
def waive(engine, people, blocked):
    def act(who: str | Actor = "ana", seen: int | None = blocked.version, **given: Any):
        values = {"gate": "parameter-shift", "code": "known-cause", "reason": REASON, "password": PASSWORD}
        values |= {"expires_utc": utc_after(DAY_S), "parameter_set_id": blocked.id, **given}
        actor = people[who] if isinstance(who, str) else who
        with open_writing(engine) as session:
            values["proof"] = proved(session, actor, values.pop("password"))
            return gates.waive(session, actor, seen_version=seen, **values)

    return act


def find_report(engine, parameter_set_id: int) -> BoundGateReport:
    with open_reading(engine) as session:
        return gates.lay_waivers(session, gate_rows.find_newest_report(session, parameter_set_id))


@pytest.mark.parametrize("who", ["ana", "cy", "bo"])
def test_an_analyst_or_an_approver_waives_in_person(waive, engine, blocked, who):
    waiver = waive(who)
    found = find_report(engine, blocked.id)
    assert (found.blocking, found.waived) == ([], ["parameter-shift"])
    assert found.words == "NO-DATA (1 gate waived)"
    assert (waiver.reason, waiver.printed_name) == (REASON, who.title())
    with open_reading(engine) as session:
        record = audit.find_last_change(session, f"parameter-sets/{blocked.id}/waivers")
        assert (record.actor, record.reason, record.after["gate"]) == (who.title(), REASON, "parameter-shift")
        assert [one.id for one in approval_queries.list_waivers_in_force(session, blocked.id, utc_now())] == [waiver.id]


def test_neither_another_role_nor_a_key_nor_the_command_line_waives(waive, people):
    key = Actor(people["ana"].user_id, "ana", "Ana", people["ana"].roles, "key:bs_1", frozenset({"parameter-sets"}))
    said = dict.fromkeys(("dee", "eve", "root"), "analyst or approver")
    said |= dict.fromkeys((key, COMMAND_LINE), "Only a person who is logged in may waive a gate")
    for actor, words in said.items():
        with pytest.raises(ForbiddenError, match=words):
            waive(actor)


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"password": "wrong"}, UnauthenticatedError, "assword"),
        ({"reason": "Too short a reason."}, RefusedInputError, "at least 20 letters"),
        ({"reason": " " * 30}, RefusedInputError, "at least 20 letters"),
        ({"reason": REASON + "\x07"}, RefusedInputError, "control character"),
        ({"code": "because"}, RefusedInputError, "choose from known-cause"),
        ({"gate": "beauty"}, RefusedInputError, "no gate 'beauty'"),
        ({"gate": "coverage"}, ConflictError, "does not block"),
        ({"gate": "finite"}, ConflictError, "does not block"),
        ({"expires_utc": "2020-01-01T00:00:00Z"}, RefusedInputError, "cannot expire at"),
        ({"expires_utc": "9999-12-31"}, RefusedInputError, "cannot expire at"),
        ({"expires_utc": "soon"}, RefusedInputError, "'soon' is not a time"),
        ({"parameter_set_id": 99}, NotFoundError, "no parameter set 99"),
        ({"expires_utc": utc_after(30 * DAY_S + 7200)}, RefusedInputError, "within 30 days"),
        ({"seen": None}, PreconditionRequiredError, "If-Match"),
        ({"seen": 77}, StaleError, "changed since you read it"),
    ],
)
def test_what_is_no_waiver_is_refused_and_leaves_nothing(waive, engine, blocked, given, error, words):
    with pytest.raises(error, match=words):
        waive(**given)
    assert find_report(engine, blocked.id).words == "FAIL"


def test_a_gate_that_the_profile_does_not_let_be_waived_stays(waive, set_profile, engine, blobs, people, blocked):
    set_profile(seen=1, document={"gates": [{**SHIFT["gates"][0], "waivable": False}]})
    with open_writing(engine) as session:
        gates.choose_report_for_submission(session, people["ana"], blobs, blocked.id)
    with pytest.raises(ForbiddenError, check=has_code("gate-not-waivable")):
        waive()


def test_what_was_assessed_under_other_limits_is_assessed_again_before_it_is_waived(waive, set_profile):
    set_profile(seen=1, document={"gates": []})
    with pytest.raises(ConflictError, check=has_code("no-gate-report")):
        waive()


def test_a_gate_is_waived_once_for_up_to_30_days_and_a_waiver_that_expires_blocks_again_and_stays_in_the_words(
    waive, engine, blocked, monkeypatch
):
    waive(expires_utc=utc_after(30 * DAY_S - 1))
    with pytest.raises(ConflictError, match="waived already", check=has_code("gate-does-not-block")):
        waive("cy")
    later = sessions.utc_after(31 * DAY_S)
    monkeypatch.setattr(gates, "utc_now", lambda: later)
    found = find_report(engine, blocked.id)
    assert (found.words, found.blocking) == ("FAIL (1 gate waived)", ["parameter-shift"])
    with open_reading(engine) as session:
        assert approval_queries.list_waivers_in_force(session, blocked.id, later) == []
        assert len(approval_queries.list_waivers(session, [blocked.id])) == 1


def test_baseline_and_package_tell_the_verdict_that_was_signed_also_when_its_waiver_is_over(
    waive, engine, blobs, people, blocked, monkeypatch
):
    def export(session, row):
        return packages.build(
            session, people["dee"], blobs, row.id, packages.prepare(session, people["dee"], blobs, row.id)
        )

    waive()
    with open_writing(engine) as session:
        request = approvals.submit(session, people["ana"], blobs, blocked.id, "With the waiver.", blocked.version)
        for name in ("cy", "bo"):
            approve(session, people[name], request)
        row = session.get_known(ParameterSet, blocked.id)
        approvals.promote(session, people["dee"], row.id, row.version)
        package = export(session, row)
        assert set_queries.find_baseline(session, 1).id == blocked.id
        shown = gates.read_verdicts(session, [blocked.id])[blocked.id].words
    assert shown == "NO-DATA (1 gate waived)"
    with zipfile.ZipFile(blobs.path(package.sha256)) as packed:
        said = json.loads(packed.read("MANIFEST.json"))["gates"]
        assert f"<h2>Gates: {shown}</h2>" in packed.read("verification_sheet.html").decode()
    assert (said["words"], said["verdict"], said["waived"]) == (shown, "NO-DATA", ["parameter-shift"])
    assert said["document"]["verdict"] == "FAIL", "the report itself stays as its hash has it"
    later = sessions.utc_after(2 * DAY_S)
    monkeypatch.setattr(gates, "utc_now", lambda: later)
    with open_writing(engine) as session:
        assert export(session, blocked).id == package.id
