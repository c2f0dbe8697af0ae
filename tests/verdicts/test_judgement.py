"""Judging: the worst decides, only what is sure fails, and what is waived stays in the words."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.estimation.statistics.consistency import chi_square
from boresight.verdicts.gates import GATES, Measurement, judge, parse_profile, read_measurements, summarise, words
from boresight.verdicts.gates.judgement import STATUSES, find_worst

NUMBERS = st.floats(0.0, 1.0)


def answer(name, measured, **entry):
    report = judge(parse_profile({"gates": [{"name": name, **entry}]}), {name: measured})
    return next(one for one in report["gates"] if one["name"] == name)


def sound(**changed):
    good = {"below": 0.0, "around": 1.0}
    return {
        name: Measurement(None, "Met.", met="PASS") if gate.direction == "met"
        else Measurement(good.get(gate.direction, gate.highest), "Good.")
        for name, gate in GATES.items()
    } | {name.replace("_", "-"): value for name, value in changed.items()}  # fmt: skip


@pytest.mark.parametrize(
    ("value", "interval", "status"),
    [
        (1.0, None, "PASS"),
        (1.6, None, "MARGINAL"),
        (3.1, None, "FAIL"),
        (1.0, (0.8, 1.4), "PASS"),
        (1.4, (1.0, 3.2), "MARGINAL"),
        (5.0, (2.9, 7.0), "MARGINAL"),
        (5.0, (3.1, 7.0), "FAIL"),
        (1.0, (None, 1.2), "PASS"),
        (1.0, (0.9, None), "MARGINAL"),
        (5.0, (None, 7.0), "MARGINAL"),
        (None, None, "NO-DATA"),
    ],
)
def test_a_gate_that_wants_little_fails_only_what_is_surely_too_much(value, interval, status):
    assert answer("validation-rms", Measurement(value, "", interval=interval))["status"] == status


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_wanting_much_is_wanting_little_of_the_negative(value, a, b, limit):
    interval = (min(a, b, value), max(a, b, value))
    above = answer("coverage", Measurement(value, "", interval=interval), limit=limit, marginal=1.0)
    mirrored = Measurement(1 - value, "", interval=(1 - interval[1], 1 - interval[0]))
    below = answer("quantisation", mirrored, limit=1 - limit, marginal=0.0)
    near = min(abs(end - limit) for end in (*interval, value)) < 1e-12
    assert near or above["status"] == below["status"]


@pytest.mark.parametrize(
    ("value", "bounds", "status"),
    [
        (1.05, (0.99, 1.01), "PASS"),  # significant and without meaning
        (1.5, (0.4, 1.8), "PASS"),  # far off and no sign of anything
        (1.5, (0.9, 1.1), "MARGINAL"),
        (0.5, (0.9, 1.1), "MARGINAL"),
        (10.0, (0.9, 1.1), "FAIL"),
        (0.1, (0.9, 1.1), "FAIL"),
        (12.0, (0.01, 20.0), "PASS"),
        (1.5, None, "MARGINAL"),
    ],
)
def test_a_ratio_passes_inside_its_statistical_bounds_or_the_factor_that_is_allowed(value, bounds, status):
    assert answer("chi-square", Measurement(value, "", bounds=bounds))["status"] == status


@pytest.mark.parametrize("name", [gate.name for gate in GATES.values() if gate.direction != "met"])
def test_thresholds_of_none_are_never_crossed(name):
    for value in (-1e9, 1e-9, 1e9):
        found = answer(name, Measurement(value, "", interval=(value, value)), limit=None, marginal=None)
        assert (found["status"], found["margin"]) == ("PASS", None)


@given(st.floats(0.2, 30.0))
def test_the_margin_is_negative_where_and_only_where_the_limit_is_crossed(value):
    for name, measured in (
        ("validation-rms", Measurement(value, "")),
        ("matched-stars", Measurement(value, "")),
        ("chi-square", Measurement(value, "", bounds=(0.9, 1.1))),
    ):
        found = answer(name, measured)
        assert (found["margin"] < 0) == (found["status"] == "FAIL")


def test_the_worst_answer_is_the_verdict_in_this_order():
    assert STATUSES == ("PASS", "MARGINAL", "NO-DATA", "FAIL")
    for pair in itertools.product(STATUSES, repeat=2):
        assert find_worst(pair) == STATUSES[max(map(STATUSES.index, pair))]
    assert judge(parse_profile({}), sound())["verdict"] == "PASS"
    assert judge(parse_profile({}), sound(coverage=Measurement(0.5, "")))["verdict"] == "MARGINAL"
    assert judge(parse_profile({}), sound(coverage=Measurement(None, "")))["verdict"] == "NO-DATA"
    assert judge(parse_profile({}), sound(nis=Measurement(50.0, "")))["verdict"] == "FAIL"


@given(st.lists(st.sampled_from(STATUSES), min_size=1))
def test_no_number_of_good_answers_makes_up_for_a_bad_one(statuses):
    assert find_worst([*statuses, "FAIL"]) == "FAIL"


def test_only_failing_blocks_and_having_no_data_where_there_must_be_some():
    profile = parse_profile({"gates": [{"name": "availability", "must_have_data": True}]})
    measured = sound(nis=Measurement(50.0, ""), coverage=Measurement(None, ""), availability=Measurement(None, ""))
    measured["condition-number"] = Measurement(1e9, "")
    report = judge(profile, measured)
    assert report["blocking"] == ["availability", "nis"]
    assert judge(parse_profile({}), {})["blocking"] == [name for name, gate in GATES.items() if gate.critical]


def test_what_is_only_observed_is_shown_and_counts_for_nothing():
    profile = parse_profile({"gates": [{"name": "nis", "observe_only": True}]})
    report = judge(profile, sound(nis=Measurement(50.0, "")))
    assert (report["verdict"], report["blocking"]) == ("PASS", [])
    assert next(one for one in report["gates"] if one["name"] == "nis")["status"] == "FAIL"


def test_a_waiver_lets_pass_and_stays_in_the_words_when_it_has_expired():
    report = judge(parse_profile({}), sound(nis=Measurement(50.0, ""), validation_rms=Measurement(9.0, "")))
    assert summarise(report, {"nis"}, {"nis"})["blocking"] == ["validation-rms"]
    both = summarise(report, {"nis", "validation-rms"}, {"nis", "validation-rms"})
    assert (both["words"], both["blocking"]) == ("PASS (2 gates waived)", [])
    expired = summarise(report, set(), {"nis"})
    assert (expired["words"], expired["blocking"]) == ("FAIL (1 gate waived)", ["validation-rms", "nis"])
    assert words("PASS", 0) == "PASS"


def test_a_gate_that_was_waived_and_passes_by_now_still_taints_the_verdict():
    assert summarise(judge(parse_profile({}), sound()), {"nis"}, {"nis"})["words"] == "PASS (1 gate waived)"


@pytest.mark.parametrize("name", [name for name, gate in GATES.items() if gate.critical])
def test_no_waiver_lifts_a_critical_gate(name):
    report = judge(parse_profile({}), sound(**{name: Measurement(None, "No.", met="FAIL")}))
    waived = summarise(report, {name}, {name})
    assert (waived["verdict"], waived["blocking"]) == ("FAIL", [name])


def test_a_report_judged_again_by_its_own_profile_is_the_same():
    measured = sound(nis=Measurement(50.0, "Much.", bounds=(0.9, 1.1)), coverage=Measurement(None, "None."))
    measured["availability"] = Measurement(0.9, "Fair.", interval=(None, 0.95), incumbent=0.8)
    report = judge(parse_profile({}), measured)
    assert read_measurements(report) == measured
    assert judge(parse_profile({}), read_measurements(report)) == report
    assert all(math.isfinite(one["margin"]) for one in report["gates"] if one["margin"] is not None)


@pytest.mark.parametrize("dof", [5, 50, 500, 50_000])
def test_sound_residuals_are_called_marginal_no_oftener_than_their_bounds_say_and_fail_of_a_handful_only(dof):
    rng = np.random.default_rng(dof)
    answers = []
    for value in rng.chisquare(dof, 400):
        fit = chi_square(float(value), dof)
        measured = Measurement(fit.mean, "", bounds=(fit.lower, fit.upper))
        answers.append(answer("chi-square", measured)["status"])
    assert answers.count("MARGINAL") / 400 < 0.08
    assert answers.count("FAIL") <= (8 if dof == 5 else 0)


@pytest.mark.parametrize("scale", [0.05, 12.0])
def test_residuals_far_from_the_stated_noise_fail_when_there_are_enough_to_tell(scale):
    fit = chi_square(scale * 500, 500)
    assert answer("chi-square", Measurement(fit.mean, "", bounds=(fit.lower, fit.upper)))["status"] == "FAIL"
