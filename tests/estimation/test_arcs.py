"""Pairs, order and covariance of arclengths, held against their plain forms and against Monte Carlo."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import arcs
from tests.effort import effort
from tests.estimation.fields import GROUND, NOISE_PX, PITCH, star_field, weighed


def _scattered(rng, n, half_width=0.17):
    xy = rng.uniform(-half_width, half_width, (n, 2))
    return np.column_stack([xy, np.ones(n)]) / np.linalg.norm(np.column_stack([xy, np.ones(n)]), axis=1)[:, None]


def _dense_factor(band):
    n = len(band)
    L = np.zeros((n, n))
    for d in range(5):
        L[np.arange(d, n), np.arange(n - d)] = band[d:, 4 - d]
    return L


@pytest.mark.parametrize("n", [4, 5, 7, 12, 40])
def test_an_exposure_of_n_stars_has_2n_minus_3_arcs_that_connect_every_star(n):
    pairs = arcs.pairs(n)
    assert len(pairs) == 2 * n - 3
    assert len({tuple(pair) for pair in pairs}) == 2 * n - 3
    assert set(pairs.ravel()) == set(range(n))


@given(n=st.integers(4, 120), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=effort(20, 100), deadline=None)
def test_the_order_is_a_permutation_and_keeps_R_well_conditioned(n, seed):
    s = _scattered(np.random.default_rng(seed), n)
    places, fatness = arcs.order(np.array([0, n]), s)
    assert sorted(places) == list(range(n))
    R = arcs.covariance(s[places], np.ones(n))
    smallest = np.linalg.eigvalsh(R)[0]
    assert smallest > 0
    assert fatness[0] > 0.05 or n < 12
    if fatness[0] > 0.02:
        # bending modes of a long strip of triangles are soft, yet whitening keeps at least eight of sixteen digits
        assert np.linalg.cond(R) < 1e8


@given(seed=st.integers(0, 2**32 - 1), angle=st.floats(0, np.pi))
@example(seed=2975, angle=0.0)  # placed greedily, the last three stars lie on one line
@settings(deadline=None)
def test_two_lines_of_stars_are_woven_so_that_no_three_in_a_row_are_collinear(seed, angle):
    rng = np.random.default_rng(seed)
    along = np.sort(rng.uniform(-0.15, 0.15, 10)) + np.arange(10) * 1e-3
    xy = np.concatenate(
        [np.column_stack([along[:5], np.zeros(5) + 0.05]), np.column_stack([along[5:], np.zeros(5) - 0.05])]
    )
    xy = xy @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    s = np.column_stack([xy, np.ones(10)])
    _, fatness = arcs.order(np.array([0, 10]), s / np.linalg.norm(s, axis=1)[:, None])
    assert fatness[0] > arcs.COLLINEAR


def test_stars_on_one_great_circle_are_called_collinear():
    across = np.linspace(-0.1, 0.1, 9)
    s = np.column_stack([np.sin(across), np.zeros(9), np.cos(across)])
    _, fatness = arcs.order(np.array([0, 9]), s)
    assert fatness[0] < arcs.COLLINEAR


@pytest.mark.parametrize("n", [4, 6, 11, 60])
def test_the_banded_factor_is_the_cholesky_factor_of_the_full_covariance(n):
    rng = np.random.default_rng(n)
    field = star_field(rng, frames=1, mean_stars=n)
    sigma = rng.uniform(1e-5, 1e-4, field.n_stars)
    banded, bad = arcs.whiten(field, sigma)
    assert not bad.any()
    for k in range(field.n_exposures):
        stars = slice(field.star_start[k], field.star_start[k + 1])
        rows = slice(2 * stars.start - 3 * k, 2 * stars.stop - 3 * (k + 1))
        R = arcs.covariance(field.s_i[stars], sigma[stars])
        np.testing.assert_allclose(_dense_factor(banded.band[rows]), np.linalg.cholesky(R), rtol=1e-8, atol=1e-12)
        half_band = np.abs(np.subtract.outer(np.arange(len(R)), np.arange(len(R))))
        assert not R[half_band > 4].any()


def test_R_is_the_covariance_of_simulated_arc_errors():
    rng = np.random.default_rng(8)
    row, col = rng.uniform(100, 1800, 8), rng.uniform(100, 2400, 8)
    s = INVERTED_WANG.directions(GROUND, row, col, PITCH)
    pair = arcs.pairs(8)
    sigma_px = 0.5
    noise = rng.normal(size=(2, 20_000, 8)) * sigma_px
    measured = INVERTED_WANG.directions(GROUND, row + noise[0], col + noise[1], PITCH)
    errors = arcs.arclength(measured[:, pair[:, 0]], measured[:, pair[:, 1]])
    sampled = np.cov(errors.T)
    down = INVERTED_WANG.directions(GROUND, row + 1, col, PITCH) - s
    right = INVERTED_WANG.directions(GROUND, row, col + 1, PITCH) - s
    predicted = arcs.covariance(s, sigma_px * np.sqrt(np.linalg.norm(np.cross(down, right), axis=1)))
    scale = np.sqrt(np.outer(np.diag(predicted), np.diag(predicted)))
    # 20,000 samples know a correlation to 0.7 %; the isotropic approximation is off by cos(theta), 6 % at the corners
    assert np.abs(sampled - predicted).max() < 0.07 * scale.max()
    assert np.abs(np.diag(sampled) / np.diag(predicted) - 1).max() < 0.12


@given(separation=st.floats(1e-9, np.pi - 1e-9))
def test_arclength_is_exact_at_every_separation(separation):
    a = np.array([[1.0, 0, 0]])
    b = np.array([[np.cos(separation), np.sin(separation), 0]])
    np.testing.assert_allclose(arcs.arclength(a, b), separation, rtol=1e-12)


def test_a_part_of_a_set_has_the_arcs_of_its_frames():
    field = weighed(star_field(np.random.default_rng(2), frames=9), GROUND)
    parts = [field.frames(0, 4), field.frames(4, 9)]
    np.testing.assert_array_equal(np.concatenate([part.phi for part in parts]), field.phi)
    np.testing.assert_array_equal(np.concatenate([part.band for part in parts]), field.band)
    assert sum(part.n_arcs for part in parts) == field.n_arcs
    assert field.sigma_px[0] == NOISE_PX


@given(stars=st.integers(4, 12), seed=st.integers(0, 2**32 - 1))
def test_rounding_of_the_directions_does_not_choose_another_order(stars, seed):
    rng = np.random.default_rng(seed)
    s_i = rng.normal(size=(stars, 3)) * 0.1 + [0.0, 0.0, 1.0]
    s_i /= np.linalg.norm(s_i, axis=1, keepdims=True)
    starts = np.array([0, stars])
    places, _ = arcs.order(starts, s_i)
    again, _ = arcs.order(starts, s_i + 1e-16 * rng.integers(-1, 2, s_i.shape))
    np.testing.assert_array_equal(again, places)
