"""What matching again finds, and what it does not believe, from every start; pooled over sensors so that shares mean something."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.matching.rematch import matched_telemetry
from boresight.sky.matching import LEFT_OUT, STARTS
from tests.calibration.rematched import SENSORS, Score, sky


@pytest.fixture(scope="session")
def patterns(tmp_path_factory):
    return tmp_path_factory.mktemp("patterns")


@pytest.mark.parametrize(
    ("start", "least", "most_wrong"), [("ground", 0.97, 0.002), ("refined", 0.99, 0.001)], ids=["ground", "refined"]
)
def test_half_of_the_names_come_back_and_hardly_any_is_wrong(catalogue, start, least, most_wrong):
    score = Score()
    for number in SENSORS:
        field = sky(catalogue, number, 50, start=start)
        telemetry = field.blanked(0.5)
        score.count(field.match(telemetry), telemetry, field.true)
    assert score.sought > 2500
    assert score.recovered >= least
    assert score.wrong_share <= most_wrong


def test_the_quaternion_alone_is_start_enough(catalogue):
    score = Score()
    for number in SENSORS:
        field = sky(catalogue, number, 30)
        telemetry = replace(field.telemetry, star_id=None)
        matches = field.match(telemetry)
        assert set(matches.start[matches.valid]) <= {STARTS.index("quaternion"), STARTS.index("other exposure")}
        score.count(matches, replace(telemetry, star_id=np.zeros_like(field.true)), field.true)
    assert score.recovered >= 0.97
    assert score.wrong_share <= 0.002


@pytest.mark.parametrize("number", [1, 4])
def test_a_frame_without_anything_is_found_from_its_neighbours(catalogue, number):
    field = sky(catalogue, number, 30)
    bare = np.isin(field.telemetry.frame, [0, 11, 12, 29])
    telemetry = replace(field.telemetry, star_id=np.where(bare, 0, field.true), quaternion=None)
    matches = field.match(telemetry)
    without = np.isin(matches.frame, [0, 11, 12, 29])
    assert matches.valid[without].all()
    assert STARTS.index("neighbouring frame") in matches.start[without]
    assert STARTS.index("lost in space") not in matches.start
    assert np.mean(matches.star_id[bare & (field.true > 0)] == field.true[bare & (field.true > 0)]) > 0.95


def test_with_neither_names_nor_attitudes_the_sky_is_recognised(catalogue, patterns):
    pytest.importorskip("tetra3rs", reason="the lost-in-space extra is not installed")
    score = Score()
    for number in SENSORS:
        field = sky(catalogue, number, 40)
        telemetry = replace(field.blanked(1.0), star_id=None)
        matches = field.match(telemetry, patterns)
        assert STARTS.index("lost in space") in matches.start
        score.count(matches, field.blanked(1.0), field.true)
    assert score.solved >= 0.97 * score.frames
    assert score.wrong_share <= 0.002


@pytest.mark.parametrize(("start", "most_kept"), [("ground", 0.02), ("refined", 0.01)], ids=["ground", "refined"])
@pytest.mark.parametrize("of", ["the same image", "the whole sky"])
def test_wrong_names_are_found_out(catalogue, start, most_kept, of):
    rng, kept, changed, score = np.random.default_rng(3), 0, 0, Score()
    for number in SENSORS:
        field = sky(catalogue, number, 30, start=start)
        named = field.true > 0
        given = field.true.copy()
        image = 2 * field.telemetry.frame + field.telemetry.exposure
        for row in np.flatnonzero(named & (rng.random(len(named)) < 0.1)):
            others = named & (image == image[row]) if of == "the same image" else named
            given[row] = rng.choice(field.true[others])
        wrong = given != field.true
        telemetry = replace(field.telemetry, star_id=given, quaternion=None)
        matches = field.match(telemetry)
        kept, changed = kept + (wrong & (matches.star_id == given)).sum(), changed + wrong.sum()
        score.count(matches, telemetry, field.true)
    assert changed > 250
    assert kept <= most_kept * changed
    assert score.wrong_share <= 0.002


def test_a_set_whose_names_are_all_wrong_is_matched_from_its_quaternions_all_the_same(catalogue):
    score = Score()
    for number in (3, 5):
        field = sky(catalogue, number, 30)
        wrong = np.random.default_rng(5).permutation(field.true)
        named = replace(field.telemetry, star_id=np.where(wrong == field.true, 0, wrong))
        score.count(field.match(named), replace(named, star_id=np.zeros_like(field.true)), field.true)
    assert score.recovered >= 0.95
    assert score.wrong_share <= 0.003


def test_an_upright_image_gives_the_same_matches_and_attitudes(catalogue):
    field = sky(catalogue, 2, 20)
    telemetry = field.blanked(0.5)
    mirrored = replace(telemetry, col_px=field.sensor.columns - 1 - telemetry.col_px)
    x = field.x.copy()
    x[2], x[5] = field.sensor.columns - 1 - x[2], -x[5]
    right = field.match(telemetry)
    left = replace(field, sensor=replace(field.sensor, parity=-1, initial=x), x=x).match(mirrored)
    np.testing.assert_array_equal(left.star_id, right.star_id)
    np.testing.assert_allclose(left.quaternion, right.quaternion, atol=1e-9)
    np.testing.assert_allclose(left.attitude_covariance, right.attitude_covariance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("exposures", [1, 3])
def test_frames_of_one_exposure_and_of_three_are_matched_alike(catalogue, exposures):
    score = Score()
    for number in (1, 3, 6):
        field = sky(catalogue, number, 60 // exposures, exposures=exposures)
        telemetry = field.blanked(0.5)
        score.count(field.match(telemetry), telemetry, field.true)
    assert score.recovered >= 0.97
    assert score.wrong_share <= 0.003


@pytest.mark.parametrize("start", ["ground", "refined"])
def test_given_names_are_not_trimmed_where_the_centroid_noise_is_understated(catalogue, start):
    kept, named = 0, 0
    for number in SENSORS:
        field = sky(catalogue, number, 25, start=start)
        believed = replace(field, sensor=replace(field.sensor, centroid_sigma_px=0.2))
        matches = believed.match(replace(field.telemetry, sigma_px=None, quaternion=None))
        kept, named = kept + (matches.star_id == field.true)[field.true > 0].sum(), named + (field.true > 0).sum()
    assert kept >= 0.99 * named


def test_without_times_the_given_names_stand_and_nothing_is_added(catalogue):
    field = sky(catalogue, 1, 15, start="refined")
    whole = matched_telemetry(field.telemetry, field.match(field.telemetry))
    half = np.random.default_rng(1).random(len(field.true)) < 0.5
    telemetry = replace(
        whole, star_id=np.where(half, whole.star_id, 0), ra_rad=np.where(half, whole.ra_rad, np.nan),
        dec_rad=np.where(half, whole.dec_rad, np.nan), time_utc=None, quaternion=None,
    )  # fmt: skip
    matches = field.match(telemetry)
    np.testing.assert_array_equal(matches.star_id[matches.star_id > 0], telemetry.star_id[matches.star_id > 0])
    rich = np.repeat(np.add.reduceat(telemetry.star_id > 0, matches.exposure_start[:-1], dtype=int) >= 4,
                     np.diff(matches.exposure_start))  # fmt: skip
    assert np.mean(matches.star_id[rich & (telemetry.star_id > 0)] > 0) > 0.99


def test_double_stars_are_left_out_when_asked_and_say_so(catalogue):
    field = sky(catalogue, 3, 20, start="refined")
    every, fewer = (field.match(field.blanked(0.5), leave_out_doubles=choice) for choice in (False, True))
    gone = (every.star_id > 0) & (fewer.star_id == 0)
    assert gone.any()
    np.testing.assert_array_equal(gone, (every.flags > 0) & (every.star_id > 0))
    assert (fewer.row_reason[gone] == LEFT_OUT).all()
    assert np.isnan(fewer.s_i[gone]).all()
    assert not (every.row_reason == LEFT_OUT).any()


def test_the_order_of_the_frames_and_their_company_do_not_matter(catalogue):
    field = sky(catalogue, 5, 20)
    telemetry = field.blanked(0.3)
    order = np.argsort(-telemetry.frame, kind="stable")
    arrays = {name: value[order] for name, value in vars(telemetry).items() if isinstance(value, np.ndarray)}
    backwards = replace(telemetry, **{**arrays, "frame": 19 - arrays["frame"]})
    forth, back = field.match(telemetry), field.match(backwards)
    np.testing.assert_array_equal(back.star_id, forth.star_id[order])
    np.testing.assert_array_equal(back.row_reason, forth.row_reason[order])


def test_an_exposure_never_has_a_star_twice(catalogue):
    field = sky(catalogue, 4, 40)
    for share in (0.0, 0.5, 0.9):
        matches = field.match(field.blanked(share))
        for first, last in zip(matches.exposure_start[:-1], matches.exposure_start[1:], strict=True):
            found = matches.star_id[first:last][matches.star_id[first:last] > 0]
            assert len(set(found)) == len(found)
