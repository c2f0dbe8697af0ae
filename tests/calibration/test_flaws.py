"""A flaw at one place, edges and exposures: found where they are, measured, and by chance as seldom as told."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from boresight.calibration.trust.departures import EDGE, find_departures
from boresight.calibration.trust.displacements import add_up, find_score
from boresight.calibration.trust.fitted_set import UNLIKELY
from boresight.calibration.trust.flaws import bump, chance_of_maximum, measure_field
from tests.calibration.sets import case, field
from tests.estimation.fields import COLUMNS, ROWS

HALF_DIAGONAL = np.hypot(ROWS, COLUMNS) / 2


def moved(telemetry, u):
    row, col = telemetry.row_px + u[:, 0], telemetry.col_px + u[:, 1]
    return replace(telemetry, row_px=np.clip(row, 0, ROWS - 1), col_px=np.clip(col, 0, COLUMNS - 1))


def find_tests(report):
    return {test.name: test for test in report.tests}


def test_the_chance_of_a_maximum_is_that_of_simulated_fields():
    # white noise smoothed over w: a field of the correlation exp(-d^2 / 4 w^2), whose metric is that of the plane over 2 w^2
    rng, w, shape, thinned = np.random.default_rng(1), 4.0, (60, 80), (slice(30, 90, 2), slice(30, 110, 2))
    fields = np.array([gaussian_filter(rng.normal(size=(120, 140)), w)[thinned] for _ in range(1500)])
    fields /= fields.std()
    flat = fields.reshape(len(fields), -1)
    place = np.stack(np.meshgrid(*(np.arange(0, n, 2) for n in shape), indexing="ij"), axis=-1).reshape(-1, 2)
    correlation = np.exp(-np.sum((place[:, None] - place) ** 2, axis=2) / (4 * w**2))
    around, area = measure_field(np.eye(len(place)), correlation, (30, 40))
    assert around == pytest.approx((58 + 78) / (np.sqrt(2) * w), rel=0.05)
    assert area == pytest.approx(58 * 78 / (2 * w**2), rel=0.06)
    for t in (3.5, 4.0):
        p, seen = chance_of_maximum(t, around, area), np.mean(flat.max(axis=1) > t)
        assert seen == pytest.approx(p, abs=4 * np.sqrt(p / len(flat)) + 0.1 * p)


def test_a_dent_is_found_where_it_is_and_a_sound_window_has_none(sensor, catalogue):
    centre, width, depth = np.array([[700.0], [1500.0]]), 300.0, 1.0
    telemetry = field(4, frames=150)
    places = np.stack([telemetry.row_px, telemetry.col_px], axis=1)[..., None]
    dented = case(moved(telemetry, depth * bump(places, centre, width)[..., 0]), sensor, catalogue)
    report = dented.report
    test = find_tests(report)["flaw"]
    assert test.noticed
    assert report.causes[0].name == "flaw"
    flaw = np.array([*map(float, re.search(r"row (\d+), column (\d+)", report.causes[0].sentence).groups())])
    assert np.hypot(*(flaw - centre[:, 0])) < 0.5 * width
    assert not find_tests(case(telemetry, sensor, catalogue).report)["flaw"].noticed


def test_what_is_drawn_off_near_the_edges_is_measured_and_named(sensor, catalogue):
    telemetry, reach = field(5, frames=150), EDGE * HALF_DIAGONAL
    inwards = [
        np.maximum(1 - at / reach, 0) - np.maximum(1 - (n - 1 - at) / reach, 0)
        for at, n in ((telemetry.row_px, ROWS), (telemetry.col_px, COLUMNS))
    ]
    spoiled = case(moved(telemetry, 0.8 * np.stack(inwards, axis=1)), sensor, catalogue)
    departures, _ = find_departures(spoiled.ground)
    score = find_score(add_up(spoiled.ground, departures), "edges")
    assert score.c[0] == pytest.approx(-0.8, abs=4 * np.sqrt(score.covariance[0, 0]))
    assert score.p < UNLIKELY
    assert spoiled.report.causes[0].name == "edges"


def test_exposures_of_a_frame_that_see_another_focal_length_are_told_apart(sensor, catalogue):
    telemetry = field(6, frames=100)
    second = (telemetry.exposure == 1)[:, None]
    centre = np.array([(ROWS - 1) / 2, (COLUMNS - 1) / 2])
    places = np.stack([telemetry.row_px, telemetry.col_px], axis=1)
    spoiled = case(moved(telemetry, 4e-4 * second * (places - centre)), sensor, catalogue)
    report = spoiled.report
    assert find_tests(report)["exposure"].noticed
    assert report.causes[0].name == "exposure"
    departures, _ = find_departures(spoiled.ground)
    score = find_score(add_up(spoiled.ground, departures), "exposure")
    f, P = spoiled.ground.names.index("f_m"), score.covariance
    ppm = 1e6 * score.c[f] * spoiled.ground.parameters.scale[f] / spoiled.ground.x[spoiled.ground.parameters.free[f]]
    sigma = (
        1e6
        * np.sqrt(P[f, f])
        * spoiled.ground.parameters.scale[f]
        / spoiled.ground.x[spoiled.ground.parameters.free[f]]
    )
    assert ppm == pytest.approx(200.0, abs=4 * sigma)  # half of the difference, from the mean of both


def test_a_set_of_single_exposures_has_no_test_of_them(sensor, catalogue):
    report = case(field(7, frames=60, exposures=1), sensor, catalogue).report
    assert "exposure" not in find_tests(report)
