"""Hipparcos-2 is trimmed once and cached whole; doubles by a search through all pairs; guide stars that an image resolves."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.sky.apparent import days_since_j2000, earth_state
from boresight.sky.catalogue import SINGLE_STAR, Catalogue, load_catalogue
from boresight.sky.guide_stars import DOUBLE, FAINTER_MAG, UNRELIABLE, guide_stars, observer_motion, phrases, star_flags

RAD_PER_MAS = np.pi / 180 / 3.6e6
SIRIUS, ALPHA_CENTAURI, VEGA, POLARIS = 32349, 71683, 91262, 11767
XI_URSAE_MAJORIS = 55203


def star(catalogue, hip):
    return int(catalogue.find_index(np.array([hip]))[0])


def same(one, other):
    return all(np.array_equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(Catalogue))


def test_the_catalogue_goes_down_to_the_magnitude_asked_for(catalogue):
    assert len(catalogue) == 117955
    assert len(load_catalogue(None, 8.0)) == 37622
    assert len(load_catalogue(None, 6.0)) == np.count_nonzero(catalogue.magnitude <= 6.0)
    none = load_catalogue(None, magnitude_limit=-5.0)
    assert (len(none), none.find_index(np.array([1, 2])).tolist()) == (0, [-1, -1])


def test_sirius_has_the_numbers_of_the_published_catalogue_in_which_most_stars_are_single(catalogue):
    k = star(catalogue, SIRIUS)
    assert np.degrees(catalogue.ra_rad[k]) == pytest.approx(101.28854105, abs=1e-6)
    assert np.degrees(catalogue.dec_rad[k]) == pytest.approx(-16.71314306, abs=1e-6)
    assert catalogue.parallax_rad[k] / RAD_PER_MAS == pytest.approx(379.21, abs=0.01)
    assert catalogue.pm_ra_cosdec_rad_yr[k] / RAD_PER_MAS == pytest.approx(-546.01, abs=0.01)
    assert catalogue.pm_dec_rad_yr[k] / RAD_PER_MAS == pytest.approx(-1223.07, abs=0.01)
    assert catalogue.magnitude[k] == pytest.approx(-1.09, abs=0.01)
    assert set(np.unique(catalogue.solution_type)) <= {0, 1, 3, 5, 7, 9}
    assert 0.9 < np.mean(catalogue.solution_type == SINGLE_STAR) < 1.0


@pytest.mark.parametrize("hip", [XI_URSAE_MAJORIS, 0, -1, 999_999, 115125])
def test_numbers_that_are_not_there_answer_minus_one(deep_catalogue, hip):
    assert star(deep_catalogue, hip) == -1


@given(hip=st.lists(st.integers(-5, 130_000), max_size=50))
def test_index_of_finds_each_star_under_its_own_number(catalogue, hip):
    hip = np.array(hip, dtype=np.int64)
    index = catalogue.find_index(hip)
    assert (catalogue.hip[index[index >= 0]] == hip[index >= 0]).all()
    assert not np.isin(hip[index < 0], catalogue.hip).any()


def test_each_magnitude_has_its_own_cache_of_what_the_package_holds_and_nothing_half_written(tmp_path, monkeypatch):
    folder = tmp_path / "catalogue"
    first, second = load_catalogue(folder, 6.0), load_catalogue(folder, 6.0)
    assert same(first, second)
    assert [path.suffix for path in folder.iterdir()] == [".npz"]
    assert len(load_catalogue(folder, 5.0)) < len(first)
    monkeypatch.setattr("boresight.sky.catalogue._read_package", lambda _: pytest.fail("the package was read again"))
    assert len(load_catalogue(folder, 6.0)) > 4000


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 half a file", b"\x93NUMPY"])
def test_a_damaged_cache_is_made_again(tmp_path, content):
    whole = load_catalogue(tmp_path, 6.0)
    cache = next(tmp_path.iterdir())
    cache.write_bytes(content)
    assert same(load_catalogue(tmp_path, 6.0), whole)
    assert cache.stat().st_size > 1000


def test_a_folder_that_cannot_be_made_means_no_cache(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_bytes(b"")
    assert len(load_catalogue(blocked / "catalogue", 6.0)) > 4000


ARCSEC = np.pi / 180 / 3600


def made(ra_rad, dec_rad, magnitude, **columns):
    n = len(ra_rad)
    columns = {"ra_rad": ra_rad, "dec_rad": dec_rad, "magnitude": magnitude, **columns}
    arrays = {field.name: np.zeros(n) for field in fields(Catalogue)} | {"solution_type": np.full(n, SINGLE_STAR)}
    return Catalogue(
        **arrays | {name: np.asarray(cells) for name, cells in columns.items()} | {"hip": np.arange(1, n + 1)}
    )


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 30), blend_arcsec=st.floats(1.0, 3000.0))
def test_the_flags_are_those_of_a_search_through_all_pairs(seed, n, blend_arcsec):
    rng = np.random.default_rng(seed)
    stars = made(
        0.02 * rng.random(n), 0.02 * rng.random(n), rng.uniform(0, 10, n), solution_type=rng.choice([1, 5, 7], n)
    )
    flags = star_flags(stars, blend_arcsec * ARCSEC)
    c = np.cos(stars.dec_rad)
    s = np.column_stack([c * np.cos(stars.ra_rad), c * np.sin(stars.ra_rad), np.sin(stars.dec_rad)])
    near = np.linalg.norm(s[:, None] - s[None], axis=2) <= 2 * np.sin(blend_arcsec * ARCSEC / 2)
    matters = stars.magnitude[None] - stars.magnitude[:, None] <= FAINTER_MAG
    expected = (near & matters & ~np.eye(n, dtype=bool)).any(axis=1)
    np.testing.assert_array_equal((flags & DOUBLE) > 0, expected)
    np.testing.assert_array_equal((flags & UNRELIABLE) > 0, stars.solution_type != SINGLE_STAR)


def test_a_companion_of_a_much_brighter_star_is_a_double_and_few_bright_ones_are(catalogue):
    pair = made(np.array([0.0, 20 * ARCSEC]), np.zeros(2), np.array([1.0, 6.0]))
    assert star_flags(pair, 30 * ARCSEC).tolist() == [0, DOUBLE]
    assert star_flags(pair, 10 * ARCSEC).tolist() == [0, 0]
    assert [phrases(flags) for flags in (0, UNRELIABLE | DOUBLE)] == [[], ["unreliable astrometry", "double"]]
    bright = star_flags(catalogue, 140 * ARCSEC)[catalogue.magnitude < 5.0]
    assert 0.01 < np.mean(bright & DOUBLE > 0) < 0.1
    assert 0.02 < np.mean(bright & UNRELIABLE > 0) < 0.3


@pytest.mark.parametrize("hip", [71683, 71681, 78820, 78821])  # alpha Centauri A and B, beta Scorpii
def test_famous_doubles_are_known(hip, catalogue):
    flags = star_flags(catalogue, 60 * ARCSEC)
    assert flags[catalogue.find_index(np.array([hip]))[0]] & DOUBLE


NOON = np.array(["2026-03-01T12:00", "2026-03-01T12:00", "NaT", "2026-09-01T00:00"], "datetime64[us]")


def test_only_the_brighter_of_two_stars_in_one_image_can_be_matched_and_none_too_faint_to_be_detected():
    catalogue = made([0.0, 1e-4, 0.1, 0.1], [0.0, 0.0, 0.0, 3e-4], [3.0, 4.0, 4.5, 4.2])
    found = [guide_stars(catalogue, 6.0, apart).hip.tolist() for apart in (2e-4, 5e-4, 5e-5)]
    assert found == [[1, 3, 4], [1, 4], [1, 2, 3, 4]]
    faint = made([0.0, 1e-4], [0.0, 0.0], [5.0, 7.0])
    assert [guide_stars(faint, limit, 1e-3).hip.tolist() for limit in (6.0, 4.0)] == [[1], []]


def test_guide_stars_ascend_in_declination_and_their_motion_is_across_the_line_of_sight(catalogue):
    stars = guide_stars(catalogue, 5.5, 1e-4)
    assert (np.diff(stars.place[:, 2]) >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(stars.place, axis=1), 1)
    assert stars.density == pytest.approx(len(stars.hip) / (4 * np.pi))
    assert (catalogue.magnitude[catalogue.find_index(stars.hip)] <= 5.5).all()
    stars = guide_stars(made([1.0, 2.0], [0.5, -0.5], [3.0, 3.0], pm_dec_rad_yr=[1e-6] * 2), 6.0, 1e-4)
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
    assert np.isnan(motion.years).tolist() == [False, False, True, False]  # at an unknown time no star has a place
    np.testing.assert_array_equal(motion[1:4].years, motion.years[1:4])
    np.testing.assert_array_equal(motion[1:4].beta, motion.beta[1:4])
