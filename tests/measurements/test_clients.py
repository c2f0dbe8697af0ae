"""A small crowd at a real server: everybody is answered, and fifty listeners, some of whom leave and come back, miss nothing."""

from __future__ import annotations

from typing import Any

import pytest

from boresight.measurements.clients import CROWDS, measure
from boresight.measurements.full_store import fill, settings_in
from boresight.services import audit
from boresight.store.sessions import open_engine, reading

LISTENERS = 50


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    """Measure once, as small as it says anything."""
    return measure(lambda *_: None, runs=120, clients=12, seconds=0.5, listeners=LISTENERS, changes=12)


def test_everybody_is_answered(found: dict[str, Any]) -> None:
    for name in CROWDS:
        assert found[name]["failures"] == 0, found[name]
        assert found[name]["requests"] > 0, name


def test_two_crowds_ask_while_runs_are_launched_and_the_first_answers_are_timed(found: dict[str, Any]) -> None:
    for name in ("list_while_writing", "page_while_writing"):
        assert found[name]["launches"] > 0, name
        assert found[name]["median_ms"] > 0
        assert found[name]["all_answered_once_after_s"] > 0


def test_who_has_a_copy_is_told_that_it_holds(found: dict[str, Any]) -> None:
    unchanged = found["list_unchanged"]
    assert unchanged["statuses"].get("304", 0) > 0
    assert unchanged["received_mb"] / unchanged["requests"] < found["list"]["received_mb"] / found["list"]["requests"]


def test_every_listener_hears_every_event_once_and_in_order(found: dict[str, Any]) -> None:
    feed = found["feed"]
    assert feed["listening"] == LISTENERS
    assert feed["events"] >= 4 * 12
    assert {name: feed[name] for name in ("lost", "twice", "out_of_order", "not_theirs", "ended_by_the_server")} == {
        "lost": 0,
        "twice": 0,
        "out_of_order": 0,
        "not_theirs": 0,
        "ended_by_the_server": 0,
    }
    assert feed["returns"] > 0


def test_what_is_promised_is_held_against_what_was_found(found: dict[str, Any]) -> None:
    for name in ("failures", "events_lost", "events_twice_or_out_of_order"):
        assert found["limits"][name]["kept"], found["limits"][name]
    assert found["limits"]["list_median"]["measured"] == found["list"]["median_ms"]


def test_a_store_that_was_filled_fast_verifies_as_any_other(tmp_path: Any) -> None:
    fill(tmp_path, 30, 2)
    engine = open_engine(settings_in(tmp_path).database_url)
    with reading(engine) as session:
        report = audit.verify(session)
    engine.dispose()
    assert report.ok, report.sentence
