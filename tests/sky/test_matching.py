"""Association on skies made up star by star: one to one, every reason for not matching, doubt where there is doubt."""

import dataclasses
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.stars import star_frames
from boresight.calibration.matching.rematch import ground_covariance, rematch
from boresight.calibration.options import CalibrationSettings
from boresight.estimation.blocks import computing_on
from boresight.kernels import matching as loops
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.sky import matching
from boresight.sky.catalogue import load_catalogue
from boresight.sky.guide_stars import GuideStars, ObserverMotion
from boresight.sky.matching import ROW_REASONS, STARTS, Detections, match
from tests.effort import effort
from tests.exposures import SIGMA, Exposure

CONE = 0.26


def reason(words):
    (place,) = (place for place, phrase in enumerate(ROW_REASONS) if words in phrase)
    return place


@dataclass
class Image:
    detections: Detections
    sky: np.ndarray
    true: np.ndarray
    density: float = 1.0

    def match(self, minimum_stars=4, identify=None):
        order = np.argsort(self.sky[:, 2], kind="stable")
        n = len(order)
        stars = GuideStars(np.arange(1, n + 1)[order], self.sky[order], np.zeros((n, 3)), np.zeros(n), self.density)
        motion = ObserverMotion(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))
        return match(self.detections, stars, motion, CONE, minimum_stars, identify)

    def with_(self, **changes):
        return replace(self, detections=replace(self.detections, **changes))


def image(seed, n=12, named=12, false=0, extra=(), exact=False, noise=1.0, y=None):
    rng = np.random.default_rng(seed)
    field = Exposure(rng, n + false)
    sky = field.stars(np.zeros(11) if y is None else y)[:n]
    s = field.s + noise * SIGMA * np.einsum("nr,nra->na", rng.normal(size=(n + false, 2)), field.T)
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    true = np.r_[np.arange(1, n + 1), np.zeros(false, int)]
    given_id = np.where(np.arange(n + false) < named, true, 0)
    known = given_id > 0
    given_s = np.full((n + false, 3), np.nan)
    given_s[known] = sky[given_id[known] - 1]
    detections = Detections(
        frame_start=np.array([0, 1]), row_start=np.array([0, n + false]), s=s,
        G=field.G * (1e-6 if exact else 1.0), sigma_rad=field.sigma, star_id=given_id, given_s=given_s,
        own=np.zeros(n + false, np.bool_), quaternion=np.full((1, 4), np.nan), time_s=np.zeros(1),
    )  # fmt: skip
    beside = [np.atleast_2d(star(field, sky)) for star in extra]
    return Image(detections, np.concatenate([sky, *beside]), true)


def beside(k, sigmas, turn=0.0):
    def star(field, sky):
        c = sky[k] + sigmas * SIGMA * ([np.cos(turn), np.sin(turn)] @ field.T[k]) @ field.C
        return c / np.linalg.norm(c)

    return star


# One to one.


@settings(max_examples=effort(16, 80))
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(3, 14),
    named=st.integers(0, 14),
    false=st.integers(0, 4),
    companions=st.lists(st.tuples(st.integers(0, 2), st.floats(1.0, 30.0), st.floats(0, 6.28)), max_size=4),
    exact=st.booleans(),
)
def test_no_star_is_matched_twice_and_every_match_is_a_star_of_the_sky(seed, n, named, false, companions, exact):
    scene = image(seed, n, min(named, n), false, [beside(*star) for star in companions], exact)
    if named < 2:
        scene = scene.with_(quaternion=Rotation.from_matrix(np.eye(3)).as_quat()[None])
    answer = scene.match()
    found = answer.star_id > 0
    assert len(set(answer.star_id[found])) == found.sum()
    np.testing.assert_allclose(answer.s_i[found], scene.sky[answer.star_id[found] - 1])
    np.testing.assert_array_equal(found, answer.row_reason == loops.MATCHED)
    np.testing.assert_array_equal(found, np.isfinite(answer.s_i[:, 0]))
    np.testing.assert_array_equal(found, np.isfinite(answer.tolerance_rad))
    assert (answer.reason[0] == 0) == (found.sum() >= 4)
    assert np.isfinite(answer.C).all() or not found.any()


@settings(max_examples=effort(12, 40))
@given(seed=st.integers(0, 2**32), named=st.integers(4, 12), size=st.floats(0.0, 1.0))
def test_whatever_the_parameters_are_off_by_within_their_covariance_no_star_is_taken_for_another(seed, named, size):
    y = np.r_[np.zeros(3), size * np.random.default_rng(seed).normal(size=8)]
    answer = image(seed, 12, named, 2, y=y).match()
    assume(answer.reason[0] == 0)
    true = np.r_[np.arange(1, 13), 0, 0]
    assert np.isin(answer.star_id - true, [0, *-np.arange(1, 13)])[answer.star_id == 0].all()
    np.testing.assert_array_equal(answer.star_id[answer.star_id > 0], true[answer.star_id > 0])


# Every reason.


def test_false_detections_have_no_star_and_two_of_one_star_are_both_in_doubt():
    answer = image(1, 12, 6, false=1).match()
    assert answer.star_id.tolist() == [*range(1, 13), 0]
    assert answer.row_reason[12] == reason("no catalogue star")
    scene = image(3, 12, 8, exact=True, noise=0.0)
    s = scene.detections.s.copy()
    s[11] = s[10] + 1.0 * SIGMA * np.array([1.0, 0.0, -s[10, 0] / s[10, 2]])
    s[11] /= np.linalg.norm(s[11])
    answer = scene.with_(s=s).match()
    assert answer.row_reason[10] == answer.row_reason[11] == reason("equally well")


@pytest.mark.parametrize("apart", [1.5, 2.5, 8.0])
def test_a_second_star_makes_an_unnamed_detection_ambiguous_only_where_it_is_nearly_as_likely(apart):
    answer = image(2, 12, 8, extra=[beside(10, apart)], exact=True, noise=0.3).match()
    assert (np.delete(answer.star_id, 10) == np.delete(np.arange(1, 13), 10)).all()
    if apart < 8:
        assert answer.row_reason[10] == reason("equally well")
    else:
        assert answer.star_id[10] == 11


def test_two_stars_that_may_have_changed_places_are_called_ambiguous():
    scene, field = image(4, 5, 3), Exposure(np.random.default_rng(4), 5)
    # the second star lies where the three named ones leave the first most uncertain
    Lambda, _ = field.information(np.arange(5) < 3)
    _, axes = np.linalg.eigh(field.A[3] @ np.linalg.solve(Lambda, field.A[3].T))
    close = scene.sky[3] + 12 * SIGMA * axes[:, 1] @ field.T[3] @ field.C
    scene.sky[4] = close / np.linalg.norm(close)
    s, G = scene.detections.s.copy(), scene.detections.G.copy()
    s[4], G[4] = field.C @ scene.sky[4], G[3]
    wide, narrow = (scene.with_(s=s, G=scale * G).match() for scale in (4.0, 1e-6))
    assert wide.row_reason.tolist() == [loops.MATCHED] * 3 + [reason("equally well")] * 2
    assert narrow.star_id.tolist() == [1, 2, 3, 4, 5]


def test_in_a_gate_that_holds_chance_stars_nothing_is_taken():
    scene = image(5, 12, 4)
    scene.density = 1e9
    answer = scene.match()
    assert (answer.row_reason[4:] == reason("too wide")).any()
    assert set(answer.row_reason[4:]) <= {reason("too wide"), reason("no catalogue star")}


@pytest.mark.parametrize("exact", [True, False], ids=["refined", "ground"])
def test_a_wrong_name_disagrees_with_the_other_arcs(exact):
    scene = image(6, 12, 12, exact=exact)
    star_id, given_s = scene.detections.star_id.copy(), scene.detections.given_s.copy()
    star_id[[2, 9]], given_s[[2, 9]] = star_id[[9, 2]], given_s[[9, 2]]
    answer = scene.with_(star_id=star_id, given_s=given_s).match()
    np.testing.assert_array_equal(answer.star_id[answer.star_id > 0], scene.true[answer.star_id > 0])
    assert (answer.star_id[[2, 9]] != star_id[[2, 9]]).all()
    assert (answer.star_id > 0).sum() >= 10


def test_a_name_far_off_its_star_disagrees():
    scene = image(6, 12, 12, exact=True)
    given_s = scene.detections.given_s.copy()
    given_s[2] = given_s[9] + 1e-2
    answer = scene.with_(given_s=given_s / np.linalg.norm(given_s, axis=1, keepdims=True)).match()
    assert answer.star_id[2] in {0, 3}
    assert (np.delete(answer.star_id, 2) > 0).all()


def test_without_anything_there_is_no_attitude_and_too_few_stars_are_said_to_be_too_few():
    answer = image(7, 12, 0).match()
    assert (answer.row_reason == reason("no attitude")).all()
    assert answer.start[0] == STARTS.index("none")
    assert np.isnan(answer.C).all()
    scene = image(8, 6, 0)
    hinted = scene.with_(quaternion=Rotation.from_matrix(Exposure(np.random.default_rng(8), 6).C).as_quat()[None])
    assert hinted.match(4).reason[0] == 0
    answer = hinted.match(7)
    assert answer.reason[0] == 2
    assert (answer.row_reason == reason("too few other stars")).all()


# Lost in space.


def test_what_the_identification_answers_is_checked_by_matching():
    scene = image(9, 12, 0)
    right = Rotation.from_matrix(Exposure(np.random.default_rng(9), 12).C)
    off = Rotation.from_rotvec([0.01, -0.01, 0.02]) * right
    asked = []

    def identify(exposure, turn=off):
        asked.append(exposure)
        return turn.as_quat()

    answer = scene.match(identify=identify)
    assert asked == [0]
    assert answer.start[0] == STARTS.index("lost in space")
    assert answer.star_id.tolist() == list(range(1, 13))

    nonsense = scene.match(identify=lambda _: Rotation.from_rotvec([0.0, 1.0, 0.0]).as_quat())
    assert not (nonsense.star_id > 0).any()
    assert not (scene.match(identify=lambda _: None).star_id > 0).any()


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
