"""The report is one file that needs nothing else, and shows what it was given without running it."""

import re

import pytest

from boresight.errors import RefusedInputError
from boresight.figures import FIGURES
from boresight.figures.report import command, render_report
from boresight.figures.tables import digits, printed_rows
from boresight.verdicts.verdict import make_verdict, trust_doubts

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"


@pytest.fixture(scope="module")
def report(sequential_result):
    return render_report(sequential_result)


def without_library(text):
    return text.replace(max(re.findall(r"<script>.*?</script>", text, re.DOTALL), key=len), "")


def test_the_report_stands_alone(report):
    page = without_library(report)
    assert "default-src 'none'" in page
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!data:)", page)
    assert report.count("plotly.js v") == 1


def test_the_report_has_every_figure_with_its_guide(report):
    for figure in FIGURES.values():
        assert f'data-figure="{figure.name}"' in report
        assert figure.title in report


def test_the_report_has_verdict_advice_parameters_provenance_and_the_command(report, sequential_result):
    assert "CAUTION · converged, with reservations" in report
    assert sequential_result["trust"]["drop_one_sentence"] in report
    assert sequential_result["advice"][0] in report
    assert "ab" * 32 in report
    assert "boresight calibrate TELEMETRY --sensor SENSOR.json --method sqrf --match " in report
    assert "change / sigma" in report


def test_the_report_of_where_one_person_works_alone_says_so(report, sequential_result):
    assert "FOUR EYES ARE OFF" not in report
    assert "FOUR EYES ARE OFF" in render_report(sequential_result, four_eyes=False)


def test_nothing_that_came_from_outside_becomes_markup(sequential_result):
    hostile = sequential_result | {
        "sensor": HOSTILE,
        "advice": [HOSTILE],
        "method": HOSTILE,
        "free": [*sequential_result["free"], HOSTILE],
        "inputs": {HOSTILE: HOSTILE},
        "symbols": {HOSTILE: HOSTILE},
        "parameters": sequential_result["parameters"] | {HOSTILE: 1.0},
    }
    page = without_library(render_report(hostile))
    assert "<script>alert" not in page
    assert "<img" not in page


def test_a_failed_run_still_gets_its_report(sequential_result):
    absent = dict.fromkeys(("history", "trace", "radial", "coverage", "observability", "chi2", "nis", "validation"))
    empty = sequential_result | absent | {"status": "too_few_stars", "chi2_per_dof": None}
    empty |= {"rms_arc_rad": {"initial": None, "final": None}, "sigma": dict.fromkeys(empty["sigma"])}
    assert "CRITICAL · too few stars" in render_report(empty)


@pytest.mark.parametrize("document", [{}, [], {"schema": "boresight.evaluation/1"}])
def test_what_is_no_calibration_is_refused(document):
    with pytest.raises(RefusedInputError, match="no calibration"):
        render_report(document)


@pytest.mark.parametrize(
    ("change", "level"),
    [
        ({}, "normal"),
        ({"status": "diverged"}, "critical"),
        ({"status": "rank_deficient"}, "serious"),
        ({"status": "running"}, "standby"),
        ({"chi2": {"consistent": False}}, "caution"),
        ({"nis": {"consistent": False}}, "caution"),
        ({"observability": {"singular_values": [3.0, 0.5], "sigma_of_direction": [0.3, 2.0]}}, "caution"),
        ({"observability": {"singular_values": [3.0, 0.0], "sigma_of_direction": [0.3, None]}}, "caution"),
        ({"validation": {"rms_arc_rad": {"initial": 1e-4, "final": 2e-4}}}, "serious"),
    ],
)
def test_the_verdict_is_as_good_as_its_worst_answer(change, level, sequential_result):
    judged = make_verdict(sequential_result | {"trust": None} | change)
    assert judged.level == level
    assert all(reason.endswith(".") for reason in judged.reasons)


def test_a_doubt_of_the_examination_is_a_reservation_of_the_verdict(sequential_result):
    judged = make_verdict(sequential_result)
    assert (judged.level, judged.word) == ("caution", "converged, with reservations")
    assert set(judged.reasons) == set(trust_doubts(sequential_result))


def test_a_value_stops_at_the_second_digit_of_its_sigma():
    assert digits(16.0198234, 0.00063) == "16.01982"
    assert digits(-1886.7, 10.2) == "−1,887"
    assert digits(6.634e7, 7.9e5) == "6.634e+07"
    assert digits(786_689.0, 786_689.0) == "7.9e+05"
    assert digits(0.5, None) == "0.5"
    assert digits(None, 1.0) == "–"


def test_a_fixed_parameter_shows_dashes_for_what_is_not_known(sequential_result):
    fixed = sequential_result | {"sigma": sequential_result["sigma"] | {"g_y": None}}
    row = printed_rows(fixed)[-1]
    assert (row.sigma, row.worth, row.typical) == ("–", "–", "–")


def test_the_command_of_a_batch_run_names_no_filter_settings(batch_result):
    assert "--linearisations" not in command(batch_result)
    assert "--method batch" in command(batch_result)
