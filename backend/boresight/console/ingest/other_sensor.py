"""Whose is a set that its sensor's sets did not forecast? Of a camera that stepped, or of another sensor of the same design.

An upload is held against all cameras by the angles between its stars, which tells cameras apart that differ by several times the
noise of one star (`calibration.diagnosis.other_camera`). A calibration knows its camera by the noise of all of them. Let theta be
its estimate with covariance P, and m_s with F_s what the sets of sensor s forecast of that time and temperature; before there are
enough of them, its baseline. It is of another sensor where that one's forecast holds, D^2 below its limit, and

    log N(theta; m_other, P + F_other) - log N(theta; m_own, P + F_own + diag(sigma^2)) > log `CLEARLY`

with the typical sigmas of the sensor: against a step of its own camera of the usual size, so another sensor that is hardly known
takes nothing for its own. Only baselines that stars measured count, of the same camera model and detector.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.console.fleet.trend import MOST_FOLLOWED, Trend, TrendPoint, make_epoch
from boresight.console.ingest.change_tests import OtherSensor, make_follower, make_reference
from boresight.console.ingest.rules import PolicyRules
from boresight.estimation.statistics import drift as tests
from boresight.estimation.statistics.drift import Epoch

#: How many times likelier another sensor has to be.
CLEARLY = 1000.0
#: Sensors whose sets are followed, those whose baselines are nearest; each takes up to a second.
MOST_LOOKED_INTO = 3


def is_of_one_design(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two sensor files are of the same camera model and detector."""
    return all(one[name] == other[name] for name in ("camera_model", "detector"))


def find_other_sensor(point: TrendPoint, own: Trend, others: Sequence[Trend], rules: PolicyRules) -> OtherSensor | None:
    """Return the sensor that a calibration of a set outside of its forecast is of; None where none is clearly likelier."""
    epoch, typical = make_epoch(point, sorted(point.names)), own.sensor.document["typical_sigma"]
    expected = _expect(point, own, own.independent, rules)
    mine = None if expected is None else tests.baseline_test(epoch, expected, rules.false_alarm_rate)
    if expected is None or mine is None or not mine.rejects:
        return None
    step = np.diag(np.array([typical[name] for name in sorted(point.names)], np.float64) ** 2)
    stepped = _log_likelihood(epoch, replace(expected, covariance=expected.covariance + step))
    near = sorted((far, k) for k, one in enumerate(others) if (far := _measure_distance(point, one)) is not None)
    found: list[tuple[float, OtherSensor]] = []
    for _, k in near[:MOST_LOOKED_INTO]:
        other = _expect(point, others[k], others[k].independent[-MOST_FOLLOWED:], rules)
        test = None if other is None else tests.baseline_test(epoch, other, rules.false_alarm_rate)
        if other is None or test is None or test.rejects:
            continue
        gain, sensor = _log_likelihood(epoch, other) - stepped, others[k].sensor
        if gain > np.log(CLEARLY):
            found.append((gain, OtherSensor(sensor.id, sensor.name, mine, test)))
    return max(found, key=lambda one: one[0])[1] if found else None


def _expect(point: TrendPoint, trend: Trend, series: Sequence[TrendPoint], rules: PolicyRules) -> Epoch | None:
    """What a sensor's sets forecast of a calibration; its baseline where they are too few; None where neither compares."""
    follower = make_follower(rules)
    for one in series:
        if one.at_utc < point.at_utc:
            follower.follow(one)
    followed = follower.follow(point)
    if followed is not None and followed.found.forecast is not None:
        return followed.found.forecast
    return _of_baseline(point, trend)


def _measure_distance(point: TrendPoint, trend: Trend) -> float | None:
    """Chi-square of a calibration against a sensor's baseline; None where that is not measured, or of other parameters."""
    base = _of_baseline(point, trend) if trend.baseline is not None and trend.baseline.run_id is not None else None
    test = None if base is None else tests.baseline_test(make_epoch(point, sorted(point.names)), base)
    return None if test is None else test.statistic


def _of_baseline(point: TrendPoint, trend: Trend) -> Epoch | None:
    """The baseline's estimate of a calibration's parameters, in their order."""
    reference = make_reference(trend)
    if reference is None or not point.names or not set(point.names) <= set(reference.names):
        return None
    order = [reference.names.index(name) for name in sorted(point.names)]
    return replace(
        reference.epoch, value=reference.epoch.value[order], covariance=reference.epoch.covariance[np.ix_(order, order)]
    )


def _log_likelihood(epoch: Epoch, expected: Epoch) -> float:
    """Log of the normal density of a calibration, up to a constant that all share."""
    S: FloatArray = epoch.covariance + expected.covariance
    d = (epoch.value - expected.value) / (root := np.sqrt(np.diag(S)))
    correlation = S / np.outer(root, root)
    sign, log_det = np.linalg.slogdet(correlation)
    if sign <= 0:
        return -np.inf
    return -float(d @ np.linalg.solve(correlation, d) + log_det + 2.0 * np.log(root).sum()) / 2.0
