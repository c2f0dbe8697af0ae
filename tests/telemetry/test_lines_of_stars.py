"""Stars on one line say nothing across it, and the quality report says so before any run."""

import dataclasses

import numpy as np

from boresight.telemetry.quality.report import quality_report
from tests.telemetry.troubles import ROWS, STARS, Stars, calm_telemetry, codes, finding


def test_stars_on_one_line_everywhere_are_serious(sensor):
    place = np.arange(ROWS) % STARS
    troubled = dataclasses.replace(calm_telemetry(), row_px=10.0 + 50 * place, col_px=20.0 + 80.0 * place)
    assert finding(quality_report(troubled, sensor, Stars()), "ON_ONE_LINE")["severity"] == "SERIOUS"


def test_stars_all_over_the_detector_are_not_on_one_line(sensor):
    assert "ON_ONE_LINE" not in codes(quality_report(calm_telemetry(), sensor, Stars()))
