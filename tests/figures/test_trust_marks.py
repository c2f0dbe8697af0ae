"""The examination in words: marks, tables of stars and of matching."""

import pytest

from boresight.figures.report import MOST_STARS, render_report
from boresight.figures.tables import flight_rows, match_counts, reason_tables, star_rows, to_flag
from boresight.verdicts.verdict import prospects, trust_doubts, trust_level, trust_marks


def changed(result, part, **values):
    trust = result["trust"]
    made = {**trust[part], **values} if values else None
    return result | {"trust": trust | {part: made}}


def mark_of(result, question):
    return next(mark for mark in trust_marks(result) if mark.question == question)


def test_a_result_without_trust_has_no_marks_and_is_not_judged(sequential_result):
    nothing = sequential_result | {"trust": None}
    assert trust_marks(nothing) == []
    assert trust_level(nothing) == "off"


@pytest.mark.parametrize(
    ("part", "question", "values"),
    [
        ("two_halves", "Two halves", {"chi2": {"value": 60.0, "dof": 8, "upper": 17.5, "consistent": False}}),
        ("nis_over_time", "Innovations over time", {"consistent": False}),
        ("whiteness", "Whiteness", {"white": False}),
        ("efficiency", "Efficiency", {"overall_ratio": 0.8}),
        ("efficiency", "Efficiency", {"overall_ratio": 2.0}),
        ("residual_against", "Residual against causes", {"radius": {"even": False, "sentence": "It depends."}}),
    ],
)
def test_a_test_that_fails_is_a_caution_with_its_sentence(part, question, values, sequential_result):
    assert mark_of(sequential_result, question).level == "normal"
    mark = mark_of(changed(sequential_result, part, **values), question)
    assert mark.level == "caution"
    assert mark.reason.endswith(".")


@pytest.mark.parametrize(
    "part", ["two_halves", "nis_over_time", "whiteness", "efficiency", "residual_against", "drop_one", "stars"]
)
def test_a_part_that_is_missing_is_no_data_and_never_passes(part, sequential_result):
    before = trust_marks(sequential_result)
    after = trust_marks(changed(sequential_result, part))
    (lost,) = [now for was, now in zip(before, after, strict=True) if was != now]
    assert (lost.level, lost.word) == ("off", "NO DATA")


def test_doubts_are_the_sentences_of_the_cautions(sequential_result):
    trust = sequential_result["trust"]
    assert trust_doubts(sequential_result) == [trust["drop_one_sentence"], trust["stars_sentence"]]
    assert trust_level(sequential_result) == "caution"
    assert prospects(sequential_result) == [trust["more_data"]["sentence"]]


def test_stars_are_listed_as_the_result_orders_them_with_the_list_to_flag(sequential_result):
    rows = star_rows(sequential_result)
    assert [row.star_id for row in rows if row.suspect] == [1000, 1017]
    assert to_flag(sequential_result) == "1000, 1017"
    assert rows[3].flags == "double"
    assert rows[0].cells[-1] == "9.1"


def test_matches_are_counted_and_reasons_ordered(sequential_result):
    matching = sequential_result["matching"]
    assert [number for _, number, _ in match_counts(matching)][-1] == "4\u202f466"
    starts = reason_tables(matching)[0]
    assert [times for _, times in starts.rows] == [371, 24, 5]


def test_intervals_stand_beside_what_they_belong_to(sequential_result):
    intervals = {"availability": {"initial": [0.35, 0.57], "final": [0.96, 1.0]}, "matched_star_ratio": [2.5, 2.9]}
    with_them = sequential_result | {"validation": sequential_result["validation"] | {"intervals": intervals}}
    rows = {(row.whose, row.name): row for row in flight_rows(with_them)}
    assert rows["Validation set", "Frames available"].initial == "46.0\u202f% (35.0 to 57.0)"
    assert rows["Validation set", "Matched star ratio"].final == "2.70 (2.50 to 2.90)"
    assert rows["Calibration set", "Matched star ratio"].final == "2.70"


def test_the_report_prints_trust_and_matching_with_their_tables(sequential_result):
    page = render_report(sequential_result)
    assert sequential_result["trust"]["whiteness"]["sentence"] in page
    assert "Stars to flag (HIP): <code>1000, 1017</code>" in page
    assert f"The {MOST_STARS} worst stars" in page
    assert "neighbouring frame" in page
    assert "46.0\u202f%" in page


def test_the_report_of_a_result_without_trust_says_why(sequential_result):
    page = render_report(sequential_result | {"trust": None, "matching": None})
    assert "start it again to have one" in page
    assert "nothing was matched again" in page
