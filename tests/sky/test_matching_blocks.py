"""Frames are matched one by one: how they are cut into blocks, and on how many threads, changes no bit."""

import dataclasses

import numpy as np
import pytest

from benchmarks.stars import star_frames
from boresight.calibration.matching.rematch import ground_covariance, rematch
from boresight.calibration.options import CalibrationSettings
from boresight.estimation.blocks import computing_on
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.sky import matching
from boresight.sky.catalogue import load_catalogue

SENSOR = st16_sensor(1)


@pytest.fixture(scope="module")
def matched():
    catalogue, rng = load_catalogue(None), np.random.default_rng(12)
    stars = star_frames(40, SENSOR, st16_truth(1), catalogue, rng)
    half_named = dataclasses.replace(stars, star_id=np.where(rng.random(len(stars)) < 0.5, stars.star_id, 0))
    P, settings = ground_covariance(SENSOR, 10.0), CalibrationSettings(match="rematch")
    return lambda: rematch(half_named, SENSOR, catalogue, SENSOR.initial, P, settings, None)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_blocks_and_threads_change_no_bit_of_the_matches(matched, monkeypatch, threads):
    whole = matched()
    monkeypatch.setattr(matching, "FRAMES", 7)
    with computing_on(threads):
        in_parts = matched()
    for field in dataclasses.fields(whole):
        np.testing.assert_array_equal(getattr(in_parts, field.name), getattr(whole, field.name), strict=True)
    assert (whole.star_id > 0).mean() > 0.9
