"""What is put into sets of passes comes out of them: f(T) and drift, without bias and as often inside as their intervals say."""

import numpy as np
import pytest

from boresight.calibration.estimate import never
from boresight.calibration.joint.passes_fit import PassesProblem, list_places, middle_days
from boresight.calibration.joint.variation import fit_variation, fit_walk
from boresight.calibration.options import CalibrationSettings
from boresight.estimation.walk import WalkedPasses, find_walk, link_by_walk
from tests.calibration.test_variation import PARAMETERS, moved, problem_of
from tests.effort import effort
from tests.estimation.fields import SCALE, TRUTH

SETS, WALKS = effort(60, 200), effort(8, 200)
#: 68 and 95 % of a normal number, and the rise of -2 log L at the ends of such intervals.
SHARES = {0.683: (1.0, 1.0), 0.95: (1.96, 3.841458820694124)}


def held(inside, share):
    """Whether so many of the sets were inside, within three sigmas of the count."""
    return np.mean(inside) == pytest.approx(share, abs=3.0 * np.sqrt(share * (1 - share) / len(inside)))


def test_a_focal_length_quadratic_in_temperature_is_recovered(sensor, catalogue):
    errors = []
    for number in range(SETS):
        rng = np.random.default_rng([11, number])
        warm = rng.uniform(-20.0, 30.0, 6)
        curve = 0.03 * warm + 0.001 * warm**2
        problem, passes = problem_of(moved(curve, seed=5000 + 10 * number, frames=6, warm=warm), sensor, catalogue)
        settings = CalibrationSettings(vary=("f_m",), vary_as="temperature", degree="2")
        _, found = fit_variation(problem, passes, PARAMETERS, TRUTH, settings, never)
        truth = SCALE[0] * np.array([0.03 + 0.002 * found.reference_temperature_c, 0.001])
        errors.append((np.array(found.coefficients["f_m"]) - truth) / found.coefficient_sigma["f_m"])
    errors = np.array(errors)
    assert np.abs(errors.mean(axis=0)).max() < 0.2 + 3.0 / np.sqrt(SETS)
    for share, (width, _) in SHARES.items():
        for one in errors.T:
            assert held(np.abs(one) < width, share)


def test_the_drift_of_a_focal_length_is_recovered(sensor, catalogue):
    truth, logs, inside, own = 0.4, [], {share: [] for share in SHARES}, np.array([0])
    for number in range(WALKS):
        rng = np.random.default_rng([12, number])
        days = np.cumsum(rng.integers(1, 6, 15))
        steps = truth * np.sqrt(np.diff(days, prepend=days[0])) * rng.normal(size=15)
        sets = moved(np.cumsum(steps), seed=9000 + 20 * number, frames=5, days=days.tolist())
        problem, passes = problem_of(sets, sensor, catalogue)
        of = PassesProblem(
            problem, passes, PARAMETERS, TRUTH, CalibrationSettings(), never, list_places(problem, passes)
        )
        between = np.diff(middle_days(passes))
        fitted, walk = fit_walk(of, between, own, of.fit(link_by_walk(own, between, np.array([0.1]))))
        logs.append(float(np.log(walk.sigma[0] / truth)))
        for share, (_, rise) in SHARES.items():
            found = find_walk(WalkedPasses(fitted.sums, of.departures(fitted), own, between), rise)
            inside[share].append(found.low[0] <= truth <= found.high[0])
    spread = np.std(logs)
    assert abs(np.mean(logs)) < (0.2 + 3.0 / np.sqrt(WALKS)) * spread
    for share, hits in inside.items():
        assert held(hits, share)
