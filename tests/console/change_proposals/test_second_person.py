"""A second person for gate limits and table layouts: proposed, confirmed by another, bound to the version in force."""

import threading
from collections.abc import Callable, Mapping
from typing import Any

import pytest
import sqlalchemy as sa

from boresight.console.access import api_keys, users
from boresight.console.access.tables import User
from boresight.console.alarms import rules as alarm_rules
from boresight.console.approvals import gate_profiles
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval, GateProfile
from boresight.console.change_proposals import service as proposals
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet import service as sensors
from boresight.console.uplinks import table_definitions
from boresight.errors import BoresightError, ConflictError, ForbiddenError, RefusedInputError, StaleError
from boresight.platform.actors import COMMAND_LINE, Actor, Policy
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_after
from boresight.settings import read_settings
from boresight.uplink.table_definition import plain_definition
from tests.console.conftest import SENSOR
from tests.passwords import add_person
from tests.refusals import has_code

People = Mapping[str, Actor]
ON = Policy(second_person=True)
SHIFT = {"gates": [{"name": "parameter-shift", "limit": 1e6, "marginal": 1e6}]}


@pytest.fixture
def two(engine) -> People:
    with open_writing(engine) as session:
        for name, role in (("rita", "administrator"), ("ann", "analyst")):
            add_person(session, name, role)
    with open_reading(engine) as session:
        rows = {row.name: row for row in users.list_users(session)}
        return {name: users.get_actor(session, row.id) for name, row in rows.items()}


@pytest.fixture
def propose(engine, two) -> Callable[..., ChangeProposal]:
    def make(
        who: str | Actor = "root", document: Mapping[str, Any] = SHIFT, kind: str = "gate-profile"
    ) -> ChangeProposal:
        actor = two[who] if isinstance(who, str) else who
        with open_writing(engine) as session:
            made = proposals.change(session, actor, kind, 1, document, "To be tried.", 0, policy=ON)
        assert isinstance(made, ChangeProposal)
        return made

    return make


def _confirm(engine: Engine, actor: Actor, row: ChangeProposal, seen: int = 1) -> ChangeProposal:
    with open_writing(engine) as session:
        return proposals.confirm(session, actor, row.id, seen)


def _state(engine: Engine, row: ChangeProposal) -> str:
    with open_reading(engine) as session:
        return session.get_known(ChangeProposal, row.id).state


def _in_force(engine: Engine) -> int:
    with open_reading(engine) as session:
        return gate_profiles.get_profile_in_force(session, 1).number


def test_a_proposed_change_takes_effect_only_when_another_confirms_it(engine, two, propose):
    row = propose()
    assert (row.state, row.base_number, _in_force(engine)) == ("OPEN", 0, 0)
    with pytest.raises(ForbiddenError, check=has_code("own-proposal")):
        _confirm(engine, two["root"], row)
    done = _confirm(engine, two["rita"], row)
    assert (done.state, done.number, done.closed_by, _in_force(engine)) == ("CONFIRMED", 1, two["rita"].user_id, 1)
    with open_reading(engine) as session:
        profile = gate_profiles.get_profile_in_force(session, 1)
        assert (profile.created_by, profile.sha256) == (two["root"].user_id, row.sha256)
        record = audit.find_last_change(session, f"change-proposals/{row.id}")
        assert (record.actor, record.action, record.after["number"]) == ("Rita", "confirmed", 1)
        put = audit.find_last_change(session, "sensors/1/gate-profiles")
        assert put.after["proposal"] == row.id
        assert audit.verify(session).ok


@pytest.mark.parametrize("name", ["ana", "bo", "cy", "dee", "eve"])
def test_only_who_may_make_the_change_confirms_or_refuses_it(engine, two, propose, name):
    row = propose()
    for decide in (proposals.confirm, proposals.refuse):
        with open_writing(engine) as session, pytest.raises(ForbiddenError, match="administrator"):
            decide(session, two[name], row.id, 1, "no")
    assert _state(engine, row) == "OPEN"


def test_no_key_nor_a_given_password_confirms_and_what_a_key_proposed_is_its_owners(engine, two, propose):
    with open_writing(engine) as session:
        secrets = [
            api_keys.create_key(session, two[name], label="robot", scopes=["sensors"])[1] for name in ("root", "rita")
        ]
        own, other = (api_keys.find_actor_of_key(session, secret) for secret in secrets)
    row = propose(own)
    for actor in (own, other, COMMAND_LINE):
        with pytest.raises(ForbiddenError, check=has_code("not-a-person")):
            _confirm(engine, actor, row)
    with pytest.raises(ForbiddenError, match="You proposed"):
        _confirm(engine, two["root"], row)
    with open_writing(engine) as session:
        session.get_one(User, two["rita"].user_id).must_change_password = 1
        audit.append(session, COMMAND_LINE, "changed", "users/1")
    with pytest.raises(ForbiddenError, check=has_code("password-due")):
        _confirm(engine, two["rita"], row)
    with open_writing(engine) as session:
        session.get_one(User, two["rita"].user_id).must_change_password = 0
        audit.append(session, COMMAND_LINE, "changed", "users/1")
    assert _confirm(engine, two["rita"], row).state == "CONFIRMED"


def test_a_refusal_needs_a_comment_and_a_withdrawal_its_owner(engine, two, propose):
    row, other = propose(), propose(document={"gates": [{"name": "coverage", "limit": 0.2}]})
    with open_writing(engine) as session, pytest.raises(RefusedInputError, match="Say why"):
        proposals.refuse(session, two["rita"], row.id, 1, " ")
    with open_writing(engine) as session:
        assert proposals.refuse(session, two["rita"], row.id, 1, "Too loose.").comment == "Too loose."
    with open_writing(engine) as session, pytest.raises(ForbiddenError):
        proposals.withdraw(session, two["ana"], other.id, 1)
    with open_writing(engine) as session:
        proposals.withdraw(session, two["root"], other.id, 1)
    assert (_state(engine, row), _state(engine, other), _in_force(engine)) == ("REFUSED", "WITHDRAWN", 0)
    with pytest.raises(ConflictError, match="REFUSED: Rita", check=has_code("wrong-state")):
        _confirm(engine, two["rita"], row, 2)


def test_a_confirmed_change_makes_every_other_proposal_of_its_kind_stale(engine, two, propose):
    first, second = propose(), propose(document={"gates": [{"name": "coverage", "limit": 0.2}]})
    layout = propose("ana", plain_definition("inverted_wang"), "table-definition")
    _confirm(engine, two["rita"], first)
    assert (_state(engine, second), _state(engine, layout)) == ("STALE", "OPEN")
    with pytest.raises(StaleError):
        _confirm(engine, two["rita"], second)
    with pytest.raises(ConflictError, match="is STALE"):
        _confirm(engine, two["rita"], second, 2)
    assert _in_force(engine) == 1


def test_a_version_that_came_into_force_past_the_services_makes_a_proposal_stale_when_confirmed(engine, two, propose):
    row = propose()
    with open_writing(engine) as session:
        profile = gate_profiles.ensure_profile(session, two["root"], 1)
        copied = {"document": profile.document, "sha256": "0" * 64, "reason": "x", "created_utc": profile.created_utc}
        session.add(GateProfile(sensor_id=1, number=1, **copied))
        audit.append(session, two["root"], "set", "sensors/1/gate-profiles")
    with pytest.raises(StaleError, match=r"version 0.*version 1", check=has_code("proposal-outdated")):
        _confirm(engine, two["rita"], row)
    assert (_state(engine, row), _in_force(engine)) == ("STALE", 1)


def test_requests_stay_open_while_a_change_is_proposed_and_become_stale_with_its_confirmation(
    engine, two, propose, candidate, blobs
):
    made = candidate()
    with open_writing(engine) as session:
        approval = approvals.submit(session, two["ana"], blobs, made.id, "better", made.version)
    row = propose("ana", plain_definition("inverted_wang"), "table-definition")
    with open_reading(engine) as session:
        assert approvals.explain_why_not_sign(session, two["cy"], approval.id) is None
    with open_writing(engine) as session:
        done = proposals.confirm(session, two["ann"], row.id, 1)
        assert table_definitions.find_definition_in_force(session, 1).number == done.number == 1
        assert session.get_known(Approval, approval.id).state == "STALE"


def test_a_proposal_expires_by_itself_or_by_who_comes_too_late(engine, two, propose, monkeypatch):
    first, second = propose(), propose(document={"gates": [{"name": "coverage", "limit": 0.2}]})
    later = utc_after(31 * 86400.0)
    monkeypatch.setattr(proposals, "utc_now", lambda: later)
    with pytest.raises(ConflictError, match="expired at"):
        _confirm(engine, two["rita"], first)
    with open_writing(engine) as session:
        assert proposals.is_any_due(session)
        assert [row.id for row in proposals.expire_due(session)] == [second.id]
    assert {_state(engine, row) for row in (first, second)} == {"EXPIRED"}


def test_a_change_that_could_not_be_made_is_not_proposed_nor_the_same_twice(engine, two, propose):
    row = propose()
    asked: list[tuple[str, Mapping[str, Any], str, int | None, type[BoresightError]]] = [
        ("root", SHIFT, "again", 0, ConflictError),
        ("root", {"gates": [{"name": "nothing"}]}, "x", 0, RefusedInputError),
        ("root", {"gates": []}, "x", 0, RefusedInputError),
        ("root", SHIFT, " ", 0, RefusedInputError),
        ("root", SHIFT, "x", 3, StaleError),
        ("ana", SHIFT, "x", 0, ForbiddenError),
    ]
    for who, document, reason, seen, error in asked:
        with open_writing(engine) as session, pytest.raises(error):
            proposals.change(session, two[who], "gate-profile", 1, document, reason, seen, policy=ON)
    with open_reading(engine) as session:
        assert [one.id for one in proposals.list_proposals(session)] == [row.id]


def test_a_proposal_shows_each_entry_that_it_changes(engine, propose):
    row = propose()
    layout = propose("ana", plain_definition("inverted_wang"), "table-definition")
    with open_reading(engine) as session:
        found = {one.place: (one.before, one.after) for one in proposals.list_differences(session, row)}
        fields = [one.place for one in proposals.list_differences(session, layout)]
    assert found == {
        "gates[parameter-shift].limit": (None, 1e6),
        "gates[parameter-shift].marginal": (15.0, 1e6),
    }
    assert any(place.startswith("fields[") and place.endswith(".type") for place in fields)


@pytest.fixture(params=["sqlite", "postgresql"])
def race(request, engine, two) -> Any:
    if request.param == "sqlite":
        return engine, two
    other: Engine = request.getfixturevalue("postgresql")
    with open_writing(other) as session:
        for name in ("root", "rita", "rosa"):
            add_person(session, name, "administrator", printed_name=name)
        sensors.register_sensor(session, COMMAND_LINE, SENSOR)
    with open_reading(other) as session:
        return other, {row.name: users.get_actor(session, row.id) for row in users.list_users(session)}


def test_of_many_that_confirm_at_once_one_does(race):
    engine, people = race
    with open_writing(engine) as session:
        row = proposals.change(session, people["root"], "gate-profile", 1, SHIFT, "x", 0, policy=ON)
    gate, outcomes = threading.Barrier(8), []

    def confirm() -> None:
        gate.wait()
        try:
            outcomes.append(_confirm(engine, people["rita"], row).state)
        except StaleError:
            outcomes.append("STALE")

    threads = [threading.Thread(target=confirm) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert sorted(outcomes) == ["CONFIRMED", *["STALE"] * 7]
    with open_reading(engine) as session:
        numbers = session.scalars(sa.select(GateProfile.number).order_by(GateProfile.number)).all()
        confirmed = [one for one in audit.list_records(session, limit=200) if one.action == "confirmed"]
        assert audit.verify(session).ok
    assert list(numbers) == [0, 1]
    assert len(confirmed) == 1


def test_a_jump_of_the_clock_expires_no_proposal_before_somebody_has_acknowledged_it(engine, two, monkeypatch):
    wall_s, steady_s = [1.8e9], 1000.0
    monkeypatch.setattr(alarm_rules, "OURS", alarm_rules.Clock(lambda: wall_s[0], lambda: steady_s))
    with open_writing(engine) as session:
        at_once = Policy(second_person=True, approval_days=0.0)
        row = proposals.change(session, two["root"], "gate-profile", 1, SHIFT, "To be tried.", 0, policy=at_once)
    assert isinstance(row, ChangeProposal)
    wall_s[0] += 40 * 86_400.0
    with open_writing(engine) as session:
        assert not proposals.is_any_due(session)
        assert not proposals.expire_due(session)
    assert _state(engine, _confirm(engine, two["rita"], row)) == "CONFIRMED"


@pytest.mark.parametrize(
    ("given", "asked"),
    [
        ({}, True),
        ({"second_person": "0"}, False),
        ({"four_eyes": "0"}, False),
        ({"four_eyes": "0", "second_person": "1"}, False),
    ],
)
def test_a_second_person_is_asked_for_unless_a_setting_waives_it(given, asked):
    settings = read_settings({f"BORESIGHT_{name.upper()}": value for name, value in given.items()})
    assert settings.policy.second_person is asked
