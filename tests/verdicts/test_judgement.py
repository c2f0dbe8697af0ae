"""Judging: the worst decides, only what is sure fails, what is waived stays in the words; profiles and what may be edited."""

import copy
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.calibration.calibration import to_plain
from boresight.errors import RefusedInputError
from boresight.estimation.statistics.consistency import chi_square
from boresight.verdicts.gates import (
    DEFAULT_PROFILE,
    GATES,
    Measurement,
    judge,
    parse_profile,
    parse_report,
    read_measurements,
    summarise,
    words,
)
from boresight.verdicts.gates.judgement import STATUSES, find_worst, gate_rows
from boresight.verdicts.gates.profile import FLAGS

NUMBERS = st.floats(0.0, 1.0)


def answer(name, measured, **entry):
    report = judge(parse_profile({"gates": [{"name": name, **entry}]}), {name: measured})
    return next(one for one in report.gates if one.name == name)


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
    assert answer("validation-rms", Measurement(value, "", interval=interval)).status == status


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_wanting_much_is_wanting_little_of_the_negative(value, a, b, limit):
    interval = (min(a, b, value), max(a, b, value))
    above = answer("coverage", Measurement(value, "", interval=interval), limit=limit, marginal=1.0)
    mirrored = Measurement(1 - value, "", interval=(1 - interval[1], 1 - interval[0]))
    below = answer("quantisation", mirrored, limit=1 - limit, marginal=0.0)
    near = min(abs(end - limit) for end in (*interval, value)) < 1e-12
    assert near or above.status == below.status


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
    assert answer("chi-square", Measurement(value, "", bounds=bounds)).status == status


@pytest.mark.parametrize("name", [gate.name for gate in GATES.values() if gate.direction != "met"])
def test_thresholds_of_none_are_never_crossed(name):
    for value in (-1e9, 1e-9, 1e9):
        found = answer(name, Measurement(value, "", interval=(value, value)), limit=None, marginal=None)
        assert (found.status, found.margin) == ("PASS", None)


@given(st.floats(0.2, 30.0))
def test_the_margin_is_negative_where_and_only_where_the_limit_is_crossed(value):
    for name, measured in (
        ("validation-rms", Measurement(value, "")),
        ("matched-stars", Measurement(value, "")),
        ("chi-square", Measurement(value, "", bounds=(0.9, 1.1))),
    ):
        found = answer(name, measured)
        assert (found.margin < 0) == (found.status == "FAIL")


@given(st.lists(st.sampled_from(("PASS", "MARGINAL", "NO-DATA", "FAIL")), min_size=1))
def test_the_worst_answer_is_the_verdict_in_this_order_however_many_are_good(statuses):
    assert STATUSES == ("PASS", "MARGINAL", "NO-DATA", "FAIL")
    assert find_worst(statuses) == STATUSES[max(map(STATUSES.index, statuses))]
    changes = [{}, {"coverage": 0.5}, {"coverage": None}, {"nis": 50.0}]
    for changed, verdict in zip(changes, STATUSES, strict=True):
        measured = sound(**{name: Measurement(value, "") for name, value in changed.items()})
        assert judge(parse_profile({}), measured).verdict == verdict


def test_only_failing_and_missing_data_block_and_what_is_only_observed_counts_for_nothing():
    profile = parse_profile({"gates": [{"name": "availability", "must_have_data": True}]})
    measured = sound(nis=Measurement(50.0, ""), coverage=Measurement(None, ""), availability=Measurement(None, ""))
    measured["condition-number"] = Measurement(1e9, "")
    report = judge(profile, measured)
    assert report.blocking == ["availability", "nis"]
    assert judge(parse_profile({}), {}).blocking == [name for name, gate in GATES.items() if gate.critical]
    profile = parse_profile({"gates": [{"name": "nis", "observe_only": True}]})
    report = judge(profile, sound(nis=Measurement(50.0, "")))
    assert (report.verdict, report.blocking) == ("PASS", [])
    assert next(one for one in report.gates if one.name == "nis").status == "FAIL"


def test_a_waiver_lets_pass_and_stays_in_the_words_when_it_has_expired_or_the_gate_passes_by_now():
    report = judge(parse_profile({}), sound(nis=Measurement(50.0, ""), validation_rms=Measurement(9.0, "")))
    assert summarise(report, {"nis"}, {"nis"}).blocking == ["validation-rms"]
    both = summarise(report, {"nis", "validation-rms"}, {"nis", "validation-rms"})
    assert (both.words, both.blocking) == ("PASS (2 gates waived)", [])
    expired = summarise(report, set(), {"nis"})
    assert (expired.words, expired.blocking) == ("FAIL (1 gate waived)", ["validation-rms", "nis"])
    assert words("PASS", 0) == "PASS"
    assert summarise(judge(parse_profile({}), sound()), {"nis"}, {"nis"}).words == "PASS (1 gate waived)"


@pytest.mark.parametrize("name", [name for name, gate in GATES.items() if gate.critical])
def test_no_waiver_lifts_a_critical_gate(name):
    report = judge(parse_profile({}), sound(**{name: Measurement(None, "No.", met="FAIL")}))
    waived = summarise(report, {name}, {name})
    assert (waived.verdict, waived.blocking) == ("FAIL", [name])


def test_a_report_judged_again_by_its_own_profile_is_the_same():
    measured = sound(nis=Measurement(50.0, "Much.", bounds=(0.9, 1.1)), coverage=Measurement(None, "None."))
    measured["availability"] = Measurement(0.9, "Fair.", interval=(None, 0.95), incumbent=0.8)
    report = judge(parse_profile({}), measured)
    assert read_measurements(report) == measured
    assert judge(parse_profile({}), read_measurements(report)) == report
    assert parse_report({**to_plain(report), "held_out": None}) == report
    assert all(math.isfinite(one.margin) for one in report.gates if one.margin is not None)


def of_residuals(value, dof):
    fit = chi_square(float(value), dof)
    return answer("chi-square", Measurement(fit.mean, "", bounds=(fit.lower, fit.upper))).status


@pytest.mark.parametrize("dof", [5, 50, 500, 50_000])
def test_sound_residuals_are_called_marginal_no_oftener_than_their_bounds_say_and_fail_of_a_handful_only(dof):
    answers = [of_residuals(value, dof) for value in np.random.default_rng(dof).chisquare(dof, 400)]
    assert answers.count("MARGINAL") / 400 < 0.08
    assert answers.count("FAIL") <= (8 if dof == 5 else 0)
    assert [of_residuals(scale * 500, 500) for scale in (0.05, 12.0)] == ["FAIL"] * 2  # far from the stated noise


@pytest.mark.parametrize(
    ("name", "measured", "thresholds", "decides", "numbers"),
    [
        ("weak-directions", Measurement(2.42, ""), {"marginal": 0.5}, "marginal", ("0.5", "2.0 times")),
        ("chi-square", Measurement(1.15, "", bounds=(0.9, 1.1)), {"limit": 9, "marginal": 1.05}, "marginal", ("1.10",)),
        ("nis", Measurement(50.0, "", bounds=(0.9, 1.1)), {"limit": 3, "marginal": 2}, "limit", ("3.00",)),
        ("centroid-noise", Measurement(1.24, ""), {"limit": 3, "marginal": 1.2}, "marginal", ("1.20",)),
        (
            "centroid-noise",
            Measurement(2.9, "", interval=(2.0, 3.3)),
            {"limit": 3, "marginal": 2.95},
            "limit",
            ("3.00",),
        ),
        ("centroid-noise", Measurement(9.0, ""), {"limit": 3, "marginal": 1.2}, "limit", ("3.00",)),
        ("centroid-noise", Measurement(0.1, ""), {"limit": 3, "marginal": 1.2}, "limit", ("3.00",)),
    ],
)
def test_a_row_says_which_threshold_decided_its_answer_and_its_warning_has_the_number_beside(
    name, measured, thresholds, decides, numbers
):
    given = answer(name, measured, **thresholds)
    (row,) = gate_rows([given], [])
    assert decides in row.decided_by
    assert ("limit" in row.also) == (decides == "marginal")
    assert all(one in row.decided_by for one in numbers)
    assert row.value in row.warning
    assert row.decided_by in row.warning


LIMITED = [gate for gate in GATES.values() if gate.direction != "met"]
CRITICAL = [name for name, gate in GATES.items() if gate.critical]


def refusal(**entry):
    with pytest.raises(RefusedInputError) as refused:
        parse_profile({"gates": [entry]})
    return str(refused.value)


def test_the_default_reads_back_and_stands_for_what_is_left_out():
    assert parse_profile(DEFAULT_PROFILE).document() == DEFAULT_PROFILE == parse_profile({}).document()
    assert [entry["name"] for entry in DEFAULT_PROFILE["gates"]] == list(GATES)
    expected = copy.deepcopy(DEFAULT_PROFILE)
    expected["gates"][list(GATES).index("coverage")]["limit"] = 0.5
    assert parse_profile({"gates": [{"name": "coverage", "limit": 0.5}]}).document() == expected
    written = {repr(parse_profile({"gates": [{"name": "nis", "limit": limit}]}).document()) for limit in (3, 3.0)}
    assert len(written) == 1


@pytest.mark.parametrize("name", CRITICAL)
@pytest.mark.parametrize(
    ("key", "value"), [("waivable", True), ("observe_only", True), ("must_have_data", False), ("critical", False)]
)
def test_a_critical_gate_cannot_be_softened(name, key, value):
    assert name in refusal(name=name, **{key: value})


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"name": "coverage", "limit": 1.5}, "coverage: limit is 1.5; give a number from 0 to 1, or null"),
        ({"name": "coverage", "marginal": "much"}, "coverage: marginal is 'much'"),
        ({"name": "coverage", "limit": True}, "coverage: limit is True"),
        ({"name": "coverage", "limit": float("nan")}, "coverage: limit is nan"),
        ({"name": "chi-square", "limit": 0.5}, "chi-square: limit is 0.5; give a number from 1"),
        ({"name": "validation-rms", "limit": 2, "marginal": 3}, "validation-rms: marginal is 3 and the limit 2"),
        ({"name": "availability", "limit": 0.9, "marginal": 0.5}, "give a marginal of at least the limit"),
        ({"name": "finite", "limit": 1.0}, "finite: this gate has no limit or marginal"),
        ({"name": "coverage", "direction": "below"}, "coverage: direction is 'below', but it is always 'above'"),
        ({"name": "coverage", "waivable": "yes"}, "coverage: waivable is 'yes'; give true or false"),
        ({"name": "coverage", "critical": True}, "coverage: it is not critical"),
        ({"name": "coverage", "lowest": 3}, "Gate coverage has no key 'lowest'"),
        ({"name": "beauty"}, "There is no gate 'beauty'"),
        ({}, "There is no gate None"),
    ],
)
def test_a_wrong_entry_is_refused_with_its_gate_and_key(entry, words):
    assert words in refusal(**entry)


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"gate": []}, "no key 'gate'"),
        ({"schema": "other", "gates": []}, "schema is 'other'"),
        ({"gates": {}}, "not a list of objects"),
        ({"gates": ["coverage"]}, "not a list of objects"),
        ({"gates": [{"name": "nis"}, {"name": "nis"}]}, "nis is given twice"),
    ],
)
def test_a_document_that_is_no_profile_is_refused(document, words):
    with pytest.raises(RefusedInputError, match=words):
        parse_profile(document)


@given(st.data())
def test_any_thresholds_in_range_and_order_are_taken_and_read_back(data):
    entries = []
    for gate in LIMITED:
        pair = sorted(data.draw(st.floats(gate.lowest, gate.highest)) for _ in range(2))
        limit, marginal = pair if gate.direction == "above" else reversed(pair)
        flags = {key: data.draw(st.booleans()) for key in set(FLAGS) - {"critical"}}
        given_limit = data.draw(st.sampled_from([limit, None]))
        entries.append({"name": gate.name, "limit": given_limit, "marginal": marginal, **flags})
    profile = parse_profile({"gates": entries})
    assert parse_profile(profile.document()) == profile
    kept = {threshold.name: threshold for threshold in profile.thresholds}
    assert all(
        getattr(kept[entry["name"]], key) == value
        for entry, key in itertools.product(entries, entries[0])
        for value in [entry[key]]
    )
