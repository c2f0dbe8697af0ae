"""Smoother and process noise of a calibration: the batch where nothing moves, drift by time, by parameter, and from the data."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.errors import RefusedInputError
from tests.calibration.conftest import telemetry
from tests.calibration.sets import differences, in_memory, same_in_pieces, written
from tests.calibration.test_joint import BEGIN, DAY
from tests.calibration.test_variation import moved, run

SECOND = np.timedelta64(1, "s")


def timed(seed=50, frames=60, gap=SECOND, after=30):
    """One set, a frame a second, but for a gap after some frame."""
    one = telemetry(seed, frames=frames)
    return replace(one, time_utc=BEGIN + one.frame * SECOND + np.where(one.frame >= after, 1, 0) * gap)


def filtered(one, sensor, catalogue, **settings):
    chosen = {"match": "given", "method": "sqrf", **settings}
    return calibrate(one, sensor, catalogue, CalibrationSettings.parse(chosen))


def test_the_smoothed_parameters_of_a_camera_that_rests_are_the_batch(sensor, catalogue):
    one = timed()
    batch = calibrate(one, sensor, catalogue, CalibrationSettings(match="given"))
    found = filtered(one, sensor, catalogue, smooth=True, initial_sigma_scale=1e4)
    assert found.smoothed.settled
    assert found.smoothed.frame == sorted(set(one.frame.tolist()))
    for name, values, sigmas in zip(
        found.parameter_names,
        zip(*found.smoothed.parameters, strict=True),
        zip(*found.smoothed.sigma, strict=True),
        strict=True,
    ):
        # the batch rests within 1e-4 of a sigma of its optimum
        np.testing.assert_allclose(values, batch.parameters[name], atol=2e-4 * batch.sigma[name])
        np.testing.assert_allclose(sigmas, batch.sigma[name], rtol=1e-5)


@pytest.mark.parametrize("method", ["sqrf", "ekf", "svd"])
def test_a_smoother_changes_nothing_of_its_filter(sensor, catalogue, method):
    one = timed(frames=30)
    plain, smoothed = (
        filtered(one, sensor, catalogue, method=method, variant="q", smooth=smooth).to_dict()
        for smooth in (False, True)
    )
    assert smoothed["smoothed"]["settled"]
    left = {key: value for key, value in smoothed.items() if key not in ("smoothed", "inputs")}
    assert differences({**left, "smoothed": None}, {k: v for k, v in plain.items() if k != "inputs"}) == []
    end = np.array(smoothed["smoothed"]["parameters"])[-1]
    np.testing.assert_allclose((end - list(plain["parameters"].values())) / list(plain["sigma"].values()), 0, atol=0.6)


def test_a_smoother_in_pieces_gives_the_bits_of_memory(sensor, catalogue, tmp_path):
    path, whole = written(timed(frames=40), tmp_path)
    choices = {"match": "given", "method": "sqrf", "variant": "q", "smooth": True}
    document = same_in_pieces(path, whole, sensor, catalogue, 16, **choices)
    assert document["smoothed"]["settled"]
    assert document == document | {"smoothed": in_memory(whole, sensor, catalogue, **choices)["smoothed"]}


def test_drift_a_day_counts_the_time_between_frames_and_drift_a_frame_does_not(sensor, catalogue):
    sets = [timed(gap=gap, frames=40, after=20) for gap in (0 * SECOND, 30 * DAY)]
    by_frame, by_day = (
        [
            filtered(one, sensor, catalogue, variant="q", process_noise_sigma=0.02, process_noise_per=per, smooth=True)
            for one in sets
        ]
        for per in ("frame", "day")
    )
    assert by_frame[0].parameters == by_frame[1].parameters
    short, long = (np.array(found.history.sigma)[:, 0] for found in by_day)
    after = np.array(by_day[1].history.frame)
    assert long[after < 20] == pytest.approx(short[after < 20])
    first = int(np.flatnonzero(after >= 20)[0])
    # the gap adds 0.02^2 a day of variance before the frame that ends it
    assert long[first] > 1.1 * short[first]
    no_gap = filtered(sets[0], sensor, catalogue, smooth=True)
    assert by_day[0].sigma["f_m"] == pytest.approx(no_gap.sigma["f_m"], rel=0.02)


def test_drift_of_one_parameter_is_its_own(sensor, catalogue):
    one = timed()
    usual = filtered(one, sensor, catalogue)
    found = filtered(one, sensor, catalogue, variant="q", process_noise_sigma=0.0, process_noise_of=["f_m=0.1"])
    assert found.process_noise.sigma["f_m"] == 0.1
    assert found.process_noise.sigma["n0_px"] == 0.0
    assert found.process_noise.source == "given"
    assert found.sigma["f_m"] > 1.3 * usual.sigma["f_m"]
    assert found.sigma["b4_per_m4"] == pytest.approx(usual.sigma["b4_per_m4"], rel=0.2)


def test_a_filter_on_a_joint_set_takes_its_drift_from_the_passes_and_says_so(sensor, catalogue):
    rng, truth = np.random.default_rng(4), 0.5
    sets = moved(np.cumsum(truth * rng.normal(size=10)), frames=12, days=list(range(10)))
    found = run(sets, sensor, catalogue, method="sqrf", variant="q", smooth=True)
    noise = found.process_noise
    assert (noise.source, noise.per, noise.stretches) == ("estimated", "day", 10)
    assert noise.interval["f_m"][0] < truth < noise.interval["f_m"][1]
    assert noise.interval["m0_px"][0] == 0.0
    assert noise.sigma["f_m"] > 5 * noise.sigma["b4_per_m4"]
    assert "10 stretches" in noise.sentence
    stated = run(sets, sensor, catalogue, method="sqrf", variant="q", process_noise_sigma=0.02)
    assert stated.process_noise.source == "given"


def test_one_short_set_keeps_the_usual_drift_bit_for_bit_and_says_so(sensor, catalogue):
    one = timed()
    usual = filtered(one, sensor, catalogue, variant="q").to_dict()
    stated = filtered(one, sensor, catalogue, variant="q", process_noise_sigma=0.02).to_dict()
    assert usual["process_noise"]["source"] == "usual"
    assert set(usual["process_noise"]["sigma"].values()) == {0.02}
    apart = ("process_noise", "inputs")
    assert differences(*({k: v for k, v in one.items() if k not in apart} for one in (usual, stated))) == []
    assert filtered(one, sensor, catalogue).process_noise is None


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"method": "batch", "smooth": True}, "choose a filter, or leave 'smooth' off"),
        ({"smooth": True, "forgetting_factor": 0.9}, "set 'forgetting_factor' to 1"),
        ({"variant": "q", "process_noise_per": "day"}, "give --process-noise"),
        ({"variant": "q", "process_noise_of": ["f_m=lots"]}, "give parameters with numbers"),
        ({"variant": "q", "process_noise_of": ["k1=0.5"]}, "k1 is not free, so it cannot drift: choose"),
        ({"variant": "q", "process_noise_sigma": 0.1, "process_noise_per": "day"}, "add time_utc"),
    ],
)
def test_what_cannot_be_smoothed_or_drift_is_refused(sensor, catalogue, settings, said):
    with pytest.raises(RefusedInputError, match=said):
        filtered(telemetry(1, frames=10), sensor, catalogue, **settings)
