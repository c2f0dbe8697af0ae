"""What counts as a calibration of its own, when a sensor drifts, and what is advised."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from boresight.calibration.advice_kinds import ADVICE_KINDS
from boresight.console.fleet import trend as drift
from boresight.console.fleet.trend import Trend, _periods, read_trend
from boresight.console.fleet.trend_document import advise, find_unseen_telemetry, make_trend_document
from boresight.platform.db.sessions import Session
from tests.missions import add_run, add_set, make_baseline

FIRST = np.eye(8)[0]  # a1: the store keeps keys sorted


def _mission(
    session: Session, rng: np.random.Generator, days: list[float], slope: float = 0.0, **kept: Any
) -> list[int]:
    return [add_run(session, add_set(session, 1, day), rng, slope * day * FIRST, **kept).id for day in days]


def _baselined(session: Session, rng: np.random.Generator) -> int:
    run = add_run(session, add_set(session, 1, 0), rng)
    make_baseline(session, run)
    return run.id


def _left_out(trend: Trend) -> dict[int, str]:
    return {point.run_id: point.left_out for point in trend.points if point.left_out}


def test_a_calibration_stands_at_the_middle_of_its_data(session):
    _mission(session, np.random.default_rng(1), [10.0])
    (point,) = read_trend(session, 1).points
    assert point.at_utc.startswith("2026-01-11T01:00:00")
    assert point.timed
    assert list(_periods([])) == []


def test_of_calibrations_of_the_same_stars_one_counts_and_of_unequal_methods_the_batch(session):
    rng, data = np.random.default_rng(1), add_set(session, 1, 5)
    batch = add_run(session, data, rng)
    sqrf = add_run(session, data, rng, method="sqrf")
    half_over = add_run(session, add_set(session, 1, 5 + 1 / 24), rng)  # an hour later, two hours long
    trend = read_trend(session, 1)
    assert [point.run_id for point in trend.independent] == [half_over.id]
    assert all(str(half_over.id) in why for why in _left_out(trend).values())
    assert set(_left_out(trend)) == {batch.id, sqrf.id}


def test_what_cannot_be_compared_is_left_out_with_its_reason(session):
    rng = np.random.default_rng(1)
    _baselined(session, rng)
    over = add_run(session, add_set(session, 1, 3), rng, left_out="with a forgetting factor")
    names = list(over.summary["trend"]["names"])
    fewer = add_run(
        session, add_set(session, 1, 6), rng, names=names[:5], covariance=np.eye(5).tolist()
    )  # the other three are held at what the ground calibration has, the baseline has others
    other = add_run(session, add_set(session, 1, 9), rng, camera_model="pinhole_radial")
    older = add_run(session, add_set(session, 1, 12), rng)
    older.summary = {"status": "converged"}
    trend = read_trend(session, 1)
    assert set(_left_out(trend)) == {over.id, fewer.id}
    assert "free parameters differs" in _left_out(trend)[fewer.id]
    assert [point.run_id for point in trend.others] == [other.id]
    assert drift.judge_drift(trend).verdict == "NOT TESTED"


def test_a_sensor_that_holds_raises_no_alarm_and_one_that_moves_does(session):
    rng = np.random.default_rng(1)
    _baselined(session, rng)
    _mission(session, rng, [30, 60, 90])
    holds = drift.judge_drift(read_trend(session, 1))
    assert (holds.verdict, holds.counted) == ("HOLDS", 4)
    _mission(session, rng, [120], slope=0.01)
    moved = drift.judge_drift(read_trend(session, 1))
    assert moved.verdict == "DRIFT"
    assert moved.largest is not None
    assert "largest change is in a1" in moved.sentence


def test_a_limit_says_how_often_chance_exceeds_it_which_is_half_as_often_where_two_tests_are_made(session):
    rng = np.random.default_rng(1)
    _baselined(session, rng)
    for days, tests, share in (([30], 1, 0.001), ([60, 90], 2, 0.0005)):
        _mission(session, rng, days)
        found = drift.judge_drift(read_trend(session, 1))
        made = [one for one in (found.holds, found.slope) if one is not None]
        assert [one.alpha for one in made] == [share] * tests
        assert [one.limit for one in made] == pytest.approx([chi2.isf(share, 8)] * tests)
        for one in made:
            assert f"for 8 degrees of freedom, {drift.describe_limit(one)}" in found.sentence
            assert f"{100 * share:g}\u202f%" in drift.describe_limit(one)


def test_a_slow_drift_is_seen_by_the_line_before_any_single_calibration_shows_it(session):
    rng = np.random.default_rng(3)
    _baselined(session, rng)
    _mission(session, rng, list(range(10, 130, 6)), slope=0.0025)
    found = drift.judge_drift(read_trend(session, 1))
    assert found.slope.rejects
    assert found.line.slope_per_d[0] == pytest.approx(0.0025 * 0.01, rel=0.5)


def test_after_a_promotion_the_drift_that_led_to_it_is_history(session):
    rng = np.random.default_rng(1)
    _baselined(session, rng)
    _mission(session, rng, [30, 60, 90], slope=0.01)
    run = add_run(session, add_set(session, 1, 120), rng, 1.2 * FIRST)
    assert drift.judge_drift(read_trend(session, 1)).verdict == "DRIFT"
    make_baseline(session, run)
    assert drift.judge_drift(read_trend(session, 1)).verdict == "NOT TESTED"
    add_run(session, add_set(session, 1, 150), rng, 1.2 * FIRST)
    assert drift.judge_drift(read_trend(session, 1)).verdict == "HOLDS"


def test_looks_at_a_sensor_that_holds_alarm_as_seldom_as_is_said(session):
    rng = np.random.default_rng(12)
    _baselined(session, rng)
    _mission(session, rng, [30, 60, 90, 120, 150])
    trend, alpha, trials = read_trend(session, 1), 0.05, 400
    truth = np.array(list(trend.sensor.document["initial"].values()))
    alarms = 0
    for _ in range(trials):
        points = []
        for point in trend.points:
            scale = np.sqrt(np.diag(point.covariance))
            L = np.linalg.cholesky(point.covariance / np.outer(scale, scale))
            drawn = dict(zip(point.names, truth + scale * (L @ rng.standard_normal(8)), strict=True))
            points.append(replace(point, parameters=drawn))
        assert trend.baseline is not None
        trend.baseline.document = {**trend.baseline.document, "parameters": dict(points[0].parameters)}
        alarms += drift.judge_drift(replace(trend, points=points), alpha).verdict == "DRIFT"
    session.rollback()
    assert alarms / trials < alpha + 3 * (alpha * (1 - alpha) / trials) ** 0.5
    assert alarms > 0  # and it is not asleep


def test_telemetry_without_times_is_on_no_line(session):
    rng = np.random.default_rng(1)
    _baselined(session, rng)
    for _ in range(4):
        add_run(session, add_set(session, 1, 0, timed=False), rng)
    found = drift.judge_drift(read_trend(session, 1))
    assert found.line is None
    assert found.verdict == "HOLDS"


@pytest.mark.parametrize(
    ("days", "slope", "answer"),
    [((), 0.0, "MORE DATA NEEDED"), ((30,), 0.0, "NOT YET"), ((30, 60, 90), 0.02, "YES")],
)
def test_the_advice_follows_drift_and_data(session, days, slope, answer):
    rng = np.random.default_rng(1)
    _baselined(session, rng)
    _mission(session, rng, list(days), slope)
    advice = advise(read_trend(session, 1))
    assert advice.answer == answer
    assert advice.code in ADVICE_KINDS
    assert advice.sentence.endswith(".")
    assert advice.reasons


def test_a_single_calibration_that_stands_apart_asks_for_another_one(session):
    rng = np.random.default_rng(1)
    _baselined(session, rng)
    _mission(session, rng, [*range(15, 150, 15)])
    add_run(session, add_set(session, 1, 150), rng, 20 * FIRST)
    found = drift.judge_drift(read_trend(session, 1))
    assert (found.verdict, found.is_jump) == ("DRIFT", True)
    assert advise(read_trend(session, 1), found).answer == "MORE DATA NEEDED"


def test_data_that_nobody_looked_at_yet_or_that_would_halve_the_sigmas_ask_for_a_calibration(session):
    rng = np.random.default_rng(1)
    _baselined(session, rng)
    add_set(session, 1, 35, stars=100)
    assert advise(read_trend(session, 1)).answer == "MORE DATA NEEDED"  # a handful of stars is too coarse
    add_set(session, 1, 40)
    assert "not calibrated yet" in advise(read_trend(session, 1)).sentence
    add_set(session, 1, 50, stars=40_000)
    sharper = advise(read_trend(session, 1))
    assert (sharper.answer, "every sigma would be" in sharper.sentence) == ("YES", True)


def test_a_set_whose_newest_calibration_failed_does_not_wait_for_one(session):
    rng = np.random.default_rng(1)
    _baselined(session, rng)
    add_set(session, 1, 40)
    failed = add_set(session, 1, 50)
    add_run(session, failed, rng, state="FAILED")
    data = find_unseen_telemetry(read_trend(session, 1))
    assert [len(rows) for rows in (data.sets, data.untried, data.failed)] == [1, 1, 1]
    assert failed.name in " ".join(advise(read_trend(session, 1)).reasons)
    add_run(session, failed, rng)
    data = find_unseen_telemetry(read_trend(session, 1))
    assert [len(rows) for rows in (data.sets, data.untried, data.failed)] == [2, 1, 0]


def test_the_document_is_json_with_a_sigma_beside_every_number(session):
    rng = np.random.default_rng(1)
    _baselined(session, rng)
    _mission(session, rng, [30, 60, 90])
    document = make_trend_document(session, 1)
    assert document.drift.false_alarm_rate == 0.001
    for point in document.points:
        assert point.parameters.keys() == point.sigma.keys()
    assert document.drift.difference.keys() == document.drift.sigma.keys()


def test_a_shift_against_a_ground_calibration_is_no_drift_and_asks_for_a_promotion(session):
    add_run(session, add_set(session, 1, 30), np.random.default_rng(1), 20 * FIRST)
    trend = read_trend(session, 1)
    found = drift.judge_drift(trend)
    assert found.verdict == "GROUND SHIFT"
    assert found.sentence.startswith(drift.GROUND_SHIFTED)
    advice = advise(trend, found)
    assert (advice.answer, advice.sentence) == ("YES", drift.GROUND_SHIFTED)


def test_calibrations_that_move_with_time_drift_whatever_the_baseline_is(session):
    _mission(session, np.random.default_rng(1), [30, 60, 90, 120], slope=0.1)
    assert drift.judge_drift(read_trend(session, 1)).verdict == "DRIFT"
