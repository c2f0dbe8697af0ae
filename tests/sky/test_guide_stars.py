"""Guide stars: what an image resolves, in the order the loops need; and the observer's place and velocity."""

import numpy as np
import pytest

from boresight.sky.apparent import days_since_j2000, earth_state
from boresight.sky.catalogue import Catalogue
from boresight.sky.guide_stars import guide_stars, observer_motion

NOON = np.array(["2026-03-01T12:00", "2026-03-01T12:00", "NaT", "2026-09-01T00:00"], "datetime64[us]")


def made(ra, dec, magnitude, pm=0.0):
    n, zero = len(ra), np.zeros(len(ra))
    return Catalogue(
        hip=np.arange(1, n + 1), ra_rad=np.array(ra), dec_rad=np.array(dec), parallax_rad=zero + 1e-7,
        pm_ra_cosdec_rad_yr=zero, pm_dec_rad_yr=zero + pm, magnitude=np.array(magnitude), solution_type=np.full(n, 5),
    )  # fmt: skip


def test_only_the_brighter_of_two_stars_in_one_image_can_be_matched():
    catalogue = made([0.0, 1e-4, 0.1, 0.1], [0.0, 0.0, 0.0, 3e-4], [3.0, 4.0, 4.5, 4.2])
    assert guide_stars(catalogue, 6.0, 2e-4).hip.tolist() == [1, 3, 4]
    assert guide_stars(catalogue, 6.0, 5e-4).hip.tolist() == [1, 4]
    assert guide_stars(catalogue, 6.0, 5e-5).hip.tolist() == [1, 2, 3, 4]


def test_a_star_too_faint_to_be_detected_swallows_nothing_and_is_not_there():
    catalogue = made([0.0, 1e-4], [0.0, 0.0], [5.0, 7.0])
    assert guide_stars(catalogue, 6.0, 1e-3).hip.tolist() == [1]
    assert guide_stars(catalogue, 4.0, 1e-3).hip.tolist() == []


def test_guide_stars_ascend_in_declination_and_know_their_density(catalogue):
    stars = guide_stars(catalogue, 5.5, 1e-4)
    assert (np.diff(stars.place[:, 2]) >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(stars.place, axis=1), 1)
    assert stars.density == pytest.approx(len(stars.hip) / (4 * np.pi))
    assert (catalogue.magnitude[catalogue.find_index(stars.hip)] <= 5.5).all()


def test_proper_motion_is_a_vector_across_the_line_of_sight():
    stars = guide_stars(made([1.0, 2.0], [0.5, -0.5], [3.0, 3.0], pm=1e-6), 6.0, 1e-4)
    np.testing.assert_allclose(np.sum(stars.place * stars.motion, axis=1), 0, atol=1e-20)
    np.testing.assert_allclose(np.linalg.norm(stars.motion, axis=1), 1e-6)
    assert (stars.motion[:, 2] > 0).all()


def test_the_observer_moves_with_the_earth_and_the_satellite():
    velocity = np.array([[7e3, 0.0, 0.0], [np.nan] * 3, [0.0] * 3, [0.0] * 3])
    motion = observer_motion(NOON, velocity)
    place, speed = earth_state(days_since_j2000(NOON[[0, 3]]))
    np.testing.assert_allclose(motion.earth_au[[0, 1, 3]], place[[0, 0, 1]])
    np.testing.assert_allclose(motion.beta[0] - motion.beta[1], [7e3 / 299792458, 0, 0], atol=1e-18)
    np.testing.assert_allclose(motion.beta[3], speed[1] / 173.1446326846693)
    assert 34.9 < motion.years[0] < 35.0


def test_at_an_unknown_time_no_star_has_a_place():
    assert np.isnan(observer_motion(NOON, None).years).tolist() == [False, False, True, False]


def test_consecutive_exposures_keep_their_own_motion():
    whole = observer_motion(NOON, None)
    part = whole[1:4]
    np.testing.assert_array_equal(part.years, whole.years[1:4])
    np.testing.assert_array_equal(part.beta, whole.beta[1:4])
