"""The first update of a filter: it is left time to rest, and takes in frames until what they tell hangs on no place in it."""

import numpy as np
import pytest

from boresight.calibration import sequence
from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor
from tests.estimation.fields import rotation

PITCH, NOISE_PX, STARS = 6.9e-6, 0.13, 120
#: Eleven degrees corner to corner with hardly any distortion: (m0, a2) and (n0, a1) move stars almost alike.
NARROW = Sensor(
    name="NARROW", rows=768, columns=1024, pixel_pitch_m=PITCH, camera_model="inverted_wang", parity=-1,
    centroid_sigma_px=NOISE_PX, initial=np.array([0.035, 383.5, 511.5, 0.0, 0.0, 0.0, 0.0, 1.0]),
    typical_sigma=np.array([3e-4, 10.0, 10.0, 1e6, 100.0, 5e-3, 5e-3, 2e-4]), free=INVERTED_WANG.parameter_names,
)  # fmt: skip
TRUTH = np.array([0.0353, 401.0, 546.0, 3e5, -89.0, 7e-3, 3e-3, 1.00004])


def dense(seed, frames=5):
    rng = np.random.default_rng(seed)
    n = frames * STARS
    row, col = rng.uniform(0, NARROW.rows - 1, n), rng.uniform(0, NARROW.columns - 1, n)
    s_d = INVERTED_WANG.directions(TRUTH, row, col, PITCH).reshape(-1, STARS, 3)
    s_i = np.concatenate([block @ rotation(rng) for block in s_d])
    return Telemetry(
        frame=np.repeat(np.arange(frames), STARS),
        exposure=np.zeros(n, np.int64),
        row_px=row + NOISE_PX * rng.normal(size=n),
        col_px=col + NOISE_PX * rng.normal(size=n),
        star_id=np.arange(1, n + 1),
        ra_rad=np.arctan2(s_i[:, 1], s_i[:, 0]),
        dec_rad=np.arcsin(s_i[:, 2]),
    )


@pytest.fixture
def calibrated(catalogue):
    def run(seed, method, **chosen):
        settings = CalibrationSettings(method=method, match="given", **chosen)
        return calibrate(dense(seed), NARROW, catalogue, settings)

    return run


def off(document, other):
    return max(
        abs(document["parameters"][name] - value) / other["sigma"][name] for name, value in other["parameters"].items()
    )


@pytest.mark.parametrize("method", ["sqrf", "angular", "svd"])
def test_a_few_dense_fields_are_taken_in_at_once_and_end_where_the_batch_does(calibrated, method):
    for seed in (0, 1, 3):
        found, batch = (calibrated(seed, each) for each in (method, "batch"))
        assert off(found, batch) < (1.5 if method == "svd" else 0.3)  # singular values hold a tenth less
        assert not any("filter claims" in sentence for sentence in found["advice"])
        assert any("All 5 frames were taken in as one update" in sentence for sentence in found["advice"])


def test_taken_one_by_one_they_would_claim_several_times_what_they_hold(calibrated, monkeypatch):
    monkeypatch.setattr(sequence, "BENT", np.inf)
    found = [calibrated(seed, "svd") for seed in (0, 1, 3)]
    assert any(any("filter claims" in sentence for sentence in document["advice"]) for document in found)
    assert not any("one update" in sentence for document in found for sentence in document["advice"])


def test_the_first_update_is_left_time_to_rest(calibrated, monkeypatch):
    monkeypatch.setattr(sequence, "BENT", np.inf)  # the first frame alone, which takes 15 linearisations
    rested = calibrated(3, "svd")
    allowed = calibrated(3, "svd", linearisations=100)
    monkeypatch.setattr(sequence, "START_LINEARISATIONS", 1)
    stopped = calibrated(3, "svd")
    assert off(rested, allowed) < 0.1
    assert off(stopped, allowed) > 0.3


def test_the_filter_as_printed_still_takes_one_frame_and_linearises_once(calibrated):
    document = calibrated(0, "svd", linearisations=1)
    assert document["iterations"] == 5
