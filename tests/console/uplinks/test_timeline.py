"""What held at a time is the fold of what happened until then, and says who said so."""

import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any
from urllib.parse import quote

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from boresight.console import list_queries as lists
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import GateProfile
from boresight.console.fleet import timeline
from boresight.console.parameter_sets.tables import ONBOARD_STATES, ParameterSet, Promotion
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.tables import TableDefinition, Uplink
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import (
    Session,
    mark_dry_run,
    open_reading,
    open_writing,
    utc_after,
    utc_text,
)
from boresight.platform.db.times import STYLE
from tests.console.uplinks import pages as board
from tests.console.uplinks.services import advance, define, promote_by_hand
from tests.effort import effort
from tests.passwords import approve
from tests.refusals import has_code
from tests.sites import codes

People = Mapping[str, Actor]
Step = tuple[str, int, str, int]  # what, which set, which state, seconds since the step before
BEGIN = datetime(2100, 1, 1, tzinfo=UTC)
SETS = 3
WORDS = ONBOARD_STATES[1:]
STEPS = st.lists(
    st.tuples(
        st.sampled_from(("promotion", "uplink", "gate profile", "table definition")),
        st.integers(0, SETS),
        st.sampled_from(WORDS),
        st.integers(0, 2),
    ),
    max_size=14,
)


Held = tuple[int | None, dict[int, str], int | None, int | None]  # baseline, on board, profile, definition


def _at(seconds: int) -> str:
    return utc_text(BEGIN + timedelta(seconds=seconds))


def _timed(steps: Sequence[Step]) -> Iterator[tuple[str, int, str, int]]:
    seconds = 0
    for what, which, state, later in steps:
        seconds += later
        yield what, which + 1, state, seconds


def _add_sets(session: Session) -> None:
    first = session.get_one(ParameterSet, 1)
    for number in range(1, SETS + 1):
        columns = {"id": 1 + number, "sensor_id": 1, "number": number, "sha256": "0" * 64, "document": first.document}
        session.add(ParameterSet(name=f"PS-{number}", ground_state="SUPERSEDED", created_utc=_at(0), **columns))
    session.flush()


def _write(session: Session, steps: Sequence[Step]) -> None:
    numbers = {"gate profile": 100, "table definition": 100}
    tables = {"gate profile": GateProfile, "table definition": TableDefinition}
    for what, which, state, seconds in _timed(steps):
        at_utc = _at(seconds)
        if what == "promotion":
            session.add(Promotion(sensor_id=1, parameter_set_id=which, at_utc=at_utc))
        elif what == "uplink":
            record = {"onboard_state": state, "source": "x", "recorded_utc": at_utc, "recorded_by": 1}
            session.add(Uplink(parameter_set_id=which, **record))
        else:
            numbers[what] += 1
            columns: dict[str, Any] = {"document": {}, "sha256": "0" * 64, "reason": "x", "created_utc": at_utc}
            session.add(tables[what](sensor_id=1, number=numbers[what], **columns))
        session.flush()
    audit.append(session, COMMAND_LINE, "made up", "sensors/1")


def _replayed(steps: Sequence[Step], until: int) -> Held:
    baseline, on_board, profile, definition = 1, {}, 100, 100
    for what, which, state, seconds in _timed(steps):
        if seconds > until:
            break
        if what == "promotion":
            baseline = which
        elif what == "uplink":
            on_board[which] = state
        elif what == "gate profile":
            profile += 1
        else:
            definition += 1
    return baseline, on_board, profile if profile > 100 else None, definition if definition > 100 else None


def _answered(known: timeline.AsOf) -> Held:
    return (
        None if known.baseline is None else known.baseline.id,
        {row.id: record.onboard_state for row, record in known.on_board},
        None if known.profile is None else known.profile.number,
        None if known.definition is None else known.definition.number,
    )


def _folded(events: Sequence[Any]) -> tuple[int | None, dict[int, str]]:
    baseline, on_board = None, {}
    for event in events:
        if event.state == "BASELINE":
            baseline = event.parameter_set_id
        elif event.kind == "uplink":
            on_board[event.parameter_set_id] = event.state
    return baseline, on_board


@settings(max_examples=effort(12, 40), suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(steps=STEPS, until=st.integers(-1, 30), length=st.integers(1, 5))
def test_what_held_at_a_time_is_the_fold_of_what_happened_until_then(engine, steps, until, length) -> None:
    with open_writing(engine) as session:
        mark_dry_run(session)
        _add_sets(session)
        _write(session, steps)
        known = timeline.get_state_at(session, 1, _at(until))
        assert _answered(known) == _replayed(steps, until)
        listed = timeline.list_events(session, 1, until=_at(until))
        assert _folded(listed[::-1]) == _answered(known)[:2]
        assert [event.at_utc for event in listed] == sorted((event.at_utc for event in listed), reverse=True)
        assert _paged(session, length, _at(until)) == listed


def _paged(session: Session, length: int, until: str) -> list[Any]:
    pages: list[Any] = []
    while page := timeline.list_events(
        session, 1, until=until, before_id=pages[-1].id if pages else None, limit=length
    ):
        pages += page
    return pages


@pytest.fixture
def promoted(engine, people, approved) -> ParameterSet:
    row = approved()
    with open_writing(engine) as session:
        return approvals.promote(session, people["dee"], row.id, row.version)


def test_an_answer_names_who_asked_who_signed_and_who_promoted(engine, people, promoted):
    with open_reading(engine) as session:
        known = timeline.get_state_at(session, 1, utc_after(0.0))
    assert (known.baseline.id, known.differs) == (promoted.id, False)
    assert known.promotion is not None
    assert known.promotion.promoted_by == people["dee"].user_id
    assert known.approval is not None
    assert (known.approval.reason, known.approval.submitted_by) == ("better", people["ana"].user_id)
    assert [(one.printed_name, one.meaning, one.decision) for one in known.signatures] == [
        ("Cy", "I approve", "APPROVE")
    ]
    assert known.approval.bound["set_sha256"] == promoted.sha256


def test_the_timeline_tells_every_step_with_who_and_their_words(engine, people, promoted):
    define(engine, people["ana"])
    advance(engine, people["dee"], "SENT", set_id=promoted.id)
    with open_reading(engine) as session:
        told = [(event.kind, event.who, event.said) for event in timeline.list_events(session, 1)]
    assert told[:5] == [
        ("uplink", "Dee", "pass 4711"),
        ("table definition", "Ana", "As flown."),
        ("promotion", "Dee", "better"),
        ("signature", "Cy", "I approve"),
        ("request", "Ana", "better"),
    ]
    assert {kind for kind, _, _ in told[5:]} == {"ground calibration", "gate profile"}


def test_a_roll_back_on_the_ground_leaves_the_board_as_it_was_and_says_so(engine, people, blobs, promoted):
    advance(engine, people["dee"], "SENT", "LOADED", "VERIFIED", "ACTIVE", set_id=promoted.id)
    with open_reading(engine) as session:
        assert (
            timeline.get_state_at(session, 1).sentence
            == f"baseline {promoted.name}, on board {promoted.name} ACTIVE: the same"
        )
    with open_writing(engine) as session:
        ground = session.get_one(ParameterSet, 1)
        approval = approvals.roll_back(session, people["ana"], blobs, 1, "worse than thought", ground.version)
        approve(session, people["cy"], approval)
        approvals.promote(session, people["dee"], 1, ground.version)
    with open_reading(engine) as session:
        known, newest = timeline.get_state_at(session, 1), timeline.list_events(session, 1, limit=1)[0]
    assert known.differs
    assert known.sentence == f"baseline PS-ST16-1-0, on board {promoted.name} ACTIVE: differs"
    assert newest.kind == "roll-back"
    assert newest.sentence.startswith("PS-ST16-1-0 ")


def test_what_was_learned_later_is_told_apart_from_what_was_known_and_a_mismatch_is_said(engine, people):
    before, between = utc_after(-7200.0), utc_after(-3600.0)
    with open_writing(engine) as session:
        uplinks.record(session, people["dee"], 1, "SENT", "pass 4711", happened=utc_after(-5400.0))
    with open_reading(engine) as session:
        then, earlier, now = (timeline.get_state_at(session, 1, time) for time in (between, before, utc_after(0.0)))
    assert [record.onboard_state for _, record in then.learned_later] == ["SENT"]
    assert (list(then.on_board), list(earlier.learned_later), list(now.learned_later)) == ([], [], [])
    assert [record.onboard_state for _, record in now.on_board] == ["SENT"]
    advance(engine, people["dee"], "MISMATCH")
    with open_reading(engine) as session:
        sentence = timeline.get_state_at(session, 1).sentence
    assert sentence.startswith("baseline PS-ST16-1-0; ")
    assert sentence.endswith("; PS-ST16-1-0 MISMATCH")


def test_a_baseline_that_was_promoted_by_hand_at_a_later_time_is_not_answered_before(engine, candidate):
    row = candidate()
    with open_writing(engine) as session:
        promote_by_hand(session, session.get_one(ParameterSet, row.id), utc_after(3600.0))
    with open_reading(engine) as session:
        assert timeline.get_state_at(session, 1, "2000-01-01").baseline is None
        names = [timeline.get_state_at(session, 1, utc_after(later)).sentence.split(";")[0] for later in (0.0, 7200.0)]
    assert names == ["baseline PS-ST16-1-0", f"baseline {row.name}"]


def test_what_cannot_be_asked_is_refused(engine):
    with open_reading(engine) as session:
        with pytest.raises(RefusedInputError, match="2026-11-21T03:04:05Z"):
            timeline.get_state_at(session, 1, "yesterday")
        with pytest.raises(RefusedInputError, check=has_code("not-a-time")):
            timeline.get_state_at(session, 1, "0001-01-01T00:00:00+14:00")
        with pytest.raises(NotFoundError, match="77"):
            timeline.get_state_at(session, 77)
        with pytest.raises(NotFoundError, match="77"):
            timeline.list_events(session, 77)
        with pytest.raises(RefusedInputError, check=has_code("unknown-cursor")):
            timeline.list_events(session, 1, before_id=99999)


PAGE = "/sensors/1/timeline"


def test_the_answer_for_now_names_baseline_board_and_definition(site, read):
    board.define(site)
    board.advance(site, "SENT", "LOADED", "VERIFIED", "ACTIVE")
    page = site.visitor("victor").get(PAGE)
    words = read(page)
    assert 'data-known="the-same"' in page
    assert re.search(r"Table definition 1 .*Ada Analyst: As flown\.", words)
    assert re.search(r"PS-ST16-1-0 ACTIVE .*Olga Operator pass for ACTIVE signed: I saw it\.", words)


def test_the_answer_for_a_time_is_of_that_time_and_in_the_address(site, read):
    board.advance(site, "SENT")
    between = utc_after(0.0)
    board.advance(site, "LOADED")
    page = site.visitor("victor").get(f"{PAGE}?at={quote(between)}")
    answer = read(page).split("What happened")[0]
    assert f"As of {STYLE.show(datetime.fromisoformat(between))}" in answer
    assert ("SENT" in answer, "LOADED" in answer) == (True, False)
    assert f'value="{between}"' in page
    page = site.visitor("victor").get(f"{PAGE}?at=2000-01-01T00:00Z")
    assert 'data-known="none-active"' in page
    assert "nothing-recorded" in codes(page)


def test_what_is_no_time_is_refused_in_place_with_the_events_still_there(site, read):
    page = site.visitor("victor").get(f"{PAGE}?at=yesterday", status=422)
    assert "not-a-time" in codes(page)
    assert "ground calibration" in read(page)


def test_what_was_learned_later_is_shown_apart(site):
    with open_writing(site.engine) as session:
        uplinks.record(session, site.actor("olga"), 1, "SENT", "pass 7", happened=utc_after(-7200.0))
    page = site.visitor("victor").get(f"{PAGE}?at={quote(utc_after(-3600.0))}")
    assert "pass 7" in page.split('id="learned-later"')[1]


def test_the_events_are_paged_and_keep_the_question(site, read):
    for _ in range(20):
        board.advance(site, "SENT", "UNKNOWN", "VERIFIED")
    at = quote(utc_after(0.0))
    visitor = site.visitor("victor")
    page = visitor.get(f"{PAGE}?at={at}")
    older = re.search(r'href="([^"]+before=\d+)"', page)[1].replace("&amp;", "&")
    assert "at=" in older
    assert "ground calibration" in read(visitor.get(older))
    assert "ground calibration" not in read(page).split("What happened")[1]


def test_a_source_that_is_markup_is_shown_as_text(site):
    with open_writing(site.engine) as session:
        uplinks.record(session, site.actor("olga"), 1, "SENT", "<script>alert(1)</script>")
    for address in (PAGE, "/uplink", "/parameter-sets/1/uplink"):
        page = site.visitor("victor").get(address)
        assert "<script>alert" not in page
        assert "&lt;script&gt;alert(1)" in page


def test_every_state_of_the_store_is_left_as_it_was_by_looking(site):
    board.advance(site, "SENT")
    with open_reading(site.engine) as session:
        before = [row.id for row in lists.list_newest(session, Uplink)]
    for address in (PAGE, "/uplink", "/parameter-sets/1/uplink"):
        site.visitor("olga").get(address)
    with open_reading(site.engine) as session:
        assert [row.id for row in lists.list_newest(session, Uplink)] == before
