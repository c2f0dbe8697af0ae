"""Waivers: in person, with a reason and an end, never of a critical gate, and in the verdict for ever."""

import json
import zipfile
from typing import Any

import pytest

from boresight.console import transitions
from boresight.console.approvals import gate_profiles, gates
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
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
from tests.console.conftest import PASSWORD
from tests.passwords import approve, proved

REASON = "The shift is the one that launch made; we know it."
DAY_S = 86400.0
TIGHT = {"gates": [{"name": "parameter-shift", "limit": 1e-6, "marginal": 1e-6}]}


@pytest.fixture
def blocked(engine, blobs, people, candidate) -> ParameterSet:
    row = candidate()
    with open_writing(engine) as session:
        gate_profiles.set_profile(session, people["root"], 1, TIGHT, "To be tried.", 0)
        report = gates.report_for_submission(session, people["ana"], blobs, row.id)
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


def document(engine, parameter_set_id: int) -> dict[str, Any]:
    with open_reading(engine) as session:
        return gates.with_waivers(session, gates.newest_report(session, parameter_set_id))


@pytest.mark.parametrize("who", ["ana", "cy", "bo"])
def test_an_analyst_or_an_approver_waives_in_person(waive, engine, blocked, who):
    waiver = waive(who)
    found = document(engine, blocked.id)
    assert (found["blocking"], found["waived"]) == ([], ["parameter-shift"])
    assert found["words"] == "NO-DATA (1 gate waived)"
    assert (waiver.reason, waiver.printed_name) == (REASON, who.title())
    with open_reading(engine) as session:
        record = audit.last_change(session, f"parameter-sets/{blocked.id}/waivers")
        assert (record.actor, record.reason, record.after["gate"]) == (who.title(), REASON, "parameter-shift")
        assert [one.id for one in approval_queries.waivers_in_force(session, blocked.id, utc_now())] == [waiver.id]


@pytest.mark.parametrize("who", ["dee", "eve", "root"])
def test_no_other_role_waives(waive, who):
    with pytest.raises(ForbiddenError, match="analyst or approver"):
        waive(who)


def test_neither_a_key_nor_the_command_line_waives(waive, people):
    key = Actor(people["ana"].user_id, "ana", "Ana", people["ana"].roles, "key:bs_1", frozenset({"parameter-sets"}))
    for actor in (key, COMMAND_LINE):
        with pytest.raises(ForbiddenError, match="Only a person who is logged in may waive a gate"):
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
        ({"expires_utc": "2020-01-01T00:00:00Z"}, RefusedInputError, "in the future and within 30 days"),
        ({"expires_utc": "9999-12-31"}, RefusedInputError, "in the future and within 30 days"),
        ({"expires_utc": "soon"}, RefusedInputError, "'soon' is no time"),
        ({"parameter_set_id": 99}, NotFoundError, "no parameter set 99"),
        ({"seen": None}, PreconditionRequiredError, "If-Match"),
        ({"seen": 77}, StaleError, "changed since you looked"),
    ],
)
def test_what_is_no_waiver_is_refused_and_leaves_nothing(waive, engine, blocked, given, error, words):
    with pytest.raises(error, match=words):
        waive(**given)
    assert document(engine, blocked.id)["words"] == "FAIL"


def test_a_waiver_of_thirty_days_is_taken_and_of_more_is_not(waive):
    waive(expires_utc=utc_after(30 * DAY_S - 1))
    with pytest.raises(RefusedInputError, match="within 30 days"):
        waive(expires_utc=utc_after(30 * DAY_S + 60))


def test_a_gate_that_is_waived_is_not_waived_again(waive):
    waive()
    with pytest.raises(ConflictError, match="it is waived already"):
        waive("cy")


def test_a_gate_that_the_profile_does_not_let_be_waived_stays(waive, engine, blobs, people, blocked):
    entry = {**TIGHT["gates"][0], "waivable": False}
    with open_writing(engine) as session:
        gate_profiles.set_profile(session, people["root"], 1, {"gates": [entry]}, "Not this one.", 1)
        gates.report_for_submission(session, people["ana"], blobs, blocked.id)
    with pytest.raises(ForbiddenError, match="the gate profile does not let it be waived"):
        waive()


def test_what_was_assessed_under_other_limits_is_assessed_again_before_it_is_waived(waive, engine, people):
    with open_writing(engine) as session:
        gate_profiles.set_profile(session, people["root"], 1, {"gates": []}, "As before.", 1)
    with pytest.raises(ConflictError, match="no gate report that holds now: assess it"):
        waive()


def test_a_waiver_that_expires_blocks_again_and_stays_in_the_words(waive, engine, blocked, monkeypatch):
    waive()
    later = sessions.utc_after(2 * DAY_S)
    monkeypatch.setattr(gates, "utc_now", lambda: later)
    found = document(engine, blocked.id)
    assert (found["words"], found["blocking"]) == ("FAIL (1 gate waived)", ["parameter-shift"])
    with open_reading(engine) as session:
        assert approval_queries.waivers_in_force(session, blocked.id, later) == []
        assert len(gates.all_waivers(session, blocked.id)) == 1


def test_waiving_makes_an_open_request_stale_and_the_next_one_needs_two_approvals(
    waive, engine, blobs, people, blocked
):
    with open_writing(engine) as session:
        first = approvals.submit(session, people["ana"], blobs, blocked.id, "It moved.", blocked.version)
        seen = transitions.get_parameter_set(session, blocked.id).version
    assert first.needed == 1
    waive(seen=seen)
    with open_writing(engine) as session:
        assert transitions.get_approval(session, first.id).state == "STALE"
        row = transitions.get_parameter_set(session, blocked.id)
        again = approvals.submit(session, people["ana"], blobs, row.id, "With the waiver.", row.version)
        assert again.needed == 2


def test_a_set_that_is_promoted_with_a_waiver_tells_of_it_as_baseline(waive, engine, blobs, people, blocked):
    waive()
    with open_writing(engine) as session:
        request = approvals.submit(session, people["ana"], blobs, blocked.id, "With the waiver.", blocked.version)
        for name in ("cy", "bo"):
            approve(session, people[name], request)
        row = transitions.get_parameter_set(session, blocked.id)
        approvals.promote(session, people["dee"], row.id, row.version)
    with open_reading(engine) as session:
        assert set_queries.baseline(session, 1).id == blocked.id
        assert gates.verdicts(session, [blocked.id]) == {blocked.id: "NO-DATA (1 gate waived)"}


def test_a_package_tells_the_verdict_that_was_signed_also_when_its_waiver_is_over(
    waive, engine, blobs, people, blocked, monkeypatch
):
    waive()
    with open_writing(engine) as session:
        request = approvals.submit(session, people["ana"], blobs, blocked.id, "With the waiver.", blocked.version)
        for name in ("cy", "bo"):
            approve(session, people[name], request)
        row = transitions.get_parameter_set(session, blocked.id)
        approvals.promote(session, people["dee"], row.id, row.version)
        package = packages.build(session, people["dee"], blobs, row.id)
        shown = gates.verdicts(session, [blocked.id])[blocked.id]
    with zipfile.ZipFile(blobs.path(package.sha256)) as packed:
        said = json.loads(packed.read("MANIFEST.json"))["gates"]
        assert f"<h2>Gates: {shown}</h2>" in packed.read("verification_sheet.html").decode()
    assert (said["words"], said["verdict"], said["waived"]) == (shown, "NO-DATA", ["parameter-shift"])
    assert said["document"]["verdict"] == "FAIL", "the report itself stays as its hash has it"
    later = sessions.utc_after(2 * DAY_S)
    monkeypatch.setattr(gates, "utc_now", lambda: later)
    with open_writing(engine) as session:
        assert packages.build(session, people["dee"], blobs, blocked.id).id == package.id
