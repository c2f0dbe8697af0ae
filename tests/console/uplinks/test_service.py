"""Uplinks: what is on board is what somebody recorded, step by step; what was when is one question."""

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.console import list_queries as lists
from boresight.console.access import users
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.parameter_sets.tables import ONBOARD_STATES, ParameterSet, Promotion
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.read_backs import READABLE, read_back
from boresight.console.uplinks.service import add_entry
from boresight.console.uplinks.tables import Package, Uplink
from boresight.errors import (
    BoresightError,
    ConflictError,
    ForbiddenError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
    UnauthenticatedError,
)
from boresight.platform.actors import COMMAND_LINE, SYSTEM, Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, mark_dry_run, open_reading, open_writing, utc_after, utc_now
from tests.console.conftest import PASSWORD
from tests.console.uplinks.services import advance, define, newest, onboard, promote_by_hand, sent_table
from tests.passwords import new_password, proved
from tests.refusals import has_code

People = Mapping[str, Actor]
LADDER = ("SENT", "LOADED", "VERIFIED", "ACTIVE")


def _record(engine: Engine, actor: Actor, state: str, source: str = "pass 4711", set_id: int = 1) -> None:
    with open_writing(engine) as session:
        uplinks.record(session, actor, set_id, state, source)


def test_the_ladder_is_gone_up_step_by_step_with_a_record_each(engine, people):
    advance(engine, people["dee"], *LADDER)
    assert onboard(engine) == "ACTIVE"
    with open_reading(engine) as session:
        records = lists.list_newest(session, Uplink, set=1)
        assert [row.onboard_state for row in reversed(records)] == list(LADDER)
        assert {row.recorded_by for row in records} == {people["dee"].user_id}
        change = audit.find_last_change(session, "parameter-sets/1")
    assert (change.action, change.reason) == ("recorded ACTIVE for", "pass 4711")


@given(states=st.lists(st.sampled_from(ONBOARD_STATES), max_size=12))
def test_active_is_never_reached_but_from_verified(states):
    here = "NOT SENT"
    for state in states:
        if state in uplinks.NEXT[here]:
            assert state != "ACTIVE" or here == "VERIFIED"
            assert state != "NOT SENT"
            here = state


@pytest.mark.parametrize(
    ("state", "source", "error", "says"),
    [
        (
            "LOADED",
            "x",
            ConflictError,
            "PS-ST16-1-0 is NOT SENT on board, so LOADED cannot be next; record SENT",
        ),
        ("FLYING", "x", RefusedInputError, "no on-board state 'FLYING'"),
        ("SENT", "  ", RefusedInputError, "Give the source"),
    ],
)
def test_a_step_off_the_ladder_leaves_no_record(engine, people, state, source, error, says):
    with pytest.raises(error, match=says):
        _record(engine, people["dee"], state, source)
    assert onboard(engine) == "NOT SENT"
    with open_reading(engine) as session:
        assert not lists.list_newest(session, Uplink)


@pytest.mark.parametrize("reached", [(), ("SENT", "LOADED"), ("SENT", "LOADED", "VERIFIED"), ("SENT", "UNKNOWN")])
def test_nobodys_word_makes_a_set_verified_or_active_and_the_door_is_named(engine, people, reached):
    advance(engine, people["dee"], *reached)
    before = onboard(engine)
    with pytest.raises(ConflictError, match=r"VERIFIED.*`:read-back`", check=has_code("not-by-statement")):
        _record(engine, people["dee"], "VERIFIED")
    with pytest.raises(ConflictError, match=r"ACTIVE.*`:activate`", check=has_code("not-by-statement")):
        _record(engine, people["dee"], "ACTIVE")
    key = replace(people["dee"], credential="key:abc", scopes=frozenset({"uplinks"}))
    with pytest.raises(ForbiddenError, check=has_code("not-a-person")):
        _record(engine, key, "ACTIVE")
    with pytest.raises(ConflictError, match="VERIFIED", check=has_code("not-by-statement")):
        _record(engine, key, "VERIFIED")
    with pytest.raises(ForbiddenError, check=has_code("no-user")):
        _record(engine, COMMAND_LINE, "SENT")
    assert onboard(engine) == before


@pytest.mark.parametrize("state", uplinks.NEXT)
def test_what_is_offered_to_be_stated_can_be_and_is_never_verified_or_active_nor_sent_but_of_the_baseline(
    state, engine
):
    for ground, never in (("BASELINE", {"VERIFIED", "ACTIVE"}), ("SUPERSEDED", {"VERIFIED", "ACTIVE", "SENT"})):
        with open_reading(engine) as session:
            row = ParameterSet(id=1, onboard_state=state, ground_state=ground)
            assert set(uplinks.list_next_statements(session, row)) == set(uplinks.NEXT[state]) - never


def test_only_the_baseline_is_sent_one_set_is_active_and_the_one_before_becomes_unknown(engine, people, candidate):
    row: ParameterSet = candidate()
    with pytest.raises(ConflictError, match="CANDIDATE", check=has_code("not-the-baseline")):
        _record(engine, people["dee"], "SENT", set_id=row.id)
    advance(engine, people["dee"], *LADDER)
    with open_writing(engine) as session:
        promote_by_hand(session, session.get_one(ParameterSet, row.id), utc_after(0.0))
    advance(engine, people["dee"], *LADDER, set_id=row.id)
    assert (onboard(engine, 1), onboard(engine, row.id)) == ("UNKNOWN", "ACTIVE")
    with open_reading(engine) as session:
        newest = lists.list_newest(session, Uplink, set=1)[0]
        assert newest.source.startswith(f"{row.name} ")
        assert newest.source.endswith(": pass 4711")
        assert len(lists.list_newest(session, Uplink, sensor=row.sensor_id)) == 9


def test_what_was_baseline_is_answered_for_any_time_and_what_is_none_is_refused_with_an_example(engine, candidate):
    number = candidate().id
    with open_writing(engine) as session:
        second = session.get_one(ParameterSet, number)
        promote_by_hand(session, second, utc_after(3600.0))
    with open_reading(engine) as session:
        times = ("2000-01-01", utc_after(60.0), utc_after(7200.0), "2100-01-01T00:00:00+02:00")
        answers = [getattr(uplinks.find_baseline_at(session, 1, time), "name", None) for time in times]
        assert [row.parameter_set_id for row in set_rows.list_promotions(session, 1)] == [second.id, 1]
        with pytest.raises(RefusedInputError, match="2026-11-21T03:04:05Z"):
            uplinks.find_baseline_at(session, 1, "yesterday")
    assert answers == [None, "PS-ST16-1-0", second.name, second.name]


def test_a_time_on_the_second_counts_what_happened_within_it_as_later(engine):
    with open_writing(engine) as session:
        session.add(Promotion(sensor_id=1, parameter_set_id=1, at_utc="2020-01-01T00:00:00.500000Z"))
        audit.append(session, COMMAND_LINE, "promoted", "parameter-sets/1")
    with open_reading(engine) as session:
        assert uplinks.find_baseline_at(session, 1, "2020-01-01T00:00:00Z") is None
        assert uplinks.find_baseline_at(session, 1, "2020-01-01T00:00:01Z") is not None


def test_what_was_on_board_is_answered_for_any_time(engine, people):
    _record(engine, people["dee"], "SENT")
    between = utc_after(0.0)
    advance(engine, people["dee"], "LOADED", "VERIFIED")
    with open_reading(engine) as session:
        assert list(uplinks.list_onboard_at(session, 1, "2000-01-01")) == []
        then = [(row.name, record.onboard_state) for row, record in uplinks.list_onboard_at(session, 1, between)]
        now = [(row.name, record.onboard_state) for row, record in uplinks.list_onboard_at(session, 1, utc_after(0.0))]
    assert (then, now) == ([("PS-ST16-1-0", "SENT")], [("PS-ST16-1-0", "VERIFIED")])


MEANING = "I saw this table active in telemetry."


def activate(engine: Engine, actor: Actor, **given: Any) -> Uplink:
    entry = {"source": "TM page STR-2", "meaning": MEANING, "password": PASSWORD} | given
    with open_writing(engine) as session:
        entry["proof"] = proved(session, actor, entry.pop("password"))
        seen = entry.pop("seen", session.get_one(ParameterSet, 1).version)
        return uplinks.activate(session, actor, 1, seen_version=seen, **entry)


@pytest.fixture
def verified(engine, people) -> None:
    advance(engine, people["dee"], "SENT", "LOADED", "VERIFIED")


@pytest.mark.usefixtures("verified")
def test_a_signed_entry_keeps_name_meaning_source_and_the_hash_of_what_was_shown(engine, people):
    with open_reading(engine) as session:
        shown = uplinks.compute_shown_sha256(session, session.get_one(ParameterSet, 1))
    row = activate(engine, people["dee"])
    assert (row.onboard_state, onboard(engine)) == ("ACTIVE", "ACTIVE")
    assert (row.printed_name, row.meaning, row.source, row.method) == ("Dee", MEANING, "TM page STR-2", None)
    assert row.evidence["shown_sha256"] == shown
    with open_reading(engine) as session:
        change = audit.find_last_change(session, "parameter-sets/1")
    assert (change.action, change.after["meaning"]) == ("recorded ACTIVE for", MEANING)


REFUSED: list[tuple[str, dict[str, Any], type[BoresightError], str]] = [
    ("dee", {"password": "wrong"}, UnauthenticatedError, "password"),
    ("dee", {"meaning": "  "}, RefusedInputError, "Say what your signature means"),
    ("dee", {"source": ""}, RefusedInputError, "Give the source"),
    ("dee", {"seen": None}, PreconditionRequiredError, "which version"),
    ("dee", {"seen": 1}, StaleError, "changed since you read it"),
    ("dee", {"happened": "soon"}, RefusedInputError, "is not a time"),
    ("ana", {}, ForbiddenError, "role operator"),
    ("cy", {}, ForbiddenError, "role operator"),
    ("root", {}, ForbiddenError, "An administrator cannot sign"),
]


@pytest.mark.usefixtures("verified")
@pytest.mark.parametrize(("name", "given", "error", "says"), REFUSED)
def test_an_entry_that_is_not_signed_as_it_must_be_leaves_no_record(engine, people, name, given, error, says):
    with pytest.raises(error, match=says):
        activate(engine, people[name], **given)
    assert newest(engine).onboard_state == "VERIFIED"


@pytest.mark.usefixtures("verified")
def test_whose_password_somebody_else_set_does_not_sign(engine, people):
    dee = people["dee"]
    with open_writing(engine) as session:
        users.change_password(session, people["root"], dee.user_id, new_password("given by root"))
    with pytest.raises(ForbiddenError, check=has_code("password-due")):
        activate(engine, dee, password="given by root")


def test_what_an_earlier_version_took_for_verified_on_somebodys_word_is_read_back_before_it_is_signed(engine, people):
    advance(engine, people["dee"], "SENT", "LOADED")
    with open_writing(engine) as session:
        add_entry(session, people["dee"], session.get_one(ParameterSet, 1), "VERIFIED", "pass 4711")
    with pytest.raises(ConflictError, check=has_code("verified-by-statement")):
        activate(engine, people["dee"])
    advance(engine, people["dee"], "VERIFIED")
    assert activate(engine, people["dee"]).onboard_state == "ACTIVE"


def test_a_record_names_the_package_that_was_sent_and_no_other_sets(engine, people, candidate):
    other = candidate()
    with open_writing(engine) as session:
        sha256 = session.get_one(ParameterSet, other.id).document["result_sha256"]
        for set_id in (1, other.id):
            session.add(Package(parameter_set_id=set_id, inputs={}, sha256=sha256, created_utc=utc_now()))
            session.flush()
        row = uplinks.record(session, people["dee"], 1, "SENT", "pass 1", package_id=1)
    assert row.evidence["package"] == {"id": 1, "sha256": sha256}
    with (
        pytest.raises(RefusedInputError, match=r"package 2 .*PS-ST16-1-0", check=has_code("no-such-package")),
        open_writing(engine) as session,
    ):
        uplinks.record(session, people["dee"], 1, "LOADED", "pass 1", package_id=2)


def test_a_package_for_a_table_that_is_no_longer_in_force_is_not_sent(engine, people, candidate):
    sha256 = candidate().document["result_sha256"]
    old = define(engine, people["ana"])
    with open_writing(engine) as session:
        columns = {"inputs": {}, "sha256": sha256, "created_utc": utc_now(), "table_definition_id": old.id}
        session.add(Package(parameter_set_id=1, **columns))
        session.flush()
        audit.append(session, people["dee"], "built", "packages/1")
    define(engine, people["ana"], flight_software_version="4.3")
    with pytest.raises(ConflictError, check=has_code("other-table-definition")), open_writing(engine) as session:
        uplinks.record(session, people["dee"], 1, "SENT", "pass 1", package_id=1)


OPERATOR = frozenset({"operator"})
STATEMENTS = tuple(f"record {state}" for state in ONBOARD_STATES)
MOVES = (*STATEMENTS, "read back well", "read back badly", "sign active")


@dataclass(frozen=True)
class Person:
    make: Callable[[Mapping[str, Actor]], Actor]
    moves: tuple[str, ...] = ()


def _key(actor: Actor, *scopes: str) -> Actor:
    return replace(actor, credential="key:abcd", scopes=frozenset(scopes))


BUT_SIGNING = tuple(move for move in MOVES if move not in {"record ACTIVE", "sign active"})
PERSONS = {
    "viewer": Person(lambda people: people["eve"]),
    "analyst": Person(lambda people: people["ana"]),
    "approver": Person(lambda people: people["cy"]),
    "analyst and approver": Person(lambda people: people["bo"]),
    "administrator": Person(lambda people: people["root"]),
    "operator": Person(lambda people: people["dee"], MOVES),
    "operator and administrator": Person(
        lambda people: replace(people["dee"], roles=OPERATOR | {"administrator"}), BUT_SIGNING
    ),
    "operator's key": Person(lambda people: _key(people["dee"], "uplinks"), BUT_SIGNING),
    "operator's key for runs": Person(lambda people: _key(people["dee"], "runs", "parameter-sets")),
    "command line": Person(lambda _: COMMAND_LINE),
    "system": Person(lambda _: SYSTEM),
}


def _leads_to(move: str, state: str) -> str | None:
    if move in STATEMENTS:
        wanted = move.removeprefix("record ")
        return wanted if wanted in uplinks.STATED and wanted in uplinks.NEXT[state] else None
    if move == "sign active":
        return "ACTIVE" if state == "VERIFIED" else None
    if state not in READABLE:
        return None
    return "MISMATCH" if move == "read back badly" else "ACTIVE" if state == "ACTIVE" else "VERIFIED"


def _make(session: Session, actor: Actor, blobs: BlobStore, move: str, table: bytes) -> Uplink:
    seen = session.get_one(ParameterSet, 1).version
    if move in STATEMENTS:
        return uplinks.record(session, actor, 1, move.removeprefix("record "), "pass 1", seen)
    if move == "sign active":
        return uplinks.activate(session, actor, 1, "pass 1", "I saw it.", proved(session, actor, PASSWORD), seen)
    dump = table if move == "read back well" else bytes([table[0] ^ 1]) + table[1:]
    blobs.put(dump)
    return read_back(session, actor, blobs, 1, dump, "pass 1", seen)


def _put(session: Session, state: str) -> None:
    mark_dry_run(session)
    session.get_one(ParameterSet, 1).onboard_state = state
    if state != "NOT SENT":
        columns = {"source": "pass 1", "recorded_utc": utc_now(), "recorded_by": 1, "method": "crc"}
        session.add(Uplink(parameter_set_id=1, onboard_state=state, **columns))
    session.flush()
    audit.append(session, COMMAND_LINE, "put", "parameter-sets/1")


def _table() -> Iterator[tuple[str, str]]:
    yield from itertools.product(ONBOARD_STATES, MOVES)


@pytest.mark.few(5)
@pytest.mark.parametrize("name", PERSONS)
def test_a_move_succeeds_where_person_and_state_allow_it_and_nowhere_else(engine, people, blobs, name):
    define(engine, people["ana"])
    table, person = sent_table(engine).content, PERSONS[name]
    actor = person.make(people)
    for state, move in _table():
        end = _leads_to(move, state) if move in person.moves else None
        if end is not None:
            with open_writing(engine) as session:
                _put(session, state)
                assert _make(session, actor, blobs, move, table).onboard_state == end, (state, move)
            continue
        refusals: tuple[type[BoresightError], ...] = (ForbiddenError,)
        if move in person.moves:
            refusals = (ConflictError,)
        elif move in {"record ACTIVE", "sign active"} and person.moves:
            refusals = (ForbiddenError, ConflictError)
        with open_writing(engine) as session:
            _put(session, state)
            with pytest.raises(refusals):
                _make(session, actor, blobs, move, table)
            assert session.get_one(ParameterSet, 1).onboard_state == state, (state, move)
    with open_reading(engine) as session:
        assert not lists.list_newest(session, Uplink)


def test_the_list_of_moves_leaves_no_state_and_no_service_out():
    assert {state for state, _ in _table()} == set(uplinks.NEXT) == set(ONBOARD_STATES)
    assert {state for following in uplinks.NEXT.values() for state in following} == set(ONBOARD_STATES) - {"NOT SENT"}
    assert all(uplinks.NEXT.values())
    assert len(list(_table())) * len(PERSONS) == 7 * 10 * 11
    assert all(_leads_to(move, "NOT SENT") is None for move in MOVES if move != "record SENT")
