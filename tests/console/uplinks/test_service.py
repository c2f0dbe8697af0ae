"""Uplinks: what is on board is what somebody recorded, step by step; what was when is one question."""

from collections.abc import Mapping
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.console import transitions
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets.tables import ONBOARD_STATES, ParameterSet, Promotion
from boresight.console.uplinks import service as uplinks
from boresight.errors import BoresightError, ConflictError, ForbiddenError, RefusedInputError
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_after
from tests.console.uplinks.services import climb

People = Mapping[str, Actor]
LADDER = ("SENT", "LOADED", "VERIFIED", "ACTIVE")


def _record(engine: Engine, actor: Actor, state: str, source: str = "pass 4711", set_id: int = 1) -> None:
    with open_writing(engine) as session:
        uplinks.record(session, actor, set_id, state, source)


def _onboard(engine: Engine, set_id: int = 1) -> str:
    with open_reading(engine) as session:
        return transitions.get_parameter_set(session, set_id).onboard_state


def test_the_ladder_is_climbed_step_by_step_with_a_record_each(engine: Engine, people: People) -> None:
    climb(engine, people["dee"], *LADDER)
    assert _onboard(engine) == "ACTIVE"
    with open_reading(engine) as session:
        records = uplinks.list_uplinks(session, parameter_set_id=1)
        assert [row.onboard_state for row in reversed(records)] == list(LADDER)
        assert {row.recorded_by for row in records} == {people["dee"].user_id}
        change = audit.last_change(session, "parameter-sets/1")
    assert change is not None
    assert (change.action, change.reason) == ("recorded ACTIVE for", "pass 4711")


@given(states=st.lists(st.sampled_from(ONBOARD_STATES), max_size=12))
def test_active_is_never_reached_but_from_verified(states: list[str]) -> None:
    here = "NOT SENT"
    for state in states:
        if state in uplinks.NEXT[here]:
            assert state != "ACTIVE" or here == "VERIFIED"
            assert state != "NOT SENT"
            here = state


def test_every_state_says_what_may_follow() -> None:
    assert set(uplinks.NEXT) == set(ONBOARD_STATES)
    assert {state for following in uplinks.NEXT.values() for state in following} == set(ONBOARD_STATES) - {"NOT SENT"}
    assert all(uplinks.NEXT.values())


@pytest.mark.parametrize(
    ("state", "source", "error", "says"),
    [
        ("LOADED", "x", ConflictError, "PS-ST16-1-0 is NOT SENT on board; next can be SENT, not LOADED"),
        ("FLYING", "x", RefusedInputError, "no on-board state 'FLYING'; the states are NOT SENT, SENT"),
        ("SENT", "  ", RefusedInputError, "Say where this is known from"),
    ],
)
def test_a_step_off_the_ladder_leaves_no_record(
    engine: Engine, people: People, state: str, source: str, error: type[BoresightError], says: str
) -> None:
    with pytest.raises(error, match=says):
        _record(engine, people["dee"], state, source)
    assert _onboard(engine) == "NOT SENT"
    with open_reading(engine) as session:
        assert not uplinks.list_uplinks(session)


@pytest.mark.parametrize("climbed", [(), ("SENT", "LOADED"), ("SENT", "LOADED", "VERIFIED"), ("SENT", "UNKNOWN")])
def test_nobodys_word_makes_a_set_verified_or_active_and_the_door_is_named(
    engine: Engine, people: People, climbed: tuple[str, ...]
) -> None:
    climb(engine, people["dee"], *climbed)
    before = _onboard(engine)
    with pytest.raises(
        ConflictError, match=r"VERIFIED is not recorded by statement: .* `:read-back`, which compares\."
    ):
        _record(engine, people["dee"], "VERIFIED")
    with pytest.raises(ConflictError, match=r"ACTIVE is not recorded by statement: .* by `:activate`\."):
        _record(engine, people["dee"], "ACTIVE")
    key = replace(people["dee"], credential="key:abc", scopes=frozenset({"uplinks"}))
    with pytest.raises(ForbiddenError, match="Only a person who is logged in"):
        _record(engine, key, "ACTIVE")
    with pytest.raises(ConflictError, match="VERIFIED is not recorded by statement"):
        _record(engine, key, "VERIFIED")
    assert _onboard(engine) == before


@pytest.mark.parametrize("state", uplinks.NEXT)
def test_what_is_offered_to_be_stated_can_be_and_is_never_verified_or_active(state: str, engine: Engine) -> None:
    with open_reading(engine) as session:
        offered = uplinks.next_statements(session, ParameterSet(id=1, onboard_state=state))
    assert set(offered) == set(uplinks.NEXT[state]) - {"VERIFIED", "ACTIVE"}


@pytest.mark.parametrize("name", ["ana", "cy", "eve", "root"])
def test_only_an_operator_records(engine: Engine, people: People, name: str) -> None:
    with pytest.raises(ForbiddenError, match="role operator"):
        _record(engine, people[name], "SENT")


def test_nobody_in_particular_records_nothing(engine: Engine) -> None:
    with pytest.raises(ForbiddenError, match="answer for this"):
        _record(engine, COMMAND_LINE, "SENT")


def _promote_by_hand(session: Session, row: ParameterSet, at_utc: str) -> None:
    incumbent = set_queries.baseline(session, row.sensor_id)
    assert incumbent is not None
    incumbent.ground_state = "SUPERSEDED"
    session.flush()
    row.ground_state = "BASELINE"
    session.add(Promotion(sensor_id=row.sensor_id, parameter_set_id=row.id, at_utc=at_utc))
    session.flush()
    audit.append(session, COMMAND_LINE, "promoted", f"parameter-sets/{row.id}")


@pytest.fixture
def second(engine: Engine, candidate: object) -> ParameterSet:
    row: ParameterSet = candidate()  # type: ignore[operator]
    with open_writing(engine) as session:
        row = session.get_one(ParameterSet, row.id)
        _promote_by_hand(session, row, utc_after(3600.0))
    return row


def test_only_the_baseline_is_sent(engine: Engine, people: People, candidate: object) -> None:
    row: ParameterSet = candidate()  # type: ignore[operator]
    with pytest.raises(ConflictError, match="is CANDIDATE; only the baseline is sent"):
        _record(engine, people["dee"], "SENT", set_id=row.id)


def test_one_set_is_active_and_the_one_before_becomes_unknown(
    engine: Engine, people: People, candidate: object
) -> None:
    row: ParameterSet = candidate()  # type: ignore[operator]
    climb(engine, people["dee"], *LADDER)
    with open_writing(engine) as session:
        _promote_by_hand(session, session.get_one(ParameterSet, row.id), utc_after(0.0))
    climb(engine, people["dee"], *LADDER, set_id=row.id)
    assert (_onboard(engine, 1), _onboard(engine, row.id)) == ("UNKNOWN", "ACTIVE")
    with open_reading(engine) as session:
        newest = uplinks.list_uplinks(session, parameter_set_id=1)[0]
        assert newest.source == f"{row.name} was read back as active: pass 4711"
        assert len(uplinks.list_uplinks(session, sensor_id=row.sensor_id)) == 9


def test_what_was_baseline_is_answered_for_any_time(engine: Engine, second: ParameterSet) -> None:
    with open_reading(engine) as session:
        asked = {
            time: getattr(uplinks.baseline_at(session, 1, time), "name", None)
            for time in ("2000-01-01", utc_after(60.0), utc_after(7200.0), "2100-01-01T00:00:00+02:00")
        }
        promotions = [row.parameter_set_id for row in uplinks.list_promotions(session, 1)]
    assert list(asked.values()) == [None, "PS-ST16-1-0", second.name, second.name]
    assert promotions == [second.id, 1]


def test_a_time_on_the_second_counts_what_happened_within_it_as_later(engine: Engine) -> None:
    with open_writing(engine) as session:
        session.add(Promotion(sensor_id=1, parameter_set_id=1, at_utc="2020-01-01T00:00:00.500000Z"))
        audit.append(session, COMMAND_LINE, "promoted", "parameter-sets/1")
    with open_reading(engine) as session:
        assert uplinks.baseline_at(session, 1, "2020-01-01T00:00:00Z") is None
        assert uplinks.baseline_at(session, 1, "2020-01-01T00:00:01Z") is not None


def test_what_was_on_board_is_answered_for_any_time(engine: Engine, people: People) -> None:
    _record(engine, people["dee"], "SENT")
    between = utc_after(0.0)
    climb(engine, people["dee"], "LOADED", "VERIFIED")
    with open_reading(engine) as session:
        assert list(uplinks.onboard_at(session, 1, "2000-01-01")) == []
        then = [(row.name, record.onboard_state) for row, record in uplinks.onboard_at(session, 1, between)]
        now = [(row.name, record.onboard_state) for row, record in uplinks.onboard_at(session, 1, utc_after(0.0))]
    assert (then, now) == ([("PS-ST16-1-0", "SENT")], [("PS-ST16-1-0", "VERIFIED")])


def test_what_is_no_time_is_refused_with_an_example(engine: Engine) -> None:
    with open_reading(engine) as session, pytest.raises(RefusedInputError, match="2026-11-21T03:04:05Z"):
        uplinks.baseline_at(session, 1, "yesterday")
