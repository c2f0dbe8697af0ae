"""Peers get the stars that Boresight gets, and each is judged by what its camera says of the detector."""

import numpy as np
import pytest

from benchmarks import accuracy
from benchmarks.accuracy import detector_errors, trial
from benchmarks.estimators import PEERS
from benchmarks.stars import simulated_views
from boresight.sky.catalogue import load_catalogue

FRAMES = 20
#: Filters that take each frame once end some sigmas from the optimum of so few.
LINEARISED_ONCE = {"numpy_ekf", "filterpy_ekf", "filterpy_sqrf"}


@pytest.fixture(scope="module")
def views():
    return simulated_views(FRAMES, 1, load_catalogue(None))


@pytest.mark.full
@pytest.mark.parametrize("name", PEERS)
def test_every_peer_answers_and_is_as_right_as_the_problem_it_solves_allows(name, views):
    if not PEERS[name].installed:
        pytest.skip(f"{PEERS[name].package} is not installed: pip install boresight[bench]")
    theirs, ours = (trial(one, views)["errors"] for one in (name, "boresight_batch"))
    assert 0.3 < theirs["rms_px"] < 1.0
    if PEERS[name].problem == "poses":
        assert theirs["detector_px"] > 2 * ours["detector_px"]
    else:
        apart = np.abs(np.subtract(theirs["over_bound"], ours["over_bound"])).max()
        assert apart < (5.0 if name in LINEARISED_ONCE else 0.5)


def test_a_detector_error_is_the_pixels_that_a_camera_is_wrong_by_however_it_is_turned(views):
    longer, C = views.truth * np.where(np.arange(8) == 0, 1.001, 1.0), np.eye(3)[[1, 2, 0]]

    def errors(x):
        pitch = views.sensor.pixel_pitch_m
        return detector_errors(lambda row, col: views.camera.directions(x, row, col, pitch) @ C.T, views)

    spread, corner = errors(longer)
    assert errors(views.truth) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert corner == pytest.approx(1.6, abs=0.3)
    assert 0.5 < spread < corner


def test_a_peer_that_raises_is_a_finding(views, monkeypatch):
    def broken(_views):
        raise RuntimeError("no bundle could be adjusted\nin this library")

    monkeypatch.setitem(vars(PEERS["scipy_least_squares"]), "estimate", broken)
    found = trial("scipy_least_squares", views)

    assert found["failure"] == "RuntimeError: no bundle could be adjusted"
    assert found["errors"] is None


def test_the_part_sets_each_peer_beside_the_batch_on_the_same_frames_in_the_same_run(monkeypatch):
    monkeypatch.setattr(accuracy, "LEAST_GROWTH_FRAMES", 12)
    monkeypatch.setattr(accuracy, "GROWTH_REPEATS", 1)
    monkeypatch.setattr(type(PEERS["pyceres"]), "installed", property(lambda self: not self.module))
    some = ["scipy_least_squares", "pyceres"]
    found = accuracy.measure(lambda *_: None, frames=12, sets=1, more_frames=24, peers=some)["estimators"]
    batch, scipy = found["boresight_batch"], found["scipy_least_squares"]
    assert scipy["us_per_frame_over_ours"] == pytest.approx(scipy["us_per_frame"] / scipy["ours_us_per_frame"])
    assert scipy["error_over_bound"] == pytest.approx(batch["error_over_bound"], rel=0.2)
    assert (scipy["growth"]["from_frames"], scipy["growth"]["to_frames"]) == (12, 24)
    assert found["pyceres"]["missing"] == "pyceres is not installed (pip install boresight[bench])"
