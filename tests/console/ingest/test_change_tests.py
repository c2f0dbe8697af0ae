"""The judgement of one set, and the dry run over many: false alarms as often as promised, drifts and jumps told apart."""

from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest

from boresight.console.fleet.trend import Trend, TrendPoint, make_epoch
from boresight.console.ingest.change_tests import Reference, judge, judge_newest, make_follower, promote_point, rehearse
from boresight.console.ingest.rules import RULES, PolicyRules, parse_rules
from boresight.errors import RefusedInputError
from boresight.platform.db.sessions import utc_text

NAMES = ("f_m", "m0_px")
SIGMA = np.array([1e-6, 0.5])
P = np.outer(SIGMA, SIGMA) * np.array([[1.0, 0.6], [0.6, 1.0]])
TRUTH = np.array([0.016, 970.0])


def point(k, value, *, day=None, **changed):
    at = utc_text(datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=k if day is None else day))
    given = {
        "run_id": k + 1,
        "label": "",
        "method": "batch",
        "telemetry_set_id": k + 1,
        "telemetry": f"pass-{k}",
        "begins_utc": at,
        "at_utc": at,
        "ends_utc": at,
        "timed": True,
        "temperature_c": None,
        "camera_model": "inverted_wang",
        "names": NAMES,
        "parameters": dict(zip(NAMES, map(float, value), strict=True)),
        "covariance": P,
        "stars": 1000,
        "rms_arc_rad": 1e-5,
        "left_out": "",
        "said": "",
    }
    return TrendPoint(**{**given, **changed})


def drawn(rng, mean):
    return mean + np.linalg.cholesky(P) @ rng.standard_normal(2)


def reference(value=TRUTH):
    base = point(0, value)
    return Reference("PS-1", NAMES, make_epoch(base, NAMES), 1, 1)


RULE = PolicyRules()


def judged(points, base, rules=RULE):
    """What a policy finds in each of some sets since a reference."""
    follower, since, found = make_follower(rules), [], []
    for one in points:
        own = follower.follow(one)
        found.append(judge(one, own, since, base, rules))
        since = since if own is None else [*since, own]
    return found


@pytest.mark.full
def test_sets_of_a_camera_that_did_not_change_are_asked_about_as_often_as_the_policy_says():
    rng, rules, trials = np.random.default_rng(5), PolicyRules(false_alarm_rate=0.02), 4000
    base = [reference(drawn(rng, TRUTH)) for _ in range(trials)]
    asked = [judged([point(1, drawn(rng, TRUTH))], one, rules)[0].state == "ASKED" for one in base]
    assert abs(np.mean(asked) - 0.02) < 4 * np.sqrt(0.02 * 0.98 / trials)


@pytest.mark.full
def test_with_a_forecast_each_of_the_two_tests_has_half_of_the_rate():
    rng, rules = np.random.default_rng(8), PolicyRules(false_alarm_rate=0.04)
    found = [
        one
        for _ in range(30)
        for one in judged([point(k, drawn(rng, TRUTH)) for k in range(1, 61)], reference(drawn(rng, TRUTH)), rules)
        if one.forecast is not None
    ]
    outside = np.mean([one.forecast.rejects for one in found])
    assert abs(outside - 0.02) < 4 * np.sqrt(0.02 * 0.98 / len(found))
    assert {one.holds.limit for one in found} == {one.forecast.limit for one in found}


def test_a_drift_is_forecast_and_asked_once_the_baseline_is_left_and_a_jump_is_not():
    rng = np.random.default_rng(6)
    found = judged([point(k, drawn(rng, TRUTH + k * SIGMA)) for k in range(1, 25)], reference())
    assert (found[-1].state, found[-1].is_forecast) == ("ASKED", True)
    assert [one.code for one in found[-1].reasons] == ["OUTSIDE", "LARGEST", "DRIFT", "IN ROW"]
    still = [point(k, drawn(rng, TRUTH)) for k in range(1, 21)]
    *before, found = judged([*still, point(21, TRUTH + 20 * SIGMA)], reference())
    assert {one.state for one in before} == {"WITHIN FORECAST"}
    assert (found.state, found.is_forecast, found.in_row) == ("ASKED", False, 1)
    assert "JUMP" in [one.code for one in found.reasons]
    assert found.largest[1] > 10


def test_what_comes_and_goes_with_the_temperature_is_forecast_and_no_drift():
    rng = np.random.default_rng(9)
    warm = 10.0 * np.sin(np.arange(60) / 5.0)
    season = [point(k, drawn(rng, TRUTH + T * SIGMA), temperature_c=15.0 + T) for k, T in enumerate(warm)]
    base = promote_point(season[0])
    found = judged(season[20:], base, RULE)
    assert (
        sum(one.state == "ASKED" for one in found) <= 8
    )  # until there is a forecast, each is held against the baseline
    assert {one.state for one in found[8:]} == {"WITHIN FORECAST"}


def test_people_are_asked_once_so_many_sets_in_a_row_left_the_baseline():
    rules = PolicyRules(confirmations=3)
    moved = [point(k, TRUTH + 20 * SIGMA) for k in range(1, 5)]
    assert [(one.state, one.in_row) for one in judged(moved, reference(), rules)] == [
        ("UNCONFIRMED", 1),
        ("UNCONFIRMED", 2),
        ("ASKED", 3),
        ("ASKED", 4),
    ]
    back = [*moved[:2], point(3, TRUTH), point(4, TRUTH + 20 * SIGMA)]
    assert judged(back, reference(), rules)[-1].in_row == 1


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"left_out": "it is a choice of a camera"}, "LEFT OUT"),
        ({"timed": False}, "NO TIME"),
        ({"stars": 10}, "FEW STARS"),
        ({"names": ("f_m", "k1"), "parameters": {"f_m": 1.0, "k1": 0.0}}, "OTHER PARAMETERS"),
        ({"covariance": np.ones((2, 2))}, "NO COVARIANCE"),
    ],
)
def test_what_cannot_be_compared_says_why(changed, code):
    assert judged([point(1, TRUTH, **changed)], reference())[0].reasons[0].code == code


def _trend(points, baseline_of=None):
    document = {
        "camera_model": "inverted_wang",
        "parameters": dict(zip(NAMES, TRUTH.tolist(), strict=True)),
        "covariance": {"names": list(NAMES), "matrix": P.tolist()},
    }
    baseline = SimpleNamespace(
        id=7, name="PS-7", run_id=baseline_of, document=document, created_utc="2026-01-01T00:00:00Z"
    )
    return Trend(SimpleNamespace(id=1), baseline, "inverted_wang", points, [], [], [], {})


def test_data_that_are_not_newer_than_the_baselines_own_are_not_judged():
    points = [point(0, TRUTH), point(1, TRUTH), point(2, TRUTH + 20 * SIGMA)]
    trend = _trend(points, baseline_of=2)
    assert [judge_newest(trend, one.run_id, RULE).reasons[0].code for one in points] == ["OLDER", "OLDER", "OUTSIDE"]
    assert judge_newest(trend, 99, RULE).reasons[0].code == "NO RESULT"


def test_the_dry_run_asks_twice_about_a_step_and_once_about_an_outlier():
    rng = np.random.default_rng(8)
    step = [point(k, drawn(rng, TRUTH + (30 * SIGMA if k >= 20 else 0))) for k in range(40)]
    found = rehearse(_trend(step, baseline_of=1), RULE)
    assert (found["sets"], found["asked"], found["held"], found["not_judged"]) == (39, 2, 37, 0)
    asked = [(line["run_id"], line["against"]) for line in found["lines"] if line["state"] == "ASKED"]
    assert asked == [(21, "run 1"), (22, "run 1")]  # a jump; the next set confirms it, and is promoted
    assert found["lines"][-1]["against"] == "run 22"
    assert found["false_requests_per_year"] == pytest.approx(0.001 * 365.25, rel=1e-6)
    step[20:] = [point(k, drawn(rng, TRUTH + (30 * SIGMA if k == 20 else 0))) for k in range(20, 40)]
    found = rehearse(_trend(step, baseline_of=1), RULE)
    assert [line["run_id"] for line in found["lines"] if line["state"] == "ASKED"] == [21]


def test_the_dry_run_counts_what_would_have_paused_the_policy():
    busy = [point(k, TRUTH, day=k / 48) for k in range(30)]
    found = rehearse(_trend(busy, baseline_of=1), PolicyRules(sets_per_day=24))
    assert (found["busiest_day_sets"], found["would_pause"]) == (30, True)
    assert rehearse(_trend([], baseline_of=1), RULE)["sets"] == 0


def test_rules_are_read_from_forms_and_json_and_refused_by_their_bounds():
    assert parse_rules({}) == PolicyRules()
    assert parse_rules({"confirmations": "3", "false_alarm_rate": "1e-4"}) == PolicyRules(
        confirmations=3, false_alarm_rate=1e-4
    )
    assert parse_rules(PolicyRules(preset="wu").to_dict()).preset == "wu"
    for bad in (
        {"confirmations": 2.5},
        {"sets_per_day": 0},
        {"false_alarm_rate": "nan"},
        {"oldest_days": True},
        {"x": 1},
    ):
        with pytest.raises(RefusedInputError):
            parse_rules(bad)
    assert all(rule.sentence.endswith(".") for rule in RULES.values())
