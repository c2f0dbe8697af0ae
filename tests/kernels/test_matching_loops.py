"""The compiled loops of matching against plain NumPy, and their gates against the dense Gaussian they stand for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from boresight.estimation.attitude import attitudes, rotation_vector, wahba
from boresight.kernels import matching as loops
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import load_catalogue
from boresight.sky.guide_stars import guide_stars, observer_motion
from tests.effort import effort
from tests.exposures import GATE, SIGMA, Exposure

#: Space for exposures of forty detections, eight parameters and fifty guide stars.
WORK = loops.scratch(40, 11, 50)

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


def test_stars_that_are_not_used_do_not_pull_and_one_star_gives_no_attitude():
    field, C = Exposure(np.random.default_rng(1), 8), np.empty((3, 3))
    c = field.stars()
    c[3] = -c[3]
    loops._wahba(field.s, c, 1 / field.sigma**2, np.arange(8) != 3, C, WORK)
    np.testing.assert_allclose(C, field.C, atol=1e-12)
    s = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, np.sqrt(0.99)]])
    assert not loops._wahba(s, s.copy(), np.full(2, 1e8), np.array([True, False]), np.empty((3, 3)), WORK)


@pytest.mark.parametrize("apart", [0.0, 1e-4])
def test_stars_in_one_direction_give_no_attitude(apart):
    s = np.array([[0.0, 0.0, 1.0], [apart, 0.0, np.sqrt(1 - apart**2)]])
    assert not loops._wahba(s, s.copy(), np.full(2, 1e8), np.ones(2, np.bool_), np.empty((3, 3)), WORK)


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


def off_by(field, i, V, sigmas, turn):
    delta = sigmas * np.linalg.cholesky(V) @ [np.cos(turn), np.sin(turn)]
    c = (field.s[i] - delta @ field.T[i]) @ field.C
    return c / np.linalg.norm(c)


@pytest.mark.parametrize("y", [np.zeros(11), np.r_[2e-4, -1e-4, 3e-4, np.full(8, 0.5)]], ids=["as believed", "off"])
@pytest.mark.parametrize("i", [3, 9])
def test_a_star_is_taken_inside_the_gate_of_the_conditioned_gaussian_and_not_outside(i, y):
    field = Exposure(np.random.default_rng(i))
    use = np.arange(12) != i
    Lambda, eta = field.information(use, y)
    predicted = field.A[i] @ np.linalg.solve(Lambda, eta)
    V = field.A[i] @ np.linalg.solve(Lambda, field.A[i].T)
    V += (SIGMA**2 + loops._CURVATURE**2 * predicted @ predicted) * np.eye(2)
    for turn in np.linspace(0, 2 * np.pi, 7):
        for sigmas, expected in ((0.99 * GATE, loops.MATCHED), (1.01 * GATE, loops.NO_STAR)):
            c = off_by(field, i, V, sigmas, turn) - predicted @ field.T[i] @ field.C
            used, chosen, reason = use.copy(), np.zeros(12, np.int64), np.zeros(12, np.int64)
            loops._grow(
                field.s, field.T, field.A, field.sigma, field.C, 1, c[None], np.empty((1, 3)), np.zeros(1, np.bool_),
                0.0, GATE, np.tril(Lambda), eta.copy(), used, chosen, reason, np.zeros((11, 11)), np.empty(11), WORK,
            )  # fmt: skip
            assert reason[i] == expected
            assert used[i] == (expected == loops.MATCHED)


def pruned(field, c, named, use):
    r, Lambda, eta = np.empty(2), np.diag([loops._DIFFUSE] * 3 + [1.0] * 8), np.zeros(11)
    for i in np.flatnonzero(use):
        loops._residual(field.s[i], field.T[i], field.C, c[i], r)
        loops._add(Lambda, eta, field.A[i], *r, 1 / loops._variance(SIGMA, *r), 11)
    kept, reason, tolerance = use.copy(), np.zeros(12, np.int64), np.full(12, np.nan)
    loops._prune(
        field.s, field.T, field.A, field.sigma, field.C, c, named, GATE, Lambda, eta, kept, reason, tolerance,
        np.zeros((11, 11)), np.empty(11), WORK,
    )  # fmt: skip
    return kept, tolerance


@pytest.mark.parametrize("named", [False, True])
def test_a_star_is_dropped_where_the_others_predict_it_elsewhere_and_believed_with_more_noise_where_named(named):
    field = Exposure(np.random.default_rng(8))
    i, others = 4, np.arange(12) != 4
    own = (SIGMA * loops._GIVEN_NOISE if named else SIGMA) ** 2
    Lambda, _ = field.information(others)
    spread = field.A[i] @ np.linalg.solve(Lambda, field.A[i].T)
    for turn in np.linspace(0, 2 * np.pi, 5):
        for share, stays in ((0.98, True), (1.02, False)):
            c, V = field.stars(), spread + own * np.eye(2)
            for _ in range(20):  # the curvature's part grows with the distance itself
                c[i] = off_by(field, i, V, share * GATE, turn)
                r = field.T[i] @ (field.s[i] - field.C @ c[i])
                V = spread + (own + loops._CURVATURE**2 * r @ r) * np.eye(2)
            kept, _ = pruned(field, c, np.full(12, named), np.ones(12, np.bool_))
            assert kept[i] == stays
            assert kept[others].all()
    axes = GATE * np.sqrt(np.linalg.eigvalsh(spread + SIGMA**2 * np.eye(2)))
    kept, tolerance = pruned(field, field.stars(), np.full(12, named), np.ones(12, np.bool_))
    assert axes[0] <= tolerance[i] <= axes[1]


@given(seed=st.integers(0, 2**32), parameters=st.booleans(), share=st.sampled_from([-1.02, -0.98, 0.98, 1.02]))
def test_arcs_agree_within_the_gate_of_their_own_variance(seed, parameters, share):
    rng = np.random.default_rng(seed)
    field = Exposure(rng, 2, spread=rng.choice([0.1, 1.0]))
    s, G = field.s, field.G if parameters else np.zeros((2, 3, 0))
    phi = np.arctan2(np.linalg.norm(np.cross(*s)), s[0] @ s[1])
    slope = -(s[1] @ G[0] + s[0] @ G[1]) / np.sin(phi)
    allowed = GATE * np.sqrt(2 * SIGMA**2 + slope @ slope)
    if allowed > 0.1 * phi:
        return  # the arc is too short for a first-order answer
    axis = np.cross(*s) / np.linalg.norm(np.cross(*s))
    c = np.array([s[0], Rotation.from_rotvec(share * allowed * axis).apply(s[1])]) @ field.C
    answers = [loops._arcs_agree(s, G, field.sigma, 0, 1, c, 0, 1, GATE, widest) for widest in (np.inf, 1e-9)]
    assert answers == [abs(share) < 1, False]


def test_two_detections_in_one_place_have_no_arc():
    s = np.array([[0.0, 0.0, 1.0]] * 2)
    assert not loops._arcs_agree(s, np.zeros((2, 3, 0)), np.ones(2), 0, 1, s, 0, 1, GATE, np.inf)


# Attitude covariance.


@pytest.mark.parametrize("n", [4, 12])
def test_the_attitude_covariance_is_that_of_many_draws_of_noise_and_parameters(n):
    rng = np.random.default_rng(n)
    field, covariance, draws = Exposure(rng, n), np.empty((3, 3)), 3000
    loops._attitude_covariance(field.A, field.sigma, np.ones(n, np.bool_), covariance, WORK)
    true = np.stack([field.stars(np.r_[np.zeros(3), w]) for w in 0.2 * rng.normal(size=(draws, 8))])
    noise = 0.2 * SIGMA * rng.normal(size=(draws, n, 2))
    seen = field.s + np.einsum("dnr,nra->dna", noise, field.T)
    found = attitudes(np.arange(draws + 1) * n, seen.reshape(-1, 3), true.reshape(-1, 3), np.full(draws * n, SIGMA))
    theta = rotation_vector(Rotation.from_matrix(found.C @ field.C.T).as_quat())
    root = np.linalg.inv(np.linalg.cholesky(0.04 * covariance))
    np.testing.assert_allclose(root @ np.cov(theta.T) @ root.T, np.eye(3), atol=0.12)
