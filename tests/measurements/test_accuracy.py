"""Peers get the stars that Boresight gets, and each is judged by what its camera says of the detector."""

from typing import ClassVar

import numpy as np
import pytest

from boresight.measurements import accuracy
from boresight.measurements.bound import cramer_rao
from boresight.measurements.detector_errors import detector_errors, nearest_rotation
from boresight.measurements.peers import PEERS
from boresight.measurements.peers.trial import trial
from boresight.measurements.views import simulated_views
from boresight.sky.catalogue import load_catalogue
from boresight.studies.star_frames import STARS

FRAMES = 20
#: Filters that take each frame once end some sigmas from the optimum of so few.
LINEARISED_ONCE = {"numpy_ekf", "filterpy_ekf", "filterpy_sqrf"}


@pytest.fixture(scope="module")
def views():
    return simulated_views(FRAMES, 1, load_catalogue(None))


@pytest.fixture(scope="module")
def ours(views):
    return trial("boresight_batch", [views])["errors"][0]


@pytest.mark.parametrize("name", PEERS)
def test_every_peer_answers_and_is_as_right_as_the_problem_it_solves_allows(name, views, ours):
    peer = PEERS[name]
    if not peer.installed:
        pytest.skip(f"{peer.needs[1]} is not installed: pip install boresight[bench]")

    found = trial(name, [views])

    assert found["failures"] == []
    theirs = found["errors"][0]
    assert 0.3 < theirs["rms_px"] < 1.0
    if peer.problem == "poses":
        assert theirs["detector_px"] > 2 * ours["detector_px"]
    else:
        apart = np.abs(np.subtract(theirs["over_bound"], ours["over_bound"])).max()
        assert apart < (5.0 if name in LINEARISED_ONCE else 0.5)


def test_a_view_holds_the_same_number_of_stars_and_lies_on_the_detector(views):
    assert views.pixels.shape == (2 * FRAMES, STARS, 2)
    assert (views.pixels > -0.5).all()
    np.testing.assert_allclose(np.linalg.norm(views.stars, axis=-1), 1.0)
    assert views.first(5).n_frames == 5
    assert views.first(5).magnitude.shape == (10, STARS)


def test_the_truth_has_no_detector_error_however_it_is_turned(views):
    C = nearest_rotation(np.eye(3), np.eye(3)[[1, 2, 0]])

    def directions(row, col):
        return views.camera.directions(views.truth, row, col, views.sensor.pixel_pitch_m) @ C.T

    assert detector_errors(directions, views) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_a_detector_error_is_the_pixels_that_a_camera_is_wrong_by(views):
    """A focal length one part in a thousand too long is a pixel for each thousand from the middle, once the rotation is out."""
    longer = views.truth * np.where(np.arange(8) == 0, 1.001, 1.0)

    spread, corner = detector_errors(
        lambda row, col: views.camera.directions(longer, row, col, views.sensor.pixel_pitch_m), views
    )

    assert corner == pytest.approx(1.6, abs=0.3)
    assert 0.5 < spread < corner


def test_a_camera_that_sees_nothing_has_an_infinite_error(views):
    assert detector_errors(lambda row, _col: np.full((len(row), 3), np.nan), views) == (np.inf, np.inf)


def test_the_bound_falls_with_the_root_of_the_frames(views):
    few = views.first(FRAMES // 2)
    ratio = cramer_rao(few.arcs, few.sensor, few.truth) / cramer_rao(views.arcs, views.sensor, views.truth)

    assert np.exp(np.log(ratio).mean()) == pytest.approx(np.sqrt(2), rel=0.15)


def test_a_peer_that_raises_is_a_finding(views, monkeypatch):
    def broken(_views):
        raise RuntimeError("no bundle could be adjusted\nin this library")

    monkeypatch.setattr(type(PEERS["scipy_least_squares"]), "estimator", lambda _self: broken)

    found = trial("scipy_least_squares", [views])

    assert found["failures"] == ["RuntimeError: no bundle could be adjusted"]
    assert found["errors"] == []


def test_the_part_sets_each_peer_beside_the_batch_on_the_same_frames_in_the_same_run(monkeypatch):
    monkeypatch.setattr(accuracy, "LEAST_GROWTH_FRAMES", 12)
    told = []

    found = accuracy.measure(
        lambda fraction, message: told.append((fraction, message)),
        frames=12,
        sets=2,
        more_frames=24,
        peers=["scipy_least_squares"],
    )

    batch, scipy = (found["estimators"][name] for name in ("boresight_batch", "scipy_least_squares"))
    assert scipy["us_per_frame_over_ours"] == pytest.approx(scipy["us_per_frame"] / scipy["ours_us_per_frame"])
    assert scipy["sets"] == batch["sets"] == 2
    assert scipy["ours_us_per_frame"] != batch["us_per_frame"]  # measured again, in turns with the peer
    assert scipy["error_over_bound"] == pytest.approx(batch["error_over_bound"], rel=0.2)
    assert (scipy["growth"]["from_frames"], scipy["growth"]["to_frames"]) == (12, 24)
    assert scipy["growth"]["exponent"] < 4
    assert len(batch["error"]) == len(found["parameters"]) == 8
    assert {limit["kept"] for limit in found["limits"].values()} <= {True, False}
    assert [fraction for fraction, _ in told] == sorted(fraction for fraction, _ in told)


def _trial(name, views, seconds):
    return {"frames": len(views), "sets": 1, "seconds": [seconds], "peak_rss_mb": 1.0, "work_rss_mb": 0.5, "errors": [],
            "failures": [name]}  # fmt: skip


class _Here:
    """A process for trials that is none, and writes down who was asked."""

    asked: ClassVar[list[tuple[str, str]]] = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def submit(self, _trial_of, name, sets):
        self.asked.append((name, sets[0]))
        return self

    def result(self):
        name, views = self.asked[-1]
        return _trial(name, views, 6.0 if name == "pyceres" else 0.1)


def test_a_slow_peer_takes_turns_with_the_batch_and_solves_three_sets(monkeypatch):
    monkeypatch.setattr(accuracy, "_a_process", _Here)
    monkeypatch.setattr(_Here, "asked", [])

    slow, ours = accuracy._taking_turns("pyceres", ["one", "two", "three", "four"])

    assert _Here.asked == [
        (name, views) for views in ("one", "two", "three") for name in ("pyceres", "boresight_batch")
    ]
    assert slow["sets"] == ours["sets"] == 3
    assert slow["work_rss_mb"] == pytest.approx(1.5)


def test_too_short_sets_tell_no_exponent(views):
    assert accuracy._growth("boresight_batch", {"us_per_frame": 50.0}, views.first(10), views) == {}


def test_a_peer_that_is_not_installed_is_said_to_be_missing(monkeypatch):
    monkeypatch.setattr(type(PEERS["pyceres"]), "installed", property(lambda self: self.needs is None))

    found = accuracy.measure(lambda _fraction, _message: None, frames=12, sets=1, more_frames=12, peers=["pyceres"])

    assert found["estimators"]["pyceres"]["missing"] == "pyceres is not installed (pip install boresight[bench])"
    assert "us_per_frame" not in found["estimators"]["pyceres"]
