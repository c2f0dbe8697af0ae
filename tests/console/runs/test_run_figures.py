"""What a reader asks of a run's charts in the address, and the facts that stand beside them."""

import pytest
from starlette.datastructures import QueryParams

from boresight.console.runs.pages.run import list_history_facts, read_run_view, sight_facts, tail_facts
from boresight.verdicts.verdict import make_verdict_marks


def view(text, result):
    return read_run_view(QueryParams(text), result)


def test_a_view_is_what_the_address_asks_for_as_far_as_it_can_be_had(results):
    timed = {**results["sqrf"], "history": {**results["sqrf"]["history"], "time_utc": ["2026-01-01T00:00:00Z"] * 40}}
    asked = view("align=time&scale=linear&tail_from=20", timed)
    assert (asked.align, asked.scale, asked.tail_from) == ("time", "linear", 20.0)
    assert asked.query == "align=time&tail_from=20"
    untimed = {**timed, "history": {**timed["history"], "time_utc": None}}
    assert view("align=time", untimed).align == "frame"
    assert list(view("", untimed).aligns) == ["frame", "update"]


@pytest.mark.parametrize("text", ["", "align=moon&scale=cubic&tail_from=soon", "tail_from=nan", "tail_from=1e999"])
def test_what_cannot_be_had_falls_back_to_the_usual_view(text, results):
    usual = view(text, results["sqrf"])
    assert (usual.align, usual.scale, usual.tail_from, usual.query) == ("frame", "log", None, "")


def test_a_batch_has_no_axis_to_choose_and_no_tail(results):
    asked = view("align=update&tail_from=3", results["batch"])
    assert (dict(asked.aligns), asked.align, asked.tail_from) == ({}, "frame", None)
    tail, rows = tail_facts(results["batch"], asked)
    assert tail is None
    assert not any(term.startswith("Tail") for term, _, _ in rows)


def test_errors_stand_with_their_three_sigma_and_held_out_ones_by_themselves(results):
    result = results["sqrf"]
    tail, rows = tail_facts(result, view("tail_from=30", result))
    numbers = {term: number for term, number, _ in rows}
    final = 1e6 * result["rms_arc_rad"]["final"]
    value, _, reach = numbers["Fitted data, new parameters"].partition(" ± ")
    assert float(value) == pytest.approx(final, rel=1e-3)
    assert float(reach) == pytest.approx(3 * final / (2 * result["pairs"]) ** 0.5, rel=0.05)
    held_out = 1e6 * result["validation"]["rms_arc_rad"]["final"]
    value, _, reach = numbers["Validation data, new parameters"].partition(" ± ")
    assert float(value) == pytest.approx(held_out, rel=1e-3)
    assert float(reach) == pytest.approx(3 * held_out / (2 * result["validation"]["common_pairs"]) ** 0.5, rel=0.05)
    assert (tail.start, tail.chosen) == (30.0, True)


def test_a_result_that_kept_no_number_of_held_out_arcs_shows_the_value_and_says_so(results):
    result = results["batch"]
    kept = {key: value for key, value in result["validation"].items() if key != "common_pairs"}
    _, value, meaning = tail_facts({**result, "validation": kept}, view("", result))[1][-1]
    assert float(value) == pytest.approx(1e6 * kept["rms_arc_rad"]["final"], rel=1e-3)
    assert meaning.endswith("σ not kept.")
    said = {mark.question: mark.detail for mark in make_verdict_marks({**result, "validation": kept})}
    assert said["Validation RMS"].endswith("σ not kept")
    assert "(3σ)" in next(mark.detail for mark in make_verdict_marks(result) if mark.question == "Validation RMS")


def test_without_a_held_out_set_the_desk_says_how_to_have_one(results):
    rows = tail_facts({**results["batch"], "validation": None}, view("", results["batch"]))[1]
    assert "launch with one" in rows[-1][2]


def test_a_course_says_where_it_settled_or_that_it_has_not_yet(results):
    assert list_history_facts(results["batch"])[0][1].startswith("iteration ")
    assert list_history_facts({**results["sqrf"], "status": "running"})[0][1] == "not yet"
    assert list_history_facts(None) == []


def test_what_the_data_see_is_said_in_words(results):
    rows, helpful = sight_facts(results["batch"])
    assert [term for term, _, _ in rows] == ["Weakest direction", "Known to", "Condition number"]
    assert helpful
    assert sight_facts({**results["batch"], "observability": None}) == ([], [])
