"""What the whole-way tests of transitions stand on: real servers over real stores, filled with a real calibration."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_csv
from tests.transitions.installation import ExampleRun

SCENARIO = dataclasses.replace(calibration_scenario(1), frames=30)


@pytest.fixture(scope="session")
def example_run(tmp_path_factory: pytest.TempPathFactory, catalogue: Catalogue) -> ExampleRun:
    path: Path = tmp_path_factory.mktemp("evidence") / "telemetry.csv"
    telemetry = simulate(SCENARIO, np.random.default_rng(1), catalogue)
    write_csv(telemetry, path)
    result = calibrate(telemetry, SCENARIO.sensor, catalogue, CalibrationSettings(method="batch")).to_dict()
    return ExampleRun(sensor_document(SCENARIO.sensor), path, result)
