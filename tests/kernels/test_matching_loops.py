"""The compiled loops of matching against plain NumPy: rotations, apparent places, rows, eliminations, affine maps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from boresight.estimation.attitude import wahba
from boresight.kernels import matching as loops
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import load_catalogue
from boresight.sky.guide_stars import guide_stars, observer_motion
from tests.effort import effort
from tests.exposures import SIGMA, Exposure

#: Space for exposures of thirty detections, eight parameters and fifty guide stars.
WORK = loops.scratch(30, 11, 50)

# Wahba.


@settings(max_examples=effort(12, 60))
@given(seed=st.integers(0, 2**32), n=st.integers(2, 14), noise=st.sampled_from([0.0, 1e-5, 1e-3]))
def test_newton_steps_from_a_triad_reach_the_rotation_of_the_singular_values(seed, n, noise):
    rng = np.random.default_rng(seed)
    field = Exposure(rng, n)
    s = field.s + noise * rng.normal(size=(n, 3))
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    sigma = SIGMA * rng.uniform(0.5, 2, n)
    c, C = field.stars(), np.empty((3, 3))
    assert loops._wahba(s, c, 1 / sigma**2, np.ones(n, np.bool_), C, WORK)
    # what a nearly flat cost leaves open is bounded by the weakest axis; the rest is rounding
    plain = wahba(s, c, sigma)
    weakest = np.sqrt(np.linalg.eigvalsh(plain.covariance)[-1]) / SIGMA
    np.testing.assert_allclose(C, plain.C, atol=1e-12 * max(1.0, weakest))
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-14)


def test_stars_that_are_not_used_do_not_pull():
    field, C = Exposure(np.random.default_rng(1), 8), np.empty((3, 3))
    c = field.stars()
    c[3] = -c[3]
    loops._wahba(field.s, c, 1 / field.sigma**2, np.arange(8) != 3, C, WORK)
    np.testing.assert_allclose(C, field.C, atol=1e-12)


@pytest.mark.parametrize("apart", [0.0, 1e-4])
def test_stars_in_one_direction_give_no_attitude(apart):
    s = np.array([[0.0, 0.0, 1.0], [apart, 0.0, np.sqrt(1 - apart**2)]])
    assert not loops._wahba(s, s.copy(), np.full(2, 1e8), np.ones(2, np.bool_), np.empty((3, 3)), WORK)


def test_one_star_gives_no_attitude():
    s = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, np.sqrt(0.99)]])
    assert not loops._wahba(s, s.copy(), np.full(2, 1e8), np.array([True, False]), np.empty((3, 3)), WORK)


# Apparent places.


@pytest.mark.parametrize("date", ["1991-04-02T13:30", "2018-07-20", "2026-11-21T06:00", "2049-02-01"])
def test_the_short_form_of_apparent_place_agrees_with_the_standard_one(date):
    catalogue = load_catalogue(None)
    stars = guide_stars(catalogue, 15.0, 0.0)
    time, velocity = np.array([np.datetime64(date, "us")]), np.array([[3100.0, -6500.0, 2300.0]])
    motion, c = observer_motion(time, velocity), np.empty((len(stars.hip), 3))
    for j in range(len(stars.hip)):
        loops._apparent(
            stars.place, stars.motion, stars.parallax_rad, j,
            motion.years[0], motion.earth_au[0], motion.beta[0], c[j],
        )  # fmt: skip
    n = len(stars.hip)
    standard = apparent_directions(
        catalogue, catalogue.find_index(stars.hip), np.repeat(time, n), np.repeat(velocity, n, 0)
    )
    assert np.linalg.norm(c - standard, axis=1).max() < 1e-9


def test_the_stars_of_a_cone_are_found_at_the_poles_too():
    stars = guide_stars(load_catalogue(None), 6.0, 0.0)
    motion = observer_motion(np.array([np.datetime64("2026-01-01", "us")]), None)
    for axis in ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.0, 0.999, -np.sqrt(1 - 0.999**2)]):
        star, c = np.empty(len(stars.hip), np.int64), np.empty((len(stars.hip), 3))
        m = loops._candidates(
            np.array(axis), 0.3, stars.place, stars.motion, stars.parallax_rad,
            motion.years[0], motion.earth_au[0], motion.beta[0], star, c,
        )  # fmt: skip
        assert set(star[:m]) == set(np.flatnonzero(stars.place @ axis > np.cos(0.3)))


# Rows and eliminations.


def test_the_rows_are_the_derivatives_of_the_true_residual():
    field = Exposure(np.random.default_rng(2), 6)
    r = np.empty(2)

    def residuals(y):
        c = field.stars(y)
        rows = np.empty((6, 2))
        for i in range(6):
            loops._residual(field.s[i], field.T[i], field.C, c[i], r)
            rows[i] = r
        return rows

    for place, step in enumerate([1e-6] * 3 + [1e-3] * 8):
        y = step * np.eye(11)[place]
        slope = (residuals(y) - residuals(-y)) / (2 * step)
        np.testing.assert_allclose(field.A[:, :, place], slope, atol=2e-5 * np.abs(field.A[:, :, place]).max())


def test_tangent_vectors_are_a_right_handed_triad_with_their_star():
    field = Exposure(np.random.default_rng(3))
    np.testing.assert_allclose(np.cross(field.T[:, 0], field.T[:, 1]), field.s, atol=1e-14)
    np.testing.assert_allclose(field.T @ field.T.transpose(0, 2, 1), np.broadcast_to(np.eye(2), (12, 2, 2)), atol=1e-14)


@given(seed=st.integers(0, 2**32))
@settings(max_examples=20)
def test_what_stars_say_of_the_parameters_is_the_schur_complement(seed):
    rng = np.random.default_rng(seed)
    field = Exposure(rng, 7)
    Lambda, eta = field.information(np.ones(7, np.bool_), rng.normal(size=11) * ([1e-3] * 3 + [1] * 8))
    M, m, L = np.empty((8, 8)), np.empty(8), np.empty((11, 11))
    loops._marginal(np.tril(Lambda), eta, 11, L, M, m, WORK)
    a, b, c = Lambda[:3, :3], Lambda[3:, :3], Lambda[3:, 3:]
    np.testing.assert_allclose(M, c - b @ np.linalg.solve(a, b.T), rtol=1e-7, atol=1e-10 * np.abs(c).max())
    np.testing.assert_allclose(m, eta[3:] - b @ np.linalg.solve(a, eta[:3]), rtol=1e-6, atol=1e-10 * np.abs(eta).max())


def test_a_star_taken_into_the_information_and_out_again_leaves_it_as_it_was():
    field = Exposure(np.random.default_rng(4))
    Lambda, eta = field.information(np.arange(12) < 6)
    again, eta_again = np.tril(Lambda), eta.copy()
    loops._add(again, eta_again, field.A[7], 1e-4, -2e-4, 3e8, 11)
    with_it = again.copy()
    loops._add(again, eta_again, field.A[7], 1e-4, -2e-4, -3e8, 11)
    np.testing.assert_allclose(with_it, np.tril(Lambda + 3e8 * field.A[7].T @ field.A[7]), atol=1e-12 * with_it.max())
    np.testing.assert_allclose(again, np.tril(Lambda), atol=1e-12 * with_it.max())
    np.testing.assert_allclose(eta_again, eta, atol=1e-10)


# Directions that the file gives itself.


def sky_patch(rng, n=24):
    s = np.column_stack([rng.uniform(-0.09, 0.09, (n, 2)), np.ones(n)]) @ Rotation.random(rng=rng).as_matrix()
    return s / np.linalg.norm(s, axis=1, keepdims=True)


def refracted(s, zenith, strength=3e-4):
    up = zenith - (s @ zenith)[:, None] * s
    lifted = s + strength * up / (s @ zenith)[:, None]
    return lifted / np.linalg.norm(lifted, axis=1, keepdims=True)


@pytest.mark.parametrize("named", [6, 12])
def test_refraction_is_carried_from_named_stars_to_the_others(named):
    rng = np.random.default_rng(named)
    c = sky_patch(rng)
    aside = np.cross(c[0], c[5])
    shifted = refracted(c, (c[0] + aside / np.linalg.norm(aside)) / np.sqrt(2))
    twin = np.where(np.arange(24) < named, np.arange(24), -1)
    moved = c.copy()
    assert loops._affine(24, moved, shifted, twin, twin >= 0, SIGMA, WORK)
    assert np.linalg.norm(c - shifted, axis=1).min() > 1e-4
    assert np.linalg.norm(moved - shifted, axis=1).max() < 0.2 * SIGMA


def test_shifts_that_no_affine_map_explains_are_refused():
    rng = np.random.default_rng(5)
    c = sky_patch(rng)
    scattered = c + 5 * SIGMA * rng.normal(size=c.shape)
    assert not loops._affine(24, c.copy(), scattered, np.arange(24), np.ones(24, np.bool_), SIGMA, WORK)
