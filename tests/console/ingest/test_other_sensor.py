"""A set in the folder of a sensor of the same design: told with the numbers of both, and no step is taken for another sensor."""

from types import SimpleNamespace

import numpy as np
import pytest

from boresight.console.fleet.trend import Trend
from boresight.console.ingest.other_sensor import find_other_sensor
from boresight.console.ingest.rules import PolicyRules
from tests.console.ingest.test_change_tests import NAMES, SIGMA, TRUTH, P, point

TYPICAL = dict(zip(NAMES, (100.0 * SIGMA).tolist(), strict=True))
TWIN = TRUTH + 8.0 * SIGMA
RULE = PolicyRules()


def mission(sensor_id, truth, sets, seed, *, measured=True, covariance=P):
    """Sets of a sensor, the first of which is its baseline."""
    rng = np.random.default_rng(seed)
    points = [point(k, rng.multivariate_normal(truth, covariance), covariance=covariance) for k in range(sets)]
    document = {"parameters": points[0].parameters, "covariance": {"names": NAMES, "matrix": covariance.tolist()}}
    baseline = SimpleNamespace(id=sensor_id, name=f"PS-{sensor_id}", run_id=1 if measured else None, document=document)
    sensor = SimpleNamespace(id=sensor_id, name=f"ST-{sensor_id}", document={"typical_sigma": TYPICAL})
    return Trend(sensor, baseline, "inverted_wang", points, [], [], [], {})


@pytest.mark.parametrize("sets", [3, 20], ids=["against the baselines", "against the forecasts"])
def test_a_set_of_a_twin_is_told_with_both_chi_squares(sets):
    own, twin, far = mission(1, TRUTH, sets, 1), mission(2, TWIN, sets, 2), mission(3, TRUTH - 9.0 * SIGMA, sets, 3)
    found = find_other_sensor(point(sets, TWIN + 0.5 * SIGMA), own, [far, twin], RULE)
    assert (found.sensor_id, found.own.rejects, found.other.rejects) == (2, True, False)
    assert found.own.statistic > found.other.statistic + 20


def test_sets_of_the_sensor_itself_are_its_own_and_so_is_a_step_elsewhere():
    rng, own, twin = np.random.default_rng(5), mission(1, TRUTH, 20, 1), mission(2, TWIN, 20, 2)
    for k in range(50):
        assert find_other_sensor(point(20 + k, rng.multivariate_normal(TRUTH, P)), own, [twin], RULE) is None
    steps = rng.normal(size=(200, 2)) * 40.0 * SIGMA
    told = [find_other_sensor(point(20, TRUTH + step), own, [twin], RULE) is not None for step in steps]
    assert np.mean(told) < 0.05  # those that end where the twin is: two numbers alone, of 40 sigma


def test_a_sensor_that_is_hardly_known_or_declared_only_takes_nothing_for_its_own():
    own, there = mission(1, TRUTH, 20, 1), point(20, TWIN)
    vague = mission(2, TWIN, 3, 2, covariance=1e4 * P)
    declared = mission(3, TWIN, 3, 3, measured=False)
    assert find_other_sensor(there, own, [vague, declared], RULE) is None


def test_two_sensors_that_nothing_tells_apart_are_not_told_apart():
    own, same = mission(1, TRUTH, 20, 1), mission(2, TRUTH, 20, 2)
    assert find_other_sensor(point(20, TRUTH), own, [same], RULE) is None
