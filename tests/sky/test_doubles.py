"""Doubles by a search that looks at every pair, and known doubles by name."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.sky.catalogue import SINGLE_STAR, Catalogue
from boresight.sky.guide_stars import DOUBLE, FAINTER_MAG, UNRELIABLE, phrases, star_flags

ARCSEC = np.pi / 180 / 3600


def made(ra_rad, dec_rad, magnitude, solution_type=None):
    n = len(ra_rad)
    arrays = {field.name: np.zeros(n) for field in fields(Catalogue)}
    arrays |= {"hip": np.arange(1, n + 1), "ra_rad": ra_rad, "dec_rad": dec_rad, "magnitude": magnitude}
    arrays["solution_type"] = np.full(n, SINGLE_STAR) if solution_type is None else np.asarray(solution_type)
    return Catalogue(**arrays)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 30), blend_arcsec=st.floats(1.0, 3000.0))
def test_the_flags_are_those_of_a_search_through_all_pairs(seed, n, blend_arcsec):
    rng = np.random.default_rng(seed)
    stars = made(0.02 * rng.random(n), 0.02 * rng.random(n), rng.uniform(0, 10, n), rng.choice([1, 5, 7], n))
    flags = star_flags(stars, blend_arcsec * ARCSEC)
    c = np.cos(stars.dec_rad)
    s = np.column_stack([c * np.cos(stars.ra_rad), c * np.sin(stars.ra_rad), np.sin(stars.dec_rad)])
    near = np.linalg.norm(s[:, None] - s[None], axis=2) <= 2 * np.sin(blend_arcsec * ARCSEC / 2)
    matters = stars.magnitude[None] - stars.magnitude[:, None] <= FAINTER_MAG
    expected = (near & matters & ~np.eye(n, dtype=bool)).any(axis=1)
    np.testing.assert_array_equal((flags & DOUBLE) > 0, expected)
    np.testing.assert_array_equal((flags & UNRELIABLE) > 0, stars.solution_type != SINGLE_STAR)


def test_a_much_brighter_star_is_not_a_double_but_its_companion_is():
    pair = made(np.array([0.0, 20 * ARCSEC]), np.zeros(2), np.array([1.0, 6.0]))
    assert star_flags(pair, 30 * ARCSEC).tolist() == [0, DOUBLE]
    assert star_flags(pair, 10 * ARCSEC).tolist() == [0, 0]


@pytest.mark.parametrize("hip", [71683, 71681, 78820, 78821])  # alpha Centauri A and B, beta Scorpii
def test_famous_doubles_are_known(hip, catalogue):
    flags = star_flags(catalogue, 60 * ARCSEC)
    assert flags[catalogue.find_index(np.array([hip]))[0]] & DOUBLE


def test_few_bright_stars_are_flagged_within_a_few_pixels(catalogue):
    bright = star_flags(catalogue, 140 * ARCSEC)[catalogue.magnitude < 5.0]
    assert 0.01 < np.mean(bright & DOUBLE > 0) < 0.1
    assert 0.02 < np.mean(bright & UNRELIABLE > 0) < 0.3


def test_flags_are_said_in_words():
    assert phrases(0) == []
    assert phrases(UNRELIABLE | DOUBLE) == ["unreliable astrometry", "double"]
