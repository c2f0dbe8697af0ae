"""Points of the unscented filter beyond the turn of the lens: it diverges, says whose spread it was, and what helps."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.simulation.scenes import parse_scenario, simulate
from tests.calibration.test_pinhole_radial import SENSOR, TRUTH

WIDE = np.array([1e-3, 1e-4, 10.0, 10.0, 0.1, 20.0])
FIELD = {"sensor": SENSOR, "truth": TRUTH, "frames": 30, "exposures": 1, "magnitude_limit": 5.5, "seed": 3}


@pytest.fixture(scope="module")
def scenario():
    return parse_scenario(FIELD)


@pytest.fixture(scope="module")
def telemetry(scenario, catalogue):
    return simulate(scenario, np.random.default_rng(scenario.seed), catalogue)


@pytest.fixture
def calibrated(scenario, telemetry, catalogue):
    def run(sigma, method="ukf", **chosen):
        sensor = replace(scenario.sensor, typical_sigma=sigma)
        return calibrate(telemetry, sensor, catalogue, CalibrationSettings(method=method, match="given", **chosen))

    return run


def test_the_first_sentence_names_the_parameter_whose_spread_it_was(calibrated):
    result = calibrated(WIDE)
    assert result["status"] == "diverged"
    assert "states 2.4 of its sigmas away" in result["advice"][0]
    assert "by k2 the lens turns back" in result["advice"][0]
    assert "choose sqrf" in result["advice"][0]


def test_what_the_sentence_says_helps(calibrated):
    assert calibrated(WIDE, "sqrf")["status"] == "converged"
    assert calibrated(WIDE, initial_sigma_scale=0.5)["status"] == "converged"
    assert calibrated(WIDE / 20)["status"] == "converged"
