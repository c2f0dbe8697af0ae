"""The report is one file that needs nothing else; the examination in words, the command that makes it again, helpful data."""

import re
from dataclasses import asdict, replace

import click
import pytest

from boresight.calibration.calibration import (
    Calibration,
    Change,
    Coverage,
    InputPass,
    Observability,
    PriorUse,
    RadialDifference,
    Values,
    WeakestDirection,
)  # fmt: skip
from boresight.calibration.options import OPTIONS, CalibrationSettings
from boresight.cli import main
from boresight.estimation.statistics.observability import WEAK
from boresight.figures import FIGURES
from boresight.figures.charts.matching import GIVEN
from boresight.figures.charts.observability import helpful_data, weakest_words
from boresight.figures.report import MOST_STARS, calibrate_command, command, render_report
from boresight.figures.tables import digits, flight_rows, match_counts, printed_rows, reason_tables, star_rows, to_flag
from boresight.verdicts.verdict import NEVER, make_verdict, prospects, trust_doubts, trust_level, trust_marks
from tests.calibrations import changed

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"


@pytest.fixture(scope="module")
def report(sequential_result):
    return render_report(sequential_result)


def without_library(text):
    return text.replace(max(re.findall(r"<script>.*?</script>", text, re.DOTALL), key=len), "")


def test_the_report_stands_alone_with_every_figure_and_its_guide(report):
    page = without_library(report)
    assert "default-src 'none'" in page
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!data:)", page)
    assert report.count("plotly.js v") == 1
    for figure in FIGURES.values():
        assert f'data-figure="{figure.name}"' in report
        assert figure.title in report


def test_the_report_has_verdict_advice_parameters_trust_matching_provenance_and_the_command(report, sequential_result):
    trust = sequential_result.trust
    for said in (
        "CAUTION · converged with warnings",
        trust.drop_one_sentence,
        trust.whiteness.sentence,
        sequential_result.advice[0],
        "ab" * 32,
        "boresight calibrate TELEMETRY --sensor SENSOR.json --method sqrf --match ",
        "change / σ",
        "Stars to flag (HIP): <code>1000, 1017</code>",
        f"The {MOST_STARS} worst stars",
        "neighbouring frame",
        "46.0\u202f%",
    ):
        assert said in report


def test_the_report_says_where_one_person_works_alone_and_why_a_part_is_not_there(report, sequential_result):
    page = render_report(replace(sequential_result, trust=None, matching=None), four_eyes=False)
    assert ["FOUR-EYES RULE OFF" in one for one in (report, page)] == [False, True]
    assert NEVER in page
    assert GIVEN in page


def test_nothing_that_came_from_outside_becomes_markup_and_a_failed_run_still_gets_its_report(sequential_result):
    hostile = {"sensor": HOSTILE, "advice": [HOSTILE], "method": HOSTILE, "symbols": {HOSTILE: HOSTILE}}
    read = changed(sequential_result, **hostile, inputs={"versions": {HOSTILE: HOSTILE}})
    values = Values({**sequential_result.parameters, HOSTILE: 1.0})  # names that no file may have
    page = without_library(render_report(replace(read, parameters=values, free=[*sequential_result.free, HOSTILE])))
    assert "<script>alert" not in page
    assert "<img" not in page
    absent = dict.fromkeys(("history", "trace", "radial", "coverage", "observability", "chi2", "nis", "validation"))
    unknown = Values(dict.fromkeys(sequential_result.sigma))
    empty = replace(sequential_result, **absent, status="too_few_stars", chi2_per_dof=None, sigma=unknown)
    assert "CRITICAL · too few stars" in render_report(replace(empty, rms_arc_rad=Change()))


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
        ({"observability": {"chi2_rise": 1.4}}, "normal"),
        ({"observability": {"chi2_rise": 1.6}}, "caution"),
        ({"validation": {"rms_arc_rad": {"initial": 1e-4, "final": 2e-4}}}, "serious"),
    ],
)
def test_the_verdict_is_as_good_as_its_worst_answer(change, level, sequential_result):
    judged = make_verdict(changed(replace(sequential_result, trust=None, tests=[]), **change))
    assert judged.level == level
    assert all(reason.endswith(".") for reason in judged.reasons)


def test_a_value_stops_at_the_second_digit_of_its_sigma_and_what_is_not_known_is_a_dash(sequential_result):
    known = [(16.0198234, 0.00063), (-1886.7, 10.2), (6.634e7, 7.9e5), (786_689.0, 786_689.0), (0.5, None), (None, 1.0)]
    assert [digits(*pair) for pair in known] == ["16.01982", "−1\u202f887", "6.634·10⁷", "7.9·10⁵", "0.5", "–"]
    row = printed_rows(changed(sequential_result, sigma={"g_y": None}, sigma_with_misfit={"g_y": None}))[-1]
    assert (row.sigma, row.worth, row.typical) == ("–", "–", "–")


def find_mark(result, question):
    return next(mark for mark in trust_marks(result) if mark.question == question)


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
    assert find_mark(sequential_result, question).level == "normal"
    mark = find_mark(changed(sequential_result, trust={part: values}, tests=[]), question)
    assert mark.level == "caution"
    assert mark.reason.endswith(".")


@pytest.mark.parametrize(
    "part", ["two_halves", "nis_over_time", "whiteness", "efficiency", "residual_against", "drop_one", "stars"]
)
def test_a_part_that_is_missing_is_no_data_and_never_passes(part, sequential_result):
    before = trust_marks(sequential_result)
    after = trust_marks(changed(sequential_result, trust={part: None}))
    (lost,) = [now for was, now in zip(before, after, strict=True) if was != now]
    assert (lost.level, lost.word) == ("off", "NOT TESTED")


def test_doubts_are_the_sentences_of_the_cautions_and_warnings_of_the_verdict(sequential_result):
    trust, judged = sequential_result.trust, make_verdict(sequential_result)
    assert trust_doubts(sequential_result) == [trust.drop_one_sentence, trust.stars_sentence]
    assert trust_level(sequential_result) == "caution"
    assert prospects(sequential_result) == [trust.more_data.sentence]
    assert (judged.level, judged.word) == ("caution", "converged with warnings")
    assert set(judged.reasons) == set(trust_doubts(sequential_result))
    nothing = replace(sequential_result, trust=None)
    assert (trust_marks(nothing), trust_level(nothing)) == ([], "off")


def test_stars_and_matches_are_listed_in_order_with_the_list_to_flag(sequential_result):
    rows, matching = star_rows(sequential_result), sequential_result.matching
    assert [row.star_id for row in rows if row.suspect] == [1000, 1017]
    assert to_flag(sequential_result) == "1000, 1017"
    assert (rows[3].flags, rows[0].cells[-1]) == ("double", "9.1")
    assert match_counts(matching)[-1][1] == "4\u202f466"
    assert [times for _, times in reason_tables(matching)[0].rows] == [371, 24, 5]


def test_intervals_stand_beside_what_they_belong_to(sequential_result):
    nothing = {"initial": [], "final": []}
    intervals = {"availability": {"initial": [0.35, 0.57], "final": [0.96, 1.0]}, "matched_star_ratio": [2.5, 2.9]}
    intervals |= {"rms_arc_rad": nothing, "rms_ratio": []}
    with_them = changed(sequential_result, validation={"intervals": intervals})
    rows = {(row.whose, row.name): row for row in flight_rows(with_them)}
    assert rows["Validation set", "Frames available"].initial == "46.0\u202f% (35.0 to 57.0)"
    assert rows["Validation set", "Matched star ratio"].final == "2.70 (2.50 to 2.90)"
    assert rows["Calibration set", "Matched star ratio"].final == "2.70"


CHANGED = {
    "blends": "keep",
    "method": "sqrf", "variant": "q", "free": ["f_m", "m0_px"], "match": "given", "match_parameters": "baseline",
    "match_rule": "flight", "flight_tolerance_urad": 300.0, "noise_model": "from-data", "leave_out_doubles": True,
    "leave_out_stars": [71681, 71683],
    "vary": ["f_m", "m0_px"], "vary_as": "walk", "walk_sigma": 0.3, "degree": "auto", "events": ["2026-03-02T10:00:00Z"],
    "prior_covariance": "noise", "prior_inflation": 2.0, "prior_drift_sigma": 0.1, "prior_age_days": 30.0,
    "minimum_stars": 5, "max_iterations": 20, "error": "cosine", "robust": "huber", "huber_threshold": 2.0,
    "linearisations": 1, "process_noise_sigma": 0.5, "forgetting_factor": 0.9, "initial_sigma_scale": 3.0,
    "process_noise_of": ["f_m=0.1"], "process_noise_per": "day", "smooth": True,
    "star_model": 2, "singular_values": [1, 3], "gain_form": "gain",
}  # fmt: skip


def words(settings):
    return calibrate_command(["a b.csv"], "s.json", CalibrationSettings(**settings), None, "r.json")


def test_the_command_says_defaults_in_two_words_quotes_blanks_and_forgets_no_setting(batch_result):
    assert words({})[2:-1] == ["--method batch", "--match rematch"]
    assert words({})[0] == "boresight calibrate 'a b.csv'"
    several = [InputPass(name=name, frames=1, detections=4, first_frame=0, last_frame=0) for name in "ab"]
    found = replace(batch_result, inputs=replace(batch_result.inputs, passes=several))
    found = replace(found, prior=PriorUse(name="a.json", covariance="noise", inflation=1.0))
    assert command(found).startswith("boresight calibrate TELEMETRY_1 TELEMETRY_2 --sensor")
    assert "--prior PRIOR.json" in command(found)
    assert set(CHANGED) == set(asdict(CalibrationSettings())) - {"replay_frames_per_s"}
    assert ["--linearisations" in command(batch_result), "--method batch" in command(batch_result)] == [False, True]


def test_settings_of_another_method_are_left_out_of_the_command_but_not_the_start_of_matching():
    line = " ".join(words({"method": "batch", "variant": "q", "linearisations": 1, "initial_sigma_scale": 3.0}))
    assert [flag in line for flag in ("--variant", "--linearisations", "--initial-sigma-scale 3")] == [
        False,
        False,
        True,
    ]


@pytest.mark.parametrize("name", [*CHANGED])
def test_every_changed_setting_becomes_an_option_that_the_command_reads_back(name):
    command = main.commands["calibrate"]
    line = words({"method": OPTIONS[name].methods[0], name: CHANGED[name]})[1:]
    with click.Context(command) as context:
        choices = command.parse_args(context, ["t.csv", *" ".join(line).split()])
        read = context.params[name]
    assert choices == []
    listed = isinstance(CHANGED[name], list)
    assert read == (",".join(map(str, CHANGED[name])) if listed else CHANGED[name])


def seen(direction, sigma, frames=200, **rest):
    weakest = WeakestDirection(direction=Values(direction), sentence="Said elsewhere.")
    observed = Observability(
        parameter_names=[*direction],
        singular_values=[9.0, 1.0],
        condition_number=9.0,
        right_singular_vectors=[],
        sigma_of_direction=[0.1, sigma],
        weakest=weakest,
    )
    return Calibration(status="converged", observability=observed, frames=frames, **rest)


def test_data_that_would_help_name_what_the_weakest_direction_mixes_and_where_stars_are_missing():
    assert weakest_words(seen({"m0_px": 0.82, "a2_rad": -0.55, "f_m": 0.05}, 0.4)) == "0.82 m0 − 0.55 a2"
    assert weakest_words(Calibration(status="running")) == ""
    columns = ("difference_px", "sigma_px", "difference_arcsec", "sigma_arcsec")
    curves = {name: [0.0, 0.0] for name in columns}
    radial = RadialDifference(radius_px=[0.0, 1000.0], data_radius_px=600.0, **curves)
    coverage = Coverage(row_edges_px=[0.0, 1.0, 2.0], col_edges_px=[0.0, 1.0, 2.0], counts=[[3, 0], [0, 2]])
    said = " ".join(helpful_data(seen({"f_m": 1.0}, 0.1, radial=radial, coverage=coverage)))
    assert "60\u202f% of the way" in said
    assert "2 of 4 cells" in said


@pytest.mark.parametrize(
    ("direction", "wanted"),
    [
        ({"f_m": 0.7, "b2_per_m2": 0.7}, "at all radii"),
        ({"m0_px": 0.8, "a2_rad": 0.6}, "on opposite sides"),
        ({"g_y": 1.0}, "along rows and along columns"),
        ({"s": 1.0}, "along rows and along columns"),
    ],
)
def test_what_is_mixed_says_which_stars_would_part_it(direction, wanted):
    (first, *_) = helpful_data(seen(direction, 0.1))
    assert wanted in first


@pytest.mark.parametrize(
    ("sigma", "said"),
    [
        (2 * WEAK, "About 800 frames like these, instead of 200"),
        (20 * WEAK, "would not help enough"),
        (None, "would not determine"),
        (WEAK, "Every direction is determined"),
    ],
)
def test_so_many_times_the_frames_as_the_square_of_what_is_missing(sigma, said, sequential_result):
    assert said in helpful_data(seen({"f_m": 1.0}, sigma))[-1]
    assert helpful_data(replace(sequential_result, observability=None)) == []
    assert helpful_data(sequential_result)
